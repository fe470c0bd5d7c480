"""The sphere-fit comparison: height surfaces, residual maps and histograms of both methods."""

from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from twin.paper.figure_layout import LETTERS, panels_of
from twin.paper.panel_data import PanelData
from twin.paper.panel_plots import no_measurement, residual_limit_um, show_histogram, show_residuals
from twin.paper.panel_relief import ReliefView, show_relief, show_scale, stage_for
from twin.paper.sheet import label_panel, sheet
from twin.report.canvas import FAINT, add_colorbar, axes_at

_SPECIMEN = "two_balls"
_METHODS = {"photometric_stereo": "GelSight", "contact_fpp": "contact-FPP (proposed)"}
_WIDTH_IN, _HEIGHT_IN = 7.16, 5.8
_HALF_IN = _WIDTH_IN / 2
_SURFACE_TOP_IN, _MAP_TOP_IN, _HISTOGRAM_TOP_IN = 0.25, 2.6, 4.3
_BALLS = 2


def draw_sphere_fit(cases: Path, stem: Path) -> None:
    """Draw the two joined balls by GelSight (left) and contact-FPP (right), on one height scale.

    Residuals, too, have one scale for both methods.
    """
    found = {method: panels_of(cases, _SPECIMEN, method) for method in _METHODS}
    measured = [one for one in found.values() if one is not None]
    with sheet(stem, _WIDTH_IN, _HEIGHT_IN) as figure:
        for column, (method, name) in enumerate(_METHODS.items()):
            left_in = column * _HALF_IN
            figure.text(
                (left_in + _HALF_IN / 2) / _WIDTH_IN,
                1 - 0.13 / _HEIGHT_IN,
                name,
                ha="center",
                va="center",
                fontsize=8.5,
            )
            data = found[method]
            axes = axes_at(figure, left_in + 0.5, _SURFACE_TOP_IN, 2.2, 1.45)
            label_panel(axes, LETTERS[column])
            if data is None:
                no_measurement(axes)
                continue
            _surface(axes, data, stage_for(*measured))
            _residuals(figure, column, data, residual_limit_um(*measured))


def _surface(axes: Axes, data: PanelData, stage: ReliefView) -> None:
    show_relief(axes, data, stage)
    show_scale(axes, stage)


def _residuals(figure: Figure, column: int, data: PanelData, limit_um: float) -> None:
    """Draw map over histogram for each ball."""
    for number, ball in enumerate(data.numbers.balls[:_BALLS]):
        left_in = column * _HALF_IN + 0.42 + 1.3 * number
        residuals = axes_at(figure, left_in, _MAP_TOP_IN, 1.05, 1.05)
        shown = show_residuals(residuals, data, ball.number, limit_um)
        residuals.set_title(f"sphere {ball.number}", color=FAINT)
        histogram = axes_at(figure, left_in, _HISTOGRAM_TOP_IN, 1.05, 1.0)
        show_histogram(histogram, data, ball.number, limit_um)
        if number:
            add_colorbar(residuals, shown, "residual (µm)", extend="both")
            residuals.set_ylabel("")
            histogram.set_ylabel("")
        else:
            label_panel(residuals, LETTERS[2 + column])
            label_panel(histogram, LETTERS[4 + column])
