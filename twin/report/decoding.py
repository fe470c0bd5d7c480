"""Figure of the decoder's maps: phase, fringe order, modulation, and why pixels are masked."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.patches import Patch
from numpy.typing import NDArray

from reconstruction.arrays import Reason
from reconstruction.decoding.decode import AxisDecode
from reconstruction.patterns import PatternSet
from reconstruction.pipeline import Reconstruction
from twin.report.canvas import add_colorbar, axes_at, cyclic, drawing, round_up, sequential

_SHOWN_PX, _MAP_IN = 480, 2.85
# Reasons for which the decoder has no phase at all.
_NO_PHASE = (Reason.DARK, Reason.LOW_MODULATION, Reason.SATURATED)

REASON_COLOURS = {
    Reason.VALID: "#d5e8da",
    Reason.DARK: "#2f3640",
    Reason.LOW_MODULATION: "#7f8c9b",
    Reason.SATURATED: "#d7263d",
    Reason.ORDER_UNCERTAIN: "#f2a541",
    Reason.OUTSIDE_PROJECTOR: "#8e6bbf",
    Reason.EDGE: "#5fa8d3",
    Reason.EPIPOLAR_MISMATCH: "#e36bae",
    Reason.NO_POINT: "#8a5a00",
}


def draw_decoding(path: Path, reconstruction: Reconstruction, patterns: PatternSet) -> None:
    """Draw wrapped phase and order of both directions, modulation and reason mask as PNG.

    Raises
    ------
    InputError
        `path` cannot be written.
    """
    decoded, reason = reconstruction.decoded, reconstruction.point_map.mask_reason
    rows, cols = reason.shape
    height_in = _MAP_IN * rows / cols
    line_in = height_in + 1.25
    with drawing(path, 10.0, 2 * line_in) as figure:
        places = [
            [
                axes_at(figure, 0.4 + 3.3 * at, 0.3 + line * line_in, _MAP_IN, height_in)
                for at in range(3)
            ]
            for line in range(2)
        ]
        for line, (name, axis) in enumerate((("column", decoded.column), ("row", decoded.row))):
            _phase(places[line][0], name, axis, reason)
            _order(places[line][1], name, axis, reconstruction)
        _modulation(places[0][2], decoded.column)
        _reasons(places[1][2], reason)


def _percent(share: float) -> str:
    return "< 0.01%" if share < 1e-4 else f"{share:.2%}"


def reason_shares(reason: NDArray[np.uint8]) -> dict[Reason, float]:
    """Return the share of the image under each reason that occurs."""
    counts = np.bincount(reason.ravel(), minlength=len(Reason))
    return {r: float(counts[r]) / reason.size for r in Reason if counts[r]}


def _map(axes: Axes, values: NDArray[Any], **options: Any) -> Any:
    """Show every n-th pixel: phases and codes must not be averaged."""
    rows, cols = values.shape
    step = -(-max(rows, cols) // _SHOWN_PX)
    extent = (-0.5, cols - 0.5, rows - 0.5, -0.5)
    return axes.imshow(values[::step, ::step], extent=extent, **options)


def _phase(axes: Axes, name: str, axis: AxisDecode, reason: NDArray[np.uint8]) -> None:
    known = np.ma.masked_where(np.isin(reason, _NO_PHASE), axis.phase_rad)
    shown = _map(axes, known, cmap=cyclic(), vmin=0, vmax=2 * np.pi)
    axes.set_title(f"wrapped phase, {name}")
    add_colorbar(axes, shown, "phase (rad), 0 to 2π", side="below")


def _order(axes: Axes, name: str, axis: AxisDecode, reconstruction: Reconstruction) -> None:
    valid = reconstruction.decoded.valid
    orders = axis.order[valid]
    low, high = (int(orders.min()), int(orders.max())) if orders.size else (0, 1)
    shown = _map(
        axes,
        np.ma.masked_where(~valid, axis.order),
        cmap=sequential(),
        vmin=low,
        vmax=max(high, low + 1),
    )
    axes.set_title(f"fringe order, {name}")
    add_colorbar(axes, shown, f"period number, {low} to {high}", side="below")


def _modulation(axes: Axes, axis: AxisDecode) -> None:
    top = round_up(float(axis.modulation_dn.max()))
    shown = _map(axes, axis.modulation_dn, cmap=sequential(), vmin=0, vmax=top)
    axes.set_title("modulation, column")
    add_colorbar(axes, shown, "amplitude (DN)", side="below")


def _reasons(axes: Axes, reason: NDArray[np.uint8]) -> None:
    colours = ListedColormap([REASON_COLOURS[r] for r in Reason])
    norm = BoundaryNorm(np.arange(len(Reason) + 1) - 0.5, len(Reason))
    _map(axes, reason, cmap=colours, norm=norm)
    handles = [
        Patch(
            color=REASON_COLOURS[r], label=f"{r.name.lower().replace('_', ' ')} {_percent(share)}"
        )
        for r, share in reason_shares(reason).items()
    ]
    axes.set_title("why pixels are masked")
    axes.legend(
        handles=handles,
        loc="upper center",
        bbox_to_anchor=(0.5, -0.1),
        ncols=2,
        fontsize=7.5,
        handlelength=1.0,
    )
