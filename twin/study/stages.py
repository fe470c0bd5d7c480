"""One virtual measurement in stages that hand their results on to the next case.

press -> texture -> geometry -> view -> trace -> frames -> capture -> reconstruction; each is kept,
and used again for every later case that has the same values in all fields that the stage looked at,
and the same earlier stages. The bytes are those of `measure`.
"""

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from reconstruction.pipeline import Reconstruction, reconstruct
from twin.config import Experiment
from twin.mechanics import PressedElastomer, face_mesh
from twin.mechanics.scaling import unit_press, with_modulus
from twin.modalities.contact_fpp import check_layers, options_of, press_smooth, with_texture
from twin.modalities.progress import Stopwatch
from twin.modalities.recording import Recording, expose_capture
from twin.modalities.score import Score, score
from twin.optics.backend import activate
from twin.optics.stack import RadianceStack
from twin.study.memo import Kept, Memo
from twin.study.reads import Path

if TYPE_CHECKING:
    from twin.optics.one_trace import Patches
    from twin.optics.shared_trace import Geometry, View

# A pressed face has a few MB: kept longer than the rest, which at full size has 600 MB per stack.
_FACES = 8


@dataclass(frozen=True, eq=False)
class Staged:
    """One case, whole: as `Measurement`, without the clock."""

    pressed: PressedElastomer
    recording: Recording
    reconstruction: Reconstruction
    score: Score


@dataclass(frozen=True, eq=False)
class _Pressed:
    """A press, and the digest of its coated face, which names it wherever it came from."""

    pressed: PressedElastomer
    face_digest: str


class ContactStages:
    """Contact-FPP, case after case."""

    def __init__(self) -> None:
        self._shape: Memo[_Pressed | None] = Memo("shape", _FACES)
        self._press: Memo[_Pressed] = Memo("press", _FACES)
        self._texture: Memo[_Pressed] = Memo("texture", _FACES)
        self._geometry: Memo[Geometry] = Memo("geometry")
        self._view: Memo[View] = Memo("view")
        self._trace: Memo[Patches] = Memo("trace")
        self._frames: Memo[RadianceStack] = Memo("frames")
        self._capture: Memo[Recording] = Memo("capture")
        self._points: Memo[Reconstruction] = Memo("reconstruction")

    def measure(self, experiment: Experiment) -> Staged:
        """Run one measurement, each stage only where no kept result is the same.

        Raises
        ------
        InputError
            Something in the experiment cannot be pressed, rendered or fitted.
        MissingBackend
            No usable Dr.Jit backend.
        """
        press = self._pressed(experiment)
        radiance = self._radiance(experiment, press)
        capture = self._capture.recall(
            experiment,
            radiance.token,
            lambda seen: expose_capture(seen, radiance.value, Stopwatch(), 0),
        )
        points = self._points.recall(
            experiment,
            capture.token,
            lambda seen: reconstruct(capture.value.capture, options_of(seen.decode)),
        )
        scored = score(experiment, points.value, radiance.value.truth)
        return Staged(press.pressed, capture.value, points.value, scored)

    def stages(self) -> Iterator[tuple[str, int, int, tuple[Path, ...]]]:
        """Yield name, times computed, times recalled and fields read of every stage in order."""
        memos: tuple[Memo[Any], ...] = (
            self._shape,
            self._press,
            self._texture,
            self._geometry,
            self._view,
            self._trace,
            self._frames,
            self._capture,
            self._points,
        )
        for memo in memos:
            reads = memo.latest_reads
            yield memo.name, memo.computed, memo.recalled, reads.paths if reads else ()

    def _pressed(self, experiment: Experiment) -> _Pressed:
        smooth, token = self._smooth(experiment)
        made_from = token, smooth.pressed.young_modulus_kpa
        return self._texture.recall(
            experiment, made_from, lambda seen: _with_texture(seen, smooth)
        ).value

    def _smooth(self, experiment: Experiment) -> tuple[_Pressed, int]:
        shape = self._shape.recall(experiment, (), _unit_press)
        if shape.value is None:
            own = self._press.recall(experiment, (), _own_press)
            return own.value, own.token
        scaled = with_modulus(shape.value.pressed, experiment.elastomer)
        return _Pressed(scaled, shape.value.face_digest), shape.token

    def _radiance(self, experiment: Experiment, press: _Pressed) -> Kept[RadianceStack]:
        activate()
        from twin.optics import shared_trace
        from twin.optics.render import render

        check_layers(experiment)
        if experiment.render.engine != "one_trace":
            return self._frames.recall(
                experiment,
                press.face_digest,
                lambda seen: render(seen, face_mesh(press.pressed)),
            )
        geometry = self._geometry.recall(
            experiment,
            press.face_digest,
            lambda seen: shared_trace.load_geometry(seen, face_mesh(press.pressed)),
        )
        view = self._view.recall(
            experiment, geometry.token, lambda seen: shared_trace.view_of(seen, geometry.value)
        )
        trace = self._trace.recall(
            experiment,
            view.token,
            lambda seen: shared_trace.patches_of(seen, geometry.value, view.value),
        )
        return self._frames.recall(
            experiment,
            trace.token,
            lambda seen: RadianceStack(
                shared_trace.frames_of(seen, geometry.value, view.value, trace.value),
                view.value.truth,
            ),
        )


def _unit_press(experiment: Experiment) -> _Pressed | None:
    pressed = unit_press(
        experiment.mechanics, experiment.specimen, experiment.elastomer, experiment.press
    )
    return None if pressed is None else _Pressed(pressed, face_digest(pressed))


def _own_press(experiment: Experiment) -> _Pressed:
    pressed = press_smooth(experiment)
    return _Pressed(pressed, face_digest(pressed))


def _with_texture(experiment: Experiment, smooth: _Pressed) -> _Pressed:
    pressed = with_texture(experiment, smooth.pressed)
    return smooth if pressed is smooth.pressed else _Pressed(pressed, face_digest(pressed))


def face_digest(pressed: PressedElastomer) -> str:
    """Name a coated face by its heights and the nodes that they stand on."""
    name = hashlib.blake2b(digest_size=16)
    for values in (pressed.face_x_mm, pressed.face_y_mm, pressed.face_z_mm):
        name.update(repr(values.shape).encode() + values.tobytes())
    return name.hexdigest()
