"""Phase of a single fringe image by Fourier transform (Takeda, Ina, Kobayashi 1982).

Source: J. Opt. Soc. Am. 72, 156 (1982). The fringes are a carrier with the frequency f_0 in the
camera image, which the relief modulates. A window in the frequency domain around f_0 selects one
side lobe of the spectrum. Its inverse transform is (B / 2) exp(i phi). The window is round, flat
around f_0 and falls smoothly, so that it excludes the mean level and the other side lobe.

The phase is that of the exposure of one frame. Relief with frequencies beyond the window is lost:
the relief must change the local fringe frequency by less than about f_0 / 2, and details smaller
than a fringe period are smoothed.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from reconstruction.arrays import BoolImage, FloatArray, FloatImage, Stack
from reconstruction.errors import InputError
from reconstruction.patterns import Axis, PatternSet
from reconstruction.reduction.equivalent import (
    Equivalent,
    fringe_sets,
    lost_pixels,
    with_equal_steps,
)
from reconstruction.rig.sensor import SensorNoise
from reconstruction.stepping import CYCLE

# The window is 1 up to the first distance from the carrier and 0 from the second one on, with half
# a cosine between them; distances as shares of the carrier frequency.
FLAT, END = 0.4, 0.9
# Margin around the image, fringe periods.
MARGIN = 3.0
# Least number of fringes in the image, and largest carrier frequency, cycles per pixel.
LEAST_FRINGES, MOST_FREQUENCY = 4.0, 0.4
# Noise variance of a fringe image minus the mean of white and black, in that of one frame. The
# noise of white and black together is that of two frames at the mean level.
WITH_UNIFORM = 1.5


class Carrier(NamedTuple):
    """Mean frequency of the fringes in the camera image, cycles per pixel; the phase increases."""

    column: float
    row: float

    @property
    def frequency(self) -> float:
        """Absolute frequency, cycles per pixel."""
        return float(np.hypot(self.column, self.row))


def transform_single(
    stack: Stack, patterns: PatternSet, sensor: SensorNoise, scale: FloatImage | None = None
) -> Equivalent:
    """Return four equal steps with the phases that the Fourier transform gives.

    The direction in which the phase increases follows from the first code word. Without words it
    is that of increasing camera columns for projector columns, and of rows for rows.

    Parameters
    ----------
    stack, patterns, sensor, scale : as in `decode`, with the stepping "single"

    Raises
    ------
    InputError : there is no carrier: less than four fringes in the image, or more than 0.4 per px
    """
    equal = replace(patterns, steps=CYCLE, stepping="equal", waveform="sinusoidal")
    sets, shares = [], []
    for number, (frame,) in enumerate(fringe_sets(stack, patterns)):
        axis = patterns.axes[number // patterns.sets]
        mean_dn, light_dn = _light(stack, patterns, frame)
        lost, marked_dn = lost_pixels(frame[np.newaxis], sensor, scale)
        fringes_dn = np.where(lost | ~_is_lit(light_dn), 0.0, frame - mean_dn)
        carrier = find_carrier(fringes_dn, axis)
        direction = _direction(stack, patterns, axis, mean_dn, carrier)
        lobe = side_lobe(fringes_dn, Carrier(direction * carrier.column, direction * carrier.row))
        waves = np.exp(0.5j * np.pi * np.arange(CYCLE))[:, None, None]
        four = mean_dn + 2.0 * np.real(lobe * waves)
        sets.append(np.where(lost, marked_dn, four).astype(np.float32))
        shares.append(noise_share(carrier) * (WITH_UNIFORM if patterns.uniform else 1.0))
    still = with_equal_steps(stack, patterns, sets)
    return Equivalent(still, equal, 1.0 / max(shares), is_smooth=True)


def side_lobe(fringes_dn: FloatArray, carrier: Carrier) -> NDArray[np.complex128]:
    """Return (B / 2) exp(i phi), (row, col) complex DN, of a fringe image without its mean level.

    Parameters
    ----------
    fringes_dn : (row, col), DN; 0 where there is no light
    """
    margin = int(np.ceil(MARGIN / carrier.frequency))
    rows, cols = (size + margin for size in fringes_dn.shape)
    row = np.fft.fftfreq(rows)[:, np.newaxis] - carrier.row
    column = np.fft.fftfreq(cols) - carrier.column
    window = _window(np.hypot(row, column) / carrier.frequency)
    spectrum = np.fft.fft2(fringes_dn, (rows, cols))
    height, width = fringes_dn.shape
    return np.asarray(np.fft.ifft2(window * spectrum)[:height, :width])


def _window(distance: FloatArray) -> FloatArray:
    """Return the window at distances from the carrier, shares of the carrier frequency."""
    fall = np.clip((distance - FLAT) / (END - FLAT), 0.0, 1.0)
    return np.asarray(0.5 + 0.5 * np.cos(np.pi * fall))


def noise_share(carrier: Carrier) -> float:
    """Return the share of white noise in the window: the integral of its square."""
    distance = np.linspace(0.0, END, 2001)
    rings = 2.0 * np.pi * distance * np.square(_window(distance))
    return float(np.trapezoid(rings, distance)) * carrier.frequency**2


def find_carrier(fringes_dn: FloatArray, axis: Axis) -> Carrier:
    """Return the mean frequency of the fringes: the centroid of the strongest side lobe.

    Parameters
    ----------
    fringes_dn : (row, col) fringe image without its mean level
    axis : the frequency along the camera's columns, or for "row" along its rows, is positive

    Raises
    ------
    InputError : the strongest frequency is four fringes per image or fewer, or above 0.4 per px
    """
    rows, cols = fringes_dn.shape
    taper = np.hanning(rows)[:, np.newaxis] * np.hanning(cols)
    around_dn = fringes_dn - float((fringes_dn * taper).sum() / taper.sum())
    power = np.square(np.abs(np.fft.fft2(around_dn * taper)))
    row, column = np.meshgrid(np.fft.fftfreq(rows), np.fft.fftfreq(cols), indexing="ij")
    frequency = np.hypot(row, column)
    along = row if axis == "row" else column
    power = np.where(along > 0.0, power, 0.0)
    peak = np.unravel_index(int(np.argmax(power)), power.shape)
    near = np.hypot(row - row[peak], column - column[peak]) < FLAT * frequency[peak]
    weight = power * near
    total = float(weight.sum())
    carrier = Carrier(0.0, 0.0)
    if total > 0.0:
        carrier = Carrier(*(float((weight * f).sum()) / total for f in (column, row)))
    fringes = abs(carrier.column) * cols + abs(carrier.row) * rows
    if fringes <= LEAST_FRINGES or carrier.frequency >= MOST_FREQUENCY:
        raise InputError(
            f"patterns stepping 'single': found {fringes:.3g} fringes in the image, with"
            f" {carrier.frequency:.3g} periods per camera px; allowed more than {LEAST_FRINGES:g}"
            f" fringes and less than {MOST_FREQUENCY:g}; change period_px"
        )
    return carrier


def _light(stack: Stack, patterns: PatternSet, frame: Stack) -> tuple[FloatArray, FloatArray]:
    """Return mean level and light, (row, col) DN: by white and black, or else by the fringes."""
    if patterns.uniform:
        white, black = (stack[patterns.index(k).start].astype(float) for k in ("white", "black"))
        return 0.5 * (white + black), white - black
    smooth_px = max(frame.shape) / (2.0 * LEAST_FRINGES)
    mean_dn = np.asarray(ndimage.gaussian_filter(frame.astype(float), smooth_px))
    return mean_dn, np.ones(frame.shape)


def _is_lit(light_dn: FloatArray) -> BoolImage:
    return np.asarray(light_dn > 0.1 * np.percentile(light_dn, 95.0))


def _direction(
    stack: Stack, patterns: PatternSet, axis: Axis, mean_dn: FloatArray, carrier: Carrier
) -> int:
    """Return -1 if the first code word decreases along the carrier; 1: it increases, or no word."""
    words = patterns.words(axis)
    if not words or words[0].brightness is not None:
        return 1
    gray = stack[patterns.index("gray", axis)][: words[0].bits]
    bits = patterns.binary(gray > mean_dn)
    value = np.tensordot(2.0 ** np.arange(words[0].bits)[::-1], bits.astype(float), axes=1)
    row, col = np.indices(value.shape)
    along = carrier.column * col + carrier.row * row
    return -1 if float(np.mean((along - along.mean()) * (value - value.mean()))) < 0.0 else 1
