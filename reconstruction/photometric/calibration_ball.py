"""Reference ball presses: which colour goes with which slope, where.

A ball of radius R pressed into the gel from behind shows the camera h = sqrt(R^2 - r^2) + const
within the circle of contact: dh/dx = -x / sqrt(R^2 - r^2), x and r measured from its centre.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from reconstruction.arrays import BoolImage, Doubles, FloatImage, Levels
from reconstruction.checks import require_integer, require_number
from reconstruction.errors import FitError, InputError
from reconstruction.photometric.contact_circle import ContactCircle, find_contact_circle
from reconstruction.photometric.images import checked_image, smoothed
from reconstruction.photometric.markers import GROWTH_PX, find_markers

# Left out inside the circle: its radius is uncertain by a few pixels (published practice: 4 px).
RIM_PX = 4.0
# Untouched pixels per touched one: enough that untouched gel comes out flat (published practice).
UNTOUCHED_SHARE = 0.2
UNTOUCHED_RADII = 2.5
# Contact radius over ball radius beyond which a press is refused: slope 2.1, no gel follows that.
LARGEST_SINE = 0.9


@dataclass(frozen=True, eq=False)
class BallPress:
    """One calibration image, (row, col, 3) uint8 RGB, of a ball of known diameter."""

    image: Levels
    ball_diameter_mm: float

    def __post_init__(self) -> None:
        checked_image(self.image, "calibration image")
        require_number("ball_diameter_mm", self.ball_diameter_mm, 0.0, open_low=True)


@dataclass(frozen=True)
class SampleOptions:
    """How calibration images are read.

    Parameters
    ----------
    threshold_levels : colour difference that tells touched from untouched gel
    smoothing_px : side of the square over which colours are averaged; odd, 1 for none
    marker_level : grey level up to which a pixel is a printed dot (70 in the vendor's programs)
        and left out; 0 where the gel has no dots
    unreadable_share : share of the images that may lack a contact circle and are left out then, as
        one would press again; 0: every image must have one

    Raises
    ------
    InputError : a value out of range
    """

    threshold_levels: float = 15.0
    smoothing_px: int = 3
    marker_level: int = 0
    unreadable_share: float = 0.0

    def __post_init__(self) -> None:
        require_number("threshold_levels", self.threshold_levels, 0.0, 442.0, open_low=True)
        require_number("unreadable_share", self.unreadable_share, 0.0, 0.5)
        require_integer("marker_level", self.marker_level, 0, 254)
        require_integer("smoothing_px", self.smoothing_px, 1, 99)
        if self.smoothing_px % 2 == 0:
            raise InputError(f"smoothing_px is {self.smoothing_px}; give an odd number")


@dataclass(frozen=True, eq=False)
class Samples:
    """Pixels with known slope.

    Parameters
    ----------
    levels : (n, 3) float32, smoothed 8-bit levels, red first
    background : (n, 3) float32, untouched levels at the same pixels
    places_px : (n, 2) float, row and column
    slopes : (n, 2) float, mm/mm, along rows and along columns
    """

    levels: FloatImage
    background: FloatImage
    places_px: Doubles
    slopes: Doubles


def ball_slopes(
    circle: ContactCircle, ball_radius_mm: float, pitch_mm: float, places_px: Doubles
) -> Doubles:
    """Return the slopes of a ball at pixels (n, 2) within its radius, (n, 2) mm/mm."""
    offset_mm = (places_px - (circle.row_px, circle.col_px)) * pitch_mm
    depth_mm = np.sqrt(ball_radius_mm**2 - np.sum(offset_mm**2, axis=1))
    slopes: Doubles = -offset_mm / depth_mm[:, np.newaxis]
    return slopes


def sample_presses(
    presses: Sequence[BallPress],
    background: FloatImage,
    pitch_mm: float,
    options: SampleOptions | None = None,
) -> Samples:
    """Collect the pixels inside the contacts, and some untouched ones with slope 0.

    Parameters
    ----------
    presses : images of the shape of `background`
    background : (row, col, 3) float32, mean of untouched images
    pitch_mm : distance of neighbouring pixels on the surface

    Raises
    ------
    InputError : an image of another shape, a number out of range
    FitError : no circle in an image (its number is named), or none that fits its ball, in more
        images than `options.unreadable_share` allows
    """
    require_number("pitch_mm", pitch_mm, 0.0, open_low=True)
    how, parts = options or SampleOptions(), list[Part]()
    hidden_before = find_markers(background, how.marker_level, GROWTH_PX, small=True)
    flat = smoothed(background, how.smoothing_px)
    unreadable: list[FitError] = []
    for number, press in enumerate(presses):
        image = checked_image(press.image, f"calibration image {number}", background.shape)
        levels = smoothed(image, how.smoothing_px)
        dots = find_markers(image.astype(np.float32), how.marker_level, GROWTH_PX, small=True)
        try:
            circle = find_contact_circle(levels, flat, how.threshold_levels)
            _require_fit(circle.radius_px * pitch_mm, press.ball_diameter_mm / 2.0)
        except FitError as error:
            unreadable.append(FitError(f"calibration image {number}: {error}"))
            if len(unreadable) > how.unreadable_share * len(presses):
                raise unreadable[0] from error
            continue
        ball = partial(ball_slopes, circle, press.ball_diameter_mm / 2.0, pitch_mm)
        touched, untouched = _places(circle, ~(hidden_before | dots))
        parts.append(_part(levels, flat, touched, ball(touched)))
        parts.append(_part(levels, flat, untouched, np.zeros_like(untouched)))
    if not parts:
        raise FitError("there are no calibration images; give at least one press of a ball")
    return Samples(*(np.concatenate([part[i] for part in parts]) for i in range(4)))


Part = tuple[FloatImage, FloatImage, Doubles, Doubles]


def _require_fit(contact_mm: float, ball_radius_mm: float) -> None:
    if contact_mm > LARGEST_SINE * ball_radius_mm:
        raise FitError(
            f"a contact of radius {contact_mm:.2f} mm does not fit a ball of radius "
            f"{ball_radius_mm:.2f} mm; check the ball's diameter and pitch_mm"
        )


def _places(circle: ContactCircle, visible: BoolImage) -> tuple[Doubles, Doubles]:
    """Return the pixels inside the contact and a few of the untouched ones, (n, 2) each."""
    row, col = np.ogrid[: visible.shape[0], : visible.shape[1]]
    distance_px = np.hypot(row - circle.row_px, col - circle.col_px)
    touched = (distance_px <= circle.radius_px - RIM_PX) & visible
    untouched = (distance_px >= UNTOUCHED_RADII * circle.radius_px) & visible
    inside = np.argwhere(touched).astype(np.float64)
    return inside, _thinned(np.argwhere(untouched).astype(np.float64), len(inside))


def _thinned(places_px: Doubles, touched: int) -> Doubles:
    wanted = round(UNTOUCHED_SHARE * touched)
    step = max(len(places_px) // wanted, 1) if wanted else len(places_px) + 1
    return places_px[::step][:wanted]


def _part(levels: FloatImage, background: FloatImage, places_px: Doubles, slopes: Doubles) -> Part:
    row, col = places_px.astype(np.intp).T
    return levels[row, col], background[row, col], places_px, slopes
