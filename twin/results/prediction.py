"""Predicted levels, contrast and sigma of every pixel of a measurement, from a ray trace only.

No frame is rendered or decoded, and no noise is drawn. The trace gives the irradiance E of a white
field and the projector coordinate of each pixel. From these follow:

| step | formula |
|---|---|
| level, contrast | A = E a + dark, B = E b T(period), see `twin.optics.contrast` |
| noise of one value | EMVA 1288: (K sigma_d)^2 + K (A - black) + 1/12 DN^2, see `SensorNoise` |
| phase | sigma_phi = sqrt(2 / N) sigma_I / B (Surrel 1997), as the decoder states it |
| coordinate | sigma_x = period sigma_phi / 2 pi; of several periods 1 / sqrt(sum 1 / sigma^2) |
| height | sigma_x |dz/dx|, of the triangulation, at the surface's own slope |

The effect of the filter on the noise is computed by `reconstruction.decoding.filter_noise`.

The phase estimate from N >= 4 steps assumes that all frames have the noise of their mean. This is
not the best possible estimate. With fringes of full contrast, the shot noise of dark frames is
small, and a fit with the noise of each frame would determine phases up to sqrt(2) better. No common
decoder does so, and neither does the decoder here. The bounds here are therefore for decoded
coordinates.

Four effects are neglected: fixed pattern noise, which scales level and contrast alike; light
between surfaces; wrong fringe orders; and that noise decides whether a frame near the limit is
clipped.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from reconstruction.arrays import BoolImage, FloatArray, FloatImage, Reason, ReasonImage
from reconstruction.decoding import AxisDecode, Decoded, DecodeOptions
from reconstruction.decoding.filter_noise import FilterNoise, filter_noise, without_edges
from reconstruction.patterns import AXES, Axis
from reconstruction.rig.calibration import Calibration
from reconstruction.rig.pinhole import distortion_jacobian
from reconstruction.triangulation import PointMap, triangulate
from twin.camera import choose_exposure_ms, noise_model
from twin.config.models import Experiment
from twin.optics.contrast import FringeLight
from twin.optics.rig import true_calibration
from twin.optics.stack import TraceMaps, Truth, rows_of
from twin.results.fringe_levels import (
    FringeNumbers,
    axis_levels,
    clipping,
    steps_of,
    white_radiance,
)

# Pixels of a band of rows that, with its intermediate arrays, fits into the cache of the
# processor.
_BAND_PIXELS = 1 << 16


@dataclass(frozen=True, eq=False)
class AxisPrediction:
    """Predicted noise along one projector axis (columns or rows) that is used for the depth.

    Attributes
    ----------
    sigma_px : (row, col) standard deviation of the coordinate of single pixels before the filter,
        projector px
    height_by_px : (row, col) error of the surface's height per error of the coordinate, mm / px;
        if both axes are used, weighted by the share of this axis
    filtered : noise of the coordinate after the filter
    """

    sigma_px: FloatArray
    height_by_px: FloatArray
    filtered: FilterNoise


@dataclass(frozen=True, eq=False)
class PredictedMaps:
    """Expected points of a measurement with their predicted standard deviations by noise.

    Attributes
    ----------
    points : points without noise and filter, with the sigma of single pixels
    reason : (row, col) reason codes that the decoder is expected to give
    axes : predicted noise for each projector axis that is used for the depth
    exposure_ms : exposure time, as set or as chosen by the automatic exposure, ms
    """

    points: PointMap
    reason: ReasonImage
    axes: tuple[AxisPrediction, ...]
    exposure_ms: float

    @property
    def valid(self) -> BoolImage:
        """Mask (row, col) of the pixels that have a point."""
        return np.asarray(self.reason == Reason.VALID)

    @property
    def single_mm(self) -> FloatArray:
        """Standard deviation of each height by noise before the filter, (row, col), mm."""
        parts = [(axis.height_by_px * axis.sigma_px) ** 2 for axis in self.axes]
        return np.asarray(np.sqrt(sum(parts)))

    @property
    def filtered_mm(self) -> FloatArray:
        """Standard deviation of each height by noise after the filter, (row, col), mm."""
        shares = [axis.height_by_px**2 * axis.filtered.variance_px2 for axis in self.axes]
        return np.asarray(np.sqrt(sum(shares)))

    def noise_mm(self, slope: FloatArray) -> float:
        """Return the standard deviation, by noise, of sum(slope * height) over the pixels.

        `slope` is (row, col); the result has its unit times mm.

        The filter correlates the errors of neighbouring pixels. The noises of the two projector
        axes are independent.
        """
        return float(
            np.sqrt(sum(axis.filtered.noise(slope * axis.height_by_px) ** 2 for axis in self.axes))
        )


def predict(experiment: Experiment, maps: TraceMaps, truth: Truth) -> PredictedMaps:
    """Return the expected points and predicted sigmas of every pixel.

    Parameters
    ----------
    maps : ray trace of the camera view
    truth : true geometry of the same view; its normals convert a depth into a height

    Raises
    ------
    InputError : the exposure is automatic, and no pixel receives light
    """
    shape = maps.weight.shape
    (white,) = _by_bands(shape, lambda band: (white_radiance(rows_of(maps, band), experiment),))
    light = FringeLight.of(experiment.projector, experiment.patterns)
    exposure_ms = choose_exposure_ms(experiment, white * np.float32(light.white))
    numbers = FringeNumbers.of(experiment, exposure_ms)
    column, row, reason = _by_bands(
        shape, lambda band: _single_pixels(experiment, rows_of(maps, band), white[band], numbers)
    )
    if experiment.decode.filter_taps:
        reason = without_edges(reason)
    places: dict[Axis, FloatArray] = {"column": maps.column_px, "row": maps.row_px}
    single = _Single(places, {"column": column, "row": row}, reason)
    return _placed(experiment, single, truth, exposure_ms)


def _by_bands(
    shape: tuple[int, ...], results_of: Callable[[slice], tuple[NDArray[Any], ...]]
) -> tuple[NDArray[Any], ...]:
    """Compute results for consecutive bands of rows, and join them.

    Arrays of a whole image do not fit into the cache of the processor, and the operating system
    must clear the memory of each new array. Without bands, the computation takes three times as
    long.
    """
    rows = max(1, _BAND_PIXELS // shape[1])
    parts = [results_of(slice(first, first + rows)) for first in range(0, shape[0], rows)]
    return tuple(np.concatenate(arrays) for arrays in zip(*parts, strict=True))


def _single_pixels(
    experiment: Experiment, maps: TraceMaps, white: FloatImage, numbers: FringeNumbers
) -> tuple[FloatArray, FloatArray, ReasonImage]:
    """Return sigma of single pixels' column and row coordinates, px, and the reason codes."""
    places: dict[Axis, FloatArray] = {"column": maps.column_px, "row": maps.row_px}
    light, reason, sigma = white.astype(np.float64), _dark(experiment, white, numbers), []
    for axis in AXES:
        levels = axis_levels(maps, numbers, steps_of(experiment, axis), axis, light)
        growth = clipping(experiment, levels, places[axis], axis, reason)
        too_much = levels.phase_sigma_rad > DecodeOptions.max_phase_sigma_rad
        reason[(reason == 0) & too_much] = Reason.LOW_MODULATION
        sigma.append(np.asarray(levels.sigma_px * growth, np.float64))
    return sigma[0], sigma[1], reason


