"""Picture of the contact transfer function: what the coat keeps of a groove, against its pitch."""

from pathlib import Path

from twin.mechanics import ContactTransfer
from twin.report.canvas import FIT, MEASURED, axes_at, drawing, legend_above, plain_log


def draw_transfer(path: Path, transfer: ContactTransfer) -> None:
    """Draw kept relief against pitch, closed form and computed, as PNG.

    Raises
    ------
    InputError
        `path` cannot be written.
    """
    with drawing(path, 7.0, 3.6) as figure:
        axes = axes_at(figure, 0.7, 0.55, 6.0, 2.6)
        whole, found, what = _labels(transfer)
        axes.semilogx(transfer.pitch_mm, transfer.closed_form, color=MEASURED, label=whole)
        axes.semilogx(transfer.pitch_mm, transfer.computed, ".", color=FIT, label=found)
        for kept, pitch in ((0.5, transfer.half_pitch_mm), (0.1, transfer.tenth_pitch_mm)):
            if pitch > 0:
                axes.plot([pitch], [kept], "o", color="black", markersize=4)
                axes.annotate(f" {kept:.0%} at {pitch:.2f} mm", (pitch, kept), va="top", fontsize=8)
        axes.set_xlabel(f"pitch of the groove (mm), {what} {transfer.thickness_mm:g} mm thick")
        axes.set_ylabel("share of the relief on the coat")
        axes.set_ylim(0.0, 1.05)
        plain_log(axes.xaxis)
        axes.grid(visible=True)
        legend_above(axes, 2)


def _labels(transfer: ContactTransfer) -> tuple[str, str, str]:
    """Return what the curve is, what the points are, and what is pressed."""
    if transfer.ridge_mm is None:
        return "closed form", "computed by the solver", "slab"
    under = f"ridges of {1e3 * transfer.ridge_mm:g} µm under {transfer.pressure_kpa:g} kPa"
    return "lying on all of the ridge", under, "sheet"
