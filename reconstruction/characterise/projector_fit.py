"""Fit a model of the projector to a capture: gamma, lens blur, and the noise of the residuals.

The value of pixel p in frame k (Gray, phase or uniform), DN, is modelled as

    I_kp = o_p + s_p L_k(u_p or v_p; g, b).

Here o_p is the level of the pixel without light of the pattern and s_p its amplitude; u_p and v_p
are its projector coordinates, column and row. L_k is the light of frame k along its axis, for a
projector response of gamma g and a lens blur b (see `rig.projected_light`).

The fit uses Gauss-Newton iteration. The unknowns o, s, u, v of each pixel are eliminated from the
normal equations (variable projection, Golub and Pereyra, SIAM J. Numer. Anal. 10, 413 (1973)).
The edges of Gray bits determine the blur, the levels of the phase steps determine gamma. Harmonics
of the phase steps would not separate them without Gray bits.

With the residual r and its leverage h, the mean of r^2 / (1 - h) is exactly the variance of a pixel
value, for any scene. It gives a photon transfer curve from a single capture (`photon_transfer`).

The model neglects drift of the light from frame to frame, variation of the blur over the image, and
light reflected between surfaces. These effects raise `chi2` above 1. They also raise the
uncertainties, which are computed from the scatter of the scores (derivatives of the log-likelihood)
over blocks of the image: sandwich estimate, White, Econometrica 48, 817 (1980).
"""

from dataclasses import dataclass, replace

import numpy as np

from reconstruction.arrays import BoolImage, FloatArray, Reason, Stack
from reconstruction.characterise.frame_model import FittedPixels, eliminated, linear_frames
from reconstruction.characterise.photon_transfer import (
    NoiseSamples,
    PhotonTransfer,
    UncertainValue,
    photon_transfer,
)
from reconstruction.decoding.decode import Decoded
from reconstruction.errors import InputError
from reconstruction.patterns import AXES, PatternSet
from reconstruction.pixel_shape import pixels_per_column
from reconstruction.rig.projected_light import GAMMA_RANGE, ProjectorResponse
from reconstruction.rig.sensor import SensorNoise

_GAMMAS, _MOST_BLUR_PX = (GAMMA_RANGE[0] + 0.01, GAMMA_RANGE[1] - 0.01), 9.0
_STEPS, _ROUNDS = 8, 3
# Largest change of gamma and of blur (px) in one step, and in the last step of a converged fit.
_LARGEST_STEP, _SETTLED = 0.3, 0.1
_BLOCKS = 8
_LEAST_PIXELS = 200
# Least number of frames, white and black included: they determine o, s, u, v, gamma and blur.
_LEAST_FRAMES = 7
_LEAST_BLUR_PX = 0.05
_EDGE_PX = 8.0
# Relative standard uncertainty of gamma and blur due to the model itself: their errors for rendered
# rigs with known values (./run bench adopt).
_MODEL_GAMMA, _MODEL_BLUR = 0.0003, 0.002
# Least value of 1 - (correlation of gamma and blur)^2; below it they are not separable.
_LEAST_CONDITION = 1e-8


@dataclass(frozen=True)
class FitLimits:
    """Number of fitted pixels, and starting values of the fit.

    pixels : number of fitted pixels, evenly spread over the valid pixels
    gamma : starting value of the gamma of the projector
    blur_px : starting value of the lens blur, projector px
    gamma_known : whether gamma is kept at its starting value and only the blur is fitted
    """

    pixels: int = 4000
    gamma: float = 1.0
    blur_px: float = 0.7
    gamma_known: bool = False


