"""Preview of an experiment with changed values: a press and its camera images at reduced size.

The images are computed by the same press, ray tracing and camera as in a measurement. They have
1/16 of the pixels of a full image and a coarser coat. No frame is decoded.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from matplotlib import colormaps

from reconstruction.arrays import Levels
from reconstruction.errors import InputError
from reconstruction.patterns import PERIOD_RANGE_PX
from twin.config import Experiment, vary
from twin.config.loading import as_built
from twin.mechanics import PressedElastomer, face_mesh
from twin.optics.view import SceneSurface
from twin.pipeline import Memory
from twin.pipeline.fringes import record
from twin.pipeline.press import press
from twin.report.scene import SPECIMEN, SPECIMEN_RGB, on_nodes
from twin.specimens import shape_of

_ACROSS_PX = 250
_BINNINGS = (4, 2, 1)
_COARSE_SOLVER_MM = 0.16
_COARSE_RELIEF_MM = 0.05
_COARSE_CELL_MM = 0.3
_MOST_NODES = 240
"""Approximate number of nodes of the coat along a side: every 0.1 mm on the paper's sheet."""


@dataclass(frozen=True)
class SliderRange:
    """A slider of the live view: one number of the experiment with its range.

    Attributes
    ----------
    key : dotted path of the number, as `twin keys` lists it
    label : name with unit
    low, high, value : ends of the slider, and current value
    """

    key: str
    label: str
    low: float
    high: float
    value: float


@dataclass(frozen=True, eq=False)
class PreviewPicture:
    """Simulated camera images and press of a preview.

    Attributes
    ----------
    experiment : the experiment at full image size, with the values that the user changed
    fringes, white : images with fringes and with white light, (row, col) uint8, 255 at saturation
    pressed : the press that both images show
    """

    experiment: Experiment
    fringes: Levels
    white: Levels
    pressed: PressedElastomer

    @property
    def surfaces(self) -> tuple[SceneSurface, ...]:
        """Surfaces of coat and specimen at the end of the press, with colours, world frame."""
        coat = face_mesh(self.pressed)
        z_mm = np.asarray(coat.vertices)[:, 2]
        share = (z_mm - z_mm.min()) / max(float(np.ptp(z_mm)), 1e-9)
        touched_mm = self.experiment.elastomer.touched_plane_mm + self.pressed.depth_mm
        specimen = shape_of(self.experiment.specimen).mesh(touched_mm)
        return (
            SceneSurface.of_mesh("coat", coat, colormaps["viridis"](share)[:, :3]),
            SceneSurface.of_mesh(SPECIMEN, specimen, np.divide(SPECIMEN_RGB, 255.0)),
        )


# key, label, largest change from the current value
_MOVED: tuple[tuple[str, str, float], ...] = (
    ("camera.pose.standoff_mm", "camera: distance (mm)", 0.3),
    ("camera.pose.polar_deg", "camera: tilt (deg)", 20.0),
    ("projector.pose.standoff_mm", "projector: distance (mm)", 0.3),
    ("projector.pose.polar_deg", "projector: tilt (deg)", 20.0),
    ("projector.pose.azimuth_deg", "projector: direction (deg)", 45.0),
    ("specimen.x_mm", "specimen: x (mm)", 4.0),
    ("specimen.y_mm", "specimen: y (mm)", 4.0),
    ("specimen.yaw_deg", "specimen: turned (deg)", 90.0),
    ("specimen.tilt_deg", "specimen: tilted (deg)", 10.0),
    ("elastomer.thickness_mm", "elastomer: thickness (mm)", 0.5),
    ("press.depth_mm", "press: travel (mm)", 0.5),
    ("press.force_n", "press: force (N)", 0.8),
    ("patterns.period_px", "fringes: period (px)", 0.5),
)
# The largest change of these is relative to the value, of all others absolute.
_RELATIVE = ("standoff_mm", "thickness_mm", "depth_mm", "force_n", "period_px")
_NOT_NEGATIVE = ("polar_deg",)


def slider_ranges(experiment: Experiment) -> list[SliderRange]:
    """Return the sliders of an experiment.

    The range of a slider is that of the value's stated source; without one it is an interval round
    the current value.
    """
    tree = experiment.model_dump()
    sliders = [_control(experiment, tree, *entry) for entry in _MOVED]
    return [slider for slider in sliders if slider is not None]


