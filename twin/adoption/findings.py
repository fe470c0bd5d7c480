"""Fields of an adopted rig, each with its source, and the rig file.

| start of the source | meaning |
|---|---|
| measured | estimated from the captures; the range is the 95 % interval |
| calibration | from calibration.yaml; the range is the value plus or minus its misfit |
| stated | written in capture.toml |
| assumed | not determined by the captures; the value is that of the model rig |
"""

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from reconstruction.characterise import UncertainValue
from reconstruction.writing import write_text
from twin.assets import scene_file
from twin.config.coatings import COATINGS, Coating
from twin.config.kinds import default_kinds
from twin.config.loading import read_toml, resolve_uses, validate_experiment
from twin.config.models import Experiment
from twin.config.quantities import is_quantity

COVERAGE = 2.0
"""Half width of the 95 % interval of a normal distribution, in standard uncertainties."""

ASSUMED, NEEDS = "assumed", "; needs "
"""Start of the source of an assumed field, and text before the data that would determine it."""

DEVICES = ("camera", "projector", "coating", "elastomer")
"""Tables of a rig file whose fields have a source."""

_DIGITS = 7
# Experiment that provides specimen and press to validate the rig.
_TRIED_WITH = "examples/slab_ball"
_NEEDS = {
    "camera.prnu_percent": "flat frames (--flat)",
    "camera.dsnu_e": "dark frames (--dark)",
    "camera.dark_current_e_per_s": "dark frames of several exposures",
    "camera.read_noise_e": "dark frames (--dark) or repeated captures",
    "camera.full_well_e": "repeated captures, or more phase steps",
    "camera.quantum_efficiency": "a calibrated light source",
    "camera.lens_transmission": "a calibrated light source",
    "camera.f_number": "a calibrated light source",
    "camera.exposure_ms": "a calibrated light source",
    "projector.flux_mw": "a calibrated light source: it shows as a product with the exposure",
    "projector.contrast": "dark frames (--dark)",
    "projector.gamma": "white and black, or more phase steps",
    "projector.blur_px": "white and black, or more phase steps",
    "projector.aperture_mm": "captures at three heights or more",
    "elastomer": "a press of a known ball (--ball), or readings of presses: twin identify",
}


@dataclass(frozen=True)
class RigField:
    """Value, uncertainty and source of one field of the rig file.

    Attributes
    ----------
    path : dotted path of the field in the rig file
    uncertainty : standard uncertainty in the unit of the field; None: not estimated
    source : how the value was obtained, for the report
    """

    path: str
    value: Any
    uncertainty: float | None
    source: str

    @classmethod
    def measured(cls, path: str, estimate: UncertainValue, how: str) -> "RigField":
        """Return a field that the captures determine; `how` names the data or the method."""
        return cls(path, estimate.value, estimate.uncertainty, f"measured: {how}")

    def quantity(self) -> dict[str, Any]:
        """Return the field as a table of a rig file: value, range and source.

        The range is the 95 % interval: the value plus or minus two standard uncertainties. Its
        lower end is at least 0 if the value is not negative. The range is missing if no uncertainty
        was estimated, or if the value is not a float.
        """
        content: dict[str, Any] = {"value": _rounded(self.value)}
        if self.uncertainty is not None and isinstance(self.value, float):
            half = COVERAGE * self.uncertainty
            low, high = self.value - half, self.value + half
            content["range"] = [
                _rounded(max(low, 0.0) if self.value >= 0.0 else low),
                _rounded(high),
            ]
        content["source"] = self.source
        return content


def _rounded(value: Any) -> Any:
    if isinstance(value, (tuple, list)):
        return [_rounded(item) for item in value]
    return float(f"{value:.{_DIGITS}g}") if isinstance(value, float) else value


@dataclass(frozen=True)
class ModelRig:
    """The model rig: its values are used for all fields that no capture determines."""

    name: str
    tables: Mapping[str, Any]

    @classmethod
    def read(cls, name: str) -> "ModelRig":
        """Read a rig file, or a shipped one by its name, such as rigs/slab.

        Raises
        ------
        AssetError, ConfigError : there is no such file, or it cannot be read
        """
        file = scene_file(Path(name))
        return cls(name, resolve_uses(read_toml(file), (file,)))

    def value(self, path: str) -> Any:
        """Return the value at a dotted path; None if the model has none."""
        node: Any = self.tables
        for key in path.split("."):
            node = node.get(key) if isinstance(node, Mapping) else None
        return node["value"] if is_quantity(node) else node

    @property
    def coating(self) -> type[Coating]:
        """Class of the model rig's coating."""
        return COATINGS[str(self.value("coating.kind") or default_kinds(Experiment)["coating"])]


