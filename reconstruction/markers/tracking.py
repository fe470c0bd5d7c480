"""Track printed dots from the image without contact to the image of a press.

Displacements are those of the dots in the image. A dot that is not found after the press is LOST; a
dot whose displacement contradicts that of its neighbours is DOUBTFUL. Neither is replaced by an
estimate. The sigma of a displacement contains the errors of both centres, see `fitting`.
"""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from reconstruction.arrays import BoolArray, FloatArray, ReasonImage
from reconstruction.errors import InputError
from reconstruction.markers.detection import DotPattern, find_alike, find_pattern
from reconstruction.markers.fitting import FittedDots
from reconstruction.markers.matching import (
    UNASSIGNED,
    assign,
    deviation_from_neighbours,
    filled_from_neighbours,
)

# Largest deviation of a displacement from its neighbours' ones, in spacings: an elastomer in one
# piece is smoother, even at the edge of a contact.
_LARGEST_DEVIATION = 0.2


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


def track(
    before: FloatArray | DotPattern, after: FloatArray, previous: DotTracks | None = None
) -> DotTracks:
    """Return the displacements of the printed dots between two linear images of one camera.

    Without `previous`, displacements may reach half the spacing; with it, displacements may have
    any size, if they change by less than half the spacing from one frame to the next.

    Parameters
    ----------
    before : (row, col) image without contact, proportional to the light, or its `find_pattern`
    after : (row, col) image of the press
    previous : tracks of the frame before, by the same dots without contact; None: there is none

    Raises
    ------
    FitError : the image without contact has fewer than six similar dots
    InputError : the images have different shapes, or `previous` has other dots
    """
    if isinstance(before, DotPattern):
        pattern = before
    elif before.shape != after.shape:
        raise InputError(f"images of dots have shapes {before.shape} and {after.shape}; give equal")
    else:
        pattern = find_pattern(before)
    dots, pressed = pattern.dots, find_alike(after, pattern)
    expected_px = None if previous is None else _expected(previous, pattern)
    partner = assign(dots.centres_px, pressed.centres_px, pattern.spacing_px, expected_px)
    tracked = partner != UNASSIGNED
    moved, sigma = np.zeros_like(dots.centres_px), np.zeros_like(dots.centres_px)
    moved[tracked] = pressed.centres_px[partner[tracked]] - dots.centres_px[tracked]
    sigma[tracked] = np.hypot(pressed.sigma_px[partner[tracked]], dots.sigma_px[tracked])
    status = np.where(tracked, DotStatus.TRACKED, DotStatus.LOST).astype(np.uint8)
    off_px = deviation_from_neighbours(dots.centres_px, moved, tracked, pattern.spacing_px)
    status[tracked & (off_px > _LARGEST_DEVIATION * pattern.spacing_px)] = DotStatus.DOUBTFUL
    return DotTracks(pattern, pressed, moved, sigma, status)


def _expected(previous: DotTracks, pattern: DotPattern) -> FloatArray | None:
    """Return the displacements (dot, 2) px of the frame before, of LOST dots by their neighbours.

    None if no dot was tracked.
    """
    if previous.places_px.shape != pattern.dots.centres_px.shape:
        raise InputError(
            f"previous tracks have {len(previous.places_px)} dots, the image without contact "
            f"{len(pattern.dots.centres_px)}; track both frames from one pattern"
        )
    if not previous.tracked.any():
        return None
    return filled_from_neighbours(
        previous.places_px, previous.moved_px, previous.tracked, pattern.spacing_px
    )