def _control(
    experiment: Experiment, tree: Mapping[str, Any], key: str, label: str, reach: float
) -> SliderRange | None:
    value: Any = tree
    for part in key.split("."):
        value = value.get(part) if isinstance(value, Mapping) else None
    if not isinstance(value, (int, float)) or key in experiment.links:
        return None
    origin = experiment.provenance.get(key)
    if origin is not None and origin.range is not None:
        low, high = origin.range
    else:
        step = reach * value if key.endswith(_RELATIVE) else reach
        low, high = value - step, value + step
    if key.endswith(_NOT_NEGATIVE):
        low = max(low, 0.0)
    return SliderRange(key, label, float(low), float(high), float(value)) if high > low else None


class Preview:
    """Previews of one experiment with changed values; a press is reused if only the rig moves."""

    def __init__(self, experiment: Experiment) -> None:
        if not (experiment.method.presses and experiment.method.fringes):
            raise InputError(
                f"view: modality: found '{experiment.modality}', allowed: 'contact_fpp'; the live "
                "view needs fringes on a coat"
            )
        self._memory = Memory()
        self._full = as_built(experiment)
        self._small = vary(self._full, _preview_size(experiment))

    def show(self, changes: Mapping[str, Any]) -> PreviewPicture:
        """Return the preview of the experiment with some values changed.

        Parameters
        ----------
        changes : new value by dotted key

        Raises
        ------
        InputError : a value is not allowed, or the press or the renderer rejects it
        MissingBackend : no usable Dr.Jit backend
        """
        experiment = vary(self._small, changes)
        pressed = thinned(press(experiment, self._memory).pressed)
        recording = record(experiment, pressed, memory=self._memory)
        patterns, stack = recording.capture.patterns, recording.capture.stack
        full = recording.capture.sensor.saturation_dn
        fringes, white = (
            np.clip(np.rint(255.0 * stack[place] / full), 0, 255).astype(np.uint8)
            for place in (patterns.index("phase", "column").start, patterns.index("white").start)
        )
        return PreviewPicture(vary(self._full, changes), fringes, white, pressed)


def thinned(pressed: PressedElastomer) -> PressedElastomer:
    """Return a press with every n-th node of its coat: about `_MOST_NODES` along a side."""
    step = max(1, max(pressed.face_z_mm.shape) // _MOST_NODES)
    rows, cols = (np.arange(0, size, step) for size in pressed.face_z_mm.shape)
    return on_nodes(replace(pressed, sheet=None), rows, cols)


def _preview_size(experiment: Experiment) -> dict[str, Any]:
    """Return new values by key for images about 250 pixels wide and a short pattern sequence."""
    camera, projector, coarse = experiment.camera, experiment.projector, {}
    binning = next((b for b in _BINNINGS if camera.width_px // b >= _ACROSS_PX), 1)
    fewer = max(1, round(camera.width_px / binning / _ACROSS_PX))
    pitch_um = {"value": camera.pixel_pitch_um * fewer, "source": "preview"}
    for key, pitch_mm in (
        ("press.solver_pitch_mm", _COARSE_SOLVER_MM),
        ("press.relief_pitch_mm", _COARSE_RELIEF_MM),
    ):
        section, name = key.split(".")
        coarse[key] = max(getattr(getattr(experiment, section), name), pitch_mm)
    if experiment.press.cell_mm is None:
        coarse["press.cell_mm"] = _COARSE_CELL_MM
    return coarse | {
        "camera.binning": binning,
        "camera.width_px": camera.width_px // fewer,
        "camera.height_px": camera.height_px // fewer,
        "camera.pixel_pitch_um": pitch_um | {"range": [0.0, pitch_um["value"]]},
        # Few frames, because none is decoded.
        "patterns": {
            "period_px": max(experiment.patterns.period_px, PERIOD_RANGE_PX[0]),
            "steps": 3,
            "code": "hierarchical",
            "further_periods_px": [max(projector.width_px, projector.height_px)],
        },
        "render.samples": 1,
    }
