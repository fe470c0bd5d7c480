"""How much of the bare nut direct FPP gets, by the roughness of its steel, which is assumed."""

from collections.abc import Mapping

from twin.paper.claims import DIRECT_AT_MOST
from twin.paper.table import Cell, Column, Table


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
            f"Good points on {min(good):.0%} to {max(good):.0%} of the nut; the "
            f"target of {DIRECT_AT_MOST:.0%} is met {asked}. Sixteen camera pixels read as one.",
        ),
    )
