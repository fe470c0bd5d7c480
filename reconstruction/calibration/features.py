"""Detect the features of a board, dots or corners, and their ids in an image.

The centre of a dot is the grey-level centroid of its ink, with an error of a few thousandths of a
pixel. The three larger dots give the origin and the axes of the grid, to which further dots are
added. Corners are detected by OpenCV with sub-pixel refinement.

An image of relative brightness is the input: brightness divided by that of white print.
"""

from dataclasses import dataclass
from itertools import permutations

import cv2
import numpy as np

from reconstruction.arrays import BoolImage, FloatArray, FloatImage, Levels
from reconstruction.calibration.boards import CharucoBoard, Chessboard, DotBoard, Indices
from reconstruction.calibration.plane_images import apply_homography, fit_homography
from reconstruction.errors import InputError

# Least area of a dot; a smaller blob has too few pixels to classify its shape.
MIN_AREA_PX = 40
# Largest relative difference of a dot's area from the ellipse with the same second moments.
ELLIPSE_TOLERANCE = 0.12
MIN_AXIS_RATIO = 0.45
# Distances from the centre in units of the dot's ellipse: limit of the ink, limits of the ring of
# white print around it.
CENTROID_REACH, RING_INNER, RING_OUTER = 1.25, 1.3, 1.65
# Largest distance of a dot from its grid position, in pitches, when the grid is extended.
GROW_TOLERANCE = 0.2
# Least ratio of a larger dot's area to the median area (at least 1.4^2 = 1.96 without tilt).
LARGE_AREA = 1.5
MAX_CANDIDATES = 8
# Largest ratio of the areas of the three larger dots, which differ by perspective.
AREA_SPREAD = 1.35
MIN_DOTS = 12
# Least share of the dots within the board's outline that must be on the grid. A mirrored board fits
# a sheared grid, but only with every second dot.
MIN_ON_GRID = 0.8

SOFTEN_PX = 2.0
REFINE_TURNS, REFINE_STEP_PX = 60, 1e-4


@dataclass(frozen=True, eq=False)
class FoundDots:
    """Dots detected in an image, without ids.

    Parameters
    ----------
    centres_px : (n, 2) float, column and row of the centroid of each dot
    areas_px : (n,) float, area of each dot, px^2
    moments_px2 : (n, 2, 2) float, central second moments of the pixels of each dot
    """

    centres_px: FloatArray
    areas_px: FloatArray
    moments_px2: FloatArray

    def chosen(self, keep: Indices) -> "FoundDots":
        """Return the dots with the indices `keep`."""
        return FoundDots(self.centres_px[keep], self.areas_px[keep], self.moments_px2[keep])


def find_dots(relative: FloatImage, threshold: float) -> FoundDots:
    """Detect dark ellipses that the image border does not cut.

    The centres are centroids of the pixels below `threshold`; `refine_centres` improves them.

    Parameters
    ----------
    relative : (row, col) brightness relative to white print
    threshold : relative brightness below which a pixel is ink
    """
    ink = (relative < threshold).astype(np.uint8)
    count, labels, stats, centroids = cv2.connectedComponentsWithStats(ink, connectivity=4)
    blobs = [
        (centroids[k], float(stats[k, cv2.CC_STAT_AREA]), moments)
        for k in range(1, count)
        if _inside(stats[k], ink.shape)
        and (moments := _moments(labels, k, stats[k])) is not None
        and _is_ellipse(moments, float(stats[k, cv2.CC_STAT_AREA]))
    ]
    return FoundDots(
        np.array([entry[0] for entry in blobs], dtype=np.float64).reshape(-1, 2),
        np.array([entry[1] for entry in blobs], dtype=np.float64),
        np.array([entry[2] for entry in blobs], dtype=np.float64).reshape(-1, 2, 2),
    )


def _inside(stats: FloatArray, shape: tuple[int, int]) -> bool:
    left, top, width, height, area = stats
    touches = left <= 0 or top <= 0 or left + width >= shape[1] or top + height >= shape[0]
    # The upper limit, 25 % of the image, excludes the dark surroundings of the board.
    return not touches and MIN_AREA_PX <= area <= 0.25 * shape[0] * shape[1]


def _moments(labels: FloatArray, label: int, stats: FloatArray) -> FloatArray | None:
    left, top, width, height, _ = stats
    if not MIN_AXIS_RATIO / 2 < width / height < 2 / MIN_AXIS_RATIO:
        return None
    y, x = np.nonzero(labels[top : top + height, left : left + width] == label)
    return np.cov(np.stack([x, y]).astype(np.float64), bias=True)


def _is_ellipse(moments: FloatArray, area: float) -> bool:
    low, high = np.linalg.eigvalsh(moments)
    ellipse_area = 4.0 * np.pi * np.sqrt(max(low * high, 0.0))
    return bool(
        abs(ellipse_area / area - 1.0) < ELLIPSE_TOLERANCE and low > MIN_AXIS_RATIO**2 * high
    )


