"""Pages that need no other file and no network: templates, pictures inside, written whole."""

import base64
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined, Template

from reconstruction.machine import unwritable
from twin.output import replacing
from twin.pipeline.progress import Watcher

FIGURES_FOLDER = "figures"
STAGE = "report"


@dataclass(frozen=True)
class Plate:
    """One figure: its name, how it is drawn, its alternative text and its caption."""

    name: str
    draw: Callable[[Path], None]
    alt: str
    caption: str


@dataclass(frozen=True)
class Picture:
    """A drawn figure, as the page takes it."""

    uri: str
    plate: Plate


def draw_pictures(folder: Path, drawn: list[Plate], watch: Watcher) -> dict[str, Picture]:
    """Draw all figures into `folder`/figures and return them by name.

    Raises
    ------
    InputError
        A figure cannot be written.
    """
    figures = folder / FIGURES_FOLDER
    make_folder(figures)
    shown = {}
    for number, plate in enumerate(drawn, start=1):
        path = figures / f"{plate.name}.png"
        plate.draw(path)
        shown[plate.name] = Picture(data_uri(path), plate)
        watch(STAGE, number / (len(drawn) + 1))
    return shown


@cache
def template(name: str) -> Template:
    """Return a template of this package; an unknown name inside it is an error, not a gap."""
    environment = Environment(
        loader=PackageLoader("twin.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template(name)


def data_uri(picture: Path) -> str:
    """Return a PNG file as the text that stands in the page for it."""
    return "data:image/png;base64," + base64.b64encode(picture.read_bytes()).decode("ascii")


def make_folder(folder: Path) -> None:
    """Make a folder for figures, unless it is there.

    Raises
    ------
    InputError
        It cannot be made.
    """
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise unwritable(folder, error) from None


def write_page(path: Path, text: str) -> None:
    """Write a page, whole or not at all.

    Raises
    ------
    InputError
        It cannot be written.
    """
    with replacing(path) as part:
        part.write_text(text, encoding="utf-8")
