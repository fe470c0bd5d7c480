"""The command that shows a sensor live in a browser."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from twin.cli.app import Settings, app, load, say


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