@dataclass(frozen=True, eq=False)
class ProjectorFit:
    """Result of the fit of a projector model to a capture.

    Attributes
    ----------
    gamma : gamma of the projector
    blur_px : standard deviation of the lens blur, projector columns. Half of the share that a
        camera pixel's footprint may have in the fitted blur is subtracted
    noise : photon transfer curve of the residuals; None: the residuals do not determine it
    chi2 : squared residuals divided by the predicted variance, per degree of freedom
    offset_dn, light_dn : (pixel,) level without light, o, and amplitude, s, of the fitted pixels
    footprint_px : standard deviation of a camera pixel's footprint, projector px
    """

    gamma: UncertainValue
    blur_px: UncertainValue
    noise: PhotonTransfer | None
    chi2: float
    offset_dn: FloatArray
    light_dn: FloatArray
    footprint_px: float

    def response(self) -> ProjectorResponse:
        """Return the fitted gamma and blur with their uncertainties, as `decode` takes them."""
        return ProjectorResponse(
            self.gamma.value,
            self.gamma.uncertainty,
            self.blur_px.value,
            self.blur_px.uncertainty,
        )


def fit_projector(
    stack: Stack,
    patterns: PatternSet,
    sensor: SensorNoise,
    decoded: Decoded,
    limits: FitLimits | None = None,
) -> ProjectorFit:
    """Fit the gamma and lens blur of the projector and the noise of the camera to a capture.

    Parameters
    ----------
    stack : (frame, row, col) DN, the stack that was decoded
    patterns : projected patterns
    sensor : black level and saturation; gain and noise give only the first weights
    decoded : projector coordinates from this stack, from which the fit starts. If they were decoded
        from few phase steps without a response, their errors are 0.1 period at gamma 2, and some
        pixels converge to a wrong bit edge: decode again with the fitted response, and fit again
    limits : number of fitted pixels and starting values; None: the defaults of `FitLimits`

    Raises
    ------
    InputError : no fringes, too few frames to separate gamma and blur, too few valid pixels, no
        convergence, or a gamma or blur at the end of its range
    """
    limits = limits or FitLimits()
    _require_frames(patterns)
    pixels = _chosen(stack, patterns, sensor, decoded, limits.pixels)
    light, noise, transfer = np.array([limits.gamma, limits.blur_px]), sensor, None
    for _ in range(_ROUNDS):
        pixels, light, information, change = _converged(pixels, patterns, light, noise, limits)
        samples, chi2, scores = _residual_samples(pixels, patterns, light, noise, limits)
        try:
            transfer = photon_transfer(samples, sensor)
        except InputError:
            if change < _SETTLED:
                break
            continue  # the next round starts at the last estimate
        noise = _with_noise(sensor, transfer)
    _require_inside(light, change)
    covariance = _sandwich(information, scores, pixels.block, max(1.0, chi2), limits)
    footprint_px = _footprint_px(decoded, patterns)
    return ProjectorFit(
        UncertainValue(
            float(light[0]), float(np.hypot(np.sqrt(covariance[0, 0]), _MODEL_GAMMA * light[0]))
        ),
        _lens_blur(float(light[1]), float(np.sqrt(covariance[1, 1])), footprint_px),
        transfer,
        chi2,
        pixels.own[:, 0],
        pixels.own[:, 1],
        footprint_px,
    )


def _require_frames(patterns: PatternSet) -> None:
    own = 2 + len(patterns.axes)
    if not patterns.steps or len(patterns.frames) < max(_LEAST_FRAMES, own + 3):
        raise InputError(
            f"{len(patterns.frames)} frames with {patterns.steps} phase steps do not determine the "
            "projector's response; record more steps, bits, or white and black"
        )


