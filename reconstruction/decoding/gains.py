"""Estimate the relative light of the phase frames from the frames, and the phase ripple it causes.

Lamps drift and flicker, so that frame n of N has the light g_n = 1 + e_n relative to the mean of
its set. A pixel then has the levels b + g_n s_n with s_n = A + B cos(phi + t_n), where b is the
level without the projector's light. Neglecting e_n changes the phase by

    -(2 / N) [(A / B) Im(E_1 exp(i phi)) + Im(E_2 exp(2 i phi)) / 2],   E_k = sum e_n exp(i k t_n)

With N >= 4, the residuals of the fits of A, B and phi of many pixels determine e_n, as in the
alternating least squares of Wang and Han, Opt. Lett. 29, 1671 (2004). A pixel's residuals contain
e_1 s_1 to e_N s_N without the part that a change of A, B and phi explains. Pixels with different
phi determine all e_n but their mean, which has no effect. The linear equations are solved in one
step, and in further steps with the levels divided by the estimate before. Second and third harmonic
of the fringes, of one ratio to B in all pixels (a projector that is not linear), are estimated with
e_n, because they would bias e_n if the phases in the image are not uniformly distributed.

Motion also causes residuals. From those of a phase that changes by the same rate in all pixels the
equations give a certain e_n, which with four steps explains them completely. An estimate that
differs little from a multiple of this e_n is motion, and is not applied. Light that drifts has
other e_n: with four steps, the direction of E_1 differs by a quarter of a turn.

The pixels are a regular sample, divided into tiles of the image. Variances are those of the
jackknife: each tile is omitted in turn. They include deviations from the model that differ between
the tiles, in addition to noise.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from reconstruction.arrays import FloatArray, FloatImage, Stack
from reconstruction.compiling import run_over_rows
from reconstruction.decoding import DecodeOptions, FrameGains
from reconstruction.decoding._decode import Maps
from reconstruction.decoding._filter import Smoothed
from reconstruction.decoding._gains import (
    PixelScratch,
    SampledSet,
    TileSums,
    Widening,
    sum_tiles,
    widen_rows,
)
from reconstruction.decoding._rows import BIAS
from reconstruction.patterns import AXES, PatternSet
from reconstruction.rig.sensor import SensorNoise

ComplexArray = NDArray[np.complex128]

# Three steps always fit A, B and phi: there are no residuals. More than 64 take too long.
STEPS = 4, 64
# Every STRIDE-th row and column is sampled, more of images with less than SAMPLE_PIXELS of them.
STRIDE, SAMPLE_PIXELS, LEAST_PIXELS = 15, 2500, 400
# Number of tiles along each image axis, and least number of those that have pixels.
TILES, LEAST_TILES = 4, 4
HARMONICS = (2, 3)
# A smaller ripple, RMS, is not corrected: LEAST_RIPPLE_RAD is 0.05 um on the paper's sensor.
LEAST_RIPPLE_RAD, LEAST_SIGMAS = 5e-5, 5.0
# A frame of another pattern, not of another light.
LARGEST_GAIN = 0.25
# Pixels with larger residuals, in sigmas of the median pixel, are excluded from the last step.
OUTLIER_SIGMAS = 4.0
# Least number of steps from which the level without the projector's light is estimated.
DARK_STEPS = 5
# Share of the mean diagonal that is added to the diagonal: the equations are never singular.
RIDGE = 1e-9
# Largest deviation from the estimate that motion would cause, relative to this estimate.
MOTION_WITHIN = 0.2
# Least residual of a harmonic of amplitude 1 that is more than rounding.
LEAST_REST = 1e-9


class _Model(NamedTuple):
    """Linear equations of one fringe set, which follow from its phase shifts.

    The features of a pixel are A, B cos(phi) and B sin(phi), then real and imaginary part of
    B exp(i h phi) for each harmonic h, then a constant, the full scale of the camera in DN. The
    unknowns are e_n, two for each harmonic, and the level b as a share of the full scale.
    """

    basis: FloatArray  # (step, 3), from the first three features to levels
    unexplained: FloatArray  # (step, step), from levels to the residuals of their fit
    others: FloatArray  # (unknown, step, feature), residuals by one unit of all unknowns but e_n
    moved: FloatArray  # (step, feature), residuals by a phase rate of 1 rad per frame
    waves: ComplexArray  # (2, step), exp(i t_n) and exp(2 i t_n)


class _Solution(NamedTuple):
    """Estimates of one fringe set."""

    error: FloatArray  # (step,), e_n, with mean 0
    dark_share: float  # level without light minus the assumed level, as a share of the full scale
    variances: FloatArray  # (2,), of E_1 and E_2
    ripple_rad: float  # RMS over the phases, at the mean of (A / B)^2
    sigma_rad: float  # standard uncertainty of ripple_rad
    is_motion: bool  # whether a phase rate explains the estimate


class _SetLight(NamedTuple):
    """Light of one fringe set, see `FrameGains`."""

    relative: FloatArray  # (step,)
    ripple_rad: float
    variances: FloatArray  # (2,)
    dark_dn: float


def estimate_gains(
    stack: Stack,
    patterns: PatternSet,
    sensor: SensorNoise,
    options: DecodeOptions,
    scale: FloatImage | None,
) -> FrameGains | None:
    """Return the relative light of the phase frames; None if no set differs from 1 significantly.

    It is also None with too few or too many steps, if `options.frame_gains` is False, and if too
    few pixels have fringes.

    Parameters
    ----------
    stack, patterns, sensor, options, scale : as in `decode`
    """
    stride = min(STRIDE, max(1, math.isqrt(stack[0].size // SAMPLE_PIXELS)))
    sample = stack[:, ::stride, ::stride]
    is_possible = STEPS[0] <= patterns.steps <= STEPS[1] and sample[0].size >= LEAST_PIXELS
    if not (options.frame_gains and is_possible):
        return None
    dark_dn = np.full((2, patterns.sets), sensor.black_level_dn)
    black_dn = _black_dn(sample, patterns)
    some_scale = np.ones(sample.shape[1:]) if scale is None else scale[::stride, ::stride]
    some_scale = np.ascontiguousarray(some_scale, np.float32)
    relative = np.ones((2, patterns.sets, patterns.steps))
    ripple_rad, variances = np.zeros((2, patterns.sets)), np.zeros((2, 2))
    for axis in patterns.axes:
        k = AXES.index(axis)
        for j, frames in enumerate(patterns.step_sets(axis)):
            model = _model(np.array(patterns.shifts(axis, j)))
            levels = np.ascontiguousarray(sample[frames], np.float32)
            pixels = _sampled(levels, some_scale, model, (sensor, options))
            light = _light_of(pixels, model, black_dn)
            if light is not None:
                relative[k, j], dark_dn[k, j] = light.relative, light.dark_dn
                ripple_rad[k, j] = light.ripple_rad
                variances[k] = light.variances if j == 0 else variances[k]
    return FrameGains(relative, ripple_rad, variances, dark_dn) if ripple_rad.any() else None


def widen(
    smoothed: Smoothed,
    maps: Maps,
    patterns: PatternSet,
    gains: FrameGains | None,
    units: tuple[float, float],
) -> Smoothed:
    """Return the maps with the uncertainty of the frames' light added to sigma.

    The phase error by a wrong light is correlated over many pixels: the filter does not reduce it.

    Parameters
    ----------
    smoothed : filtered maps
    maps : unfiltered maps, with mean and modulation
    gains : light of the frames; None: it is steady, the maps are unchanged
    units : of levels, DN, and of sigma, px, in half precision
    """
    if gains is None:
        return smoothed
    level_unit, sigma_unit = units
    sigma, share = smoothed.sigma.copy(), smoothed.bias_share.copy()
    for axis in patterns.axes:
        k = AXES.index(axis)
        per_rad = patterns.period_along(axis) / (2.0 * np.pi)
        scale = 2.0 * (per_rad / patterns.steps) ** 2
        first, second = gains.variances[k]
        widening = Widening(
            sigma[k], share[k], maps.mean[k], maps.modulation[k],
            first_px2=np.float32(scale * first),
            second_px2=np.float32(0.25 * scale * second),
            dark_dn=np.float32(gains.dark_dn[k, 0]),
            per_sigma=np.float32(sigma_unit / BIAS),
            per_level=np.float32(level_unit / BIAS),
            pack=np.float32(BIAS / sigma_unit),
        )  # fmt: skip
        run_over_rows(widen_rows, sigma.shape[1], widening)
    return smoothed._replace(sigma=sigma, bias_share=share)


def _black_dn(sample: Stack, patterns: PatternSet) -> float | None:
    """Return the median of the black frame, DN; None: there is none, or it is damaged."""
    if not patterns.uniform:
        return None
    black = sample[patterns.index("black")][:, ::2, ::2]
    black = black[np.isfinite(black)]
    return float(np.median(black)) if black.size else None


def _model(shifts: FloatArray) -> _Model:
    """Return the equations of a fringe set with the phase shifts (step,), turns."""
    turns, steps = 2.0 * np.pi * shifts, shifts.size
    basis = np.stack([np.ones(steps), np.cos(turns), -np.sin(turns)], axis=1)
    unexplained = np.eye(steps) - basis * np.array([1.0, 2.0, 2.0]) @ basis.T / steps
    # A harmonic without residuals is not distinguished from A and B exp(i phi).
    waves = np.exp(1j * np.outer(HARMONICS, turns))
    rests = np.abs(waves @ unexplained).max(axis=1)
    orders = [h for h, rest in zip(HARMONICS, rests, strict=True) if rest > LEAST_REST]
    others = np.zeros((2 * len(orders) + 1, steps, 2 * len(orders) + 4))
    for unknown, h in zip(range(0, 2 * len(orders), 2), orders, strict=True):
        cosine, sine = np.cos(h * turns), np.sin(h * turns)
        parts = slice(3 + unknown, 5 + unknown)
        others[unknown, :, parts] = np.stack([cosine, -sine], axis=1)
        others[unknown + 1, :, parts] = np.stack([sine, cosine], axis=1)
    waves = np.exp(1j * np.outer([1.0, 2.0], turns))
    moved = np.zeros(others.shape[1:])
    times = np.arange(steps)[:, None] - 0.5 * (steps - 1)
    moved[:, 1:3] = unexplained @ (-times * np.stack([np.sin(turns), np.cos(turns)], axis=1))
    return _Model(basis, unexplained, others, moved, waves)


def _sampled(
    levels: FloatImage,
    scale: FloatImage,
    model: _Model,
    limits: tuple[SensorNoise, DecodeOptions],
) -> SampledSet:
    """Return the levels (step, row, col) of one fringe set for the kernel."""
    (sensor, options), steps = limits, len(levels)
    black_dn = float(sensor.black_level_dn)
    lowest_dn = 0.0 if black_dn > 0.0 else -np.inf
    dark_variance_dn2 = float(sensor.variance_dn2(black_dn))
    return SampledSet(
        levels, scale, black_dn, np.ones(steps), model.basis, TILES,
        limits=(black_dn, float(sensor.clipped_from_dn), lowest_dn),
        noise=(float(sensor.gain_dn_per_e), dark_variance_dn2),
        most_variance=0.5 * steps * options.max_phase_sigma_rad**2,
        most_misfit=np.inf,
    )  # fmt: skip


def _light_of(sample: SampledSet, model: _Model, black_dn: float | None) -> _SetLight | None:
    """Return the light of a fringe set and its uncertainty; None: it is not significant.

    Further steps exclude pixels with too large residuals, which moved or are lit by other surfaces,
    and estimate the level without the projector's light: levels divided by the light contain it
    divided by the light. It is at most the level of the black frame, which also contains light of
    the projector. Four steps do not distinguish it from the light: it is that of the black frame.

    Parameters
    ----------
    black_dn : level of the black frame; None: not known
    """
    misfit, (least_dn, clipped_dn, _) = np.zeros(sample.levels.shape[1:]), sample.limits
    first = _solve(sample, misfit, model)
    if first is None or np.abs(first.error).max() > LARGEST_GAIN:
        return None
    if first.ripple_rad < max(LEAST_RIPPLE_RAD, LEAST_SIGMAS * first.sigma_rad) or first.is_motion:
        return None
    relative, solution = 1.0 + first.error, first
    most_dn = max(0.5 * (least_dn + clipped_dn) if black_dn is None else black_dn, least_dn)
    is_estimated = len(relative) >= DARK_STEPS
    if black_dn is not None and not is_estimated:
        sample = sample._replace(dark_dn=most_dn)
    for _ in range(2):
        sample = sample._replace(factors=1.0 / relative)
        next_model = _with_dark(model, relative) if is_estimated else model
        refined = _solve(sample, misfit, next_model)
        if refined is None:
            break
        solution, relative = refined, relative * (1.0 + refined.error)
        dark_dn = min(max(sample.dark_dn + refined.dark_share * clipped_dn, least_dn), most_dn)
        most_misfit = OUTLIER_SIGMAS**2 * float(np.median(misfit[misfit >= 0.0]))
        sample = sample._replace(dark_dn=dark_dn, most_misfit=most_misfit)
    relative /= relative.mean()
    return _SetLight(relative, first.ripple_rad, solution.variances, sample.dark_dn)


def _with_dark(model: _Model, relative: FloatArray) -> _Model:
    """Return the equations with the residuals by a level without light, divided by the light."""
    others = model.others.copy()
    others[-1, :, -1] = model.unexplained @ (1.0 - relative)
    return model._replace(others=others)


def _solve(sample: SampledSet, misfit: FloatArray, model: _Model) -> _Solution | None:
    """Solve the equations of one fringe set, with all tiles and without each of them.

    The result is None with too few pixels.

    Parameters
    ----------
    misfit : (row, col), read and written, see `TileSums`
    """
    steps = len(model.basis)
    features = model.others.shape[2]
    sums = TileSums(
        np.zeros((TILES**2, features, features)),
        np.zeros((TILES**2, features, steps)),
        np.zeros(TILES**2, np.int64),
        misfit,
    )
    sum_tiles(sample, PixelScratch(np.zeros(steps), np.zeros(features)), sums)
    used = np.flatnonzero(sums.counts)
    if sums.counts.sum() < LEAST_PIXELS or len(used) < LEAST_TILES:
        return None
    matrices, sides = _equations(sums, model)
    whole, side = matrices.sum(axis=0), sides.sum(axis=0)
    size = np.trace(whole) / len(whole)
    whole += size * RIDGE * np.eye(len(whole))
    whole[:steps, :steps] += size  # the mean of e_n is 0
    solved = np.linalg.solve(whole, side)
    error, dark_share = solved[:steps], float(solved[-1])
    parts = np.linalg.solve(whole - matrices[used], (side - sides[used])[..., None])[:, :steps, 0]
    around = (parts - parts.mean(axis=0)) @ model.waves.T
    variances = (1.0 - 1.0 / len(used)) * np.square(np.abs(around)).sum(axis=0)
    squares = np.einsum("tff->f", sums.pairs)
    contrast2 = squares[0] / (squares[1] + squares[2])
    shares = 2.0 / steps**2 * np.array([contrast2, 0.25])
    ripple_rad = math.sqrt(shares @ np.square(np.abs(model.waves @ error)))
    sigma_rad = math.sqrt(shares @ variances)
    by_motion = np.linalg.solve(whole, _side_of_motion(sums, model))[:steps]
    weighted = np.sqrt(shares)[:, None] * (model.waves @ np.stack([error, by_motion], axis=1))
    is_motion = _is_multiple(weighted[:, 0], weighted[:, 1])
    return _Solution(error - error.mean(), dark_share, variances, ripple_rad, sigma_rad, is_motion)


def _side_of_motion(sums: TileSums, model: _Model) -> FloatArray:
    """Return the right side (unknown,) by residuals of a phase rate of 1 rad per frame."""
    moved = np.einsum("tfg,ng->nf", sums.pairs, model.moved)
    of_light = np.einsum("ni,ni->n", model.basis, moved[:, :3])
    return np.concatenate([of_light, np.einsum("jnf,nf->j", model.others, moved)])


def _is_multiple(estimate: ComplexArray, expected: ComplexArray) -> bool:
    """Return whether an estimate is nearly a real multiple of the expected one."""
    size = max(float(np.linalg.norm(expected)) ** 2, 1e-300)
    rate = float(np.vdot(expected, estimate).real) / size
    rest = np.linalg.norm(estimate - rate * expected)
    return bool(rest <= MOTION_WITHIN * np.linalg.norm(rate * expected))


def _equations(sums: TileSums, model: _Model) -> tuple[FloatArray, FloatArray]:
    """Return matrix (tile, unknown, unknown) and right side (tile, unknown)."""
    steps, fitted = len(model.basis), sums.pairs[:, :3]
    unknowns = steps + len(model.others)
    matrices = np.zeros((len(fitted), unknowns, unknowns))
    light = np.einsum("ni,tij,mj->tnm", model.basis, fitted[:, :, :3], model.basis)
    matrices[:, :steps, :steps] = model.unexplained * light
    moved = np.einsum("tfg,jng->tjnf", sums.pairs, model.others)
    crossed = np.einsum("ni,tjni->tnj", model.basis, moved[..., :3])
    matrices[:, :steps, steps:] = crossed
    matrices[:, steps:, :steps] = crossed.transpose(0, 2, 1)
    matrices[:, steps:, steps:] = np.einsum("jnf,tknf->tjk", model.others, moved)
    rest = sums.products - np.einsum("tif,ni->tfn", fitted, model.basis)
    of_light = np.einsum("ni,tin->tn", model.basis, rest[:, :3])
    of_others = np.einsum("jnf,tfn->tj", model.others, rest)
    return matrices, np.concatenate([of_light, of_others], axis=1)
