"""What was found of a rig, field by field, and the rig file that is made of it.

| source begins with | meaning |
|---|---|
| measured | estimated from the captures; the range is the 95 % interval |
| calibration | from calibration.yaml; the range is the value plus or minus its misfit |
| stated | written in capture.toml |
| assumed | the captures cannot tell; the value of the rig that was given as a model stays |
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
"""Standard uncertainties on either side that hold 95 % of a normal distribution."""

_DIGITS = 7
_TABLES = ("camera", "projector", "coating", "elastomer")
# What an experiment needs besides a rig, to see that the rig is one.
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
    """One field of the rig.

    Attributes
    ----------
    uncertainty : standard; None: stated, and not estimated
    """

    path: str
    value: Any
    uncertainty: float | None
    source: str

    @classmethod
    def measured(cls, path: str, found: UncertainValue, how: str) -> "RigField":
        """Return a field that the captures tell."""
        return cls(path, found.value, found.uncertainty, f"measured: {how}")

    def quantity(self) -> dict[str, Any]:
        """Return the field as data files write it."""
        told: dict[str, Any] = {"value": _rounded(self.value)}
        if self.uncertainty is not None and isinstance(self.value, float):
            half = COVERAGE * self.uncertainty
            low, high = self.value - half, self.value + half
            told["range"] = [_rounded(max(low, 0.0) if self.value >= 0.0 else low), _rounded(high)]
        told["source"] = self.source
        return told


def _rounded(value: Any) -> Any:
    if isinstance(value, (tuple, list)):
        return [_rounded(one) for one in value]
    return float(f"{value:.{_DIGITS}g}") if isinstance(value, float) else value


@dataclass(frozen=True)
class ModelRig:
    """The rig from which all comes that no capture tells: its name and its tables."""

    name: str
    tables: Mapping[str, Any]

    @classmethod
    def read(cls, name: str) -> "ModelRig":
        """Read a rig file, or a shipped one by its name, such as rigs/slab.

        Raises
        ------
        AssetError, ConfigError : there is none, or it cannot be read
        """
        file = scene_file(Path(name))
        return cls(name, resolve_uses(read_toml(file), (file,)))

    def value(self, path: str) -> Any:
        """Return the value at a dotted path; None where the model is silent."""
        node: Any = self.tables
        for key in path.split("."):
            node = node.get(key) if isinstance(node, Mapping) else None
        return node["value"] if is_quantity(node) else node

    @property
    def coating(self) -> type[Coating]:
        """The kind of its coat."""
        return COATINGS[str(self.value("coating.kind") or default_kinds(Experiment)["coating"])]


def rig_tables(model: ModelRig, found: Mapping[str, RigField]) -> dict[str, Any]:
    """Return the tables of the adopted rig: what was found, and of the model what was not."""
    tables: dict[str, Any] = {}
    for name, node in model.tables.items():
        if name == "description":
            continue
        tables[name] = _assumed(node, name, model) if name in _TABLES else node
    if any(path.startswith("elastomer.") for path in found):
        tables["elastomer"] = {}  # stated as a whole, beside what was measured of it
    for field in found.values():
        *parents, leaf = field.path.split(".")
        node = tables
        for key in parents:
            node = node.setdefault(key, {})
        node[leaf] = field.quantity()
    return tables


def _assumed(node: Any, path: str, model: ModelRig) -> Any:
    if path.endswith(".kind"):
        return node  # says which numbers there are, and is none
    if not isinstance(node, Mapping) or is_quantity(node):
        value, kept = (node["value"], node.get("range")) if is_quantity(node) else (node, None)
        told = {"value": value} | ({"range": kept} if kept else {})
        return told | {"source": _not_told(path, model)}
    return {key: _assumed(inner, f"{path}.{key}", model) for key, inner in node.items()}


def _not_told(path: str, model: ModelRig) -> str:
    table, _, name = path.partition(".")
    of_the_coat = model.coating.determined_by if table == "coating" else {}
    missing = of_the_coat.get(name) or _NEEDS.get(path) or _NEEDS.get(table)
    needs = f"; needs {missing}" if missing else ""
    return f"assumed: as in {model.name}, the captures do not tell it{needs}"


def write_rig(path: Path, name: str, tables: Mapping[str, Any]) -> None:
    """Write the rig file; experiments take it by `use = "./rig.toml"`."""
    head = f'# Adopted from captures of {name}. Experiments take it by use = "./rig.toml".'
    told = {"description": f"twin of {name}", **tables}
    write_text(path, "\n".join([head, *_lines(told, "")]) + "\n")


def _lines(table: Mapping[str, Any], name: str) -> Iterator[str]:
    """Yield a table as data files have it: a quantity in one line, tables in tables below."""
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
        return "{ " + ", ".join(f"{key} = {_as_toml(one)}" for key, one in value.items()) + " }"
    # JSON text of a string, flag, finite number or list of them is valid TOML.
    return json.dumps(value)


def tried(tables: Mapping[str, Any]) -> Experiment:
    """Return an experiment on the rig: a rig that none can use is not written.

    Raises
    ------
    ConfigError : a field is out of its range
    """
    file = scene_file(Path(_TRIED_WITH))
    base = resolve_uses(read_toml(file), (file,))
    kept = {key: base[key] for key in ("specimen", "press", "score", "seed")}
    return validate_experiment({**kept, **tables, "name": "adopted"}, where="adopted rig")


def rows_of(tables: Mapping[str, Any]) -> Iterator[tuple[str, Any, Any, str]]:
    """Yield path, value, range and source of every field that has a source."""
    yield from _rows(tables, "")


def _rows(node: Mapping[str, Any], before: str) -> Iterator[tuple[str, Any, Any, str]]:
    for key, inner in node.items():
        if is_quantity(inner):
            yield f"{before}{key}", inner["value"], inner.get("range"), inner.get("source", "")
        elif isinstance(inner, Mapping):
            yield from _rows(inner, f"{before}{key}.")
