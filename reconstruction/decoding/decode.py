"""Decode a stack of camera frames to projector coordinates, with sigma and reason per pixel.

Camera pixels are (row, col), row 0 at the top. Projector coordinates are in px, whole at the centre
of a projector pixel. `patterns` has the formulas of the fringes. The N-step least squares are those
of Surrel, Appl. Opt. 36, 271 (1997). `PatternSet`, `_order` and `_chain` describe the codes and how
fringe orders are determined at the edges of stripes.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from reconstruction.arrays import FloatImage, Reason, Stack
from reconstruction.codes import Rule, Unwrap
from reconstruction.compact import TURN_STEPS, Half, Orders, Share, Turns
from reconstruction.compiling import run_over_rows
from reconstruction.decoding import AxisDecode, Decoded, DecodeOptions, Expect, PhaseReference
from reconstruction.decoding._decode import Maps, Plan, decode_rows
from reconstruction.decoding._filter import Smoothed, Unfiltered, smooth
from reconstruction.decoding._micro import decode_micro_rows
from reconstruction.decoding.by_modulation import filter_by_modulation
from reconstruction.decoding.gains import estimate_gains, widen
from reconstruction.decoding.general import Numbering, unwrap_maps
from reconstruction.decoding.glints import add_glints
from reconstruction.decoding.micro import micro_periods
from reconstruction.decoding.plan import (
    SIGMA_UNIT_PX,
    blank_maps,
    make_plan,
    place_displaced,
    units_of,
)
from reconstruction.decoding.reference import expect_at_pixels
from reconstruction.decoding.residuals import mask_residuals
from reconstruction.decoding.ripple import NODES, Ripple, ripple_of
from reconstruction.errors import InputError
from reconstruction.patterns import AXES, Axis, PatternSet
from reconstruction.reduction import Equivalent, reduced
from reconstruction.rig.projected_light import ProjectorResponse
from reconstruction.rig.sensor import SensorNoise

__all__ = ["AxisDecode", "DecodeOptions", "Decoded", "Reason", "decode"]

STACK_TYPES = ("uint8", "uint16", "float32")
BAND_ROWS = 96


def decode(
    stack: Stack,
    patterns: PatternSet,
    sensor: SensorNoise,
    options: DecodeOptions | None = None,
    scale: FloatImage | None = None,
    *,
    response: ProjectorResponse | None = None,
    unwrap: Unwrap | None = None,
    expect: Expect | None = None,
) -> Decoded:
    """Return the projector coordinates of every camera pixel from a stack of frames.

    Parameters
    ----------
    stack : (frame, row, col) uint8, uint16 or float32, DN, in the order of `patterns.frames`
    patterns : sequence of patterns that the projector showed
    sensor : noise model of the camera, from which masks and predicted sigma are computed
    options : filter and masks; None: the defaults of `DecodeOptions`
    scale : (row, col) float32, factor by which each pixel's DN above the black level was
        multiplied, see `merge_exposures`; None: 1 everywhere
    response : projector response; None: linear. The phase error by its harmonics is subtracted; its
        uncertainty is part of sigma and of the probability of a wrong order
    unwrap : function that numbers the fringes of one axis, see `codes.Unwrap`; None: the code's
    expect : coordinates that are known otherwise; None: marked pixels in `options.reference`

    Raises
    ------
    InputError : type, axes or frames of the stack are wrong; `scale` has a wrong shape or a value
        that is not positive; the code cannot use `response` or a reference; `unwrap` is given
        without fringes, or returns a wrong shape; a single image has no carrier
    """
    options = options or DecodeOptions()
    _check(stack, patterns, scale, response, None if unwrap else options.reference)
    recorded = reduced(np.ascontiguousarray(stack), patterns, sensor, scale)
    frames, patterns = recorded.stack, recorded.patterns
    options = _options_of(recorded, options)
    ripple = ripple_of(patterns, None if recorded.is_smooth else response)
    rule = patterns.kind.rule if unwrap is None else Rule.OWN
    # For displaced patterns the kernels decode x + displacement; numpy functions get phases at x.
    displacement = 0.0 if rule is Rule.OWN else patterns.kind.displacement
    gains = estimate_gains(frames, patterns, sensor, options, scale)
    plan = make_plan(
        frames, patterns, sensor, options, scale,
        ripple=ripple, displacement=displacement, gains=gains, equal_steps=recorded.equal_steps,
    )  # fmt: skip
    maps, islands = blank_maps(stack.shape[1], stack.shape[2]), None
    if rule is Rule.OWN:
        known = expect or expect_at_pixels(options.reference, stack.shape[1:])
        islands = unwrap_maps(frames, patterns, plan, maps, Numbering(unwrap, known))
    else:
        periods = partial(micro_periods, frames, patterns, sensor, scale)
        _decode_compiled(frames, patterns, plan, periods, maps)
    units = units_of(sensor, scale)
    mask_residuals(maps, patterns, plan, options, recorded.noise_share)
    smoothed = _smoothed(maps, options, patterns)
    smoothed = widen(smoothed, maps, patterns, gains, units[:2])
    smoothed = _with_ripple(smoothed, maps, ripple, patterns)
    column, row = (_axis(maps, smoothed, axis, units, patterns) for axis in AXES)
    return Decoded(column, row, smoothed.reason, patterns.axes, gains, islands)


def _options_of(recorded: Equivalent, options: DecodeOptions) -> DecodeOptions:
    """Return the options without those that have no effect on reduced frames.

    Four averaged frames do not distinguish motion from a change of the light. The Fourier transform
    has filtered the image already.
    """
    taps = 0 if recorded.is_smooth else options.filter_taps
    is_estimated = options.frame_gains and not recorded.is_reduced
    return replace(options, filter_taps=taps, frame_gains=is_estimated)


def _decode_compiled(
    frames: Stack, patterns: PatternSet, plan: Plan, periods: Callable[[], Any], maps: Maps
) -> None:
    if patterns.kind.rule is Rule.SINGLE_IMAGES:
        _run(decode_micro_rows, frames, plan, periods(), maps)
    else:
        _run(decode_rows, frames, plan, maps)
    if patterns.kind.displacement:
        place_displaced(maps, patterns)


def _run(kernel: Callable[..., None], frames: Stack, *arguments: Any) -> None:
    """Run a kernel over all rows of the frames."""
    run_over_rows(kernel, frames.shape[1], frames, *arguments, band_rows=BAND_ROWS)


def _check(
    stack: Stack,
    patterns: PatternSet,
    scale: FloatImage | None,
    response: ProjectorResponse | None,
    reference: PhaseReference | None,
) -> None:
    _check_stack(stack, patterns)
    if reference is not None and patterns.kind.numbers_pixels:
        raise InputError(
            "decode reference_pixels and reference_z_mm have no effect with patterns code "
            f"{patterns.code!r}, which numbers the fringes itself; remove them"
        )
    if response is not None and not patterns.kind.takes_response:
        raise InputError(
            f"response is stated with patterns code {patterns.code!r}: its single images do not"
            " determine the fringes' harmonics; remove [response], or show several steps of"
            " every period"
        )
    if scale is not None and (scale.shape != stack.shape[1:] or not np.all(scale > 0.0)):
        raise InputError(
            f"scale has shape {scale.shape}; give positive numbers of shape {stack.shape[1:]}"
        )


def _check_stack(stack: Stack, patterns: PatternSet) -> None:
    if stack.dtype.name not in STACK_TYPES:
        raise InputError(f"stack is {stack.dtype}; allowed are {', '.join(STACK_TYPES)}")
    if stack.ndim != 3 or stack.shape[0] != len(patterns.frames) or stack.size == 0:
        raise InputError(
            f"stack has shape {stack.shape}; "
            f"this pattern set needs ({len(patterns.frames)} frames, rows, cols)"
        )


def _smoothed(maps: Maps, options: DecodeOptions, patterns: PatternSet) -> Smoothed:
    source = Unfiltered(maps.coordinate_px, maps.sigma, maps.reason)
    # Without fringes the coordinate is quantised by word. This is no noise that a mean reduces.
    if options.filter_taps == 0 or patterns.steps == 0:
        no_bias = np.zeros(source.sigma.shape, np.uint8)
        return Smoothed(source.coordinate_px, source.sigma, no_bias, source.reason)
    taps, sigma_px = options.filter_taps, options.filter_sigma_px
    if options.weights == "modulation":
        return filter_by_modulation(maps, patterns, taps, sigma_px)
    add_glints(maps, patterns)
    if patterns.axes == AXES and not patterns.row_periods_px:
        return smooth(source, taps, sigma_px, 0.5 * float(patterns.period_px), SIGMA_UNIT_PX)
    no_bias = np.zeros(maps.sigma.shape, np.uint8)
    result = Smoothed(
        np.zeros_like(maps.coordinate_px), np.zeros_like(maps.sigma), no_bias, maps.reason
    )
    for axis in patterns.axes:
        at = slice(AXES.index(axis), AXES.index(axis) + 1)
        limit_px = 0.5 * float(patterns.period_along(axis))
        unfiltered = Unfiltered(maps.coordinate_px[at], maps.sigma[at], maps.reason)
        filtered = smooth(unfiltered, taps, sigma_px, limit_px, SIGMA_UNIT_PX)
        for target, part in zip(result[:3], filtered[:3], strict=True):
            target[at] = part
        result = result._replace(reason=filtered.reason)
    return result


def _with_ripple(smoothed: Smoothed, maps: Maps, ripple: Ripple, patterns: PatternSet) -> Smoothed:
    """Return the maps with the uncertainty of the projector's response added to sigma.

    The phase error by the response is correlated over many pixels, so that the filter does not
    reduce its uncertainty. For a weighted mean of several periods the value of the measuring period
    is used. This is an upper bound, because the errors of different periods partly cancel.
    """
    if not ripple.error_rad.size:
        return smoothed
    sigma, share = smoothed.sigma.copy(), smoothed.bias_share.copy()
    for k, axis in enumerate(AXES):
        if axis not in patterns.axes:
            continue
        per_rad = np.float32(patterns.period_along(axis) / (2.0 * np.pi))
        node = maps.turns[k] // (TURN_STEPS // NODES)
        doubt_px = per_rad * ripple.sigma_rad[k, 0][node]
        noise_px = Half(smoothed.sigma[k], SIGMA_UNIT_PX).expand()
        whole_px = np.where(noise_px > 0.0, np.hypot(noise_px, doubt_px), np.float32(0.0))
        sigma[k] = Half.of(whole_px, SIGMA_UNIT_PX).bits
        noise_share = np.divide(
            noise_px, whole_px, out=np.ones_like(noise_px), where=whole_px > 0.0
        )
        share[k] = np.rint(share[k] * np.square(noise_share)).astype(np.uint8)
    return smoothed._replace(sigma=sigma, bias_share=share)


def _axis(
    maps: Maps,
    smoothed: Smoothed,
    axis: Axis,
    units: tuple[float, float, float],
    patterns: PatternSet,
) -> AxisDecode:
    k, period_px = AXES.index(axis), float(patterns.period_along(axis))
    level_dn, sigma_px, chance = units
    coordinate_px, turns = smoothed.coordinate_px[k], Turns(maps.turns[k])
    compact: dict[str, Any] = {
        "phase_rad": turns,
        "order": Orders(coordinate_px, turns, period_px),
        "mean_dn": Half(maps.mean[k], level_dn),
        "modulation_dn": Half(maps.modulation[k], level_dn),
        "sigma_px": Half(smoothed.sigma[k], sigma_px),
        "bias_share": Share(smoothed.bias_share[k]),
        "residual_dn": Half(maps.residual[k], level_dn),
        "order_error": Half(maps.order_error[k], chance),
    }
    return AxisDecode(coordinate_px, **compact)
