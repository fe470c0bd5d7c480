"""Shape of a projector's pixels: the key `pixel_ratio` of rigs, patterns and captures.

A number is the width of a pixel divided by its height, fy / fx: 1 for square pixels; 2 or 0.5 if
patterns have half as many columns or rows as square pixels would have.

"diamond" is a micromirror array turned by 45 degrees, whose every other row is displaced by half a
column. The columns are twice as far apart as the rows (DLP4500, 912 x 1140 mirrors: 10.8 and
5.4 um; Texas Instruments, data sheet DLPS028). The column coordinate is the mean of two
neighbouring rows: a mirror in column c of an even row is at c - 1/4, of an odd row at c + 1/4.

Across the columns a diamond is a triangle of base 1. With the displacement of the rows, the light
of a column pattern, averaged over rows, is that of a rectangular pixel, a box of width 1, averaged
over a further box of width 1/2. Across the rows a diamond is a triangle of base 2, a box of width 1
averaged over a box of width 1. These further boxes are the `smear_px`. The zigzag of the two rows
around their mean is neglected: it is finer than any fringe.
"""

from typing import Literal

from reconstruction.errors import InputError, require_number

DIAMOND: Literal["diamond"] = "diamond"
PixelRatio = float | Literal["diamond"]
PIXEL_RATIOS = (0.1, 10.0)
"""Plausible range of fy / fx, the width of a pixel divided by its height."""
_SMEARS_PX = {"column": 0.5, "row": 1.0}


def require_pixel_ratio(name: str, pixel_ratio: PixelRatio) -> None:
    """Raise InputError unless `pixel_ratio` is a number in the plausible range or "diamond"."""
    if pixel_ratio == DIAMOND:
        return
    if isinstance(pixel_ratio, str):
        raise InputError(f'{name} is {pixel_ratio!r}; give a number or "{DIAMOND}"')
    require_number(name, pixel_ratio, *PIXEL_RATIOS)


def width_over_height(pixel_ratio: PixelRatio) -> float:
    """Return the distance of the columns divided by that of the rows."""
    return 2.0 if pixel_ratio == DIAMOND else float(pixel_ratio)


def pixels_per_column(pixel_ratio: PixelRatio, axis: str) -> float:
    """Return the distance of the columns in pixels along an axis, "column" or "row"."""
    return width_over_height(pixel_ratio) if axis == "row" else 1.0


def smear_px(pixel_ratio: PixelRatio, axis: str) -> float:
    """Return the width, px, of the box that a pixel's shape adds to its box of width 1."""
    return _SMEARS_PX[axis] if pixel_ratio == DIAMOND else 0.0
