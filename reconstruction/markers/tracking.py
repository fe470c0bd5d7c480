"""Track printed dots from the image without contact to the image of a press.

Displacements are those of the dots in the image. A dot that is not found after the press is LOST; a
dot whose displacement contradicts that of its neighbours is DOUBTFUL. Neither is replaced by an
estimate. The sigma of a displacement contains the errors of both centres, see `fitting`.
"""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from reconstruction.arrays import BoolArray, FloatArray, ReasonImage
from reconstruction.errors import FitError, InputError
from reconstruction.markers.detection import DotPattern, find_alike, find_pattern
from reconstruction.markers.fitting import FittedDots
from reconstruction.markers.matching import UNASSIGNED, assign, deviation_from_neighbours

# Largest deviation of a displacement from its neighbours' ones, in spacings: an elastomer in one
# piece is smoother, even at the edge of a contact.
_LARGEST_DEVIATION = 0.2
# Dots that the affine function of all displacements needs.
_FEWEST = 4


class DotStatus(IntEnum):
    """Whether a dot has a measured displacement; all numbers of a dot that is LOST are 0."""

    TRACKED = 0
    LOST = 1
    """No dot of this size and contrast is near the place that its neighbours predict."""
    DOUBTFUL = 2
    """The displacement differs from that of the neighbours by more than a fifth of the spacing."""


@dataclass(frozen=True, eq=False)
class DotTracks:
    """Displacements of printed dots, px of the image; row downwards, column to the right.

    Attributes
    ----------
    pattern : dots of the image without contact
    after : dots of the image of the press, in their own order
    moved_px : (dot, 2) displacements; 0 for a dot that is LOST
    sigma_px : (dot, 2) standard uncertainties; 0 for a dot that is LOST
    status : (dot,) uint8, see `DotStatus`
    """

    pattern: DotPattern
    after: FittedDots
    moved_px: FloatArray
    sigma_px: FloatArray
    status: ReasonImage

    @property
    def places_px(self) -> FloatArray:
        """Centres of the dots in the image without contact, (dot, 2)."""
        return self.pattern.dots.centres_px

    @property
    def tracked(self) -> BoolArray:
        """Dots with a measured displacement, (dot,) bool."""
        return np.asarray(self.status == DotStatus.TRACKED)


@dataclass(frozen=True)
class MeanMotion:
    """Affine function of the position, fitted to displacements, with standard uncertainties.

    The uncertainties follow from the deviations of the dots from the function.

    Attributes
    ----------
    row_px, col_px, row_sigma_px, col_sigma_px : displacement in the middle of the dots
    divergence, divergence_sigma : d(row)/d(row) + d(col)/d(col); positive if the dots move apart
    rotation_rad, rotation_sigma_rad : mean rotation, counter-clockwise as displayed
    """

    row_px: float
    col_px: float
    row_sigma_px: float
    col_sigma_px: float
    divergence: float
    divergence_sigma: float
    rotation_rad: float
    rotation_sigma_rad: float


def track(before: FloatArray | DotPattern, after: FloatArray) -> DotTracks:
    """Return the displacements of the printed dots between two linear images of one camera.

    Parameters
    ----------
    before : (row, col) image without contact, proportional to the light, or its `find_pattern`
    after : (row, col) image of the press

    Raises
    ------
    FitError : the image without contact has fewer than six similar dots
    InputError : the images have different shapes
    """
    if isinstance(before, DotPattern):
        pattern = before
    elif before.shape != after.shape:
        raise InputError(f"images of dots have shapes {before.shape} and {after.shape}; give equal")
    else:
        pattern = find_pattern(before)
    dots, pressed = pattern.dots, find_alike(after, pattern)
    partner = assign(dots.centres_px, pressed.centres_px, pattern.spacing_px)
    found = partner != UNASSIGNED
    moved, sigma = np.zeros_like(dots.centres_px), np.zeros_like(dots.centres_px)
    moved[found] = pressed.centres_px[partner[found]] - dots.centres_px[found]
    sigma[found] = np.hypot(pressed.sigma_px[partner[found]], dots.sigma_px[found])
    status = np.where(found, DotStatus.TRACKED, DotStatus.LOST).astype(np.uint8)
    off_px = deviation_from_neighbours(dots.centres_px, moved, found, pattern.spacing_px)
    status[found & (off_px > _LARGEST_DEVIATION * pattern.spacing_px)] = DotStatus.DOUBTFUL
    return DotTracks(pattern, pressed, moved, sigma, status)


def mean_motion(tracks: DotTracks) -> MeanMotion:
    """Return the affine function of the tracked dots' displacements.

    Raises
    ------
    FitError : fewer than four dots are tracked, or they are on one line
    """
    places, moved = tracks.places_px[tracks.tracked], tracks.moved_px[tracks.tracked]
    if len(places) < _FEWEST:
        raise FitError(f"found {len(places)} tracked dots, needed at least {_FEWEST} for the motion")
    local = places - places.mean(axis=0)
    basis = np.column_stack([np.ones(len(local)), local])
    fit, _, rank, _ = np.linalg.lstsq(basis, moved)
    if rank < basis.shape[1]:
        raise FitError("the tracked dots are on one line; the motion needs dots on an area")
    scatter = np.sum((moved - basis @ fit) ** 2, axis=0) / (len(places) - basis.shape[1])
    share = np.linalg.inv(basis.T @ basis)
    # share: covariance of (value, d/d(row), d/d(col)) over the variance of one dot.
    at, down, right = np.diag(share)
    apart = np.sqrt(scatter[0] * down + scatter[1] * right)
    turned = 0.5 * np.sqrt(scatter[1] * down + scatter[0] * right)
    return MeanMotion(
        row_px=float(fit[0, 0]),
        col_px=float(fit[0, 1]),
        row_sigma_px=float(np.sqrt(scatter[0] * at)),
        col_sigma_px=float(np.sqrt(scatter[1] * at)),
        divergence=float(fit[1, 0] + fit[2, 1]),
        divergence_sigma=float(apart),
        # Rows increase downwards: counter-clockwise as displayed is clockwise in (row, col).
        rotation_rad=float(0.5 * (fit[1, 1] - fit[2, 0])),
        rotation_sigma_rad=float(turned),
    )
