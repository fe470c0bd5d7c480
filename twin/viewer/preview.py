"""Preview of an experiment with changed values: at once at reduced size, then measured.

The picture that appears at once has the ray tracing and the camera of a measurement, with fewer
pixels and a coarser press: a thin sheet has the coarse cells of its load steps and starts from the
sheet of the last picture. No frame is decoded. The measurement that follows differs from that of
`twin measure` only in the binning of the camera.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from reconstruction.arrays import Levels
from reconstruction.errors import InputError
from reconstruction.patterns import PERIOD_RANGE_PX
from twin.config import Experiment, vary
from twin.config.instant import experiment_at
from twin.config.loading import as_built
from twin.mechanics import PressedElastomer
from twin.mechanics.choice import preview_with
from twin.mechanics.models import PressInput, SettledPress
from twin.pipeline import Memory, measure
from twin.pipeline.fringes import record
from twin.pipeline.press import press, with_texture
from twin.pipeline.progress import ProgressCallback, no_progress
from twin.report.scene import on_nodes
from twin.results.record import Measurement
from twin.viewer.sliders import EXPOSURE

# Width of the image that appears at once, and of the measured one, where no binning has more.
_ACROSS_PX, _MEASURED_PX = 250, 400
_BINNINGS = (4, 2, 1)
_COARSE_SOLVER_MM = 0.16
_COARSE_RELIEF_MM = 0.05
_MOST_NODES = 240
"""Approximate number of nodes of the coat along a side: every 0.1 mm on the paper's sheet."""


@dataclass(frozen=True, eq=False)
class PreviewPicture:
    """Simulated camera images and press of a preview.

    Attributes
    ----------
    experiment : the experiment at full image size, with the values that the user changed
    fringes, white : images with fringes and with white light, (row, col) uint8, 255 at saturation
    pressed : the press that both images show
    exposure_ms : exposure of the images at full image size
    """

    experiment: Experiment
    fringes: Levels
    white: Levels
    pressed: PressedElastomer
    exposure_ms: float


class Preview:
    """Previews of one experiment with changed values; a press is reused if only the rig moves."""

    def __init__(self, experiment: Experiment) -> None:
        if not (experiment.method.presses and experiment.method.fringes):
            raise InputError(
                f"view: modality: found '{experiment.modality}', allowed: 'contact_fpp'; the live "
                "view needs fringes on a coat"
            )
        self._memory = Memory()
        self._full = experiment = as_built(experiment)
        self._measured = vary(experiment, {"camera.binning": _binning(experiment, _MEASURED_PX)})
        self._merged = _merged_pixels(experiment)
        self._quick = vary(experiment, _quick_size(experiment, self._merged))
        self._sheet: SettledPress | None = None
        self._known: tuple[object, PressedElastomer] | None = None

    @property
    def measured_binning(self) -> int:
        """Camera binning of the measurements."""
        return self._measured.camera.binning

    def show(self, changes: Mapping[str, Any]) -> PreviewPicture:
        """Return the picture of the experiment with some values changed, at reduced size.

        Parameters
        ----------
        changes : new value by dotted key

        Raises
        ------
        InputError : a value is not allowed, or the press or the renderer rejects it
        MissingBackend : no usable Dr.Jit backend
        """
        full, pixels_per_pixel = vary(self._full, changes), self._merged**2
        exposure_ms = full.camera.exposure_ms
        exposed = {} if exposure_ms == "auto" else {EXPOSURE: exposure_ms / pixels_per_pixel}
        experiment = experiment_at(vary(self._quick, {**changes, **exposed}), 0.0)
        pressed = self._pressed(full, experiment)
        recording = record(experiment, pressed, memory=self._memory)
        patterns, stack = recording.capture.patterns, recording.capture.stack
        saturation = recording.capture.sensor.saturation_dn
        fringes, white = (
            np.clip(np.rint(255.0 * stack[place] / saturation), 0, 255).astype(np.uint8)
            for place in (
                patterns.index("phase", patterns.axes[0]).start,
                patterns.index("white").start,
            )
        )
        exposure_ms = recording.exposure_ms * pixels_per_pixel
        return PreviewPicture(full, fringes, white, pressed, exposure_ms)

    def measure(
        self, changes: Mapping[str, Any], watch: ProgressCallback = no_progress
    ) -> Measurement:
        """Measure the experiment with some values changed, with binned pixels.

        Later pictures with the same press show the press of this measurement.

        Parameters
        ----------
        changes : new value by dotted key
        watch : progress callback; an exception that it raises ends the measurement

        Raises
        ------
        InputError, MissingBackend : as `show`; or a figure cannot be computed
        """
        experiment = vary(self._measured, changes)
        done = measure(experiment, watch, self._memory)
        self._known = _press_of(experiment), thinned(done.press)
        return done

    def _pressed(self, full: Experiment, quick: Experiment) -> PressedElastomer:
        """Return the press of the last measurement if its input is equal, else a coarse one."""
        if self._known is not None and self._known[0] == _press_of(full):
            return self._known[1]
        case = PressInput(quick.mechanics, quick.specimen, quick.elastomer, quick.press)
        sheet = preview_with(case, self._sheet)
        if sheet is None:
            return thinned(press(quick, self._memory).pressed)
        self._sheet = sheet
        return thinned(with_texture(quick, sheet.result()))


