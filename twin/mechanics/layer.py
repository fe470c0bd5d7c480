"""Deflection of a flat elastic layer under pressure: exact, by a spectral method.

Arrays are (row, col) at cell centres, row along world y, col along world x, both ascending.
Pressure is divided by Young's modulus, so that the shape of the layer depends only on thickness and
Poisson's ratio. Deflection is in mm, positive along the press.

A sine series is also evaluated exactly on a grid of nodes that includes the rim and is finer or
coarser than the cells.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
from scipy import fft

from reconstruction.arrays import FloatArray
from reconstruction.machine import threads
from twin.mechanics.patch import Patch, Span, periodic_patch, sine_patch
from twin.mechanics.transfer import CoatFilm, Column, TransferTable, tabulate

_WORKERS = min(2, threads())


@dataclass(frozen=True)
class FlatLayer:
    """A flat layer on a grid of cells, centred on the origin: base of `FreeSlab`, `BondedLayer`."""

    rows: int
    cols: int
    length_x_mm: float
    length_y_mm: float
    thickness_mm: float
    poisson_ratio: float
    #: film of the coated face, the outermost part of the thickness; None: no film
    film: CoatFilm | None = None

    @cached_property
    def x_mm(self) -> FloatArray:
        """World x of the cell centres, (col,)."""
        return _centres(self.cols, self.length_x_mm)

    @cached_property
    def y_mm(self) -> FloatArray:
        """World y of the cell centres, (row,)."""
        return _centres(self.rows, self.length_y_mm)

    @property
    def cell_area_mm2(self) -> float:
        """Area of one cell, mm^2."""
        return self.length_x_mm * self.length_y_mm / (self.rows * self.cols)

    def coarsened(self, factor: int) -> Self:
        """Return the same layer on cells `factor` times as wide."""
        return replace(self, rows=self.rows // factor, cols=self.cols // factor)

    def patch_stiffness(self, table: TransferTable, rows: Span, cols: Span) -> FloatArray:
        """Return pressure over modulus per deflection, 1/mm, at the wavenumbers of a patch.

        It is k / (2 (1 - nu^2) Phi), (row, half of col), as for a real FFT of the padded patch.
        """
        step_x, step_y = self.length_x_mm / self.cols, self.length_y_mm / self.rows
        k_x = 2 * np.pi * fft.rfftfreq(cols.padded, step_x)
        k_y = 2 * np.pi * fft.fftfreq(rows.padded, step_y)
        k = np.hypot(k_x, k_y[:, None])
        # The mean is treated as a wave twice as long as the patch.
        k[0, 0] = np.pi / max(cols.padded * step_x, rows.padded * step_y)
        k = np.maximum(k, table.lowest_q / self.thickness_mm)
        return 1 / self.compliance(table, k, "normal_t")

    def compliance(self, table: TransferTable, k: FloatArray, column: Column) -> FloatArray:
        """Return displacement per pressure over modulus, mm, at wavenumbers k, 1/mm.

        `column` selects face and direction of the displacement, as in `Transfer`.
        """
        unit: FloatArray = 2 * (1 - self.poisson_ratio**2) / k
        return unit * table(k * self.thickness_mm, column)


@dataclass(frozen=True)
class FreeSlab(FlatLayer):
    """A slab on a simply supported rim, stress-free on its far face: the opposite-face layout.

    The sine series is the exact three-dimensional solution. At the rim, through the whole
    thickness, three quantities are zero: the deflection, the displacement along the rim, and the
    stress normal to the rim.
    """

    def deflect(self, pressure: FloatArray) -> FloatArray:
        """Return the touched face's deflection (row, col), mm, for pressure over modulus."""
        return self._apply(pressure, self._compliance_t)

    def deflect_opposite(self, pressure: FloatArray) -> FloatArray:
        """Return the far face's deflection (row, col), mm, for pressure over modulus."""
        return self._apply(pressure, self._compliance_b)

    def patch(self, rows: Span, cols: Span) -> Patch:
        """Return the touched face's response to pressure within a rectangle of cells."""
        return sine_patch(self._kernel, rows, cols, self.patch_stiffness(self._table, rows, cols))

    def opposite_at_nodes(
        self, pressure: FloatArray, rows: int, cols: int, uniform_load: float = 0.0
    ) -> FloatArray:
        """Evaluate the far face's sine series on a node grid that includes the rim.

        Parameters
        ----------
        pressure : (row, col) float; pressure over modulus on the touched face, at cell centres
        rows, cols : numbers of intervals between nodes along y and x
        uniform_load : uniform pressure over modulus on the far face itself, along the press

        Returns
        -------
        (rows + 1, cols + 1) float, mm; deflection, 0 on the rim. It is the sum of the series,
            without interpolation and its ripple.
        """
        spectrum = fft.dstn(pressure, type=2, workers=_WORKERS) * self._compliance_b
        if uniform_load:
            uniform = np.full_like(pressure, uniform_load)
            spectrum += fft.dstn(uniform, type=2, workers=_WORKERS) * self._compliance_turned
        return sines_at_nodes(spectrum, rows, cols)

    def opposite_in_plane_at_nodes(
        self, pressure: FloatArray, rows: int, cols: int, uniform_load: float = 0.0
    ) -> tuple[FloatArray, FloatArray]:
        """Return the far face's displacements u_x and u_y in its plane at the nodes, mm.

        Parameters and shape of both arrays are those of `opposite_at_nodes`.
        """
        k_x, k_y = _sine_waves(self)
        potential = fft.dstn(pressure, type=2, workers=_WORKERS) / self._k
        potential *= self.compliance(self._table, self._k, "tangential_b")
        if uniform_load:
            # A load along the press on the far face is a tension there: negative pressure.
            pulled = np.full_like(pressure, -uniform_load)
            own = fft.dstn(pulled, type=2, workers=_WORKERS) / self._k
            potential += own * self.compliance(self._turned_table, self._k, "tangential_t")
        slopes = (
            sine_amplitudes(potential * k_x, rows, cols),
            sine_amplitudes(potential * k_y[:, None], rows, cols),
        )
        return cosines(slopes[0], axis=1), cosines(slopes[1], axis=0)

    def _apply(self, pressure: FloatArray, compliance: FloatArray) -> FloatArray:
        spectrum = fft.dstn(pressure, type=2, workers=_WORKERS)
        spectrum *= compliance
        return np.asarray(fft.idstn(spectrum, type=2, workers=_WORKERS, overwrite_x=True))

    @cached_property
    def _k(self) -> FloatArray:
        k_x, k_y = _sine_waves(self)
        return np.hypot(k_x, k_y[:, None])

    @cached_property
    def _table(self) -> TransferTable:
        lowest = float(self._k[0, 0]) * self.thickness_mm
        return tabulate(lowest, self.poisson_ratio, "free", self.film)

    @cached_property
    def _compliance_t(self) -> FloatArray:
        return self.compliance(self._table, self._k, "normal_t")

    @cached_property
    def _compliance_b(self) -> FloatArray:
        return self.compliance(self._table, self._k, "normal_b")

    @cached_property
    def _compliance_turned(self) -> FloatArray:
        """Compliance of the far face under a load on it, mm; without a film `_compliance_t`."""
        if self.film is None:
            return self._compliance_t
        return self.compliance(self._turned_table, self._k, "normal_t")

    @cached_property
    def _turned_table(self) -> TransferTable:
        if self.film is None:
            return self._table
        lowest = float(self._k[0, 0]) * self.thickness_mm
        return tabulate(lowest, self.poisson_ratio, "free_turned", self.film)

    @cached_property
    def _kernel(self) -> FloatArray:
        spectrum = np.pad(self._compliance_t, ((1, 0), (1, 0)))
        kernel: FloatArray = fft.dctn(spectrum, type=1, workers=_WORKERS)
        return kernel / (4 * self.rows * self.cols)


