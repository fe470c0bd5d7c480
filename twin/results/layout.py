"""Layout of the rig: figures and warnings that follow from the experiment without a measurement.

| figure | meaning |
|---|---|
| magnification | image / object, in the plane of focus |
| field_width_mm, field_height_mm | imaged field in the plane of focus, across the camera's axis |
| pixel_on_coat_um | size of a binned pixel in that plane |
| working_distance_mm | from the front of the lens to the coat; the standoff if it is not known |
| depth_of_field_mm | range of distances whose blur is at most one binned pixel |
| diffraction_um | radius of the Airy disc in the plane of focus, at the projector's wavelength |
| triangulation_angle_deg | angle between camera and projector, seen from the coat's centre |
| baseline_mm | distance between their pinholes; none with a telecentric lens |
| lit_field_share | share of the camera's image of the plane z = 0 that the projector lights |
| least_sequence_ms | duration of all frames without exposure: rates of camera and projector |
| frames | projected and recorded frames |
| sequence_ms | duration of these frames, if the exposure time is set, see `twin.results.sequence` |

Methods without fringes have only the first six figures.
"""

import math

import numpy as np

from reconstruction.errors import InputError
from reconstruction.patterns import AXES, Axis
from reconstruction.rig.calibration import Calibration
from twin.config.imaging import SensorArea, depth_limits_mm, magnification_at
from twin.config.models import Experiment
from twin.config.optics import FixedFocal, Telecentric
from twin.optics.rig import true_calibration
from twin.results.sequence import frame_count, sequence_ms, sequence_warnings

# First zero of the Airy pattern, in wavelengths times the working f-number.
_AIRY = 1.22
_STEP_MM, _LEAST_SHARE, _GRID = 0.1, 0.1, 33
_WHOLE = 0.999

LAYOUT = (
    "magnification", "field_width_mm", "field_height_mm", "pixel_on_coat_um",
    "working_distance_mm", "depth_of_field_mm", "diffraction_um", "triangulation_angle_deg",
    "baseline_mm", "lit_field_share", "least_sequence_ms",
)  # fmt: skip
"""Names of the figures that are not stored in result.json."""
KNOWN_BEFORE = {*LAYOUT, "frames", "sequence_ms"}
"""Names of all figures that may be known before a measurement."""


def layout_figures(experiment: Experiment) -> dict[str, float]:
    """Return the figures of the module docstring by name, without those that do not exist."""
    figures = _camera_figures(experiment)
    if experiment.method.fringes:
        figures |= _pair_figures(experiment) | {
            "least_sequence_ms": sequence_ms(experiment, 0.0),
            "frames": frame_count(experiment),
        }
        if experiment.camera.exposure_ms != "auto":
            figures["sequence_ms"] = sequence_ms(experiment, experiment.camera.exposure_ms)
    return figures


def layout_warnings(experiment: Experiment) -> list[str]:
    """Return warnings about the layout: the axis of the depth, and the lit part of the field."""
    lit_share = _lit_share(true_calibration(experiment)) if experiment.optics.is_stated else None
    if lit_share is None or lit_share >= _WHOLE:
        return _depth_axis_warnings(experiment)
    return [
        *_depth_axis_warnings(experiment),
        f"the projector lights {lit_share:.0%} of the camera's field; move it away "
        "(projector.pose.standoff_mm), or use a smaller field",
    ]


def known_warnings(experiment: Experiment) -> list[str]:
    """Return the warnings about layout and sequence that are known without a measurement.

    Methods without fringes have none. With an automatic exposure, the sequence has none.
    """
    if not experiment.method.fringes:
        return []
    exposure_ms = experiment.camera.exposure_ms
    sequence = [] if exposure_ms == "auto" else sequence_warnings(experiment, exposure_ms)
    return layout_warnings(experiment) + sequence


def _depth_axis_warnings(experiment: Experiment) -> list[str]:
    """Return a warning if the depth is computed from the coordinate that does not change with it.

    Along the camera's central ray, the coordinate in the direction of the baseline changes with the
    distance, and the other one hardly does.
    """
    shown, use = experiment.patterns.axes, experiment.decode.use
    if len(shown) > 1 and use == "both":
        return []
    used: Axis = shown[0] if len(shown) == 1 or use == "both" else use
    other: Axis = AXES[1 - AXES.index(used)]
    by_axis = dict(zip(AXES, _px_per_mm(true_calibration(experiment)), strict=True))
    if by_axis[used] >= _LEAST_SHARE * by_axis[other]:
        return []
    remedy = f'decode.use = "{other}"' if other in shown else f'patterns.axes = ["{other}"]'
    return [
        f"the depth is computed from projector {used}s, which change by {by_axis[used]:.2g} px per "
        f"mm of depth, {other}s by {by_axis[other]:.2g}; set {remedy}, or turn the baseline "
        "(projector.pose.azimuth_deg)"
    ]


