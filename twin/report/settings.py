"""Settings that an experiment's method reads, with their sources, as tables of a report."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

from markupsafe import Markup

from twin.config.models import Experiment, Provenance
from twin.config.quantities import value_at
from twin.report.page import Block, CollapsedSection
from twin.report.table import Column, Table
from twin.report.words import in_words, split_unit

# Shortest duration that is written in seconds.
_HEAD = ("schema_version", "name", "description", "provenance", "links")
_OF_COATS = {"elastomer", "coating", "press", "mechanics", "layers"}
_OF_FRINGES = {"projector", "patterns", "decode"}
_OF_LAMPS = {"lamps", "photometric"}
_NO_SOURCE = "set in the experiment, or default"


@dataclass(frozen=True)
class Setting:
    """One value of the experiment with its source.

    Attributes
    ----------
    section : first part of `path`, for example "camera"
    path : key for `--set`
    source : source of the value; empty if none is stated
    range : valid range as text; empty if none is stated
    assumed : True if the source states that the value is assumed
    """

    section: str
    path: str
    value: str
    unit: str
    source: str
    range: str
    assumed: bool


def settings_blocks(experiment: Experiment) -> tuple[Block, ...]:
    """Return the tables of the settings that the experiment's method reads.

    Settings without a stated source are in a collapsed section. The file `experiment.toml` contains
    all settings, including those for other methods.
    """
    settings = settings_of(experiment)
    sourced = [setting for setting in settings if setting.source]
    plain = [replace(setting, source=_NO_SOURCE) for setting in settings if not setting.source]
    folded = CollapsedSection(
        f"{len(plain)} settings without a stated source (set in the experiment, or defaults)",
        (_settings_table("plain_settings", plain),),
    )
    return (_settings_table("settings", sourced), folded)


def _settings_table(name: str, settings: Sequence[Setting]) -> Table:
    return Table(
        name,
        "",
        "",
        (
            Column("path", "setting (as --set takes it)", kind="code"),
            Column("value", "value", kind="number"),
            Column("unit", "unit", kind="unit"),
            Column("source", "source"),
            Column("range", "valid range", kind="range"),
        ),
        tuple(
            {
                "path": setting.path,
                "value": setting.value,
                "unit": setting.unit,
                "source": _marked(setting),
                "range": setting.range,
                "section": setting.section,
            }
            for setting in settings
        ),
        (
            "Shaded values are assumed: no source states them. Replace them by measured values "
            "before you rely on results that depend on them.",
        ),
        kinds=tuple("assumed" if setting.assumed else "" for setting in settings),
        group="section",
        look="settings",
    )


def settings_of(experiment: Experiment) -> list[Setting]:
    """Return the settings that the experiment's method reads, in the order of the experiment.

    They include values with a source that are at their default and that digests exclude.
    """
    tree = experiment.model_dump(mode="json", exclude={*_HEAD, *_without_meaning(experiment)})
    for path in experiment.provenance:
        parent, _, name = path.rpartition(".")
        node = tree if not parent else value_at(tree, parent)
        if isinstance(node, dict) and name not in node:
            node[name] = value_at(experiment, path)
    return [_setting(path, value, experiment.provenance.get(path)) for path, value in _leaves(tree)]


def _without_meaning(experiment: Experiment) -> set[str]:
    """Return the names of the sections that the experiment's method does not read."""
    method = experiment.method
    pressed = {"stage"} if method.presses else _OF_COATS
    return pressed | (_OF_LAMPS if method.fringes else _OF_FRINGES)


def _marked(setting: Setting) -> str:
    if not setting.assumed:
        return setting.source
    source = setting.source.removeprefix("assumed").removeprefix(":")
    return Markup('<span class="tag">assumed</span> {}').format(source)


def _leaves(node: dict[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in node.items():
        if isinstance(value, dict):
            yield from _leaves(value, f"{prefix}{key}.")
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            for setting in value:
                yield from _leaves(setting, f"{prefix}{key}.{setting.get('name', '')}.")
        elif value is not None:
            yield f"{prefix}{key}", value


def _setting(path: str, value: Any, origin: Provenance | None) -> Setting:
    _, unit = split_unit(path)
    allowed = f"{origin.range[0]:g} to {origin.range[1]:g}" if origin and origin.range else ""
    return Setting(
        section=path.split(".")[0] if "." in path else "experiment",
        path=path,
        value=in_words(value),
        unit=unit,
        source=origin.source if origin else "",
        range=allowed,
        assumed=origin is not None and origin.source.startswith("assumed"),
    )