def _chosen(
    stack: Stack, patterns: PatternSet, sensor: SensorNoise, decoded: Decoded, count: int
) -> FittedPixels:
    """Select at most `count` pixels, evenly among those that are valid and not clipped.

    Pixels within 8 projector px of the border of the projector image are left out, too.
    """
    usable: BoolImage = np.equal(decoded.mask_reason, Reason.VALID)
    usable &= stack.max(axis=0) < sensor.clipped_from_dn
    usable &= stack.min(axis=0) > 0
    for axis in patterns.axes:
        own = decoded.row if axis == "row" else decoded.column
        usable &= own.coordinate_px > _EDGE_PX
        usable &= own.coordinate_px < patterns.length_px(axis) - 1 - _EDGE_PX
        usable &= own.order_error < 1e-6
    row, col = np.nonzero(usable)
    if len(row) < _LEAST_PIXELS:
        raise InputError(
            f"{len(row)} pixels are decoded and not clipped; the projector's response needs "
            f"{_LEAST_PIXELS}"
        )
    take = np.linspace(0, len(row) - 1, min(count, len(row))).astype(int)
    row, col = row[take], col[take]
    frames = stack[:, row, col].T.astype(np.float64)
    bright, dim = frames.max(axis=1), frames.min(axis=1)
    columns = [dim, bright - dim]
    for axis in patterns.axes:
        own = decoded.row if axis == "row" else decoded.column
        columns.append(own.coordinate_px[row, col].astype(np.float64))
    rows, cols = decoded.mask_reason.shape
    block = row * _BLOCKS // rows * _BLOCKS + col * _BLOCKS // cols
    axes = tuple(AXES.index(axis) for axis in patterns.axes)
    return FittedPixels(frames, np.stack(columns, axis=1), block, axes)


def _with_noise(sensor: SensorNoise, transfer: PhotonTransfer) -> SensorNoise:
    read_e = transfer.read_noise_e.value if transfer.read_noise_e else 0.0
    return replace(
        sensor, gain_dn_per_e=transfer.gain_dn_per_e.value, read_noise_e=read_e, dsnu_e=0.0
    )


def _free(limits: FitLimits) -> FloatArray:
    return np.array([0.0 if limits.gamma_known else 1.0, 1.0])


def _converged(
    pixels: FittedPixels,
    patterns: PatternSet,
    light: FloatArray,
    noise: SensorNoise,
    limits: FitLimits,
) -> tuple[FittedPixels, FloatArray, FloatArray, float]:
    """Fit by Gauss-Newton steps; return pixels, (gamma, blur), information matrix, last change.

    The information matrix (2, 2) is that of gamma and blur.
    """
    free = _free(limits)
    for _ in range(_STEPS):
        parts = eliminated(pixels, linear_frames(pixels, patterns, light), noise)
        common = parts.common * free
        information = np.einsum("pkc,pk,pkd->cd", common, parts.weight, common)
        _require_separable(information, free)
        score = np.einsum("pkc,pk,pk->c", common, parts.weight, parts.residual)
        step = np.linalg.solve(information + np.diag(1.0 - free), score)
        step = np.clip(step, -_LARGEST_STEP, _LARGEST_STEP)
        own = pixels.own + parts.own_step - parts.own_by_common @ step
        pixels = replace(pixels, own=own)
        before, light = light, light + step
        light = np.array(
            [
                np.clip(light[0], *_GAMMAS),
                np.clip(light[1], _LEAST_BLUR_PX, _MOST_BLUR_PX),
            ]
        )
        if np.max(np.abs(step)) < 1e-5:
            break
    return pixels, light, information, float(np.max(np.abs(light - before)))


def _require_inside(light: FloatArray, last_change: float) -> None:
    """Raise InputError if gamma or blur is at a limit of its range, or the fit did not converge.

    The lower limit of the blur is allowed, because a lens may be sharp.
    """
    gamma, blur_px = light.tolist()
    is_inside = _GAMMAS[0] < gamma < _GAMMAS[1] and blur_px < _MOST_BLUR_PX
    if not is_inside or last_change >= _SETTLED:
        raise InputError(
            f"the fit of the frames does not converge: gamma {gamma:.3g}, allowed {_GAMMAS[0]:.3g} "
            f"to {_GAMMAS[1]:.3g}, blur {blur_px:.3g} px, allowed less than {_MOST_BLUR_PX:g} px; "
            "check the order and kind of the frames, and that the camera's levels are linear"
        )


def _require_separable(information: FloatArray, free: FloatArray) -> None:
    diagonal = np.diag(information)[free > 0.0]
    scaled = information / np.sqrt(np.outer(np.diag(information), np.diag(information)) + 1e-300)
    rest = 1.0 - float(scaled[0, 1]) ** 2 if free.all() else 1.0
    if not np.all(diagonal > 0.0) or rest < _LEAST_CONDITION:
        raise InputError(
            "these frames do not separate the projector's gamma from its blur; record more steps, "
            "bits, or white and black"
        )


