"""Summarise the displacements of dots: mean displacement, divergence and rotation."""

from dataclasses import dataclass

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.errors import FitError

_FEWEST = 4


@dataclass(frozen=True)
class MeanMotion:
    """Affine function of the place, fitted to displacements; with standard uncertainties.

    The uncertainties follow from the deviations of the dots from this function, which are those of
    the elastomer's own deformation more than errors of measurement.

    Attributes
    ----------
    x_mm, y_mm, x_sigma_mm, y_sigma_mm : displacement in the middle of the dots
    divergence, divergence_sigma : du_x/dx + du_y/dy; positive if the dots move apart
    shear, shear_sigma : du_x/dy + du_y/dx
    rotation_rad, rotation_sigma_rad : (du_y/dx - du_x/dy) / 2, positive counter-clockwise
    """

    x_mm: float
    y_mm: float
    x_sigma_mm: float
    y_sigma_mm: float
    divergence: float
    divergence_sigma: float
    shear: float
    shear_sigma: float
    rotation_rad: float
    rotation_sigma_rad: float


def mean_motion(places_mm: FloatArray, moved_mm: FloatArray) -> MeanMotion:
    """Return the affine function that fits displacements best, by least squares.

    Parameters
    ----------
    places_mm, moved_mm : (dot, xy) places and displacements in a right-handed frame

    Raises
    ------
    FitError : there are fewer than four dots, or they are on one line
    """
    if len(places_mm) < _FEWEST:
        raise FitError(f"found {len(places_mm)} tracked dots, needed at least {_FEWEST}")
    local = places_mm - places_mm.mean(axis=0)
    basis = np.column_stack([np.ones(len(local)), local])
    fit, _, rank, _ = np.linalg.lstsq(basis, moved_mm)
    if rank < basis.shape[1]:
        raise FitError("the tracked dots are on one line; the mean motion needs dots on an area")
    scatter = np.sum((moved_mm - basis @ fit) ** 2, axis=0)
    scatter /= len(local) - basis.shape[1]
    # (3, 3) covariance of the value and the two derivatives, for scatter 1.
    share = np.linalg.inv(basis.T @ basis)
    along = scatter[0] * share[1, 1] + scatter[1] * share[2, 2]
    across = scatter[0] * share[2, 2] + scatter[1] * share[1, 1]
    x_sigma_mm, y_sigma_mm = np.sqrt(scatter * share[0, 0])
    (dx_dx, dy_dx), (dx_dy, dy_dy) = fit[1], fit[2]
    return MeanMotion(
        x_mm=float(fit[0, 0]),
        y_mm=float(fit[0, 1]),
        x_sigma_mm=float(x_sigma_mm),
        y_sigma_mm=float(y_sigma_mm),
        divergence=float(dx_dx + dy_dy),
        divergence_sigma=float(np.sqrt(along)),
        shear=float(dx_dy + dy_dx),
        shear_sigma=float(np.sqrt(across)),
        rotation_rad=float(0.5 * (dy_dx - dx_dy)),
        rotation_sigma_rad=float(0.5 * np.sqrt(across)),
    )