def refine_centres(relative: FloatImage, dots: FoundDots) -> tuple[FloatArray, BoolImage]:
    """Return grey-level centroids (n, 2) px, and a mask (n,): True where the centroid is refined.

    A dot keeps its centre if the image border cuts the ring of white print around it. The share of
    ink at a pixel is 1 - brightness / white. The white level is a plane fitted to the ring, so that
    shading does not shift the centroid. The centroid of a uniform ellipse is its centre, also with
    symmetric blur.
    """
    centres = dots.centres_px.copy()
    is_whole = np.zeros(len(centres), dtype=np.bool_)
    for k, (start, moments) in enumerate(zip(dots.centres_px, dots.moments_px2, strict=True)):
        centre = _centroid(relative, start, moments)
        if centre is not None:
            centres[k], is_whole[k] = centre, True
    return centres, is_whole


def _centroid(relative: FloatImage, centre: FloatArray, moments: FloatArray) -> FloatArray | None:
    for _ in range(2):  # the window is centred again once
        window = _window(relative, centre, moments)
        if window is None:
            return None
        x, y, values, reach = window
        ring = (reach > RING_INNER) & (reach < RING_OUTER)
        design = np.column_stack([np.ones(ring.sum()), x[ring], y[ring]])
        plane = np.linalg.lstsq(design, values[ring], rcond=None)[0]
        ink = 1.0 - values / (plane[0] + plane[1] * x + plane[2] * y)
        ink = np.where(reach < CENTROID_REACH, ink, 0.0)
        total = float(ink.sum())
        if not total > 0.0:
            return None
        centre = centre + np.array([np.sum(ink * x), np.sum(ink * y)]) / total
    return centre


def _window(
    relative: FloatImage, centre: FloatArray, moments: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray] | None:
    """Return the pixels around a dot: x, y from its centre, px, brightness and scaled distance.

    The distance from the centre is scaled such that it is 1 on the border of the dot's ellipse.
    None: the image border cuts the window.
    """
    half = np.ceil(2.0 * RING_OUTER * np.sqrt(np.diag(moments))).astype(int) + 1
    first = np.rint(centre).astype(int) - half
    last = np.rint(centre).astype(int) + half + 1
    if first.min() < 0 or last[0] > relative.shape[1] or last[1] > relative.shape[0]:
        return None
    values = relative[first[1] : last[1], first[0] : last[0]].astype(np.float64)
    x, y = np.meshgrid(np.arange(first[0], last[0]), np.arange(first[1], last[1]))
    x, y = x - centre[0], y - centre[1]
    inverse = np.linalg.inv(moments)
    square = inverse[0, 0] * x * x + 2.0 * inverse[0, 1] * x * y + inverse[1, 1] * y * y
    return x, y, values, 0.5 * np.sqrt(square)


def label_dots(board: DotBoard, dots: FoundDots) -> tuple[list[int], list[int]]:
    """Return the ids on the board of the dots on its grid, and their indices in `dots`.

    Raises
    ------
    InputError : the larger dots are not recognised, the image is mirrored, or too few dots are on
        the grid
    """
    large = _large(dots)
    reason = f"{len(large)} larger dots found among {len(dots.areas_px)}, needed are 3"
    best: tuple[list[int], list[int]] = ([], [])
    for triple in permutations(large, 3):
        ids, indices = _grow(board, dots, triple)
        if len(ids) > len(best[0]):
            best = ids, indices
    if len(best[0]) >= MIN_DOTS:
        return best
    raise InputError(
        f"the board's grid is not recognised ({reason}; {len(best[0])} dots fit the grid, needed "
        f"are {MIN_DOTS}); show the three larger dots, keep the image unmirrored and the tilt "
        "below 40 degrees, and check the board's data"
    )


def _large(dots: FoundDots) -> list[int]:
    if not len(dots.areas_px):
        return []
    order = np.argsort(-dots.areas_px, kind="stable")
    typical = float(np.median(dots.areas_px))
    return [int(k) for k in order if dots.areas_px[k] > LARGE_AREA * typical][:MAX_CANDIDATES]


