"""From a stack of camera frames to projector coordinates, with sigma and reason for every pixel.

Frames: camera pixels (row, col), row 0 at the top; projector coordinates in px, integer = centre of
a projector pixel. Formulas: see `patterns`; N-step least squares after Surrel, Appl. Opt. 36, 271
(1997); codes and edge-safe rules: see `PatternSet`, `_order`, `_chain`.
"""

from typing import Any

import numpy as np

from reconstruction._jit import run_over_rows
from reconstruction.arrays import FloatImage, Stack
from reconstruction.compact import Half, Orders, Share, Turns
from reconstruction.decoding._band import Maps
from reconstruction.decoding._decode import decode_rows
from reconstruction.decoding._filter import Smoothed, Unfiltered
from reconstruction.decoding.decoded import AxisDecode, Decoded
from reconstruction.decoding.options import DecodeOptions
from reconstruction.decoding.plan import SIGMA_UNIT_PX, make_plan, units_of
from reconstruction.decoding.smoothing import smooth
from reconstruction.errors import InputError
from reconstruction.mask import Reason
from reconstruction.patterns import PatternSet
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
) -> Decoded:
    """Decode a stack of frames.

    Parameters
    ----------
    stack : (frame, row, col) uint8, uint16 or float32, DN, in the order of `patterns.frames`
    patterns : what was projected
    sensor : noise model; gives the masks and the predicted sigma
    options : filter and masks; None: the defaults of `DecodeOptions`
    scale : (row, col) float32, by which each pixel's DN above the black level were multiplied, see
        `merge_exposures`; None: 1

    Raises
    ------
    InputError : wrong number of axes, frames or type of the stack, or shape of the scale
    """
    _check_stack(stack, patterns)
    if scale is not None and (scale.shape != stack.shape[1:] or not np.all(scale > 0.0)):
        raise InputError(
            f"scale has shape {scale.shape}; give positive numbers of shape {stack.shape[1:]}"
        )
    frames = np.ascontiguousarray(stack)
    options = options or DecodeOptions()
    plan = make_plan(frames, patterns, sensor, options, scale)
    maps = _blank_maps(stack.shape[1], stack.shape[2])
    run_over_rows(decode_rows, stack.shape[1], frames, plan, maps, band_rows=BAND_ROWS)
    smoothed = _smoothed(maps, options, patterns.period_px)
    units = units_of(sensor, scale)
    column, row = (_axis(maps, smoothed, axis, units, patterns.period_px) for axis in range(2))
    return Decoded(column, row, smoothed.reason)


def _check_stack(stack: Stack, patterns: PatternSet) -> None:
    if stack.dtype.name not in STACK_TYPES:
        raise InputError(f"stack is {stack.dtype}; allowed are {', '.join(STACK_TYPES)}")
    if stack.ndim != 3 or stack.shape[0] != len(patterns.frames) or stack.size == 0:
        raise InputError(
            f"stack has shape {stack.shape}; "
            f"this pattern set needs ({len(patterns.frames)} frames, rows, cols)"
        )


def _blank_maps(rows: int, cols: int) -> Maps:
    turns, mean, modulation, sigma, residual, error = (
        np.zeros((2, rows, cols), np.uint16) for _ in range(6)
    )
    return Maps(
        np.zeros((2, rows, cols), np.float32),
        turns, mean, modulation, sigma, residual, error,
        np.zeros((rows, cols), np.uint8),
    )  # fmt: skip


def _smoothed(maps: Maps, options: DecodeOptions, period_px: float) -> Smoothed:
    source = Unfiltered(maps.coordinate_px, maps.sigma, maps.reason)
    if options.filter_taps == 0:
        return Smoothed(
            source.coordinate_px,
            source.sigma,
            np.zeros(source.sigma.shape, np.uint8),
            source.reason,
        )
    limit_px = 0.5 * float(period_px)
    return smooth(source, options.filter_taps, options.filter_sigma_px, limit_px, SIGMA_UNIT_PX)


def _axis(
    maps: Maps, smoothed: Smoothed, axis: int, units: tuple[float, float, float], period_px: float
) -> AxisDecode:
    level_dn, sigma_px, chance = units
    coordinate_px, turns = smoothed.coordinate_px[axis], Turns(maps.turns[axis])
    compact: dict[str, Any] = {
        "phase_rad": turns,
        "order": Orders(coordinate_px, turns, float(period_px)),
        "mean_dn": Half(maps.mean[axis], level_dn),
        "modulation_dn": Half(maps.modulation[axis], level_dn),
        "sigma_px": Half(smoothed.sigma[axis], sigma_px),
        "bias_share": Share(smoothed.bias_share[axis]),
        "residual_dn": Half(maps.residual[axis], level_dn),
        "order_error": Half(maps.order_error[axis], chance),
    }
    return AxisDecode(coordinate_px, **compact)