@dataclass(frozen=True, eq=False)
class _Single:
    """Coordinates of single pixels before the filter, and their sigma, by projector axis.

    Coordinates and sigma are (row, col), projector px. `reason` has the reason codes (row, col).
    """

    places: dict[Axis, FloatArray]
    sigma: dict[Axis, FloatArray]
    reason: ReasonImage

    def as_decoded(self) -> Decoded:
        """Return the result that a decoder would give without noise and filter."""
        zeros = np.zeros(self.reason.shape, np.float32)

        def axis(name: Axis) -> AxisDecode:
            return AxisDecode(
                coordinate_px=self.places[name].astype(np.float32),
                phase_rad=zeros,
                order=zeros.astype(np.int16),
                mean_dn=zeros,
                modulation_dn=zeros,
                sigma_px=np.where(self.reason == 0, self.sigma[name], 0.0).astype(np.float32),
                residual_dn=zeros,
                order_error=zeros,
                bias_share=zeros,
            )

        return Decoded(axis("column"), axis("row"), self.reason)


def _dark(experiment: Experiment, white: FloatImage, numbers: FringeNumbers) -> ReasonImage:
    """Return reason codes that mark pixels where white and black frame will not differ."""
    sensor = noise_model(experiment.camera)
    gain, black_dn = numbers.gain_dn_per_e, sensor.black_level_dn
    light = FringeLight.of(experiment.projector, experiment.patterns)
    electrons = light.white * white.astype(np.float64) * numbers.electrons_per_radiance
    bright = gain * (electrons + numbers.dark_e)
    dim = bright / (light.white / light.black)
    variance = sensor.variance_dn2(bright + black_dn) + sensor.variance_dn2(dim + black_dn)
    dark = bright - dim < DecodeOptions.dark_sigmas * np.sqrt(variance)
    return np.where(dark, Reason.DARK, Reason.VALID).astype(np.uint8)


