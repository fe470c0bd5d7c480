"""Draw height maps and printed dots of measured presses; this module imports Matplotlib."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from reconstruction.arrays import Levels
from reconstruction.drawing import Drawing
from reconstruction.markers import DotStatus
from reconstruction.photometric.height_map import HeightMap
from reconstruction.photometric.printed_dots import GelMotion
from reconstruction.writing import write_bytes

_ACROSS, _MOST = 4, 24
# Largest displacement as drawn, in distances of neighbouring dots.
_LONGEST_ARROW = 0.9
_OF_STATUS = {
    DotStatus.TRACKED: ("o", "#ffffff"),
    DotStatus.LOST: ("x", "#ff3030"),
    DotStatus.DOUBTFUL: ("s", "#ffb000"),
}


def draw_heights(path: Path, heights: Mapping[str, HeightMap]) -> None:
    """Draw a PNG file of named height maps with a common colour scale, mm.

    If there are more than 24 maps, 24 at equal intervals are drawn.
    """
    names = list(heights)
    if len(names) > _MOST:
        names = [names[k] for k in np.linspace(0, len(names) - 1, _MOST).astype(int)]
    shown = [heights[name] for name in names]
    low = min(float(np.percentile(height_map.height_mm, 1.0)) for height_map in shown)
    high = max(float(height_map.height_mm.max()) for height_map in shown)
    across = min(_ACROSS, len(names))
    rows = -(-len(names) // across)
    drawing = Drawing(across, rows)
    places = drawing.subplots(rows, across, squeeze=False).ravel()
    for place, name, height_map in zip(places, names, shown, strict=False):
        rows_mm, cols_mm = (count * height_map.pitch_mm for count in height_map.height_mm.shape)
        extent = (-cols_mm / 2, cols_mm / 2, -rows_mm / 2, rows_mm / 2)
        image = place.imshow(height_map.height_mm, vmin=low, vmax=high, extent=extent)
        place.set(title=name, xlabel="x (mm)", ylabel="y (mm)")
        drawing.colorbar(image, ax=place, label="height (mm)")
    for empty in places[len(names) :]:
        empty.remove()
    write_bytes(path, drawing.png())


def draw_dots(path: Path, image: Levels, motion: GelMotion) -> None:
    """Draw a PNG file of the displacements of printed dots as arrows over the image of the press.

    The scale of the arrows is in the title; they start at the places without contact. Dots that are
    lost or doubtful have a mark and no arrow.

    Parameters
    ----------
    image : (row, col, 3) uint8, red first
    """
    tracks, tracked = motion.tracks, motion.tracks.tracked
    longest_mm = float(np.hypot(*motion.moved_mm[tracked].T).max(initial=0.0))
    moved_px = motion.moved_mm * (1.0, -1.0)  # rows increase downwards
    scale = _LONGEST_ARROW * tracks.pattern.spacing_px / longest_mm if longest_mm else 1.0
    drawing = Drawing(2, 2)
    axes = drawing.subplots()
    axes.imshow(image)
    row, col = tracks.places_px.T
    for status, (marker, colour) in _OF_STATUS.items():
        some = tracks.status == status
        axes.plot(col[some], row[some], marker, color=colour, markersize=5, markerfacecolor="none",
                  linestyle="none", label=f"{status.name.lower()}: {some.sum()}")  # fmt: skip
    arrows = (scale * moved_px[tracked]).T
    axes.quiver(col[tracked], row[tracked], *arrows, color="#ffffff", edgecolor="#000000",
                linewidth=0.5, angles="xy", scale_units="xy", scale=1.0, width=0.005)  # fmt: skip
    axes.set(title=f"displacement of the dots; longest arrow {1e3 * longest_mm:.3g} µm",
             xlabel="column (px)", ylabel="row (px)")  # fmt: skip
    drawing.legend(loc="outside lower center", ncols=3, facecolor="#808080", labelcolor="white")
    write_bytes(path, drawing.png())
