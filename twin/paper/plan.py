"""Specimens, methods and resolution of the reproduction, and the numbers printed in the paper.

All specimens share one parameter set. The printed numbers are read from scenes/paper/targets.toml.
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
"""Radius of the fit region around the apex that contains the whole ball."""

BALLS, NUT = "two_balls", "nut"


@lru_cache
def identified() -> dict[str, Any]:
    """Return the stored summary of the last `twin identify` of the paper's sensor.

    Its keys are those of `twin.identification.summary`.
    """
    return tomllib.loads(asset_path("scenes", "paper/identified").read_text(encoding="utf-8"))


def chosen(alternative: str) -> str:
    """Return the most probable choice of a discrete alternative that the paper does not state."""
    choice: str = identified()["models"][0]["choices"][alternative]
    return choice


RODS = tuple(f"bars_{letter}" for letter in "abc")
"""Acrylic rods as rectangular bars: the identification gives round ones a probability of 0.02."""
WIDTH = {
    "half_height": "rod_width_mm",
    "slope_break": "rod_break_width_mm",
    "slope_change": "rod_slope_change_width_mm",
}[chosen("width")]
FIT = {"geometric": "", "algebraic": "algebraic_"}[chosen("sphere_fit")]
"""Prefix in the names of fitted values, for the kind of sphere fit that the paper probably used."""
DIRECT_AND_CONTACT = (NUT, "brick", "ball")
GRID = ("t_bolt", "bear", BALLS)
CASES: Sequence[tuple[tuple[str, ...], tuple[Method, ...]]] = (
    (DIRECT_AND_CONTACT, ("direct_fpp", "contact_fpp")),
    (GRID, ("photometric_stereo", "contact_fpp")),
    (RODS, ("contact_fpp",)),
)
"""Specimens of the figures, with the methods by which each is measured."""
BUDGET_OF: Mapping[str, str] = {
    BALLS: "sphere_1_radius_mm",
}
"""Name of the measured value, by specimen, that has a ranked uncertainty budget."""


@dataclass(frozen=True)
class Resolution:
    """Numerical resolution of the paper's experiments; no property of the sensor.

    Attributes
    ----------
    settings : settings that override those of every experiment
    cells_mm : size of the sheet's finest cells, by specimen; for other specimens it is derived from
        the thickness of the sheet
    """

    settings: Mapping[str, Any]
    cells_mm: Mapping[str, float]

    def settings_of(self, name: str) -> dict[str, Any]:
        """Return the settings of this resolution for the experiment of a specimen."""
        cells = {"press.cell_mm": self.cells_mm[name]} if name in self.cells_mm else {}
        return cells | dict(self.settings)


# Binning 2 x 2 takes 25 % of the run time with the same projector pixels. Nodes of the coat and
# cells of the sheet have the sizes used in the identification, so that both use one model. Objects
# that occur only in pictures have cells as small as those of the nut.
COARSE = Resolution(
    {"camera.binning": 2, "press.relief_pitch_mm": 0.05},
    dict.fromkeys((BALLS, "ball"), 0.3)
    | dict.fromkeys((NUT, "brick", "t_bolt", "bear"), 0.2)
    | dict.fromkeys((f"{form}_{letter}" for form in ("bars", "rods") for letter in "abc"), 0.15),
)
FINE = Resolution({}, {})


def experiment_of(name: str, resolution: Resolution = COARSE) -> Experiment:
    """Return the experiment of one of the paper's specimens; all share the rig and the press."""
    return load_experiment(f"paper/{name}", resolution.settings_of(name))


def pressed_face(experiment: Experiment) -> PressedElastomer:
    """Return the pressed elastomer of an experiment; equal presses are computed only once."""
    return press(experiment, _presses()).pressed


@lru_cache
def _presses() -> Memory:
    return Memory()


@lru_cache
def published() -> dict[str, Any]:
    """Return all numbers printed in the paper, by table, from scenes/paper/targets.toml."""
    return tomllib.loads(asset_path("scenes", "paper/targets").read_text(encoding="utf-8"))


def rows_of(table: str) -> list[dict[str, Any]]:
    """Return the printed rows of one table of the paper, each a dictionary by column."""
    rows: list[dict[str, Any]] = published()[table]
    return rows


def mean_of(table: str, method: str, key: str) -> float:
    """Return the mean over both balls of column `key` in a table of the paper, for one method."""
    values = [float(row[key]) for row in rows_of(table) if row["method"] == method]
    return sum(values) / len(values)