def thinned(pressed: PressedElastomer) -> PressedElastomer:
    """Return a press with every n-th node of its coat: about `_MOST_NODES` along a side."""
    step = max(1, max(pressed.face_z_mm.shape) // _MOST_NODES)
    rows, cols = (np.arange(0, size, step) for size in pressed.face_z_mm.shape)
    return on_nodes(replace(pressed, sheet=None), rows, cols)


def _press_of(experiment: Experiment) -> object:
    """Return the parts of an experiment on which its pressed coat depends, for a comparison."""
    parts = experiment.mechanics, experiment.specimen, experiment.elastomer, experiment.press
    return *parts, experiment.coating.texture, experiment.seed


def _binning(experiment: Experiment, least_px: int) -> int:
    """Return the largest binning with which the image has at least `least_px` columns."""
    return next((b for b in _BINNINGS if experiment.camera.width_px // b >= least_px), 1)


def _merged_pixels(experiment: Experiment) -> int:
    """Return the number of binned pixels along a side that a pixel of the quick image covers."""
    binning = _binning(experiment, _ACROSS_PX)
    return max(1, round(experiment.camera.width_px / binning / _ACROSS_PX))


def _quick_size(experiment: Experiment, merged: int) -> dict[str, Any]:
    """Return new values by key for images about 250 pixels wide and a short pattern sequence."""
    camera, projector, coarse = experiment.camera, experiment.projector, {}
    pitch_um = {"value": camera.pixel_pitch_um * merged, "source": "preview"}
    for key, pitch_mm in (
        ("press.solver_pitch_mm", _COARSE_SOLVER_MM),
        ("press.relief_pitch_mm", _COARSE_RELIEF_MM),
    ):
        section, name = key.split(".")
        coarse[key] = max(getattr(getattr(experiment, section), name), pitch_mm)
    return coarse | {
        "camera.binning": _binning(experiment, _ACROSS_PX),
        "camera.width_px": camera.width_px // merged,
        "camera.height_px": camera.height_px // merged,
        "camera.pixel_pitch_um": pitch_um | {"range": [0.0, pitch_um["value"]]},
        # Few frames, because none is decoded.
        "patterns": {
            "axes": list(experiment.patterns.axes),
            "period_px": max(experiment.patterns.period_px, PERIOD_RANGE_PX[0]),
            "steps": 3,
            "code": "hierarchical",
            "further_periods_px": [max(projector.width_px, projector.height_px)],
        },
        "render.samples": 1,
    }