def _lit_share(rig: Calibration) -> float | None:
    """Return the share of a grid of camera pixels whose point at z = 0 is in the projector's image.

    Refraction in layers is neglected. Pixels that do not see the plane count as unlit. None if the
    distortion of the camera has no inverse at some pixel.
    """
    columns = np.linspace(0.0, rig.camera.width_px - 1.0, _GRID)
    rows = np.linspace(0.0, rig.camera.height_px - 1.0, _GRID)
    pixels = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
    try:
        rays = np.column_stack([rig.camera.unproject(pixels), np.ones(len(pixels))])
    except InputError:
        return None
    rays = rays @ rig.T_world_from_cam[:3, :3].T
    rays = rays[rays[:, 2] < 0.0]
    points_mm = rig.T_world_from_cam[:3, 3] - rays * (rig.T_world_from_cam[2, 3] / rays[:, 2:])
    in_device_mm = (points_mm - rig.T_world_from_proj[:3, 3]) @ rig.T_world_from_proj[:3, :3]
    in_device_mm = in_device_mm[in_device_mm[:, 2] > 0.0]
    lit_px = rig.projector.project(in_device_mm) + 0.5
    inside = (lit_px >= 0.0) & (lit_px <= (rig.projector.width_px, rig.projector.height_px))
    return float(np.count_nonzero(inside.all(axis=1))) / len(pixels)


def _px_per_mm(rig: Calibration) -> tuple[float, float]:
    """Return the change of projector column and row per mm along the camera's ray to the origin."""
    camera_mm = rig.T_world_from_cam[:3, 3]
    nearer_mm = _STEP_MM * camera_mm / np.linalg.norm(camera_mm)
    points_mm = np.stack([np.zeros(3), nearer_mm]) - rig.T_world_from_proj[:3, 3]
    pixels = rig.projector.project(points_mm @ rig.T_world_from_proj[:3, :3])
    column, row = np.abs(pixels[1] - pixels[0]) / _STEP_MM
    return float(column), float(row)


def _camera_figures(experiment: Experiment) -> dict[str, float]:
    camera = experiment.camera
    focal_mm, distance_mm = camera.focal_length_mm, camera.pose.standoff_mm
    sensor = SensorArea.of(camera.width_px, camera.height_px, camera.pixel_pitch_um, camera.binning)
    magnification = magnification_at(focal_mm, distance_mm)
    width_mm, height_mm = sensor.field_at(magnification)
    near_mm, far_mm = depth_limits_mm(focal_mm, camera.f_number, distance_mm, sensor.pixel_mm)
    figures = {
        "magnification": magnification,
        "field_width_mm": width_mm,
        "field_height_mm": height_mm,
        "pixel_on_coat_um": 1e3 * sensor.pixel_mm / magnification,
        "working_distance_mm": _working_distance_mm(experiment),
    }
    return figures | ({"depth_of_field_mm": far_mm - near_mm} if math.isfinite(far_mm) else {})


def _working_distance_mm(experiment: Experiment) -> float:
    lens, standoff_mm = experiment.optics.lens, experiment.camera.pose.standoff_mm
    if isinstance(lens, Telecentric):
        return experiment.optics.working_distance_mm or lens.working_distance_mm
    return standoff_mm - (lens.principal_plane_mm if isinstance(lens, FixedFocal) else 0.0)


def _pair_figures(experiment: Experiment) -> dict[str, float]:
    """Return the figures of camera and projector together."""
    camera, rig = experiment.camera, true_calibration(experiment)
    magnification = magnification_at(camera.focal_length_mm, camera.pose.standoff_mm)
    working_f_number = camera.f_number * (1.0 + magnification)
    airy_um = 1e-3 * _AIRY * experiment.projector.wavelength_nm * working_f_number
    figures = {
        "diffraction_um": airy_um / magnification,
        "triangulation_angle_deg": rig.triangulation_angle_deg,
    }
    lit_share = _lit_share(rig)
    figures |= {} if lit_share is None else {"lit_field_share": lit_share}
    if isinstance(experiment.optics.lens, Telecentric):
        return figures
    baseline_mm = rig.T_world_from_proj[:3, 3] - rig.T_world_from_cam[:3, 3]
    return figures | {"baseline_mm": float(np.linalg.norm(baseline_mm))}
