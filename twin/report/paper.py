"""The paper's published numbers, shipped as data (scenes/paper/targets.toml)."""

import tomllib
from dataclasses import dataclass
from statistics import mean

from twin.assets import asset_path
from twin.config.models import Experiment, TwoBalls

PAPER_DIAMETER_MM = 8.0
CONTACT_FPP, GELSIGHT = "contact-FPP", "GelSight"


@dataclass(frozen=True)
class PaperRow:
    """One row of the paper's sphere-fitting table; lengths mm."""

    radius_mm: float
    abs_radius_error_mm: float
    rmse_mm: float
    mae_mm: float
    p95_mm: float


def paper_row(experiment: Experiment, method: str, ball: int) -> PaperRow | None:
    """Return the paper's row for a ball (1, 2); None when the specimen is not the paper's."""
    if not _is_papers_artefact(experiment):
        return None
    targets = tomllib.loads(asset_path("scenes", "paper/targets").read_text(encoding="utf-8"))
    for row in targets["sphere_fit"]:
        if row["method"] == method and row["sphere"] == ball:
            return PaperRow(
                radius_mm=row["radius"],
                abs_radius_error_mm=row["abs_radius_error"],
                rmse_mm=row["rmse"],
                mae_mm=row["mae"],
                p95_mm=row["p95"],
            )
    return None


def paper_rmse_ratio(experiment: Experiment) -> float | None:
    """Return the paper's sphere-fit RMSE of GelSight over contact-FPP, means over both balls.

    None when the specimen is not the paper's.
    """
    rows = {m: [paper_row(experiment, m, n) for n in (1, 2)] for m in (GELSIGHT, CONTACT_FPP)}
    means = [mean(row.rmse_mm for row in found if row) for found in rows.values() if all(found)]
    return means[0] / means[1] if len(means) == len(rows) else None


def _is_papers_artefact(experiment: Experiment) -> bool:
    specimen = experiment.specimen
    return isinstance(specimen, TwoBalls) and specimen.diameter_mm == PAPER_DIAMETER_MM
