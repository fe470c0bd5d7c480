"""A picture of decoded projector coordinates: needs Matplotlib, which decoding does not."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from reconstruction.arrays import Reason
from reconstruction.decoding import AxisDecode, Decoded
from reconstruction.drawing import Drawing

# Share of the valid pixels whose values span the colour scale.
_SHOWN = (1.0, 99.0)


def draw_decoded(path: Path, decoded: Decoded) -> None:
    """Draw coordinate, sigma and modulation along each axis, and why pixels have none, as PNG."""
    panels = 3 * len(decoded.axes) + 1
    drawing = Drawing(panels)
    places = drawing.subplots(1, panels, squeeze=False)[0]
    for number, name in enumerate(decoded.axes):
        axis = decoded.row if name == "row" else decoded.column
        _draw_axis(places[3 * number : 3 * number + 3], name, axis, decoded.valid)
    reasons = places[-1]
    shown = reasons.imshow(decoded.mask_reason, cmap="tab10", vmin=-0.5, vmax=9.5)
    reasons.set(title="reason", xlabel="camera column (px)", ylabel="camera row (px)")
    ticks = [int(reason) for reason in Reason]
    scale = drawing.colorbar(shown, ax=reasons, ticks=ticks)
    scale.ax.set_yticklabels([reason.name.lower().replace("_", " ") for reason in Reason])
    path.write_bytes(drawing.png())


def _draw_axis(places: Any, name: str, axis: AxisDecode, valid: NDArray[np.bool_]) -> None:
    _draw_map(places[0], axis.coordinate_px, valid, f"projector {name}", "px")
    _draw_map(places[1], axis.sigma_px, valid, f"sigma of the {name}", "px")
    _draw_map(places[2], axis.modulation_dn, np.ones_like(valid), f"modulation, {name}", "DN")


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
