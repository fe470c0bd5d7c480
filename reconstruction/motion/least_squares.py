"""Least squares of fringes whose phase shift differs from pixel to pixel."""

from dataclasses import dataclass

import numpy as np

from reconstruction.arrays import BoolImage, FloatArray

# Relative to a diagonal of 1: pixels without three different shifts stay solvable.
_RIDGE = 1e-12


@dataclass(frozen=True, eq=False)
class FittedFringes:
    """Fringes A + B cos(phi + theta); every field is (pixel,) float.

    mean_dn, modulation_dn : A and B, DN
    phase_rad : phi, in (-pi, pi]
    """

    mean_dn: FloatArray
    modulation_dn: FloatArray
    phase_rad: FloatArray

    def levels_dn(self, angles_rad: FloatArray) -> FloatArray:
        """Return the fitted levels (step, pixel), DN, at the shifts theta (step, pixel), rad."""
        return self.mean_dn + self.modulation_dn * np.cos(self.phase_rad + angles_rad)


def fit_fringes(
    frames: FloatArray, angles_rad: FloatArray, good: BoolImage | None = None
) -> FittedFringes:
    """Fit mean, modulation and phase of each pixel, with the shift of each pixel and frame.

    Parameters
    ----------
    frames : (step, pixel) levels, DN
    angles_rad : (step, pixel) phase shifts theta, rad
    good : (step, pixel) bool, levels that are used; None: all
    """
    weights = np.ones(frames.shape) if good is None else good.astype(np.float64)
    columns = np.stack([np.ones(frames.shape), np.cos(angles_rad), -np.sin(angles_rad)], axis=-1)
    weighted = columns * weights[..., None]
    normal = np.einsum("spi,spj->pij", weighted, columns)
    normal += _RIDGE * len(frames) * np.eye(3)
    side = np.einsum("spi,sp->pi", weighted, frames)
    mean, cosine, sine = np.moveaxis(np.linalg.solve(normal, side[..., None])[..., 0], -1, 0)
    return FittedFringes(mean, np.hypot(cosine, sine), np.arctan2(sine, cosine))
