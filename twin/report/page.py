"""HTML page of a report: sections of text, figures and tables in one self-contained file.

A report is data (`Page`). `write_page` draws its figures into `figures/NAME.png`, embeds them in
the page, and writes the page atomically. `Block` lists the allowed content of a page.
"""

import base64
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import count
from pathlib import Path
from typing import Literal

from jinja2 import Environment, PackageLoader, StrictUndefined, Template

from reconstruction.machine import unwritable
from reconstruction.reading import read_bytes
from reconstruction.writing import write_text
from twin.files import naming_unwritable
from twin.pipeline.progress import ProgressCallback, no_progress
from twin.report.table import Table

REPORT_FILE, FIGURES_FOLDER = "report.html", "figures"
STAGE = "report"

Grade = Literal["good", "check", "poor"]


@dataclass(frozen=True)
class Figure:
    """A picture of a report with its texts.

    Attributes
    ----------
    name : name of the PNG file, without ending
    title : a noun phrase; empty: only the caption is shown
    caption : plotted quantities with units, and how to judge them
    alt : text for readers who cannot see the picture
    draw : function that writes the PNG to a path; None: the folder of figures has the file already
    """

    name: str
    title: str
    caption: str
    alt: str
    draw: Callable[[Path], None] | None = None


Drawer = Callable[[Sequence[Figure], Callable[[Figure], Path], Callable[[], None]], None]
"""Function (figures, place, step) that draws each figure to the path `place(figure)`, and calls
`step()` after each figure."""


def one_by_one(
    figures: Sequence[Figure], place: Callable[[Figure], Path], step: Callable[[], None]
) -> None:
    """Draw figures one after another in their order; a `Drawer`."""
    for figure in figures:
        if figure.draw is not None:
            figure.draw(place(figure))
        step()


@dataclass(frozen=True)
class Verdict:
    """Judgement at the head of a page: a question, its answer, a grade and the reasons."""

    question: str
    headline: str
    grade: Grade
    reasons: tuple[str, ...]


@dataclass(frozen=True)
class JudgedTarget:
    """A target of the report, and the grade of the measurement for this target.

    Attributes
    ----------
    words : the measured value and its limits, as text
    grade : "good" if the target is met; "check" or "poor" if not
    """

    words: str
    grade: Grade


def judged(
    question: str, headline: str, targets: Sequence[JudgedTarget], more: Sequence[str] = ()
) -> Verdict:
    """Return the judgement for several targets: it has the worst grade of these targets.

    The text of each target that is not met starts with "missed".

    Parameters
    ----------
    more : reasons without a grade, listed after the targets
    """
    grades: tuple[Grade, ...] = ("poor", "check", "good")
    worst: Grade = min((entry.grade for entry in targets), key=grades.index, default="good")
    lines = (
        entry.words if entry.grade == "good" else f"missed: {entry.words}" for entry in targets
    )
    return Verdict(question, headline, worst, (*lines, *more))


def target(words: str, met: bool, otherwise: Grade = "check") -> JudgedTarget:
    """Return a target with the grade "good" if it is met, else with the grade `otherwise`."""
    return JudgedTarget(words, "good" if met else otherwise)


@dataclass(frozen=True)
class Note:
    """A paragraph in a special style: small print, a verdict, or the reason of a failure."""

    text: str
    kind: Literal["note", "verdict", "failure"] = "note"


@dataclass(frozen=True)
class Gallery:
    """Small figures next to each other, in `columns` columns."""

    figures: tuple[Figure, ...]
    columns: int


@dataclass(frozen=True)
class Shares:
    """Parts of a whole, drawn as one bar with a legend.

    Each part is (kind, which determines the colour; text; share from 0 to 1).
    """

    parts: tuple[tuple[Literal["good", "wrong", "none"], str, float], ...]


@dataclass(frozen=True)
class TwoColumns:
    """Two columns of blocks; in a narrow window, the right column is below the left column."""

    left: "tuple[Block, ...]"
    right: "tuple[Block, ...]"


