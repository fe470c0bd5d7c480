"""Commands for the results of measurements: dimensions, object behind the coat, clouds, reports.

The live view shows an experiment or a result in a browser.
"""

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from twin.cli.app import Out, Report, Settings, app, load, print_metrics, progress_bars, say

if TYPE_CHECKING:
    from collections.abc import Callable

    from twin.pipeline.compensation import CompensationResult


@app.command
def cloud(result: Path, /, *, out: Annotated[Path, Parameter(name=["--out", "-o"])]) -> None:
    """Write the points of all camera pixels as an organised point cloud, a PCD file.

    Parameters
    ----------
    result
        Result folder of `twin measure` or `twin reconstruct`.
    out
        File to write, NAME.pcd; an existing file is never overwritten.
    """
    from reconstruction.organised import write_organised_pcd
    from reconstruction.pipeline import read_reconstruction
    from twin.files import creating
    from twin.output import end_exchange

    end_exchange(result)
    measured = read_reconstruction(result / "reconstruction.nc")
    with creating(out) as part:
        write_organised_pcd(part, measured)
    rows, cols = measured.point_map.valid.shape
    say(f"wrote {out}: {cols} x {rows} points, {measured.point_map.valid.sum()} of them valid")


@app.command
def evaluate(
    result: Path,
    shape: Literal["plane", "ball", "cylinder", "bar", "step", "roughness"],
    /,
    *,
    x: tuple[float, float] | None = None,
    y: tuple[float, float] | None = None,
    z: tuple[float, float] | None = None,
    along: Literal["x", "y"] = "y",
    fraction: float = 0.5,
    nesting_mm: float = 0.8,
) -> None:
    """Measure a dimension on a part of a result's surface; see docs/evaluation.md.

    Parameters
    ----------
    result
        Result folder of `twin measure` or `twin reconstruct`.
    shape
        Shape of the part: its flatness, radius, width, height or roughness is printed.
    x, y, z
        Lowest and highest world coordinate of the part, mm; default: all.
    along
        World axis of a cylinder or a bar.
    fraction
        Fraction of a bar's height at which the width of the bar is measured.
    nesting_mm
        Nesting index of the roughness filter, mm.
    """
    from twin.output import end_exchange
    from twin.pipeline.dimensions import Region, dimensions

    end_exchange(result)
    with progress_bars() as watch:
        watch("evaluate", 0.0)
        figures = dimensions(result, shape, Region(x, y, z, along, fraction, nesting_mm))
        watch("evaluate", 1.0)
    print_metrics(figures)


@app.command
def compensate(
    result: Path,
    /,
    *,
    out: Out,
    layer: Path | None = None,
    ball_diameter_mm: float | None = None,
    report: Report = True,
) -> None:
    """Reconstruct the rigid object under the coat: contact, pressure, force, surface, radii.

    Parameters
    ----------
    result
        Result folder of `twin measure` or `twin reconstruct`.
    layer
        TOML file with the known values of elastomer and press, see docs/compensation.md; default:
        those of the result's own experiment.
    ball_diameter_mm
        Diameter of the pressed balls, mm: thickness and modulus of the sheet are fitted to the
        balls and written to OUT/layer.toml, for --layer of later measurements.
    """
    from twin.output import end_exchange
    from twin.pipeline.compensation import compensate_result
    from twin.report.compensation import write_compensation_page
    from twin.report.page import REPORT_FILE

    def draw(folder: Path, compensation: "CompensationResult") -> None:
        if report:
            write_compensation_page(folder, compensation, result.name, watch)

    end_exchange(result)
    with progress_bars() as watch:
        figures = compensate_result(
            result, out, layer, watch, draw, ball_diameter_mm=ball_diameter_mm
        )
    print_metrics(figures)
    say(f"wrote {out / REPORT_FILE if report else out}")


@app.command
def report(folder: Path, /) -> None:
    """Draw the HTML report of a finished measurement, comparison, uncertainty or scan again.

    Parameters
    ----------
    folder
        Result folder of `twin measure`, `twin demo`, `twin compare`, `twin uncertainty` or
        `twin scan`; of `twin press` or `twin render`, the picture is drawn.
    """
    from twin.output import adding, end_exchange
    from twin.report import REPORT_FILE, REPORT_NAMES
    from twin.report.pictures import draw_picture, picture_of

    end_exchange(folder)
    picture = picture_of(folder)
    if picture:
        with adding(folder, picture) as drawn:
            draw_picture(folder, drawn)
        say(f"wrote {folder / picture}")
        return
    draw = _drawer(folder)
    with adding(folder, *REPORT_NAMES) as drawn, progress_bars() as watch:
        draw(folder, watch, drawn)
    say(f"wrote {folder / REPORT_FILE}")


def _drawer(folder: Path) -> "Callable[..., Path]":
    """Return the function that draws the report of a folder; import only its module."""
    from twin.pipeline.comparison import is_comparison
    from twin.propagation.results import is_uncertainty

    if is_uncertainty(folder):
        from twin.report.uncertainty import write_uncertainty_page

        return write_uncertainty_page
    if is_comparison(folder):
        from twin.report.comparison import write_comparison

        return write_comparison
    from twin.pipeline.scan_record import is_scan

    if is_scan(folder):
        from twin.report.scan import write_scan_page

        return write_scan_page
    from twin.paper.demo import is_demo

    if is_demo(folder):
        from twin.paper.demo import write_demo

        return write_demo
    from twin.report.measurement import write_report
    from twin.report.side_by_side import draw_side_by_side

    return partial(write_report, draw=draw_side_by_side)


@app.command
def view(
    source: Annotated[
        Path, Parameter(help="experiment, as for twin measure, or the folder of a measurement")
    ],
    /,
    *,
    settings: Settings = None,
    host: str = "127.0.0.1",
    port: int = 8080,
) -> None:
    """Change the design by sliders in a browser; image, error map and figures follow.

    Parameters
    ----------
    host
        Address to listen on; with 0.0.0.0 other computers in the network can open the page.
    port
        Port to listen on, or the next free port.
    """
    from twin.viewer.live import LiveView, viser_module

    viser_module()
    measured = None
    if source.is_dir():
        from twin.results.folder import read_measurement

        measured = read_measurement(source)
    experiment = load(source / "experiment.toml" if measured else source, settings)
    shown = LiveView(experiment, measured, host, port, str(source))
    say(f"open {shown.address} in a browser; Ctrl-C ends it")
    try:
        shown.serve()
    finally:
        shown.close()
