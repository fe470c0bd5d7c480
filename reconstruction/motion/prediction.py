"""Predicted error of every point by motion, beside its standard deviation by noise.

The coordinate of a moving pixel has two errors against a surface at a reference time. The N-step
fit takes frames of different times for frames of one time: its error against the middle of the
phase frames, with ripples over the phase. And this middle is earlier or later than the reference
time: the surface has moved in between, the lag.

Two sources give both. `of_displacements` uses a stated motion and the measured surface: a pixel's
ray meets the displaced tangent plane at another depth, and displaced light changes the levels.
`of_residuals` uses the frames only (`neighbourhood`): changes of the levels are not part of it.
Both are the errors of a single pixel; the filter reduces ripples of a few pixels.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from reconstruction.arrays import BoolImage, FloatArray, FloatImage, Stack
from reconstruction.codes import Rule
from reconstruction.decoding import AxisDecode, Decoded
from reconstruction.errors import InputError
from reconstruction.motion.neighbourhood import LEAST_STEPS, motion_nearby
from reconstruction.motion.phase_rate import TURN, PhaseSteps, phase_error, steps_of
from reconstruction.patterns import AXES, Axis, PatternSet
from reconstruction.rig.calibration import Calibration
from reconstruction.rig.plane_view import camera_px
from reconstruction.rig.sensor import SensorNoise
from reconstruction.triangulation import PointMap, Use, triangulate

# Change of the coordinate by which the derivative of z is computed, px.
_STEP_PX = 0.1
# Standard deviation of the window over slopes and levels, px: as the filter of the coordinates.
_WINDOW_PX = 1.5
# Rays closer to the tangent plane than this cosine have no depth.
_LEAST_COSINE = 0.05


@dataclass(frozen=True, eq=False)
class AxisMotion:
    """Motion of a projector coordinate; every field is (row, col) float32, 0 where unknown.

    rate_rad : change of the phase from frame to frame
    error_px : error of the coordinate against that in the middle of its phase frames
    lag_px : change of the coordinate from the reference time to this middle
    """

    rate_rad: FloatImage
    error_px: FloatImage
    lag_px: FloatImage


@dataclass(frozen=True, eq=False)
class PredictedMotion:
    """Predicted errors by motion of coordinates, by axis, and of world z, (row, col) float32 mm.

    error_z_mm : error of z against the surface in the middle of the phase frames
    lag_z_mm : displacement of z along the pixel's ray from the reference time to this middle
    """

    axes: Mapping[Axis, AxisMotion]
    error_z_mm: FloatImage
    lag_z_mm: FloatImage

    def maps(self) -> dict[str, FloatImage]:
        """Return all maps by the names of their variables in netCDF files."""
        maps = {"motion_error_z_mm": self.error_z_mm, "motion_lag_z_mm": self.lag_z_mm}
        for axis, motion in self.axes.items():
            maps |= {name: getattr(motion, part) for part, name in _axis_names(axis).items()}
        return maps

    @classmethod
    def from_maps(cls, maps: Mapping[str, FloatImage]) -> "PredictedMotion | None":
        """Return the errors from all maps of a file; None if it has none."""
        if "motion_error_z_mm" not in maps:
            return None
        axes: dict[Axis, AxisMotion] = {}
        for axis in AXES:
            names = _axis_names(axis)
            if all(name in maps for name in names.values()):
                axes[axis] = AxisMotion(**{part: maps[name] for part, name in names.items()})
        return cls(axes, maps["motion_error_z_mm"], maps["motion_lag_z_mm"])


def _axis_names(axis: Axis) -> dict[str, str]:
    """Return the netCDF variable name of each field of AxisMotion."""
    return {
        "rate_rad": f"phase_rate_{axis}_rad",
        "error_px": f"motion_error_{axis}_px",
        "lag_px": f"motion_lag_{axis}_px",
    }


class Displacements(NamedTuple):
    """Displacements of the points of a surface, both (row, col, xyz) mm, world.

    per_frame_mm : from frame to frame of the phase frames
    since_reference_mm : from the reference time to the middle of the phase frames
    """

    per_frame_mm: FloatArray
    since_reference_mm: FloatArray


class MeasuredSurface(NamedTuple):
    """Measured surface, and the rig that measured it."""

    decoded: Decoded
    points: PointMap
    calibration: Calibration
    use: Use

    def z_by_px(self, axis: Axis) -> FloatArray:
        """Return the derivative of world z with respect to one coordinate, (row, col) mm / px.

        It is that of points triangulated from this coordinate only, 0 where unknown.
        """
        moved = _moved(self.decoded, axis, _STEP_PX)
        points = triangulate(moved, self.calibration, axis)
        start = (
            self.points if self.use == axis else triangulate(self.decoded, self.calibration, axis)
        )
        both = points.valid & start.valid
        change_mm = (
            points.points_world_mm[..., 2].astype(np.float64) - start.points_world_mm[..., 2]
        )
        return np.asarray(np.where(both, change_mm / _STEP_PX, 0.0))


def has_one_set(patterns: PatternSet) -> bool:
    """Return whether each coordinate follows from the phase steps of one period."""
    has_steps = bool(patterns.steps) and patterns.stepping != "single"
    return has_steps and patterns.kind.rule not in (Rule.CHAIN, Rule.SINGLE_IMAGES)


def of_residuals(
    measured: MeasuredSurface, patterns: PatternSet, stack: Stack, sensor: SensorNoise
) -> PredictedMotion:
    """Return the errors by a motion that the residuals of the phase frames contain.

    The reference time is the middle of the sequence, the frames of which have equal intervals.

    Parameters
    ----------
    stack, patterns, sensor : as in `decode`

    Raises
    ------
    InputError : fewer than four phase steps, a single frame, or a code that fuses several periods
    """
    if not has_one_set(patterns) or patterns.steps < LEAST_STEPS:
        raise InputError(
            f"decode motion_error: found {patterns.steps} steps, stepping {patterns.stepping!r} and"
            f" code {patterns.code!r}; needed are {LEAST_STEPS} steps or more of one measuring"
            " period, whose residuals contain the motion; set it to false"
        )
    axes: dict[Axis, AxisMotion] = {}
    for axis in patterns.axes:
        nearby = motion_nearby(stack, patterns, measured.decoded, sensor, axis)
        shown = patterns.step_sets(axis)[0]
        lag_frames = 0.5 * (shown.start + shown.stop - len(patterns.frames))
        lag_px = patterns.period_along(axis) / TURN * lag_frames * nearby.rate_rad
        axes[axis] = _axis_of(measured, nearby.rate_rad, nearby.error_px, lag_px)
    return _in_space(measured, axes)


def of_displacements(
    measured: MeasuredSurface, patterns: PatternSet, displaced: Mapping[Axis, Displacements]
) -> PredictedMotion:
    """Return the errors by a stated motion of a rigid specimen.

    Parameters
    ----------
    measured : points of the specimen, triangulated without layers
    displaced : displacements of the points during the phase frames of each axis

    Raises
    ------
    InputError : the rig has layers, or a coordinate does not follow from steps of one period
    """
    if measured.calibration.layers is not None:
        raise InputError("motion error: not available below [layers]; the rays would be refracted")
    if not has_one_set(patterns):
        raise InputError(f"motion error: not available with patterns code {patterns.code!r}")
    axes = {axis: _axis_motion(measured, patterns, axis, displaced[axis]) for axis in displaced}
    return _in_space(measured, axes)


def _axis_motion(
    measured: MeasuredSurface, patterns: PatternSet, axis: Axis, displaced: Displacements
) -> AxisMotion:
    maps = measured.decoded.row if axis == "row" else measured.decoded.column
    valid, z_by_px = measured.points.valid, measured.z_by_px(axis)
    per_px = np.divide(1.0, z_by_px, out=np.zeros(valid.shape), where=z_by_px != 0.0)
    rate_px = per_px * _rise_mm(measured.points, displaced.per_frame_mm)
    rate_rad = TURN / patterns.period_along(axis) * rate_px
    changes = _light_changes(measured, maps, displaced.per_frame_mm)
    error_rad = _error_rad(maps, rate_rad, steps_of(patterns, axis), changes)
    error_px = patterns.period_along(axis) / TURN * error_rad
    lag_px = per_px * _rise_mm(measured.points, displaced.since_reference_mm)
    return _axis_of(measured, rate_rad, error_px, lag_px)


def _axis_of(
    measured: MeasuredSurface, rate_rad: FloatArray, error_px: FloatArray, lag_px: FloatArray
) -> AxisMotion:
    known = measured.points.valid
    maps = (np.where(known, image, 0.0) for image in (rate_rad, error_px, lag_px))
    return AxisMotion(*(image.astype(np.float32) for image in maps))


def _error_rad(
    maps: AxisDecode,
    rate_rad: FloatArray,
    steps: PhaseSteps,
    changes: tuple[FloatArray, FloatArray],
) -> FloatArray:
    """Return the error of the decoded phase; the true phase is the decoded one minus the error."""
    phase_rad, error_rad = maps.phase_rad.astype(np.float64), np.zeros(rate_rad.shape)
    for _ in range(2):
        error_rad = phase_error(
            phase_rad - error_rad, rate_rad, steps,
            mean_change=changes[0], modulation_change=changes[1],
        )  # fmt: skip
    return error_rad


def _rise_mm(points: PointMap, displaced_mm: FloatArray) -> FloatArray:
    """Return by how much world z increases where each ray meets the displaced tangent plane, mm."""
    rays = points.points_world_mm.astype(np.float64) - points.T_world_from_cam[:3, 3]
    rays /= np.maximum(np.linalg.norm(rays, axis=-1, keepdims=True), 1e-9)
    normals = points.normals_world.astype(np.float64)
    known = points.valid & np.any(normals != 0.0, axis=-1)
    normals = np.stack([_smooth(normals[..., i], known) for i in range(3)], axis=-1)
    along = np.einsum("rcx,rcx->rc", rays, normals)
    moved = np.einsum("rcx,rcx->rc", displaced_mm, normals)
    usable = known & (along < -_LEAST_COSINE)
    rise_mm: FloatArray = np.zeros(known.shape)
    np.divide(moved * rays[..., 2], along, out=rise_mm, where=usable)
    return rise_mm


def _light_changes(
    measured: MeasuredSurface, maps: AxisDecode, per_frame_mm: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the changes of mean and modulation from frame to frame, divided by the modulation.

    The levels of a surface move with it through the image, and so do their gradients.
    """
    points_mm, valid = measured.points.points_world_mm.astype(np.float64), measured.points.valid
    after, before = (
        camera_px(measured.calibration, points_mm + sign * per_frame_mm) for sign in (0.5, -0.5)
    )
    col_px, row_px = np.moveaxis(after - before, -1, 0)
    lit = maps.modulation_dn > 0.0
    modulation_dn = _smooth(maps.modulation_dn.astype(np.float64), lit)
    changes = []
    for level_dn in (_smooth(maps.mean_dn.astype(np.float64), lit), modulation_dn):
        by_row, by_col = np.gradient(level_dn)
        change_dn = -(by_col * col_px + by_row * row_px)
        known = valid & (modulation_dn > 0.0)
        changes.append(np.divide(change_dn, modulation_dn, out=np.zeros(lit.shape), where=known))
    return changes[0], changes[1]


