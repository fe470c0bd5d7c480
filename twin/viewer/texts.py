"""Texts of the live view: figures, colour scales, command with the changed values."""

from collections.abc import Mapping, Sequence
from html import escape

from matplotlib import colormaps
from matplotlib.colors import to_hex

from reconstruction.colouring import Deviation
from twin.mechanics import PressedElastomer
from twin.report.contact import sentences
from twin.report.object import object_lines
from twin.results.record import Measurement
from twin.viewer.scene import heights_mm

_STOPS = 9
_DEVIATION_COLOURS = ("#0000ff", "#ffffff", "#ff0000")


def press_line(pressed: PressedElastomer) -> str:
    """Return force, travel and height of a press as one line."""
    return (
        f"force {pressed.force_n:.3g} N, travel {pressed.depth_mm:.3g} mm, coat up to "
        f"{pressed.face_z_mm.max():.3g} mm"
    )


def figure_list(measured: Measurement) -> str:
    """Return the figures of object and coat, and the warnings, as HTML."""
    warnings = [f"warning: {warning}" for warning in measured.warnings]
    lines = [f"object: {line}" for line in object_lines(measured)]
    return paragraphs(*lines, *sentences(measured), *warnings)


def paragraphs(*lines: str) -> str:
    """Return lines of text as HTML in the type of the result panel."""
    rows = "".join(f'<p style="margin:0 0 0.3em">{escape(line)}</p>' for line in lines)
    return f'<div style="font-size:0.8em;margin:0.5em 0.7em">{rows}</div>'


def height_scale(pressed: PressedElastomer) -> str:
    """Return the scale of the coat's colours as HTML: heights in mm."""
    low, high = heights_mm(pressed)
    colours = [to_hex(colormaps["viridis"](n / (_STOPS - 1))) for n in range(_STOPS)]
    middle = 0.5 * (low + high)
    return _scale("height z of the coat (mm)", colours, [f"{z:.3f}" for z in (low, middle, high)])


def deviation_scale(deviation: Deviation) -> str:
    """Return the scale of the error map's colours as HTML: errors in um."""
    limit = deviation.limit_um
    ends = [f"-{limit:.3g}", "0", f"+{limit:.3g}"]
    return _scale("error of z (um), grey: no point", _DEVIATION_COLOURS, ends)


def command_line(experiment: str, changes: Mapping[str, float], binning: int) -> str:
    """Return, as Markdown, the command that measures the experiment with the changed values.

    Parameters
    ----------
    binning : camera binning with which the live view measures, stated under the command
    """
    changed = "".join(f" \\\n  -s {key}={value:.6g}" for key, value in sorted(changes.items()))
    return (
        f"```\ntwin measure {experiment} -o out{changed}\n```\nfigures: camera.binning = {binning}"
    )


def _scale(title: str, colours: Sequence[str], labels: Sequence[str]) -> str:
    spread = "".join(f"<span>{escape(label)}</span>" for label in labels)
    return (
        '<div style="font-size:0.8em;margin:0 0.7em 0.4em">'
        f"<div>{escape(title)}</div>"
        f'<div style="height:0.7em;background:linear-gradient(to right,{",".join(colours)})"></div>'
        f'<div style="display:flex;justify-content:space-between">{spread}</div></div>'
    )
