"""Displacement of the touched face of a bonded layer under tangential traction, by FFT.

Frame: z along the press, from the touched face into the layer. Traction is the force per area on
the layer, divided by Young's modulus E. A traction along the wave vector k displaces the face along
k by 2 Psi(q) / (E* k), one across k by tanh(q) / (G k), with q = k h, E* = E / (1 - nu^2) and the
shear modulus G. With kappa = 3 - 4 nu, a layer bonded to a rigid window has

    Psi(q) = (2 kappa sinh 2q + 4 q) / (2 kappa cosh 2q + 4 q^2 + 1 + kappa^2).

Psi tends to 1 for short waves (half-space). Both displacements tend to h / G for long waves. A
traction also displaces the face along z; by reciprocity (Betti) with the in-plane displacement
under pressure. At nu = 1/2 a half-space has no such coupling, a layer has.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy import fft

from reconstruction.arrays import BoolArray, FloatArray
from twin.mechanics.layer import BondedLayer, periodic_waves
from twin.mechanics.patch import ComplexArray, Span, periodic_patch


class InPlane(NamedTuple):
    """Vector field in the plane of the touched face; arrays are (row, col)."""

    x: FloatArray
    y: FloatArray


def along_wave(q: FloatArray, nu: float) -> FloatArray:
    """Return Psi of a bonded layer for traction along the wave vector; `q` is > 0, any shape."""
    kappa = 3 - 4 * nu
    # Numerator and denominator times exp(-2 q), to avoid overflow.
    fade = np.exp(-2 * q)
    above = kappa * (1 - fade * fade) + 4 * q * fade
    below = kappa * (1 + fade * fade) + (4 * q * q + 1 + kappa * kappa) * fade
    return np.asarray(above / below)


@dataclass(frozen=True, eq=False)
class ShearedLayer:
    """Tangential response of a bonded layer without film; arrays are (row, col) on its cells."""

    layer: BondedLayer

    def displace(self, traction: InPlane) -> InPlane:
        """Return the in-plane displacement of the touched face, mm, for traction over modulus."""
        spectra = self._spectra(traction)
        xx, xy, yy = self._compliances
        return InPlane(
            self._field(xx * spectra[0] + xy * spectra[1]),
            self._field(xy * spectra[0] + yy * spectra[1]),
        )

    def deflect(self, traction: InPlane) -> FloatArray:
        """Return the touched face's deflection, mm, positive along the press, for the same."""
        spectra = self._spectra(traction)
        normal_x, normal_y = self._couplings
        return self._field(normal_x * spectra[0] + normal_y * spectra[1])

    def patch(self, rows: Span, cols: Span) -> "ShearPatch":
        """Return the in-plane response of a rectangle of cells to traction on these cells."""
        kernels = self._kernels
        unused = np.ones((rows.padded, cols.padded // 2 + 1))
        spectra = [periodic_patch(kernel, rows, cols, unused).kernels[0] for kernel in kernels]
        spans = np.ix_(rows.offsets() % self.layer.rows, cols.offsets() % self.layer.cols)
        size_xx, size_xy, size_yy = (float(np.abs(kernel[spans]).sum()) for kernel in kernels)
        return ShearPatch(rows, cols, tuple(spectra), max(size_xx, size_yy) + size_xy)

    @cached_property
    def _compliances(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Displacement per traction over modulus, mm: x by x, x by y, y by y."""
        layer, nu = self.layer, self.layer.poisson_ratio
        k_x, k_y, k = self._waves
        q = k * layer.thickness_mm
        along = 2 * (1 - nu**2) / k * along_wave(q, nu)
        across = 2 * (1 + nu) / k * np.tanh(q)
        unit_x, unit_y = k_x / k, k_y / k
        xx = along * unit_x**2 + across * unit_y**2
        yy = along * unit_y**2 + across * unit_x**2
        xy = (along - across) * unit_x * unit_y
        # The shortest waves have two directions of the same samples, in which xy is opposite.
        xy[self._shortest] = 0.0
        xx[0, 0] = yy[0, 0] = 2 * (1 + nu) * layer.thickness_mm
        return xx, xy, yy

    @cached_property
    def _kernels(self) -> list[FloatArray]:
        """Displacement per traction over modulus on cell (0, 0), mm: x by x, x by y, y by y."""
        return [self._field(compliance) for compliance in self._compliances]

    @cached_property
    def _couplings(self) -> tuple[ComplexArray, ComplexArray]:
        k_x, k_y, k = self._waves
        coupling = self.layer.tangential_compliance / k
        normal_x, normal_y = (np.zeros_like(k, dtype=np.complex128) for _ in range(2))
        normal_x.imag, normal_y.imag = -coupling * k_x, -coupling * k_y
        # The shortest wave has no slope on the grid.
        normal_x[:, -1] *= self.layer.cols % 2
        normal_y[self.layer.rows // 2] *= self.layer.rows % 2
        return normal_x, normal_y

    @property
    def _shortest(self) -> BoolArray:
        rows, cols = self.layer.rows, self.layer.cols
        shortest = np.zeros((rows, cols // 2 + 1), dtype=bool)
        shortest[:, -1] = cols % 2 == 0
        shortest[rows // 2] |= rows % 2 == 0
        return shortest

    @cached_property
    def _waves(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        k_x, k_y = np.meshgrid(*periodic_waves(self.layer))
        k = np.hypot(k_x, k_y)
        k[0, 0] = 1.0  # placeholder: the mean is set separately
        return k_x, k_y, k

    def _spectra(self, traction: InPlane) -> tuple[ComplexArray, ComplexArray]:
        return np.asarray(fft.rfft2(traction.x)), np.asarray(fft.rfft2(traction.y))

    def _field(self, spectrum: FloatArray | ComplexArray) -> FloatArray:
        field: FloatArray = fft.irfft2(spectrum, s=(self.layer.rows, self.layer.cols))
        return field


@dataclass(frozen=True, eq=False)
class ShearPatch:
    """In-plane response of a rectangle of cells to traction on them; arrays are (row, col)."""

    rows: Span
    cols: Span
    #: spectra of the convolution kernels x by x, x by y, y by y
    kernels: tuple[ComplexArray, ...]
    #: upper bound of displacement over traction over modulus, mm (Gershgorin)
    largest: float

    @property
    def cells(self) -> tuple[slice, slice]:
        """Index (rows, columns) of the patch in the whole grid."""
        return self.rows.cells, self.cols.cells

    def displace(self, traction: InPlane) -> InPlane:
        """Return the displacement, mm, within the patch for traction over modulus there."""
        shape = (self.rows.padded, self.cols.padded)
        x, y = fft.rfft2(np.stack(traction), s=shape)
        xx, xy, yy = self.kernels
        moved = fft.irfft2(np.stack((xx * x + xy * y, xy * x + yy * y)), s=shape, overwrite_x=True)
        return InPlane(*moved[:, : self.rows.count, : self.cols.count])