def _smooth(image: FloatArray, known: BoolImage) -> FloatArray:
    """Return the Gaussian mean of the known pixels of an image, (row, col)."""
    from scipy import ndimage  # only a prediction needs it: a decoding starts faster without

    weight = ndimage.gaussian_filter(known.astype(np.float64), _WINDOW_PX)
    total = ndimage.gaussian_filter(np.where(known, image, 0.0), _WINDOW_PX)
    mean: FloatArray = np.zeros(known.shape)
    np.divide(total, weight, out=mean, where=weight > 1e-6)
    return mean


def _moved(decoded: Decoded, axis: Axis, step_px: float) -> Decoded:
    maps = decoded.row if axis == "row" else decoded.column
    moved = AxisDecode(**{**vars(maps), "coordinate_px": maps.coordinate_px + np.float32(step_px)})
    return replace(decoded, row=moved) if axis == "row" else replace(decoded, column=moved)


def _in_space(measured: MeasuredSurface, axes: Mapping[Axis, AxisMotion]) -> PredictedMotion:
    """Return the errors of z too: of each used coordinate, with its weight in the triangulation."""
    used = [axis for axis in axes if measured.use in (axis, "both")]
    total, error_mm, lag_mm = np.zeros((3, *measured.points.valid.shape))
    for axis in used:
        maps = measured.decoded.row if axis == "row" else measured.decoded.column
        z_by_px = measured.z_by_px(axis)
        sigma_mm = np.abs(z_by_px) * maps.sigma_px
        weight = np.divide(1.0, sigma_mm**2, out=np.zeros(total.shape), where=sigma_mm > 0.0)
        total += weight
        error_mm += weight * z_by_px * axes[axis].error_px
        lag_mm += weight * z_by_px * axes[axis].lag_px
    known = measured.points.valid & (total > 0.0)
    parts = [np.divide(m, total, out=np.zeros(m.shape), where=known) for m in (error_mm, lag_mm)]
    return PredictedMotion(axes, *(part.astype(np.float32) for part in parts))
