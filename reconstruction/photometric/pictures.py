"""Draw height maps of measured presses; this module imports Matplotlib."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from reconstruction.drawing import Drawing
from reconstruction.photometric.height_map import HeightMap
from reconstruction.writing import write_bytes

_ACROSS, _MOST = 4, 24


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
