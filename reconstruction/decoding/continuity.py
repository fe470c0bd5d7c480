"""Check fringe orders after decoding: whether coordinates are continuous and do not turn back.

A cell is an interval of projector coordinates, one period wide or a larger power of two of it. On a
continuous surface the coordinate changes in small steps where an image line crosses the border of
two cells. With Gray frames in a wrong order, or a wrong first shift, it jumps there instead. Steps
and edges of a real scene cause jumps as well, but rarely at most of the crossings. The measured
share of crossings with a jump is 0 to 0.34 for correctly decoded real captures with edges of depth.
It is 0.55 to 1 if two visible, resolved frames were exchanged.

Along a line of the image the coordinate of a surface in front of its surroundings increases, or it
decreases if the camera's view of the projector is mirrored. Reflected Gray words without their
coarsest bit increase in one half of the projector and decrease in the other, without a jump.
"""

import numpy as np

from reconstruction.arrays import BoolImage, FloatImage, IntArray

# Lines of the image that are checked, along rows and along columns.
LINES = 64
# Least width of a cell, in median steps from pixel to pixel, and for a Gray code without fringes
# also in widths of a word.
LEAST_STEPS, LEAST_WORDS = 6.0, 4.0
LEAST_CROSSINGS = 50
TURN_PX = 8
"""Distance of the pixels whose coordinates are compared: beyond the edge of a code word."""
DOUBTFUL_TURN = 0.15
"""Share of an image with the opposite direction above which the coarsest bit is doubtful."""
DOUBTFUL_SHARE = 0.45
"""Share of crossings with a jump above which the fringe orders of a capture are doubtful."""


def jump_share(
    coordinate_px: FloatImage, valid: BoolImage, period_px: float, *, is_word: bool
) -> float:
    """Return the share of crossings of cell borders with a jump of the coordinate.

    It is the largest share for cells of one, two, four ... periods.

    Parameters
    ----------
    coordinate_px : (row, col), projector px
    valid : (row, col) bool, pixels with a coordinate
    period_px : period of the fringes; without fringes the length over which a code word is constant
    is_word : True for a Gray code without fringes, for which cells of one word or two are left out
        because coordinates jump from word to word

    Returns
    -------
    in [0, 1]; 0 if fewer than LEAST_CROSSINGS crossings exist
    """
    rows, cols = (_places(length) for length in valid.shape)
    lines = [
        (coordinate_px[rows], valid[rows]),
        (coordinate_px[:, cols].T, valid[:, cols].T),
    ]
    values = [x[is_valid] for x, is_valid in lines]
    seen_px = np.concatenate(values)
    steps_px = np.concatenate(
        [np.abs(np.diff(x, axis=1))[is_valid[:, 1:] & is_valid[:, :-1]] for x, is_valid in lines]
    )
    if min(steps_px.size, seen_px.size) < LEAST_CROSSINGS:
        return 0.0
    low_px, high_px = np.percentile(seen_px, [1.0, 99.0])
    least_px = max(LEAST_STEPS * float(np.median(steps_px)), LEAST_WORDS * period_px * is_word)
    worst, cell_px = 0.0, period_px
    while cell_px <= 0.5 * (high_px - low_px):
        if cell_px >= least_px:
            worst = max(worst, _share(lines, cell_px))
        cell_px *= 2.0
    return worst


def turned_share(coordinate_px: FloatImage, valid: BoolImage) -> float:
    """Return the share of pixels at which a coordinate changes in the rarer of two directions.

    The change is that over TURN_PX pixels along rows, or along columns if it is larger there.

    Returns
    -------
    in [0, 0.5]; 0 if fewer than LEAST_CROSSINGS pairs of valid pixels exist
    """
    changes = []
    for x_px, is_valid in ((coordinate_px, valid), (coordinate_px.T, valid.T)):
        pair = is_valid[:, TURN_PX:] & is_valid[:, :-TURN_PX]
        changes.append((x_px[:, TURN_PX:] - x_px[:, :-TURN_PX])[pair])
    along = max(
        changes, key=lambda change: float(np.median(np.abs(change))) if change.size else 0.0
    )
    moving = along[along != 0.0]
    if moving.size < LEAST_CROSSINGS:
        return 0.0
    rising = float(np.mean(moving > 0.0))
    return min(rising, 1.0 - rising)


def _places(length: int) -> IntArray:
    return np.unique(np.linspace(0, length - 1, LINES).astype(int))


def _share(lines: list[tuple[FloatImage, BoolImage]], cell_px: float) -> float:
    jumps, crossings = 0, 0
    for x_px, is_valid in lines:
        step_px = np.diff(x_px, axis=1)
        is_pair = is_valid[:, 1:] & is_valid[:, :-1]
        is_small = is_pair & (np.abs(step_px) < 0.5 * cell_px)
        # Only between two continuous pieces: single wrong pixels do not count.
        between = is_pair[:, 1:-1] & is_small[:, :-2] & is_small[:, 2:]
        cell = np.floor(x_px / cell_px)
        crosses = between & (cell[:, 2:-1] != cell[:, 1:-2])
        crossings += int(np.count_nonzero(crosses))
        jumps += int(np.count_nonzero(crosses & ~is_small[:, 1:-1]))
    return jumps / crossings if crossings >= LEAST_CROSSINGS else 0.0
