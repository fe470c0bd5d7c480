"""Draw a figure of decoded projector coordinates; this module imports Matplotlib."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from numpy.typing import NDArray

from reconstruction.arrays import Reason
from reconstruction.decoding import Decoded
from reconstruction.drawing import Drawing
from reconstruction.writing import write_bytes

# Percentiles of the valid pixels that are the ends of the colour scale.
_SHOWN = (1.0, 99.0)


def draw_decoded(path: Path, decoded: Decoded) -> None:
    """Draw a PNG file with maps of coordinate, sigma and modulation, and of the reason codes.

    The first three maps are drawn for each axis.
    """
    rows = len(decoded.axes)
    drawing = Drawing(4, rows)
    places = drawing.subplots(rows, 4, squeeze=False)
    for place, name in zip(places, decoded.axes, strict=True):
        axis = decoded.row if name == "row" else decoded.column
        _draw_map(place[0], axis.coordinate_px, decoded.valid, f"projector {name}", "px")
        _draw_map(place[1], axis.sigma_px, decoded.valid, f"sigma of the {name}", "px")
        everywhere = np.ones_like(decoded.valid)
        _draw_map(place[2], axis.modulation_dn, everywhere, f"modulation, {name}", "DN")
        place[0].set_ylabel("camera row (px)")
    _draw_reasons(drawing, places[0, 3], decoded)
    for empty in places[1:, 3]:
        empty.remove()
    write_bytes(path, drawing.png())


def _draw_reasons(drawing: Drawing, place: Axes, decoded: Decoded) -> None:
    """Draw a map of the reason code of every pixel; the colour bar names the codes that occur."""
    reasons = [Reason(code) for code in np.unique(decoded.mask_reason)]
    shown = place.imshow(
        np.searchsorted(reasons, decoded.mask_reason),
        cmap=colormaps["tab10"].resampled(len(reasons)),
        vmin=-0.5,
        vmax=len(reasons) - 0.5,
    )
    place.set(title="reason without coordinate", xlabel="camera column (px)")
    scale = drawing.colorbar(shown, ax=place, ticks=range(len(reasons)))
    scale.ax.set_yticklabels([reason.name.lower().replace("_", " ") for reason in reasons])


def _draw_map(
    place: Axes, values: NDArray[Any], where: NDArray[np.bool_], title: str, unit: str
) -> None:
    low, high = np.percentile(values[where], _SHOWN) if where.any() else (0.0, 1.0)
    masked = np.ma.masked_array(values, ~where)
    place.set_facecolor("#d9d9d9")
    shown = place.imshow(masked, cmap="viridis", vmin=low, vmax=max(high, low + 1e-9))
    place.set(title=title, xlabel="camera column (px)")
    figure = place.get_figure()
    assert figure is not None
    figure.colorbar(shown, ax=place, label=unit)
