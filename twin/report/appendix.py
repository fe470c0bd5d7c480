"""The report's appendix: every setting with its source, every metric, times and versions."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from twin.config.models import Experiment, Provenance
from twin.report.fields import in_words, split_unit
from twin.results.record import Measurement

_HEAD = ("schema_version", "name", "description", "provenance")


@dataclass(frozen=True)
class Setting:
    """One number of the experiment and where it comes from; `path` is what `--set` takes."""

    path: str
    value: str
    unit: str
    source: str
    range: str
    assumed: bool


@dataclass(frozen=True)
class Figure:
    """One metric, stage time or version."""

    name: str
    value: str
    unit: str = ""


def settings(experiment: Experiment) -> dict[str, list[Setting]]:
    """Return every setting by section of the experiment, in its order."""
    sections: dict[str, list[Setting]] = {}
    tree = experiment.model_dump(mode="json", exclude=set(_HEAD))
    for path, value in _leaves(tree):
        section = path.split(".")[0] if "." in path else "experiment"
        sections.setdefault(section, []).append(
            _setting(path, value, experiment.provenance.get(path))
        )
    return sections


def metrics(measured: Measurement) -> list[Figure]:
    """Return the metrics of result.json; warnings stand at the head of the report."""
    found = []
    for name, value in measured.figures.items():
        if name != "warnings":
            label, unit = split_unit(name)
            found.append(Figure(label.replace("_", " "), in_words(value), unit))
    return found


def timings(seconds: Mapping[str, float]) -> list[Figure]:
    """Return the wall-clock time of each stage."""
    return [Figure(name, f"{value:.2f}", "s") for name, value in seconds.items()]


def versions(measured: Measurement) -> list[Figure]:
    """Return the versions of what made the result."""
    return [Figure(name, str(value)) for name, value in measured.versions.items()]


def _leaves(node: dict[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in node.items():
        if isinstance(value, dict):
            yield from _leaves(value, f"{prefix}{key}.")
        elif value is not None:
            yield f"{prefix}{key}", value


def _setting(path: str, value: Any, origin: Provenance | None) -> Setting:
    _, unit = split_unit(path)
    allowed = f"{origin.range[0]:g} to {origin.range[1]:g}" if origin and origin.range else ""
    return Setting(
        path=path,
        value=in_words(value),
        unit=unit,
        source=origin.source if origin else "set in the experiment or default, no source stated",
        range=allowed,
        assumed=origin is not None and origin.source.startswith("assumed"),
    )
