"""The sphere fits of GelSight by every decoder, on the images of the same trials."""

from collections.abc import Iterator, Sequence

import numpy as np

from twin.paper.published import GELSIGHT, mean_of
from twin.paper.repeats import Trial
from twin.paper.statistics import values_of
from twin.report.table import Cell, Column, Table
from twin.results.decoders import INTEGRATION_ORDER, MAP_ORDER

_MAP_WORDS = {"table": "look-up table", "polynomial": "polynomial"}


def decoder_table(trials: Sequence[Trial]) -> Table:
    """Return one row per colour map and integration, means over both balls and all trials."""
    repeated = [one for one in trials if one.number]
    rows: list[dict[str, Cell]] = []
    for kind in MAP_ORDER:
        for scheme in INTEGRATION_ORDER:
            radius, rmse = (_mean(repeated, f"{kind}_{scheme}", key) for key in ("radius", "rmse"))
            if radius is not None and rmse is not None:
                name = f"{_MAP_WORDS[kind]}, {scheme}"
                rows.append({"decoder": name, "radius": radius, "rmse_um": 1e3 * rmse})
    return Table(
        "explain_decoders",
        "GelSight by every decoder, same images",
        "",
        (
            Column("decoder", "colour map, integration"),
            Column("radius", "radius, mm"),
            Column("rmse_um", "RMSE, um", 1),
        ),
        tuple(rows),
        tuple(_notes([float(str(row["rmse_um"])) for row in rows])),
    )


def _notes(found_um: Sequence[float]) -> Iterator[str]:
    if found_um:
        paper_um = 1e3 * mean_of("sphere_fit", GELSIGHT, "rmse")
        told = "a decoder" if max(found_um) > paper_um / 2 else "no decoder"
        yield (
            f"From {min(found_um):.1f} to {max(found_um):.1f} um; the paper reports "
            f"{paper_um:.0f} um: {told} comes within a factor of two."
        )


def _mean(trials: Sequence[Trial], decoder: str, key: str) -> float | None:
    values = [values_of(trials, f"{decoder}_sphere_{ball}_{key}_mm") for ball in (1, 2)]
    together = np.concatenate(values)
    return float(together.mean()) if together.size else None
