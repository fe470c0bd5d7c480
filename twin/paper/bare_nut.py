"""How much of the bare nut direct FPP gets, by the roughness of its steel, which is assumed."""

from collections.abc import Mapping

from reconstruction.errors import InputError
from twin.config import Experiment, vary
from twin.paper.claims import DIRECT_AT_MOST
from twin.paper.complete_table import counted
from twin.pipeline import measure
from twin.report.table import Cell, Column, Table

NUT = "nut"
ROUGHNESS = (0.05, 0.1, 0.2, 0.4)
# Sixteen pixels read as one take a quarter of the time; the table says so.
_SETTINGS = {"modality": "direct_fpp", "camera.binning": 4}


def nut_shares(experiment: Experiment) -> dict[str, list[float]]:
    """Measure the bare nut; return shares of its pixels with a good point, and with any.

    Returns
    -------
    dict
        By roughness (GGX alpha) as text.

    Raises
    ------
    InputError, MissingBackend
        As `see`.
    """
    found = {}
    for alpha in ROUGHNESS:
        bare = vary(experiment, _SETTINGS | {"specimen.material.roughness": alpha})
        share = counted(measure(bare))
        if share.specimen is None or share.specimen_points is None:
            raise InputError(f"{experiment.name}: the camera sees nothing of the specimen")
        found[f"{alpha:g}"] = [share.specimen, share.specimen_points]
    return found


def nut_table(shares: Mapping[str, list[float]]) -> Table:
    """Return one row per roughness."""
    rows: list[dict[str, Cell]] = [
        {"alpha": alpha, "good": good, "points": points} for alpha, (good, points) in shares.items()
    ]
    good = [share for share, _ in shares.values()]
    asked = "at all of them" if max(good) <= DIRECT_AT_MOST else "not at all of them"
    if min(good) > DIRECT_AT_MOST:
        asked = "at none of them"
    return Table(
        "explain_roughness",
        "Roughness of the bare nut",
        "",
        (
            Column("alpha", "GGX alpha of the steel"),
            Column("good", "of the nut, good"),
            Column("points", "of the nut, any point"),
        ),
        tuple(rows),
        (
            f"Good points on {min(good):.0%} to {max(good):.0%} of the nut; "
            f"the target of at most {DIRECT_AT_MOST:.0%} is met {asked}. "
            "Sixteen camera pixels read as one.",
        ),
    )
