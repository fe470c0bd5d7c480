"""What the paper measured: its specimens and instruments, one parameter set for all of them."""

from collections.abc import Mapping, Sequence
from typing import Any

from twin.config import Experiment, load_experiment
from twin.config.methods import Method

BALLS, NUT = "two_balls", "nut"
RODS = ("rods_a", "rods_b", "rods_c")
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
    **dict.fromkeys(RODS, "rod_width_mm"),
}
"""The figure of each specimen whose uncertainty is ranked."""

# Two by two pixels are read as one: a quarter of the time, and the same projector pixels.
COARSE: Mapping[str, Any] = {"camera.binning": 2}
FINE: Mapping[str, Any] = {}


def experiment_of(name: str, settings: Mapping[str, Any] = COARSE) -> Experiment:
    """Return one of the paper's experiments, every one on the same rig and press."""
    return load_experiment(f"paper/{name}", settings)
