"""Find the contact circle in images of pressed balls, and collect samples of colour and slope.

A ball of radius R is pressed into the face of the gel away from the camera. Within the circle of
contact the height is h = sqrt(R^2 - r^2) + const, and its slope dh/dx = -x / sqrt(R^2 - r^2). x and
r are measured from the centre of the circle.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import cv2
import numpy as np

from reconstruction.arrays import BoolImage, FloatArray, FloatImage, Levels
from reconstruction.colour_maps import Samples
from reconstruction.errors import FitError, InputError, require_integer, require_number
from reconstruction.photometric.images import GROWTH_PX, checked_image, find_markers, smoothed
from reconstruction.photometric.rest_surface import RestSurface

SMOOTHING_PX = 5
SECTORS = 72
ROUNDS = 3
# A direction with a peak below this share of the median peak has no edge (no lamp on that side).
LEAST_CONTRAST = 0.35
# Directions with a residual of more than this many robust sigmas are excluded.
OUTLIER_SIGMAS = 2.5
SIGMA_PER_MAD = 1.4826
# Margin inside the circle: its radius is uncertain by a few pixels (published practice: 4 px).
RIM_PX = 4.0
# Number of undeformed samples per sample in contact, so that undeformed gel gets the slope 0
# (published practice).
UNTOUCHED_SHARE = 0.2
UNTOUCHED_RADII = 2.5
# Largest ratio of contact radius to ball radius: a slope of 2.1, steeper than any gel in contact.
LARGEST_SINE = 0.9
# Least ratio of contact radius to ball radius. Below it slopes are under 0.1, too small for a
# calibration press, so that the ball's diameter or the pitch is probably in a wrong unit.
SMALLEST_SINE = 0.1

Part = tuple[FloatImage, FloatImage, FloatArray, FloatArray]


@dataclass(frozen=True)
class ContactCircle:
    """Edge of the contact of a ball, a circle in the image; whole coordinates are pixel centres."""

    row_px: float
    col_px: float
    radius_px: float


def find_contact_circle(
    image: FloatImage, background: FloatImage, threshold_levels: float = 15.0
) -> ContactCircle:
    """Return the circle of contact of a ball in an image.

    Parameters
    ----------
    image, background : (row, col, 3), 8-bit levels of the pressed and of the undeformed gel
    threshold_levels : Euclidean colour difference that distinguishes contact from undeformed gel

    Raises
    ------
    FitError : no pixel is in contact, or no circle can be fitted

    Notes
    -----
    The largest region above the threshold, with holes closed, gives a first circle. This region
    includes the gel next to the contact, which the ball also deforms. The slope of a ball increases
    up to the edge of contact and decreases outside it, so the colour difference has a peak at the
    edge in every direction. A circle is fitted three times, each time to the peaks that
    are no outliers.
    """
    difference = cv2.GaussianBlur(
        np.linalg.norm(image.astype(np.float32) - background, axis=2), (0, 0), SMOOTHING_PX / 3.0
    )
    circle = _first_circle(difference, threshold_levels)
    for _ in range(ROUNDS):
        circle = _refined(difference, circle)
    rows, cols = difference.shape
    inside = -0.5 <= circle.row_px <= rows - 0.5 and -0.5 <= circle.col_px <= cols - 0.5
    if not inside or circle.radius_px < SMOOTHING_PX:
        raise FitError(
            f"no contact circle: the best one has centre ({circle.row_px:.1f}, "
            f"{circle.col_px:.1f}) px and radius {circle.radius_px:.1f} px; centre the ball in the "
            "field and press deeper"
        )
    return circle


def _first_circle(difference: FloatImage, threshold_levels: float) -> ContactCircle:
    touched = (difference > threshold_levels).astype(np.uint8)
    touched = cv2.morphologyEx(touched, cv2.MORPH_CLOSE, np.ones((7, 7), np.uint8))
    outlines, _ = cv2.findContours(touched, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    if not outlines:
        raise FitError(
            f"no contact: the colour differs by at most {difference.max():.1f} levels from the "
            f"background, below the threshold {threshold_levels:g}; press deeper or lower it"
        )
    outline = max(outlines, key=cv2.contourArea)
    (col_px, row_px), radius_px = cv2.minEnclosingCircle(outline)
    return ContactCircle(row_px, col_px, max(float(radius_px), 1.0))


def _refined(difference: FloatImage, circle: ContactCircle) -> ContactCircle:
    """Return a circle through the peaks of the colour difference along rays from the centre.

    Parameters
    ----------
    difference : (row, col) colour difference to the background
    circle : circle of the previous fit
    """
    angles = 2.0 * np.pi * np.arange(SECTORS) / SECTORS
    radii = np.arange(0.4 * circle.radius_px, 1.3 * circle.radius_px, 0.5)
    rows = circle.row_px + np.outer(np.sin(angles), radii)
    cols = circle.col_px + np.outer(np.cos(angles), radii)
    places = cols.astype(np.float32), rows.astype(np.float32)
    rays = cv2.remap(difference, *places, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
    peak = np.argmax(rays, axis=1)
    height = rays[np.arange(SECTORS), peak]
    # If a ray has its maximum at its end, the edge is elsewhere or outside the image.
    clear = (height > LEAST_CONTRAST * np.median(height)) & (peak > 0) & (peak < len(radii) - 1)
    at = np.arange(SECTORS)[clear], peak[clear]
    return _robust_circle(np.column_stack([rows[at], cols[at]]))


def _robust_circle(points: FloatArray) -> ContactCircle:
    used = points
    for _ in range(3):
        if len(used) < SECTORS // 4:
            raise FitError(
                f"no contact circle: {len(used)} of {SECTORS} directions have an edge; "
                "press one ball, centred in the field"
            )
        circle = _circle_through(used)
        off_px = np.hypot(points[:, 0] - circle.row_px, points[:, 1] - circle.col_px)
        off_px = np.abs(off_px - circle.radius_px)
        used = points[off_px <= OUTLIER_SIGMAS * SIGMA_PER_MAD * np.median(off_px) + 0.5]
    return circle


def _circle_through(points: FloatArray) -> ContactCircle:
    """Return the circle of centre c by least squares of |p|^2 = 2 c p + k for points p (n, 2).

    See Kåsa 1976, IEEE Trans. Instrum. Meas. 25, 8.
    """
    offset = points.mean(axis=0)
    local = points - offset
    system = np.column_stack([2.0 * local, np.ones(len(local))])
    row, col, rest = np.linalg.lstsq(system, np.sum(local**2, axis=1))[0]
    radius = float(np.sqrt(max(rest + row * row + col * col, 0.0)))
    return ContactCircle(float(row + offset[0]), float(col + offset[1]), radius)


@dataclass(frozen=True, eq=False)
class BallPress:
    """Calibration image of one ball of known diameter in the gel.

    Parameters
    ----------
    image : (row, col, 3) uint8, red first
    dots : (row, col) bool, pixels of printed dots that are excluded in addition to those with a low
        level (see `SampleOptions.marker_level`); None: no others
    """

    image: Levels
    ball_diameter_mm: float
    dots: BoolImage | None = None

    def __post_init__(self) -> None:
        checked_image(self.image, "calibration image")
        require_number("ball_diameter_mm", self.ball_diameter_mm, 0.0, open_low=True)


@dataclass(frozen=True)
class SampleOptions:
    """Options for collecting samples from calibration images.

    Parameters
    ----------
    threshold_levels : Euclidean colour difference that distinguishes contact from undeformed gel
    smoothing_px : side of the square over which colours are averaged; odd, 1: no average
    marker_level : largest grey level of a printed dot (70 in the vendor's programs); dots are
        excluded; 0: the gel has no dots
    unreadable_share : share of the images that may have no contact circle, or one that does not fit
        the ball; these images are excluded. 0: every image must have a circle

    Raises
    ------
    InputError : a value is out of range
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


def ball_slopes(
    circle: ContactCircle,
    ball_radius_mm: float,
    pitch_mm: FloatArray | float,
    places_px: FloatArray,
) -> FloatArray:
    """Return the slopes (n, 2) of a ball, mm/mm, downwards and to the right, at pixels (n, 2).

    The pixels are (row, col), at less than the ball's radius from the centre of the circle.
    `pitch_mm` may differ from pixel to pixel, (n, 1).
    """
    offset_mm = (places_px - (circle.row_px, circle.col_px)) * pitch_mm
    depth_mm = np.sqrt(ball_radius_mm**2 - np.sum(offset_mm**2, axis=1))
    return np.asarray(-offset_mm / depth_mm[:, np.newaxis])


def sample_presses(
    presses: Sequence[BallPress],
    background: FloatImage,
    pitch_mm: float,
    options: SampleOptions | None = None,
    rest: RestSurface | None = None,
) -> Samples:
    """Collect samples of colour and slope from the calibration images.

    They are pixels in contact, and some undeformed pixels with slope 0. On a dome, slopes are those
    of the ball minus those of the undeformed coat.

    Parameters
    ----------
    presses : calibration images of the shape of `background`
    background : (row, col, 3) float32, mean of images of the undeformed gel
    pitch_mm : distance of neighbouring pixels on the surface
    options : None: the defaults of `SampleOptions`
    rest : undeformed coat of a domed gel; None: the gel is flat

    Raises
    ------
    InputError : an image has a different shape, or a number is out of range
    FitError : more images than `options.unreadable_share` allows have no circle, or one that does
        not fit the ball; the message has the number of the first such image
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
        if press.dots is not None:
            dots |= press.dots
        try:
            circle = find_contact_circle(levels, flat, how.threshold_levels)
            _require_fit(circle.radius_px * pitch_mm, press.ball_diameter_mm / 2.0)
        except FitError as error:
            unreadable.append(FitError(f"calibration image {number}: {error}"))
            if len(unreadable) > how.unreadable_share * len(presses):
                raise unreadable[0] from error
            continue
        ball = _slopes_of_ball(circle, press.ball_diameter_mm / 2.0, pitch_mm, rest)
        touched, untouched = _places(circle, ~(hidden_before | dots))
        parts.append(_part(levels, flat, touched, ball(touched)))
        parts.append(_part(levels, flat, untouched, np.zeros_like(untouched)))
    if not parts:
        raise FitError("there are no calibration images; give at least one press of a ball")
    return Samples(*(np.concatenate([part[i] for part in parts]) for i in range(4)))


def _slopes_of_ball(
    circle: ContactCircle, ball_radius_mm: float, pitch_mm: float, rest: RestSurface | None
) -> Callable[[FloatArray], FloatArray]:
    """Return the function from pixels (n, 2) to the ball's slopes minus those of the dome."""
    if rest is None:
        return partial(ball_slopes, circle, ball_radius_mm, pitch_mm)
    place_px = circle.row_px, circle.col_px
    (row_px, col_px), width_mm = rest.ball_axis(place_px, ball_radius_mm, pitch_mm)
    about_axis = replace(circle, row_px=row_px, col_px=col_px)
    # The pitch at the ball follows from its mean height above the dome, half of that in the middle.
    reach_mm = circle.radius_px * width_mm
    relief_mm = 0.5 * (ball_radius_mm - np.sqrt(ball_radius_mm**2 - reach_mm**2))

    def relative(places_px: FloatArray) -> FloatArray:
        row, col = places_px.astype(np.intp).T
        pitches_mm = pitch_mm * rest.widths(pitch_mm, relief_mm)[row, col, np.newaxis]
        ball = ball_slopes(about_axis, ball_radius_mm, pitches_mm, places_px)
        return ball - rest.slopes[:, row, col].T

    return relative


def _require_fit(contact_mm: float, ball_radius_mm: float) -> None:
    sine = contact_mm / ball_radius_mm
    if not SMALLEST_SINE <= sine <= LARGEST_SINE:
        raise FitError(
            f"a contact of radius {contact_mm:.3g} mm does not fit a ball of radius "
            f"{ball_radius_mm:.3g} mm, allowed {SMALLEST_SINE:g} to {LARGEST_SINE:g} times that; "
            "check the ball's diameter and pitch_mm"
        )


def _places(circle: ContactCircle, visible: BoolImage) -> tuple[FloatArray, FloatArray]:
    """Return the pixels inside the contact, (n, 2), and a few undeformed pixels, (m, 2).

    Parameters
    ----------
    visible : (row, col) bool, pixels without printed dots
    """
    row, col = np.ogrid[: visible.shape[0], : visible.shape[1]]
    distance_px = np.hypot(row - circle.row_px, col - circle.col_px)
    touched = (distance_px <= circle.radius_px - RIM_PX) & visible
    untouched = (distance_px >= UNTOUCHED_RADII * circle.radius_px) & visible
    inside = np.argwhere(touched).astype(np.float64)
    return inside, _thinned(np.argwhere(untouched).astype(np.float64), len(inside))


def _thinned(places_px: FloatArray, touched: int) -> FloatArray:
    count = round(UNTOUCHED_SHARE * touched)
    step = max(len(places_px) // count, 1) if count else len(places_px) + 1
    return places_px[::step][:count]


def _part(
    levels: FloatImage, background: FloatImage, places_px: FloatArray, slopes: FloatArray
) -> Part:
    row, col = places_px.astype(np.intp).T
    return levels[row, col], background[row, col], places_px, slopes
