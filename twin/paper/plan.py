"""The paper's specimens, methods and resolution, and its printed numbers as data.

One parameter set for all of them; the numbers are those of scenes/paper/targets.toml.
"""

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from twin.assets import asset_path
from twin.config import Experiment, load_experiment
from twin.config.methods import Method
from twin.mechanics import PressedElastomer
from twin.pipeline import Memory
from twin.pipeline.press import press

CONTACT_FPP, GELSIGHT = "contact-FPP", "GelSight"
METHODS = (GELSIGHT, CONTACT_FPP)
NOMINAL_RADIUS_MM = 4.0
FOOTPRINT_MM = 4.0
"""Region of a sphere fit over all of a ball."""

BALLS, NUT = "two_balls", "nut"


@lru_cache
def identified() -> dict[str, Any]:
    """Return the summary of `twin identify paper/identify`; see `twin.identification.summary`."""
    return tomllib.loads(asset_path("scenes", "paper/identified").read_text(encoding="utf-8"))


def chosen(alternative: str) -> str:
    """Return the most probable choice of an alternative that the paper does not state."""
    choice: str = identified()["models"][0]["choices"][alternative]
    return choice


_FORM = {"bars": "bars", "round": "rods"}[chosen("form")]
RODS = tuple(f"{_FORM}_{letter}" for letter in "abc")
WIDTH = {
    "half_height": "rod_width_mm",
    "slope_break": "rod_break_width_mm",
    "slope_change": "rod_slope_change_width_mm",
}[chosen("width")]
FIT = {"geometric": "", "algebraic": "algebraic_"}[chosen("sphere_fit")]
"""Prefix of a sphere's figures by the paper's most probable kind of fit."""
DIRECT_AND_CONTACT = (NUT, "brick", "ball")
GRID = ("t_bolt", "bear", BALLS)
CASES: Sequence[tuple[tuple[str, ...], tuple[Method, ...]]] = (
    (DIRECT_AND_CONTACT, ("direct_fpp", "contact_fpp")),
    (GRID, ("photometric_stereo", "contact_fpp")),
    (RODS, ("contact_fpp",)),
)
"""Specimens and methods of the figures."""
BUDGET_OF: Mapping[str, str] = {
    BALLS: "sphere_1_radius_mm",
}
"""By specimen, the figure with a ranked uncertainty budget."""


@dataclass(frozen=True)
class Resolution:
    """Numerical resolution of the paper's experiments; no property of the sensor.

    Attributes
    ----------
    settings : override those of every experiment
    cells_mm : the sheet's finest cells by specimen; default: derived from its thickness
    """

    settings: Mapping[str, Any]
    cells_mm: Mapping[str, float]

    def settings_of(self, name: str) -> dict[str, Any]:
        """Return the settings of a specimen's experiment."""
        cells = {"press.cell_mm": self.cells_mm[name]} if name in self.cells_mm else {}
        return cells | dict(self.settings)


# Binning 2 x 2: 25 % of the run time with the same projector pixels. Nodes of the coat and cells of
# the sheet have the sizes used in the identification, so that both are the same model; objects that
# only occur in pictures have the cells of the nut.
COARSE = Resolution(
    {"camera.binning": 2, "press.relief_pitch_mm": 0.05},
    dict.fromkeys((BALLS, "ball"), 0.3)
    | dict.fromkeys((NUT, "brick", "t_bolt", "bear"), 0.2)
    | dict.fromkeys((f"{form}_{letter}" for form in ("bars", "rods") for letter in "abc"), 0.15),
)
FINE = Resolution({}, {})


def experiment_of(name: str, resolution: Resolution = COARSE) -> Experiment:
    """Return one of the paper's experiments, every one on the same rig and press."""
    return load_experiment(f"paper/{name}", resolution.settings_of(name))


def pressed_face(experiment: Experiment) -> PressedElastomer:
    """Press one of the paper's specimens; tables and figures share equal presses."""
    return press(experiment, _presses()).pressed


@lru_cache
def _presses() -> Memory:
    return Memory()


@lru_cache
def published() -> dict[str, Any]:
    """Return the paper's printed numbers, the whole file."""
    return tomllib.loads(asset_path("scenes", "paper/targets").read_text(encoding="utf-8"))


def rows_of(table: str) -> list[dict[str, Any]]:
    """Return the rows of one of the paper's tables."""
    rows: list[dict[str, Any]] = published()[table]
    return rows


def mean_of(table: str, method: str, key: str) -> float:
    """Return the mean over both balls of one of the paper's columns."""
    values = [float(row[key]) for row in rows_of(table) if row["method"] == method]
    return sum(values) / len(values)
