"""Deflection of a flat elastic layer under pressure, exact and spectral.

Arrays are (row, col) at cell centres, row along world y, col along world x, both ascending.
Pressure comes divided by Young's modulus and deflection is positive along the press, mm: at unit
modulus the layer's shape depends on thickness and Poisson's ratio alone.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import fft

from twin.mechanics.transfer import FloatArray, normal_transfer

_WORKERS = 2


@dataclass(frozen=True)
class FreeSlab:
    """A slab on a simply supported rim, stress-free on its far face: the opposite-face layout.

    The sine series is the exact three-dimensional solution: at the rim normal deflection,
    tangential displacement along the rim and normal stress vanish, through the whole thickness.
    """

    rows: int
    cols: int
    length_x_mm: float
    length_y_mm: float
    thickness_mm: float
    poisson_ratio: float

    @cached_property
    def x_mm(self) -> FloatArray:
        """(col,) cell centres, world x."""
        return _centres(self.cols, self.length_x_mm)

    @cached_property
    def y_mm(self) -> FloatArray:
        """(row,) cell centres, world y."""
        return _centres(self.rows, self.length_y_mm)

    @property
    def cell_area_mm2(self) -> float:
        """Area of one cell."""
        return self.length_x_mm * self.length_y_mm / (self.rows * self.cols)

    def deflect(self, pressure: FloatArray) -> FloatArray:
        """Return the touched face's deflection (row, col), mm."""
        return self._apply(pressure, self._compliances[0])

    def deflect_opposite(self, pressure: FloatArray) -> FloatArray:
        """Return the far face's deflection (row, col), mm."""
        return self._apply(pressure, self._compliances[1])

    def opposite_at_nodes(
        self, pressure: FloatArray, rows: int, cols: int, back_pressure: float = 0.0
    ) -> FloatArray:
        """Evaluate the far face's sine series on a node grid that includes the rim.

        Parameters
        ----------
        pressure : (row, col) float
            Pressure over modulus at cell centres.
        rows, cols : int
            Intervals along y and x.
        back_pressure : float
            Uniform pressure over modulus on the far face itself, against the press.

        Returns
        -------
        (rows + 1, cols + 1) float, mm
            Deflection, 0 on the rim: the series itself, so no interpolation error or ripple.
        """
        spectrum = fft.dstn(pressure, type=2, workers=_WORKERS) * self._compliances[1]
        if back_pressure:
            # The free slab is symmetric: the far face yields to its own load as t does to its.
            uniform = np.full_like(pressure, back_pressure)
            spectrum -= fft.dstn(uniform, type=2, workers=_WORKERS) * self._compliances[0]
        # DST-II counts its highest mode of each axis twice.
        spectrum[-1] /= 2
        spectrum[:, -1] /= 2
        # Coarser nodes than cells cannot carry the highest modes, which the slab has filtered.
        kept = spectrum[: rows - 1, : cols - 1] / (self.rows * self.cols)
        padded = np.zeros((rows - 1, cols - 1))
        padded[: kept.shape[0], : kept.shape[1]] = kept
        inner = fft.dstn(padded, type=1, workers=_WORKERS) / 4
        return np.pad(inner, 1)

    def _apply(self, pressure: FloatArray, compliance: FloatArray) -> FloatArray:
        spectrum = fft.dstn(pressure, type=2, workers=_WORKERS)
        spectrum *= compliance
        deflection: FloatArray = fft.idstn(spectrum, type=2, workers=_WORKERS, overwrite_x=True)
        return deflection

    @cached_property
    def _compliances(self) -> tuple[FloatArray, FloatArray]:
        k_x = np.pi * np.arange(1, self.cols + 1) / self.length_x_mm
        k_y = np.pi * np.arange(1, self.rows + 1) / self.length_y_mm
        k = np.hypot(k_x, k_y[:, None])
        phi_t, phi_b = normal_transfer(k * self.thickness_mm, self.poisson_ratio, "free")
        unit = 2 * (1 - self.poisson_ratio**2) / k
        return unit * phi_t, unit * phi_b


@dataclass(frozen=True)
class BondedLayer:
    """A layer bonded to a rigid window, periodic in the plane: the contact-face layout.

    Keep three thicknesses between contact and window edge: the periodic images then move the
    surface by about 1 um at most.
    """

    rows: int
    cols: int
    length_x_mm: float
    length_y_mm: float
    thickness_mm: float
    poisson_ratio: float

    @cached_property
    def x_mm(self) -> FloatArray:
        """(col,) cell centres, world x."""
        return _centres(self.cols, self.length_x_mm)

    @cached_property
    def y_mm(self) -> FloatArray:
        """(row,) cell centres, world y."""
        return _centres(self.rows, self.length_y_mm)

    @property
    def cell_area_mm2(self) -> float:
        """Area of one cell."""
        return self.length_x_mm * self.length_y_mm / (self.rows * self.cols)

    def deflect(self, pressure: FloatArray) -> FloatArray:
        """Return the touched face's deflection (row, col), mm."""
        spectrum = fft.rfft2(pressure, workers=_WORKERS) * self._compliance
        deflection: FloatArray = fft.irfft2(spectrum, s=pressure.shape, workers=_WORKERS)
        return deflection

    @cached_property
    def _compliance(self) -> FloatArray:
        k_x = 2 * np.pi * fft.rfftfreq(self.cols, self.length_x_mm / self.cols)
        k_y = 2 * np.pi * fft.fftfreq(self.rows, self.length_y_mm / self.rows)
        k = np.hypot(k_x, k_y[:, None])
        k[0, 0] = k[0, 1]  # placeholder: the mean is uniform compression, set below
        phi_t, _ = normal_transfer(k * self.thickness_mm, self.poisson_ratio, "bonded")
        compliance = 2 * (1 - self.poisson_ratio**2) / k * phi_t
        nu = self.poisson_ratio
        compliance[0, 0] = self.thickness_mm * (1 + nu) * (1 - 2 * nu) / (1 - nu)
        return compliance


def _centres(count: int, length_mm: float) -> FloatArray:
    centres: FloatArray = np.arange(count, dtype=np.float64) + 0.5
    return centres * (length_mm / count) - length_mm / 2
