"""Hardness against mixing ratio, as in the paper's graph, and the modulus estimated from it."""

import tomllib
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from matplotlib.axes import Axes

from reconstruction.errors import InputError
from twin.assets import asset_path
from twin.config.quantities import split_quantities
from twin.mechanics import ModulusEstimate, estimate_modulus
from twin.report.canvas import FIT, MEASURED, NOMINAL, axes_at, plain_spines, printing

MIXES = {"A": 1.0, "B": 1.5, "C": 2.0}
"""Parts of base per part of curing agent (paper, section II-A)."""

_STATED_BY_PAPER = "A"


@dataclass(frozen=True)
class Mix:
    """One silicone of the paper.

    Attributes
    ----------
    letter : name in the paper: A, B or C
    ratio : parts of base per part of curing agent
    shore_a, low_shore_a, high_shore_a : Shore A hardness and its plausible range
    modulus : Young's modulus with its range
    source : source of the hardness
    """

    letter: str
    ratio: float
    shore_a: float
    low_shore_a: float
    high_shore_a: float
    modulus: ModulusEstimate
    source: str


@lru_cache
def mixes() -> tuple[Mix, ...]:
    """Return the paper's three silicones from `materials/elastomers`.

    Raises
    ------
    InputError
        A material does not state its hardness with a range.
    """
    return tuple(_mix(letter, ratio) for letter, ratio in MIXES.items())


def _mix(letter: str, ratio: float) -> Mix:
    path = asset_path("materials", f"elastomers/silicone_{letter.lower()}")
    values, origins = split_quantities(tomllib.loads(path.read_text(encoding="utf-8")))
    origin = origins.get("shore_a")
    if origin is None or origin.range is None:
        raise InputError(f"{path}: shore_a: found no range; give {{ value, range, source }}")
    low, high = origin.range
    shore_a = float(values["shore_a"])
    return Mix(letter, ratio, shore_a, low, high, estimate_modulus(shore_a), origin.source)


def draw_hardness(_cases: Path, stem: Path) -> None:
    """Draw Shore A and Young's modulus against the mixing ratio, with their ranges."""
    with printing(stem, 5.6, 2.65) as figure:
        left = axes_at(figure, 0.55, 0.3, 2.1, 1.75)
        right = axes_at(figure, 3.35, 0.3, 2.1, 1.75)
        _hardness(left)
        _modulus(right)
        for axes in (left, right):
            axes.set_xlabel("base : curing agent")
            axes.set_xticks([mix.ratio for mix in mixes()])
            axes.set_xticklabels([f"{mix.ratio:g}:1\n({mix.letter})" for mix in mixes()])
            axes.set_xlim(0.75, 2.25)
            plain_spines(axes)


def _hardness(axes: Axes) -> None:
    known = [mix for mix in mixes() if mix.letter == _STATED_BY_PAPER]
    assumed = [mix for mix in mixes() if mix.letter != _STATED_BY_PAPER]
    axes.plot([m.ratio for m in mixes()], [m.shore_a for m in mixes()], color=MEASURED, lw=0.8)
    for group, colour, label in (
        (known, MEASURED, "stated in the paper"),
        (assumed, NOMINAL, "assumed"),
    ):
        values = [m.shore_a for m in group]
        reach = [
            [m.shore_a - m.low_shore_a for m in group],
            [m.high_shore_a - m.shore_a for m in group],
        ]
        axes.errorbar(
            [m.ratio for m in group],
            values,
            reach,
            fmt="o",
            ms=4,
            capsize=3,
            color=colour,
            label=label,
        )
    axes.set(title="Hardness and its range", ylabel="Shore A", ylim=(0, 30))
    axes.legend(loc="upper right")


def _modulus(axes: Axes) -> None:
    best = [m.modulus.best_kpa for m in mixes()]
    reach = [
        [m.modulus.best_kpa - m.modulus.low_kpa for m in mixes()],
        [m.modulus.high_kpa - m.modulus.best_kpa for m in mixes()],
    ]
    ratios = [m.ratio for m in mixes()]
    axes.plot(ratios, best, color=FIT, lw=0.8)
    axes.errorbar(ratios, best, reach, fmt="s", ms=4, capsize=3, color=FIT)
    axes.set(title="Modulus from hardness, ±5 points", ylabel="Young's modulus (kPa)")
    axes.set_ylim(bottom=0)