def _residual_samples(
    pixels: FittedPixels,
    patterns: PatternSet,
    light: FloatArray,
    noise: SensorNoise,
    limits: FitLimits,
) -> tuple[NoiseSamples, float, FloatArray]:
    """Return samples r^2 / (1 - h), chi-square per degree of freedom, and the pixels' scores.

    The scores (pixel, 2) are the derivatives of the log-likelihood by gamma and blur.
    """
    model = linear_frames(pixels, patterns, light)
    parts = eliminated(pixels, model, noise)
    leverage = parts.weight * np.einsum("pki,pij,pkj->pk", model.own, parts.inverse, model.own)
    remaining = 1.0 - leverage
    counted = remaining > 0.2
    square = parts.residual**2 / np.where(counted, remaining, 1.0)
    common = parts.common * _free(limits)
    scores = np.einsum("pkc,pk,pk->pc", common, parts.weight, parts.residual)
    freedom = parts.residual.size - pixels.own.size - 2
    chi2 = float(np.sum(parts.weight * parts.residual**2)) / freedom
    return NoiseSamples(model.predicted[counted], square[counted]), chi2, scores


def _sandwich(
    information: FloatArray, scores: FloatArray, block: FloatArray, chi2: float, limits: FitLimits
) -> FloatArray:
    """Return the covariance (2, 2) of gamma and blur.

    It is that of the pixel noise, or that from the scatter of the scores between image blocks if
    the latter is larger.
    """
    free = _free(limits)
    inverse = np.linalg.inv(information + np.diag(1.0 - free)) * np.outer(free, free)
    totals = np.stack(
        [np.bincount(block.astype(int), scores[:, c], _BLOCKS**2) for c in range(2)], axis=1
    )
    robust = inverse @ (totals.T @ totals) @ inverse
    plain = inverse * chi2
    scale = np.sqrt(np.maximum(np.diag(robust) / np.maximum(np.diag(plain), 1e-300), 1.0))
    return np.asarray(plain * np.outer(scale, scale))


def _footprint_px(decoded: Decoded, patterns: PatternSet) -> float:
    """Return the standard deviation, projector columns, of a typical camera pixel's footprint.

    The footprint is a parallelogram with the median differences of coordinates between adjacent
    pixels as sides; the result is the RMS over both projector axes.
    """
    valid = np.equal(decoded.mask_reason, Reason.VALID)
    variances = []
    for axis in patterns.axes:
        own = (decoded.row if axis == "row" else decoded.column).coordinate_px
        along = np.diff(own, axis=1)[valid[:, 1:] & valid[:, :-1]]
        across = np.diff(own, axis=0)[valid[1:] & valid[:-1]]
        if along.size and across.size:
            square_px2 = (np.median(along) ** 2 + np.median(across) ** 2) / 12.0
            variances.append(square_px2 / pixels_per_column(patterns.pixel_ratio, axis) ** 2)
    return float(np.sqrt(np.mean(variances))) if variances else 0.0


def _lens_blur(fitted_px: float, uncertainty_px: float, footprint_px: float) -> UncertainValue:
    """Return the blur of the lens, px, from the fitted blur, which may include the footprint.

    The footprint of a real camera pixel adds to the fitted blur. That of a rendered pixel adds only
    if its samples are more than 0.25 projector pixels apart. Therefore half of the footprint's
    share is subtracted, and the other half is taken as the half width of a uniform distribution.
    """
    lens_px = float(np.sqrt(max(fitted_px**2 - footprint_px**2, 0.0)))
    half_px = 0.5 * (fitted_px - lens_px)
    spread_px = np.sqrt(uncertainty_px**2 + half_px**2 / 3.0 + (_MODEL_BLUR * fitted_px) ** 2)
    return UncertainValue(fitted_px - half_px, float(spread_px))