@dataclass(frozen=True)
class TurnableView:
    """A three-dimensional view that can be turned in the browser; data from `twin.report.view`.

    Attributes
    ----------
    name : identifier of the view in the page
    caption : plotted quantities, and how to turn the view
    data : JSON for the script of the view
    homes : names of the predefined views, with one button for each
    parts : names of the surfaces and lines that can be shown and hidden
    """

    name: str
    caption: str
    data: str
    homes: tuple[str, ...]
    parts: tuple[str, ...]


@dataclass(frozen=True)
class CollapsedSection:
    """Blocks that are collapsed until the user opens them; they are not printed."""

    title: str
    blocks: "tuple[Block, ...]"


@dataclass(frozen=True)
class Section:
    """Blocks below a heading; a section inside a section has a smaller heading."""

    name: str
    title: str
    blocks: "tuple[Block, ...]"


Block = (
    str
    | Figure
    | Table
    | Note
    | Gallery
    | Shares
    | TwoColumns
    | TurnableView
    | CollapsedSection
    | Section
)
"""Content of a section. Text is escaped for HTML unless it is `markupsafe.Markup`."""


@dataclass(frozen=True)
class Page:
    """Content of one report page.

    Attributes
    ----------
    kind : kind of report; this text is above the title
    title, lead : heading, and the paragraph below the heading
    sections : sections in their order
    verdicts : judgements at the head of the page
    warned, warnings : heading and lines of the box of warnings; without lines, there is no box
    numbered : True: the headings of sections have numbers
    contents : True: a list of the sections is before the first section
    wide : True: the page is wide enough for tables with many columns
    certificate : the first printed page; it is not shown on a screen
    """

    kind: str
    title: str
    lead: str
    sections: Sequence[Section]
    verdicts: Sequence[Verdict] = ()
    warned: str = ""
    warnings: Sequence[str] = ()
    numbered: bool = False
    contents: bool = False
    wide: bool = False
    certificate: "tuple[Block, ...]" = ()

    @property
    def turns(self) -> bool:
        """Whether the page has a `TurnableView`, so that it needs the script of these views."""
        blocks = (block for section in self.sections for block in section.blocks)
        return any(isinstance(block, TurnableView) for block in blocks)


def write_page(
    path: Path,
    page: Page,
    watch: ProgressCallback = no_progress,
    draw: Drawer = one_by_one,
) -> Path:
    """Draw the figures of a page into the folder `figures` next to it; write the page atomically.

    Returns `path`.

    Raises
    ------
    InputError : a figure or the page cannot be written
    """
    folder = figures_folder(path.parent)
    drawn = [figure for section in page.sections for figure in figures_in(section)]
    pictures = {figure.name: folder / f"{figure.name}.png" for figure in drawn}
    steps = count(1)
    draw(
        [figure for figure in drawn if figure.draw is not None],
        lambda figure: pictures[figure.name],
        lambda: watch(STAGE, next(steps) / (len(drawn) + 1)),
    )
    uris = {name: _as_uri(picture) for name, picture in pictures.items()}
    text = _template().render(page=page, uris=uris)
    with naming_unwritable(path):
        write_text(path, text)
    watch(STAGE, 1.0)
    return path


def _as_uri(picture: Path) -> str:
    image = base64.b64encode(read_bytes(picture)).decode("ascii")
    return f"data:image/png;base64,{image}"


def figures_folder(folder: Path) -> Path:
    """Create the folder of figures next to a page if it does not exist, and return it.

    Raises
    ------
    InputError : the folder cannot be created
    """
    figures = folder / FIGURES_FOLDER
    try:
        figures.mkdir(exist_ok=True)
    except OSError as error:
        raise unwritable(figures, error) from None
    return figures


def figures_in(block: Block) -> Iterator[Figure]:
    """Yield the figures in a block, including nested blocks, in their order."""
    if isinstance(block, Figure):
        yield block
    inside: Sequence[Block] = ()
    if isinstance(block, Section | CollapsedSection):
        inside = block.blocks
    elif isinstance(block, TwoColumns):
        inside = (*block.left, *block.right)
    elif isinstance(block, Gallery):
        inside = block.figures
    for entry in inside:
        yield from figures_in(entry)


@cache
def _template() -> Template:
    """Return the Jinja template of all pages; an undefined variable in it raises an error."""
    environment = Environment(
        loader=PackageLoader("twin.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["kind"] = lambda block: type(block).__name__.lower()
    return environment.get_template("page.html")
