"""Which dot is which: the three larger dots give the frame, the grid grows from them."""

from itertools import permutations

import numpy as np

from reconstruction.arrays import Doubles
from reconstruction.calibration.boards import DotBoard, Indices
from reconstruction.calibration.dots import Dots
from reconstruction.calibration.homography import apply_homography, fit_homography
from reconstruction.errors import InputError

# A dot lies this close to a grid position, in pitches, while the grid grows.
GROW_TOLERANCE = 0.2
# A larger dot has more than this many times the median area (at least 1.4^2 = 1.96 when flat).
LARGE_AREA = 1.5
MAX_CANDIDATES = 8
# Perspective makes the three large dots' areas differ a little.
AREA_SPREAD = 1.35
MIN_DOTS = 12
# Share of the dots within the board's outline that must lie on the grid: a mirrored board fits a
# sheared grid, but only every other of its dots.
MIN_ON_GRID = 0.8


def label_dots(board: DotBoard, dots: Dots) -> tuple[list[int], list[int]]:
    """Return (ids, indices into dots) of the dots that belong to the board's grid.

    Raises
    ------
    InputError : the larger dots are not found, the image is mirrored, too few dots remain
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


def _large(dots: Dots) -> list[int]:
    if not len(dots.areas_px):
        return []
    order = np.argsort(-dots.areas_px, kind="stable")
    typical = float(np.median(dots.areas_px))
    return [int(k) for k in order if dots.areas_px[k] > LARGE_AREA * typical][:MAX_CANDIDATES]


def _grow(board: DotBoard, dots: Dots, triple: tuple[int, int, int]) -> tuple[list[int], list[int]]:
    """Grow the grid ring by ring from an assumed origin, right and upper dot."""
    nothing: tuple[list[int], list[int]] = ([], [])
    origin, right, upper = dots.centres_px[list(triple)]
    across, up = (right - origin) / 2.0, upper - origin
    lengths = np.linalg.norm(across), np.linalg.norm(up)
    turn = across[0] * up[1] - across[1] * up[0]
    areas = dots.areas_px[list(triple)]
    # In the image y points down: a right-handed view turns negatively from right to up.
    if turn > -0.5 * lengths[0] * lengths[1] or not 0.5 < lengths[0] / lengths[1] < 2.0:
        return nothing
    if areas.max() > AREA_SPREAD * areas.min():
        return nothing
    affine = np.linalg.inv(
        np.array([[across[0], -up[0], origin[0]], [across[1], -up[1], origin[1]], [0, 0, 1.0]])
    )
    start = board.fiducial_ids[0]
    shift = np.array([start % board.columns, start // board.columns])
    return _grow_rings(board, dots.centres_px, affine, shift)


def _grow_rings(
    board: DotBoard, centres_px: Doubles, grid_from_image: Doubles, origin: Indices
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
    """Drop every dot whose place in the grid is claimed twice; sort by place."""
    found, first, counts = np.unique(ids[members], return_index=True, return_counts=True)
    single = counts == 1
    return found[single].tolist(), members[first[single]].tolist()