def _placed(
    experiment: Experiment, single: _Single, truth: Truth, exposure_ms: float
) -> PredictedMaps:
    """Triangulate the expected coordinates, and compute their noise after the filter."""
    places, sigma, reason = single.places, single.sigma, single.reason
    decode = experiment.decode
    used: tuple[Axis, ...] = AXES if decode.use == "both" else (decode.use,)
    rig = true_calibration(experiment)
    decoded = single.as_decoded()
    alone = {axis: triangulate(decoded, rig, axis) for axis in used}
    usable = (
        np.logical_and.reduce([coordinates.valid for coordinates in alone.values()]) & truth.lit
    )
    by_px = {
        axis: _height_by_px(rig, truth, axis, usable)
        if rig.layers is None
        else _height_mm(coordinates, truth, usable) / sigma[axis]
        for axis, coordinates in alone.items()
    }
    information = sum(np.where(usable, (by_px[a] * sigma[a]) ** -2.0, 0.0) for a in used)
    axes = []
    for axis in used:
        own = np.where(usable, (by_px[axis] * sigma[axis]) ** -2.0, 0.0)
        share = np.divide(own, information, out=np.zeros(usable.shape), where=usable)
        filtered = filter_noise(
            places[axis],
            sigma[axis] ** 2,
            reason == 0,
            taps=decode.filter_taps,
            sigma_px=decode.filter_sigma_px,
            limit_px=0.5 * experiment.patterns.period_px,
            restores=decode.weights == "equal",
        )
        axes.append(AxisPrediction(sigma[axis], share * by_px[axis], filtered))
    points = alone[used[0]]
    masked = np.where(usable, 0, np.maximum(points.mask_reason, Reason.DARK)).astype(np.uint8)
    return PredictedMaps(points, masked, tuple(axes), exposure_ms)


def coordinate_slope(
    pose: Any, focal_px: tuple[Any, Any], rig: Calibration, truth: Truth, axis: Axis
) -> Any:
    """Return the derivative of the projector coordinate along each camera ray, (row, col), px.

    The surface point moves along its ray in air, and d is its distance from the camera. The
    derivative is with respect to ln d, so that its unit is px and not px / mm. It is analytic in
    `pose` and `focal_px`, so that complex steps give its derivatives.

    Parameters
    ----------
    pose : (3, 4) upper rows of T_proj_from_world
    focal_px : focal lengths of the projector along columns and rows, px
    rig : calibration with the pose of the camera and the distortion of the projector
    """
    shape = truth.lit.shape
    # One array per coordinate: a product with an array of three columns takes several times as
    # long.
    point = np.moveaxis(truth.points_world_mm, -1, 0).reshape(3, -1).astype(np.float64)
    turned = (pose[:, :3] @ point).reshape(3, *shape)
    x, y, z = turned + pose[:, 3, None, None]
    dx, dy, dz = turned - (pose[:, :3] @ rig.T_world_from_cam[:3, 3])[:, None, None]
    z = np.where(truth.lit, z, 1.0)
    u, v = x / z, y / z
    u_slope, v_slope = (dx - u * dz) / z, (dy - v * dz) / z
    xx, xy, yy = distortion_jacobian(u, v, rig.projector.distortion)
    if axis == "row":
        return focal_px[1] * (xy * u_slope + yy * v_slope)
    return focal_px[0] * (xx * u_slope + xy * v_slope)


def _height_by_px(rig: Calibration, truth: Truth, axis: Axis, usable: BoolImage) -> FloatArray:
    """Return the error of the surface's height per error of the coordinate, in air, mm / px."""
    lens = rig.projector
    pose = np.linalg.inv(rig.T_world_from_proj)[:3]

    def of_band(band: slice) -> tuple[FloatArray]:
        band_truth = rows_of(truth, band)
        slope = np.abs(coordinate_slope(pose, (lens.fx_px, lens.fy_px), rig, band_truth, axis))
        ray = band_truth.points_world_mm.astype(np.float64) - rig.T_world_from_cam[:3, 3]
        normals = band_truth.normals_world.astype(np.float64)
        across = np.abs(np.einsum("rcx,rcx->rc", ray, normals))
        height: FloatArray = np.ones(slope.shape)
        resolved = usable[band] & (slope > 0.0)
        np.divide(across, np.abs(normals[..., 2]) * slope, out=height, where=resolved)
        return (height,)

    return _by_bands(usable.shape, of_band)[0]


def _height_mm(points: PointMap, truth: Truth, usable: BoolImage) -> FloatArray:
    """Return the standard deviation of the surface's height, (row, col), mm; 1 without a point.

    If a point has the error e (vector) along its ray, on a surface with the unit normal n, the
    height has the error e . n / n_z.
    """
    along = points.points_world_mm - points.T_world_from_cam[:3, 3].astype(np.float32)
    error = np.copysign(points.sigma_xyz_mm, along).astype(np.float64)
    across = np.abs(np.einsum("rcx,rcx->rc", error, truth.normals_world))
    upward = np.abs(truth.normals_world[..., 2].astype(np.float64))
    height: FloatArray = np.ones(usable.shape)
    np.divide(across, upward, out=height, where=usable & (across > 0.0))
    return height