@dataclass(frozen=True)
class BondedLayer(FlatLayer):
    """A layer bonded to a rigid window, periodic in the plane: the contact-face layout.

    Keep at least three thicknesses between contact and window edge. The contacts in the
    neighbouring periods then displace the surface by about 1 um at most.
    """

    def deflect(self, pressure: FloatArray) -> FloatArray:
        """Return the touched face's deflection (row, col), mm, for pressure over modulus."""
        spectrum = fft.rfft2(pressure, workers=_WORKERS) * self._compliance
        return np.asarray(fft.irfft2(spectrum, s=pressure.shape, workers=_WORKERS))

    def patch(self, rows: Span, cols: Span) -> Patch:
        """Return the touched face's response to pressure within a rectangle of cells."""
        stiffness = self.patch_stiffness(self._table, rows, cols)
        return periodic_patch(self._kernel, rows, cols, stiffness)

    @cached_property
    def _k(self) -> FloatArray:
        k_x, k_y = periodic_waves(self)
        k = np.hypot(k_x, k_y[:, None])
        k[0, 0] = min(k[0, 1], k[1, 0])  # placeholder: the mean is uniform compression, set below
        return k

    @cached_property
    def _table(self) -> TransferTable:
        lowest = float(self._k.min()) * self.thickness_mm
        return tabulate(lowest, self.poisson_ratio, "bonded", self.film)

    def in_plane(self, pressure: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the touched face's displacements u_x and u_y in its plane, (row, col), mm."""
        k_x, k_y = periodic_waves(self)
        potential = fft.rfft2(pressure, workers=_WORKERS) / self._k
        potential *= 1j * self.tangential_compliance
        # The shortest wave has no slope on the grid.
        k_x[-1] *= self.cols % 2
        u_x: FloatArray = fft.irfft2(potential * k_x, s=pressure.shape, workers=_WORKERS)
        u_y: FloatArray = fft.irfft2(potential * k_y[:, None], s=pressure.shape, workers=_WORKERS)
        return u_x, u_y

    @property
    def tangential_compliance(self) -> FloatArray:
        """In-plane displacement of the touched face per pressure over modulus, mm, by wavenumber.

        By reciprocity it is also the displacement along the press per tangential traction.
        """
        return self.compliance(self._table, self._k, "tangential_t")

    @cached_property
    def _compliance(self) -> FloatArray:
        compliance = self.compliance(self._table, self._k, "normal_t")
        compliance[0, 0] = self.thickness_mm * self._uniform_strain
        return compliance

    @property
    def _uniform_strain(self) -> float:
        """Strain per pressure over modulus, in uniform compression without lateral motion."""
        slab = _oedometric(self.poisson_ratio)
        if self.film is None:
            return slab
        # `shear_ratio` is a ratio of shear moduli: E = 2 (1 + nu) x shear modulus converts it.
        own = _oedometric(self.film.poisson_ratio) / (1 + self.film.poisson_ratio)
        coat = own * (1 + self.poisson_ratio) / self.film.shear_ratio
        return (1 - self.film.share) * slab + self.film.share * coat

    @cached_property
    def _kernel(self) -> FloatArray:
        kernel: FloatArray = fft.irfft2(
            self._compliance, s=(self.rows, self.cols), workers=_WORKERS
        )
        return kernel


def _oedometric(nu: float) -> float:
    """Return Young's modulus over the oedometer modulus, for Poisson's ratio `nu`."""
    return (1 + nu) * (1 - 2 * nu) / (1 - nu)


def periodic_waves(layer: FlatLayer) -> tuple[FloatArray, FloatArray]:
    """Return the wavenumbers of a real 2D FFT, 1/mm: (half of col,) along x, (row,) along y."""
    k_x: FloatArray = 2 * np.pi * fft.rfftfreq(layer.cols, layer.length_x_mm / layer.cols)
    k_y: FloatArray = 2 * np.pi * fft.fftfreq(layer.rows, layer.length_y_mm / layer.rows)
    return k_x, k_y


def _sine_waves(layer: FlatLayer) -> tuple[FloatArray, FloatArray]:
    """Return the wavenumbers of the sine series, 1/mm: (col,) along x, (row,) along y."""
    k_x: FloatArray = np.pi * np.arange(1.0, layer.cols + 1) / layer.length_x_mm
    k_y: FloatArray = np.pi * np.arange(1.0, layer.rows + 1) / layer.length_y_mm
    return k_x, k_y


def _centres(count: int, length_mm: float) -> FloatArray:
    centres: FloatArray = np.arange(count, dtype=np.float64) + 0.5
    return centres * (length_mm / count) - length_mm / 2


def sine_amplitudes(spectrum: FloatArray, rows: int, cols: int) -> FloatArray:
    """Return the sine amplitudes (rows - 1, cols - 1) of a DST-II spectrum.

    Modes that a grid of `rows` x `cols` intervals does not resolve are left out. The spectrum is
    overwritten.
    """
    counts = spectrum.shape
    # DST-II counts its highest mode of each axis twice.
    spectrum[-1] /= 2
    spectrum[:, -1] /= 2
    # Nodes coarser than the cells do not resolve the highest modes, which the slab attenuates.
    resolved = spectrum[: rows - 1, : cols - 1] / (counts[0] * counts[1])
    padded = np.zeros((rows - 1, cols - 1))
    padded[: resolved.shape[0], : resolved.shape[1]] = resolved
    return padded


def sines_at_nodes(spectrum: FloatArray, rows: int, cols: int) -> FloatArray:
    """Return the values of a DST-II spectrum at nodes (rows + 1, cols + 1), rim included.

    The spectrum is overwritten.
    """
    inner = fft.dstn(sine_amplitudes(spectrum, rows, cols), type=1, workers=_WORKERS) / 4
    return np.pad(inner, 1)


def cosines(amplitudes: FloatArray, axis: int) -> FloatArray:
    """Return the sum of modes at the nodes: cosines along `axis`, sines along the other axis."""
    sines = fft.dst(amplitudes, type=1, axis=1 - axis, workers=_WORKERS)
    along = tuple((1, 1) if direction == axis else (0, 0) for direction in range(2))
    across = tuple((0, 0) if direction == axis else (1, 1) for direction in range(2))
    mixed: FloatArray = fft.dct(np.pad(sines, along), type=1, axis=axis, workers=_WORKERS)
    return np.pad(mixed / 4, across)
