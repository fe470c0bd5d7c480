"""Response of a layer to pressure within a rectangle of its cells (a patch).

The contact solver evaluates this response repeatedly. A contact covers a small part of the slab,
and during the solution only the pressure and the deflection within the patch are needed. There the
response is a convolution with the response K to one loaded cell. With i the deflected and j the
loaded cell,

    free slab (sine series):  A(i, j) = K(i - j) - K(i + j + 1)   per axis,
    bonded layer (periodic):  A(i, j) = K(i - j).

An FFT of twice the patch therefore replaces an FFT of the whole grid, without approximation.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
from scipy import fft

from reconstruction.arrays import FloatArray, IntArray

ComplexArray = npt.NDArray[np.complex128]
_MARGIN = 2


@dataclass(frozen=True)
class Span:
    """A range of cells along one axis of the grid: `first` to `first + count - 1`."""

    first: int
    count: int

    @classmethod
    def around(cls, cells: npt.NDArray[np.intp], count: int) -> "Span":
        """Return the range that contains the indices `cells`, with a margin of 2 cells.

        The range is cut off at the ends of an axis of `count` cells.
        """
        first = max(int(cells.min()) - _MARGIN, 0)
        return cls(first, min(int(cells.max()) + _MARGIN + 1, count) - first)

    @property
    def padded(self) -> int:
        """Length of an FFT, in cells, in which the convolution of the patch does not wrap round."""
        return int(fft.next_fast_len(2 * self.count - 1, real=True))

    @property
    def cells(self) -> slice:
        """The range as a slice of the axis."""
        return slice(self.first, self.first + self.count)

    def offsets(self) -> IntArray:
        """Return i - j for each element (padded,) of the convolution kernel."""
        lag = np.arange(self.padded)
        return np.where(lag < self.count, lag, lag - self.padded)

    def sums(self) -> IntArray:
        """Return i + j + 1 for each element (padded,) of the kernel for the reversed pressure."""
        last = 2 * self.first + self.count
        return np.clip(self.offsets(), 1 - self.count, self.count - 1) + last


@dataclass(frozen=True, eq=False)
class Patch:
    """Response of a rectangle of cells to pressure on the same cells; arrays are (row, col)."""

    rows: Span
    cols: Span
    #: spectrum of the convolution kernel; for a sine series also the spectra of the kernels for
    #: pressure in reversed order of rows, of columns, and of both
    kernels: tuple[ComplexArray, ...]
    #: (row, half of col) pressure over modulus per deflection at each wavenumber, 1/mm, positive
    stiffness: FloatArray

    @property
    def cells(self) -> tuple[slice, slice]:
        """Index (rows, columns) of the patch in the whole grid."""
        return self.rows.cells, self.cols.cells

    def deflect(self, pressure: FloatArray) -> FloatArray:
        """Return the touched face's deflection, mm, for pressure over modulus, both (row, col)."""
        forward = self._forward(pressure)
        image = self.kernels[0] * forward
        if len(self.kernels) > 1:
            # The spectrum of a reversed real field is the conjugate one: no further FFT is needed.
            over = np.roll(forward[::-1], 1, axis=0)
            image += self.kernels[1] * over
            image += self.kernels[2] * np.conj(over, out=over)
            image += self.kernels[3] * np.conj(forward, out=forward)
        return self._back(image)

    def apply(self, gap: FloatArray) -> FloatArray:
        """Return the pressure over modulus (row, col) that deflects the face by about `gap`, mm.

        It is the preconditioner of the contact solver, an approximate inverse of `deflect`.
        """
        return self._back(self._forward(gap) * self.stiffness)

    @cached_property
    def cell(self) -> float:
        """Diagonal element of `apply`, 1/mm.

        It is the approximate pressure over modulus, per mm, on a cell that deflects while all other
        cells do not.
        """
        weights = np.full(self.stiffness.shape[1], 2.0)
        weights[0] = 1.0
        if self.cols.padded % 2 == 0:
            weights[-1] = 1.0
        return float((self.stiffness @ weights).sum()) / (self.rows.padded * self.cols.padded)

    def _forward(self, field: FloatArray) -> ComplexArray:
        return np.asarray(fft.rfft2(field, s=(self.rows.padded, self.cols.padded)))

    def _back(self, spectrum: ComplexArray) -> FloatArray:
        shape = (self.rows.padded, self.cols.padded)
        field: FloatArray = fft.irfft2(spectrum, s=shape, overwrite_x=True)
        return field[: self.rows.count, : self.cols.count]


def periodic_patch(kernel: FloatArray, rows: Span, cols: Span, stiffness: FloatArray) -> Patch:
    """Return a patch of a periodic layer.

    Parameters
    ----------
    kernel : (row, col) float, mm; deflection of the whole layer per pressure over modulus on cell
        (0, 0)
    stiffness : see `Patch`
    """
    across, along = rows.offsets() % kernel.shape[0], cols.offsets() % kernel.shape[1]
    return Patch(rows, cols, (_spectrum(kernel, across, along),), stiffness)


def sine_patch(kernel: FloatArray, rows: Span, cols: Span, stiffness: FloatArray) -> Patch:
    """Return a patch of a layer that is solved by a sine series.

    Parameters
    ----------
    kernel : (row, col) float, mm; K for distances of 0 to N cells per axis; K is even and has the
        period 2 N
    stiffness : see `Patch`
    """
    plain, mirrored = (rows.offsets(), cols.offsets()), (rows.sums(), cols.sums())
    turns = [_reversal(rows)[:, None], _reversal(cols)[: cols.padded // 2 + 1]]
    return Patch(
        rows,
        cols,
        (
            _folded(kernel, plain[0], plain[1]),
            -_folded(kernel, mirrored[0], plain[1]) * turns[0],
            -_folded(kernel, plain[0], mirrored[1]) * turns[1],
            _folded(kernel, mirrored[0], mirrored[1]) * turns[0] * turns[1],
        ),
        stiffness,
    )


def _folded(kernel: FloatArray, across: IntArray, along: IntArray) -> ComplexArray:
    periods = 2 * (kernel.shape[0] - 1), 2 * (kernel.shape[1] - 1)
    folded = [
        np.minimum(np.abs(lags) % period, period - np.abs(lags) % period)
        for lags, period in zip((across, along), periods, strict=True)
    ]
    return _spectrum(kernel, folded[0], folded[1])


def _spectrum(kernel: FloatArray, across: IntArray, along: IntArray) -> ComplexArray:
    return np.asarray(fft.rfft2(kernel[np.ix_(across, along)]))


def _reversal(span: Span) -> ComplexArray:
    """Return the spectrum of a reversed field over the field's conjugate spectrum, (padded,)."""
    turn = -2j * np.pi * np.arange(span.padded) * (span.count - 1) / span.padded
    return np.asarray(np.exp(turn))
