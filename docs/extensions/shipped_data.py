"""Directives that list what the package ships: a gallery of experiments, tables of files, keys."""

from collections.abc import Iterable, Sequence
from itertools import groupby

from docutils import nodes
from shipped import Shipped, experiments, files, first_sentence, picture_of
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from twin.config.optics import FixedFocal, Telecentric
from twin.config.rig import shipped_lenses
from twin.config.schema import Key, experiment_keys


class Gallery(SphinxDirective):
    """One picture, name and line per experiment of a folder of scenes/."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """Return the entries."""
        chosen = [
            record for record in experiments() if record.name.startswith(f"{self.arguments[0]}/")
        ]
        return [node for record in chosen for node in entry(record)]


def entry(record: Shipped) -> list[nodes.Node]:
    """Return name, line and picture of one experiment."""
    heading = nodes.paragraph("", "", nodes.strong("", "", nodes.literal(text=record.name)))
    heading += prose(f": {record.description}. {first_sentence(record.comment)}".rstrip())
    file = picture_of(record.name)
    picture = nodes.image(uri=f"gallery/{file.name}", alt=record.description)
    picture["candidates"] = {"*": f"gallery/{file.name}"}
    return [heading, picture]


def prose(text: str) -> list[nodes.Node]:
    """Return text in which names stand in backticks."""
    parts = enumerate(text.split("`"))
    return [nodes.literal(text=part) if odd % 2 else nodes.Text(part) for odd, part in parts]


class ShippedFiles(SphinxDirective):
    """A table of the data files in some folders of scenes/."""

    required_arguments = 1
    final_argument_whitespace = True

    def run(self) -> list[nodes.Node]:
        """Return the table."""
        records = [record for folder in self.arguments[0].split() for record in files(folder)]
        return [
            table(("file", "what it is"), [(record.name, record.comment) for record in records])
        ]


class Lenses(SphinxDirective):
    """A table of the shipped lenses."""

    def run(self) -> list[nodes.Node]:
        """Return the table."""
        measures = ("focal length, magnification", "distance, mm", "f-number", "circle, mm")
        headings = ("in scenes/lenses", "lens", *measures)
        return [table(headings, [lens_row(*entry) for entry in shipped_lenses().items()])]


def lens_row(name: str, lens: FixedFocal | Telecentric) -> tuple[str, ...]:
    """Return the cells of one lens."""
    name, circle = name.rpartition("/")[2], f"{lens.image_circle_mm:g}"
    if isinstance(lens, Telecentric):
        size, at = f"{lens.magnification:g}, telecentric", f"{lens.working_distance_mm:g}"
        return (name, lens.model, size, at, f"{lens.working_f_number:g} (working)", circle)
    size = f"{lens.focal_length_mm:g} mm; up to {lens.largest_magnification(0.0):.2g}"
    widest, smallest = lens.f_numbers
    at = f"from {lens.nearest_mm:g}"
    return (name, lens.model, size, at, f"{widest:g} to {smallest:g}", circle)


class ExperimentKeys(SphinxDirective):
    """A table of keys for each part of an experiment."""

    def run(self) -> list[nodes.Node]:
        """Return one section per part."""
        return [part(name, list(keys)) for name, keys in groupby(experiment_keys(), key=part_of)]


def part_of(key: Key) -> str:
    """Return the table of the experiment in which a key stands."""
    return key.path.rpartition(".")[0].split(".")[0] if "." in key.path else "experiment"


def part(name: str, keys: Sequence[Key]) -> nodes.section:
    """Return the section of one table of the experiment."""
    section = nodes.section(ids=[nodes.make_id(f"keys {name} {keys[0].path}")])
    section += nodes.title(text=name)
    rows = [(key.path, key.allowed, key.default, key.meaning) for key in keys]
    section += table(("key", "allowed", "default", "meaning"), rows)
    return section


def table(headings: Sequence[str], rows: Iterable[Sequence[str]]) -> nodes.table:
    """Return a table whose first column is code."""
    group = nodes.tgroup(cols=len(headings))
    group += [nodes.colspec(colwidth=1) for _ in headings]
    head, body = nodes.thead(), nodes.tbody()
    head += line([nodes.paragraph(text=heading) for heading in headings])
    for first, *rest in rows:
        code = nodes.paragraph("", "", nodes.literal(text=first))
        body += line([code, *(nodes.paragraph("", "", *prose(cell)) for cell in rest)])
    group += [head, body]
    return nodes.table("", group)


def line(cells: Sequence[nodes.Node]) -> nodes.row:
    """Return a row."""
    return nodes.row("", *(nodes.entry("", cell) for cell in cells))


def setup(app: Sphinx) -> dict[str, bool]:
    """Enter the directives."""
    app.add_directive("gallery", Gallery)
    app.add_directive("shipped", ShippedFiles)
    app.add_directive("lenses", Lenses)
    app.add_directive("experiment-keys", ExperimentKeys)
    return {"parallel_read_safe": True}