def rig_tables(model: ModelRig, fields: Mapping[str, RigField]) -> dict[str, Any]:
    """Return the tables of the adopted rig: the given fields, and the model's values elsewhere."""
    tables: dict[str, Any] = {}
    for name, node in model.tables.items():
        if name == "description":
            continue
        tables[name] = _assumed(node, name, model) if name in DEVICES else node
    if any(path.startswith("elastomer.") for path in fields):
        tables["elastomer"] = {}  # all its fields are given: stated or measured
    for field in fields.values():
        *parents, leaf = field.path.split(".")
        node = tables
        for key in parents:
            node = node.setdefault(key, {})
        node[leaf] = field.quantity()
    return tables


def _assumed(node: Any, path: str, model: ModelRig) -> Any:
    if path.endswith(".kind"):
        return node  # selects the fields of the table, and has no source
    if not isinstance(node, Mapping) or is_quantity(node):
        value, limits = (node["value"], node.get("range")) if is_quantity(node) else (node, None)
        quantity = {"value": value} | ({"range": limits} if limits else {})
        return quantity | {"source": _assumed_source(path, model)}
    return {key: _assumed(inner, f"{path}.{key}", model) for key, inner in node.items()}


def _assumed_source(path: str, model: ModelRig) -> str:
    table, _, name = path.partition(".")
    of_the_coat = model.coating.determined_by if table == "coating" else {}
    missing = of_the_coat.get(name) or _NEEDS.get(path) or _NEEDS.get(table)
    needs = f"{NEEDS}{missing}" if missing else ""
    return f"{ASSUMED}: as in {model.name}, not determined by the captures{needs}"


def write_rig(path: Path, name: str, tables: Mapping[str, Any]) -> None:
    """Write the rig file, which an experiment includes by `use = "./rig.toml"`."""
    head = f'# Adopted from captures of {name}. Experiments take it by use = "./rig.toml".'
    content = {"description": f"twin of {name}", **tables}
    write_text(path, "\n".join([head, *_lines(content, "")]) + "\n")


def _lines(table: Mapping[str, Any], name: str) -> Iterator[str]:
    """Yield the TOML lines of a table: each quantity in one line, then the inner tables."""
    inner = {k: v for k, v in table.items() if isinstance(v, Mapping) and not is_quantity(v)}
    if name and len(inner) < len(table):
        yield f"\n[{name}]"
    for key, value in table.items():
        if key not in inner:
            yield f"{key} = {_as_toml(value)}"
    for key, value in inner.items():
        yield from _lines(value, f"{name}.{key}" if name else key)


def _as_toml(value: Any) -> str:
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{key} = {_as_toml(item)}" for key, item in value.items()) + " }"
    # JSON text of a string, flag, finite number or list of them is valid TOML.
    return json.dumps(value)


def validated(tables: Mapping[str, Any]) -> Experiment:
    """Return an experiment on the rig, to validate the rig before it is written.

    Raises
    ------
    ConfigError : a field is out of its range
    """
    file = scene_file(Path(_TRIED_WITH))
    base = resolve_uses(read_toml(file), (file,))
    context = {key: base[key] for key in ("specimen", "press", "score", "seed")}
    return validate_experiment({**context, **tables, "name": "adopted"}, where="adopted rig")


def rows_of(tables: Mapping[str, Any]) -> Iterator[tuple[str, Any, Any, str]]:
    """Yield path, value, range and source of every field that has a source."""
    yield from _rows(tables, "")


def _rows(node: Mapping[str, Any], before: str) -> Iterator[tuple[str, Any, Any, str]]:
    for key, inner in node.items():
        if is_quantity(inner):
            yield f"{before}{key}", inner["value"], inner.get("range"), inner.get("source", "")
        elif isinstance(inner, Mapping):
            yield from _rows(inner, f"{before}{key}.")