def _grow(
    board: DotBoard, dots: FoundDots, triple: tuple[int, int, int]
) -> tuple[list[int], list[int]]:
    """Return ids and indices of the dots on the grid of three assumed larger dots.

    `triple` has the indices of the origin, the right and the upper dot. The grid is extended from
    them ring by ring.
    """
    no_match: tuple[list[int], list[int]] = ([], [])
    origin, right, upper = dots.centres_px[list(triple)]
    across, up = (right - origin) / 2.0, upper - origin
    lengths = np.linalg.norm(across), np.linalg.norm(up)
    turn = across[0] * up[1] - across[1] * up[0]
    areas = dots.areas_px[list(triple)]
    # In the image y points down: in an unmirrored view the turn from right to up is negative.
    if turn > -0.5 * lengths[0] * lengths[1] or not 0.5 < lengths[0] / lengths[1] < 2.0:
        return no_match
    if areas.max() > AREA_SPREAD * areas.min():
        return no_match
    affine = np.linalg.inv(
        np.array([[across[0], -up[0], origin[0]], [across[1], -up[1], origin[1]], [0, 0, 1.0]])
    )
    start = board.fiducial_ids[0]
    shift = np.array([start % board.columns, start // board.columns])
    return _grow_rings(board, dots.centres_px, affine, shift)


def _grow_rings(
    board: DotBoard, centres_px: FloatArray, grid_from_image: FloatArray, origin: Indices
) -> tuple[list[int], list[int]]:
    ids: list[int] = []
    members: list[int] = []
    inside = np.zeros(len(centres_px), dtype=np.bool_)
    for ring in range(2, max(board.columns, board.rows) + 1):
        place = apply_homography(grid_from_image, centres_px)
        nearest = np.rint(place)
        cell = nearest.astype(int) + origin
        inside = np.all((cell >= 0) & (cell < [board.columns, board.rows]), axis=1)
        inside &= np.max(np.abs(nearest), axis=1) <= ring
        good = inside & (np.max(np.abs(place - nearest), axis=1) < GROW_TOLERANCE)
        ids, members = _unique(cell[:, 1] * board.columns + cell[:, 0], np.flatnonzero(good))
        if len(ids) >= 8:
            grid_from_image = fit_homography(centres_px[members], nearest[members])
    return (ids, members) if len(ids) >= MIN_ON_GRID * inside.sum() else ([], [])


def _unique(ids: Indices, members: Indices) -> tuple[list[int], list[int]]:
    """Return the dots with a unique id, sorted by id: their ids and their indices."""
    unique_ids, first, counts = np.unique(ids[members], return_index=True, return_counts=True)
    single = counts == 1
    return unique_ids[single].tolist(), members[first[single]].tolist()


def find_corners(
    board: Chessboard | CharucoBoard, relative: FloatImage
) -> tuple[Indices, FloatArray]:
    """Return ids (n,) and image positions (n, 2), column and row, px, of the visible corners.

    Parameters
    ----------
    relative : (row, col) brightness relative to white print

    Raises
    ------
    InputError : the board is not recognised
    """
    image = np.clip(relative * 220.0, 0, 255).astype(np.uint8)
    if isinstance(board, Chessboard):
        ids, corners = _chessboard(board, image)
    else:
        ids, corners = _charuco(board, image)
    return ids, _refined(image, corners, _clear_share(board))


def _chessboard(board: Chessboard, image: Levels) -> tuple[Indices, FloatArray]:
    is_complete, corners = cv2.findChessboardCorners(image, (board.columns, board.rows))
    if not is_complete:
        raise InputError(
            f"no chessboard of {board.columns} x {board.rows} inner corners is recognised; show "
            "the whole board, tilt it less, or correct the board's data"
        )
    corners = corners.reshape(board.rows, board.columns, 2).astype(np.float64)
    across, down = corners[0, -1] - corners[0, 0], corners[-1, 0] - corners[0, 0]
    if across[0] * down[1] - across[1] * down[0] < 0.0:  # OpenCV may count a row backwards
        corners = corners[:, ::-1]
    return np.arange(board.columns * board.rows), corners.reshape(-1, 2)


def _charuco(board: CharucoBoard, image: Levels) -> tuple[Indices, FloatArray]:
    detector = cv2.aruco.CharucoDetector(board.opencv())
    corners, ids = detector.detectBoard(image)[:2]
    if ids is None or len(ids) < 6:
        raise InputError(
            f"{0 if ids is None else len(ids)} ChArUco corners are recognised, needed are 6; show "
            "more of the board, in focus, unmirrored, or correct the board's data"
        )
    return ids.reshape(-1), corners.reshape(-1, 2).astype(np.float64)


def _clear_share(board: Chessboard | CharucoBoard) -> float:
    """Return the largest half width of a window around a corner without other edges, in squares."""
    if isinstance(board, Chessboard):
        return 0.4
    return min(0.4, 0.4 * (1.0 - board.marker_mm / board.square_mm))


def _refined(image: Levels, corners: FloatArray, share: float) -> FloatArray:
    spacing = np.median(_nearest_distance(corners))
    half = int(np.clip(share * spacing, 2, 30))
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, REFINE_TURNS, REFINE_STEP_PX)
    start = np.ascontiguousarray(corners, dtype=np.float32).reshape(-1, 1, 2)
    # Without this blur sharp edges alias, and corners shift by 0.05 px towards pixel centres.
    soft = cv2.GaussianBlur(image.astype(np.float32), (0, 0), min(SOFTEN_PX, half / 3.0))
    refined = cv2.cornerSubPix(soft, start, (half, half), (-1, -1), criteria)
    return np.asarray(refined, dtype=np.float64).reshape(-1, 2)


def _nearest_distance(corners: FloatArray) -> FloatArray:
    distance = np.linalg.norm(corners[:, np.newaxis] - corners, axis=-1)
    np.fill_diagonal(distance, np.inf)
    return np.asarray(distance.min(axis=1))
