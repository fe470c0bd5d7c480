"""Quantities that a sample of a data set may contain, each with its axes, unit and frame.

Images are over camera pixels, (row, col). No value is NaN: a quantity is 0 where it does not exist,
and `label`, `lit` or `decoded_reason` state where that is. Phases are those of the measuring period
along a projector axis: phase = 2 pi coordinate / period, with the coordinate 0 at the middle of the
first pixel.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RegularGridInterpolator

from reconstruction.arrays import FloatArray
from reconstruction.errors import InputError
from reconstruction.patterns import Axis, PatternSet
from reconstruction.pipeline import Reconstruction
from twin.config import Experiment
from twin.mechanics import PressedElastomer
from twin.mechanics.choice import may_wrap
from twin.optics.light import pattern_set
from twin.optics.stack import Truth
from twin.results.record import Colours, Recording

Array = NDArray[Any]
Need = Literal["fringes", "column", "row", "uniform", "press", "sheet", "colours", "decoded"]

STAGE, MEASURED = 1, 2
"""Labels of a pixel: 0 no surface, 1 the stage, 2 the measured surface (coat or specimen)."""


@dataclass(frozen=True, eq=False)
class TakenSample:
    """Results of the stages of one sample from which its quantities are computed.

    Attributes
    ----------
    experiment : the drawn experiment
    truth : true geometry at every camera pixel
    pressed : pressed elastomer; None if the bare specimen is imaged
    recording : frames and radiance of fringe projection; None for photometric stereo
    reconstruction : decoded frames; None if no quantity needs them
    colours : image of a photometric sensor with its decoded heights; None for fringes
    """

    experiment: Experiment
    truth: Truth
    pressed: PressedElastomer | None = None
    recording: Recording | None = None
    reconstruction: Reconstruction | None = None
    colours: Colours | None = None

    @property
    def patterns(self) -> PatternSet:
        """The projected patterns."""
        return self.fringes.capture.patterns

    @property
    def fringes(self) -> Recording:
        """Recorded fringes; TypeError for another method."""
        if self.recording is None:
            raise TypeError(f"{self.experiment.modality} takes no fringes")
        return self.recording

    @property
    def maps(self) -> Reconstruction:
        """Decoded fringes; TypeError if they were not decoded."""
        if self.reconstruction is None:
            raise TypeError("the frames were not decoded")
        return self.reconstruction

    @property
    def face(self) -> PressedElastomer:
        """The pressed elastomer; TypeError if the method has no press."""
        if self.pressed is None:
            raise TypeError(f"{self.experiment.modality} presses nothing")
        return self.pressed

    @property
    def image(self) -> Colours:
        """Image of a photometric sensor; TypeError for another method."""
        if self.colours is None:
            raise TypeError(f"{self.experiment.modality} takes no colours")
        return self.colours


@dataclass(frozen=True)
class SampleQuantity:
    """Description of one quantity of a sample.

    Attributes
    ----------
    axes : names of the axes of the array
    unit : unit of the values; 1 for numbers without unit
    meaning : one sentence for the data card
    values : function that returns the array of a sample
    needs : traits of the experiment that the quantity needs
    """

    axes: tuple[str, ...]
    unit: str
    meaning: str
    values: Callable[[TakenSample], Array]
    needs: tuple[Need, ...] = ()


PIXELS, VECTORS, COLOURS = ("row", "col"), ("row", "col", "xyz"), ("row", "col", "rgb")
_TURN = 2.0 * np.pi


def _frames(taken: TakenSample) -> Array:
    capture = taken.fringes.capture
    kind = np.uint8 if capture.bit_depth <= 8 else np.uint16
    stack = capture.stack  # float without noise
    whole = stack if np.issubdtype(stack.dtype, np.integer) else np.rint(stack)
    return whole.astype(kind, copy=False)


def _white(taken: TakenSample) -> Array:
    return np.asarray(taken.fringes.radiance.frames[taken.patterns.index("white").start])


def _label(taken: TakenSample) -> Array:
    truth = taken.truth
    stage = np.where(truth.depth_mm > 0, STAGE, 0)
    return np.where(truth.measured, MEASURED, stage).astype(np.uint8)


def _coordinate_px(taken: TakenSample, axis: Axis) -> Array:
    return taken.truth.column_px if axis == "column" else taken.truth.row_px


def _phase(taken: TakenSample, axis: Axis) -> FloatArray:
    """Return the true absolute phase, rad; 0 at pixels that the projector does not light."""
    turns = _coordinate_px(taken, axis) / taken.patterns.period_along(axis)
    return np.asarray(np.where(taken.truth.lit, _TURN * turns, 0.0))


def _phase_32(taken: TakenSample, axis: Axis) -> Array:
    return _phase(taken, axis).astype(np.float32)


def _wrapped_phase(taken: TakenSample, axis: Axis) -> Array:
    # Rounding to float32 must not give 2 pi, which is the next fringe.
    below_turn = np.nextafter(np.float32(_TURN), np.float32(0))
    return np.minimum(np.mod(_phase(taken, axis), _TURN).astype(np.float32), below_turn)


def _order(taken: TakenSample, axis: Axis) -> Array:
    return np.floor(_phase(taken, axis) / _TURN).astype(np.int16)


def _decoded_phase(taken: TakenSample, axis: Axis) -> Array:
    decoded = taken.maps.decoded
    maps = decoded.column if axis == "column" else decoded.row
    turns = maps.coordinate_px / taken.patterns.period_along(axis)
    return np.where(decoded.valid, _TURN * turns, 0.0).astype(np.float32)


def _decoded_wrapped_phase(taken: TakenSample, axis: Axis) -> Array:
    decoded = taken.maps.decoded
    return np.asarray((decoded.column if axis == "column" else decoded.row).phase_rad, np.float32)


def _decoded_modulation(taken: TakenSample, axis: Axis) -> Array:
    decoded = taken.maps.decoded
    maps = decoded.column if axis == "column" else decoded.row
    return np.asarray(maps.modulation_dn, np.float32)


def _decoded_depth(taken: TakenSample) -> Array:
    if taken.colours is None:
        return np.asarray(taken.maps.point_map.points_cam_mm[..., 2], np.float32)
    heights = taken.colours.heights
    # The camera looks along -z: the depth is its distance from z = 0, less the height.
    depth_mm = taken.experiment.camera.pose.standoff_mm - heights.height_mm
    return np.where(heights.valid, depth_mm, 0.0).astype(np.float32)


def _decoded_normal(taken: TakenSample) -> Array:
    if taken.colours is None:
        return np.asarray(taken.maps.point_map.normals_world, np.float32)
    heights = taken.colours.heights
    # Slopes are downwards and to the right, world y is upwards.
    down, right = heights.slopes
    normal = np.stack([-right, down, np.ones_like(down)], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    return np.where(heights.valid[..., None], normal, 0.0).astype(np.float32)


def _decoded_reason(taken: TakenSample) -> Array:
    if taken.colours is None:
        return np.asarray(taken.maps.point_map.mask_reason, np.uint8)
    return np.asarray(taken.colours.heights.mask_reason, np.uint8)


def _on_pixels(
    taken: TakenSample, x_mm: FloatArray, y_mm: FloatArray, values: Array, method: str = "linear"
) -> FloatArray:
    """Return a field of the press, (y, x), at the world x and y of the point of each pixel."""
    field = RegularGridInterpolator(
        (y_mm, x_mm), values.astype(np.float64), method, bounds_error=False, fill_value=0.0
    )
    points = taken.truth.points_world_mm
    shown = field(np.stack([points[..., 1], points[..., 0]], axis=-1).astype(np.float64))
    return np.asarray(np.where(taken.truth.measured, shown, 0.0))


def _contact(taken: TakenSample) -> Array:
    face = taken.face
    return _on_pixels(taken, face.x_mm, face.y_mm, face.contact, "nearest").astype(np.uint8)


def _pressure(taken: TakenSample) -> Array:
    face = taken.face
    return _on_pixels(taken, face.x_mm, face.y_mm, face.pressure_kpa).astype(np.float32)


def _touched_face(taken: TakenSample) -> Array:
    face = taken.face
    return _on_pixels(taken, face.x_mm, face.y_mm, face.touched_face_mm).astype(np.float32)


def _thickness(taken: TakenSample) -> Array:
    face = taken.face
    assert face.sheet is not None  # `check_held`
    field = face.sheet.thickness_mm
    return _on_pixels(taken, face.face_x_mm, face.face_y_mm, field).astype(np.float32)


def _along(axis: Axis) -> Mapping[str, SampleQuantity]:
    """Return the quantities along one projector axis, by name."""
    needs: tuple[Need, ...] = ("fringes", axis)
    at = partial(partial, axis=axis)
    return {
        f"projector_{axis}_px": SampleQuantity(
            PIXELS,
            "px",
            f"true projector {axis} of the surface point; whole at pixel centres",
            at(_coordinate_px),
            ("fringes",),
        ),
        f"phase_{axis}_rad": SampleQuantity(
            PIXELS,
            "rad",
            f"true absolute phase along {axis}s; 0 where not lit",
            at(_phase_32),
            needs,
        ),
        f"wrapped_phase_{axis}_rad": SampleQuantity(
            PIXELS, "rad", f"true phase along {axis}s in [0, 2 pi)", at(_wrapped_phase), needs
        ),
        f"order_{axis}": SampleQuantity(
            PIXELS, "1", f"true fringe order along {axis}s", at(_order), needs
        ),
        f"decoded_phase_{axis}_rad": SampleQuantity(
            PIXELS,
            "rad",
            f"decoded absolute phase along {axis}s; 0 where masked",
            at(_decoded_phase),
            (*needs, "decoded"),
        ),
        f"decoded_wrapped_phase_{axis}_rad": SampleQuantity(
            PIXELS,
            "rad",
            f"decoded phase along {axis}s of the single pixel, in [0, 2 pi)",
            at(_decoded_wrapped_phase),
            (*needs, "decoded"),
        ),
        f"decoded_modulation_{axis}_dn": SampleQuantity(
            PIXELS,
            "DN",
            f"amplitude of the fringes along {axis}s",
            at(_decoded_modulation),
            (*needs, "decoded"),
        ),
    }


SAMPLE_QUANTITIES: Mapping[str, SampleQuantity] = {
    "frames": SampleQuantity(
        ("frame", "row", "col"),
        "DN",
        "recorded frames; uint8 up to 8 bits of the camera, else uint16",
        _frames,
        ("fringes",),
    ),
    "radiance": SampleQuantity(
        ("frame", "row", "col"),
        "mW / (mm^2 sr)",
        "noise-free frames: mean radiance of each pixel",
        lambda taken: np.stack(taken.fringes.radiance.frames),
        ("fringes",),
    ),
    "white": SampleQuantity(
        PIXELS,
        "mW / (mm^2 sr)",
        "noise-free radiance under the white frame",
        _white,
        ("fringes", "uniform"),
    ),
    "image": SampleQuantity(
        COLOURS,
        "level",
        "image of the pressed gel",
        lambda taken: taken.image.picture,
        ("colours",),
    ),
    "background": SampleQuantity(
        COLOURS,
        "level",
        "mean image of the undeformed gel",
        lambda taken: taken.image.calibration.background,
        ("colours",),
    ),
    "depth_mm": SampleQuantity(
        PIXELS,
        "mm",
        "true distance from the camera along its optical axis",
        lambda taken: taken.truth.depth_mm,
    ),
    "normal_world": SampleQuantity(
        VECTORS, "1", "true unit normal, world frame", lambda taken: taken.truth.normals_world
    ),
    "point_world_mm": SampleQuantity(
        VECTORS,
        "mm",
        "true surface point, world frame",
        lambda taken: taken.truth.points_world_mm,
    ),
    "label": SampleQuantity(
        PIXELS, "1", "0 no surface, 1 stage, 2 measured surface (coat or specimen)", _label
    ),
    "lit": SampleQuantity(
        PIXELS,
        "1",
        "1 where the point is lit by the projector, or in the evaluated field (photometric)",
        lambda taken: taken.truth.lit.astype(np.uint8),
    ),
    "contact": SampleQuantity(
        PIXELS,
        "1",
        "1 where the elastomer below the point touches the object",
        _contact,
        ("press",),
    ),
    "pressure_kpa": SampleQuantity(
        PIXELS, "kPa", "contact pressure below the point", _pressure, ("press",)
    ),
    "touched_face_z_mm": SampleQuantity(
        PIXELS,
        "mm",
        "world z of the touched face below the point; in the contact the object's surface",
        _touched_face,
        ("press",),
    ),
    "thickness_mm": SampleQuantity(
        PIXELS, "mm", "local thickness of the sheet", _thickness, ("press", "sheet")
    ),
    **_along("column"),
    **_along("row"),
    "decoded_depth_mm": SampleQuantity(
        PIXELS, "mm", "decoded depth; 0 where masked", _decoded_depth, ("decoded",)
    ),
    "decoded_normal_world": SampleQuantity(
        VECTORS, "1", "decoded unit normal; 0 where masked", _decoded_normal, ("decoded",)
    ),
    "decoded_sigma_z_mm": SampleQuantity(
        PIXELS,
        "mm",
        "predicted standard deviation of world z; 0 where masked",
        lambda taken: np.asarray(taken.maps.point_map.sigma_z_mm, np.float32),
        ("fringes", "decoded"),
    ),
    "decoded_reason": SampleQuantity(
        PIXELS, "1", "reason code of a masked pixel; 0: decoded", _decoded_reason, ("decoded",)
    ),
}
"""All quantities by name."""


def needs_decoding(held: tuple[str, ...]) -> bool:
    """Return True if one of the named quantities is computed from decoded frames."""
    return any("decoded" in SAMPLE_QUANTITIES[name].needs for name in held)


def check_held(held: tuple[str, ...], experiment: Experiment) -> None:
    """Check that an experiment has all quantities of a list.

    Raises
    ------
    InputError : a name is not known, or the experiment has no such quantity
    """
    for name in held:
        if name not in SAMPLE_QUANTITIES:
            allowed = ", ".join(SAMPLE_QUANTITIES)
            raise InputError(f"sample.hold: found '{name}', allowed: {allowed}")
    traits = _traits_of(experiment)
    for name in held:
        missing = [need for need in SAMPLE_QUANTITIES[name].needs if need not in traits]
        if missing:
            raise InputError(
                f"sample.hold: {name}: needs {_NEEDS[missing[0]]}; {experiment.name} has none; "
                "remove the name, or change the scene"
            )


_NEEDS: Mapping[Need, str] = {
    "fringes": "a method with fringes",
    "column": "phase steps along the axis 'column'",
    "row": "phase steps along the axis 'row'",
    "uniform": "a white frame (patterns.uniform)",
    "press": "a method with a press",
    "sheet": "a thin sheet",
    "colours": "modality = 'photometric_stereo'",
    "decoded": "decoded frames",
}


def _traits_of(experiment: Experiment) -> set[Need]:
    traits: set[Need] = {"decoded"}
    if experiment.method.fringes:
        patterns = pattern_set(experiment.projector, experiment.patterns)
        traits |= {"fringes", *(patterns.axes if patterns.steps else ())}
        traits |= {"uniform"} if patterns.uniform else set()
    else:
        traits.add("colours")
    if experiment.method.presses:
        traits.add("press")
        traits |= {"sheet"} if may_wrap(experiment.elastomer) else set()
    return traits
