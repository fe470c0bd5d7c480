"""The layer's response within a patch of its grid, which the contact solver evaluates repeatedly.

A contact covers a small part of the slab, and only the pressure and deflection within it matter
during the solution. There the layer is a convolution with its response K to one loaded cell,

    free slab (sine series):  A(i, j) = K(i - j) - K(i + j + 1)   per axis,
    bonded layer (periodic):  A(i, j) = K(i - j),

so a transform of twice the patch replaces one of the whole grid, without approximation.
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
    """Cells first..first + count - 1 of one axis of the grid."""

    first: int
    count: int

    @classmethod
    def around(cls, cells: npt.NDArray[np.intp], count: int) -> "Span":
        """Return the range of a contact's cells on an axis of `count` cells, with a margin."""
        first = max(int(cells.min()) - _MARGIN, 0)
        return cls(first, min(int(cells.max()) + _MARGIN + 1, count) - first)

    @property
    def padded(self) -> int:
        """Length of a transform in which the patch's convolution does not wrap round."""
        return int(fft.next_fast_len(2 * self.count - 1, real=True))

    @property
    def cells(self) -> slice:
        """The cells as an index."""
        return slice(self.first, self.first + self.count)

    def offsets(self) -> IntArray:
        """Return i - j for each element of the padded convolution kernel."""
        lag = np.arange(self.padded)
        return np.where(lag < self.count, lag, lag - self.padded)

    def sums(self) -> IntArray:
        """Return i + j + 1 for each element, for a pressure in reversed order."""
        last = 2 * self.first + self.count
        return np.clip(self.offsets(), 1 - self.count, self.count - 1) + last


@dataclass(frozen=True, eq=False)
class Patch:
    """Deflection of a patch of cells by pressure on the same cells; arrays (row, col)."""

    rows: Span
    cols: Span
    #: Toeplitz part first; for a sine series also the three with mirrored rows, columns, both
    kernels: tuple[ComplexArray, ...]
    #: (row, half of col) spectral inverse of the layer, positive
    stiffness: FloatArray

    @property
    def cells(self) -> tuple[slice, slice]:
        """The patch as an index into the whole grid."""
        return self.rows.cells, self.cols.cells

    def deflect(self, pressure: FloatArray) -> FloatArray:
        """Return the touched face's deflection, mm, for pressure over modulus."""
        forward = self._forward(pressure)
        image = self.kernels[0] * forward
        if len(self.kernels) > 1:
            # Reversing a real field conjugates its spectrum: no further transform is needed.
            over = np.roll(forward[::-1], 1, axis=0)
            image += self.kernels[1] * over
            image += self.kernels[2] * np.conj(over, out=over)
            image += self.kernels[3] * np.conj(forward, out=forward)
        return self._back(image)

    def apply(self, gap: FloatArray) -> FloatArray:
        """Return about the pressure that would close a gap: the conjugate gradients' scaling."""
        return self._back(self._forward(gap) * self.stiffness)

    @cached_property
    def cell(self) -> float:
        """Diagonal of `apply`, 1/mm.

        Pressure over modulus on a cell that deflects by 1 mm while all other cells do not deflect.
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
    """Cut a patch out of a periodic layer with the response `kernel` (row, col) to one cell."""
    across, along = rows.offsets() % kernel.shape[0], cols.offsets() % kernel.shape[1]
    return Patch(rows, cols, (_spectrum(kernel, across, along),), stiffness)


def sine_patch(kernel: FloatArray, rows: Span, cols: Span, stiffness: FloatArray) -> Patch:
    """Cut a patch out of a sine series; `kernel` covers 0..N cells per axis, even, period 2 N."""
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
    """Return the spectrum's factor for a field counted from the patch's last cell backwards."""
    turn = -2j * np.pi * np.arange(span.padded) * (span.count - 1) / span.padded
    return np.asarray(np.exp(turn))
