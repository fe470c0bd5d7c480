"""Write the files of an adopted rig.

| file | content |
|---|---|
| rig.toml | the rig: value, range and source of every field |
| fields.csv | the same as a table: path, value, range, source |
| experiment.toml | an experiment with a ball pressed on this rig, for twin measure |
| response.toml | the projector's response, a table for capture.toml; if it was estimated |
| photon_transfer.csv | variance of the noise (DN^2) by mean signal (DN); if it was estimated |
| result.json | figures, digest, versions |
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from reconstruction.capture.description import response_table, write_toml
from reconstruction.writing import write_text
from twin.adoption.adopt import Adopted, Given
from twin.adoption.findings import rows_of, write_rig
from twin.config import to_toml
from twin.config.digest import content_digest
from twin.output import EXPERIMENT_FILE, write_outcome
from twin.results.parts import write_rows

COMMAND = "adopt"
RIG_FILE, FIELDS_FILE = "rig.toml", "fields.csv"
RESPONSE_FILE, NOISE_FILE = "response.toml", "photon_transfer.csv"


def write_adopted(folder: Path, adopted: Adopted, given: Given) -> dict[str, Any]:
    """Write all files of an adopted rig except the report; return the figures of result.json."""
    figures = adopted_metrics(adopted)
    write_rig(folder / RIG_FILE, given.captures[0].name, adopted.tables)
    write_rows(folder / FIELDS_FILE, list(_field_rows(adopted)), 7)
    write_text(folder / EXPERIMENT_FILE, to_toml(adopted.experiment))
    response = adopted.capture.response
    if adopted.fit is not None and response is not None:
        write_toml(folder / RESPONSE_FILE, {}, response_table(response))
    if adopted.noise is not None:
        noise = adopted.noise
        names = ("mean_dn", "variance_dn2", "variance_uncertainty_dn2")
        columns = np.stack([getattr(noise, name) for name in names], axis=1)
        rows = [dict(zip(names, row, strict=True)) for row in columns.tolist()]
        write_rows(folder / NOISE_FILE, rows, 8)
    named = content_digest(adopted.capture.stack, str(adopted.tables))
    write_outcome(folder, COMMAND, figures, digest=named)
    return figures


def _field_rows(adopted: Adopted) -> Iterator[dict[str, Any]]:
    for path, value, limits, source in rows_of(adopted.tables):
        low, high = limits or (None, None)
        number = value if isinstance(value, (int, float)) else str(value)
        yield {"field": path, "value": number, "low": low, "high": high, "source": source}


def adopted_metrics(adopted: Adopted) -> dict[str, Any]:
    """Return the figures of an adopted rig by name, for result.json.

    They are the estimates with their standard uncertainties, the misfits, and the numbers of
    determined and of assumed fields.
    """
    figures: dict[str, Any] = {}
    if adopted.noise is not None:
        gain = adopted.noise.gain_dn_per_e
        figures |= {"gain_dn_per_e": gain.value, "gain_uncertainty_dn_per_e": gain.uncertainty}
    for field in adopted.fields.values():
        if field.uncertainty is None:
            continue
        name = field.path.replace(".", "_")
        figures |= {name: float(field.value), f"{name}_uncertainty": field.uncertainty}
    sources = [source for _, _, _, source in rows_of(adopted.tables)]
    figures |= {
        "camera_misfit_px": adopted.placed.misfit_px[0],
        "projector_misfit_px": adopted.placed.misfit_px[1],
        "fit_chi2": None if adopted.fit is None else adopted.fit.chi2,
        "two_period_chi2": adopted.two_period_chi2,
        **_sparkle_figures(adopted),
        "points": int(adopted.points.point_map.valid.sum()),
        "sigma_z_median_um": _sigma_um(adopted),
        "fields_found": sum(not source.startswith("assumed") for source in sources),
        "fields_assumed": sum(source.startswith("assumed") for source in sources),
        "warnings": list(adopted.notes),
    }
    return figures


def _sparkle_figures(adopted: Adopted) -> dict[str, Any]:
    """Return the figures of the white frame's local contrast; empty if it was not determined."""
    sparkle = adopted.sparkle
    if sparkle is None:
        return {}
    return {
        "coat_contrast_percent": 100.0 * sparkle.contrast,
        "coat_contrast_uncertainty_percent": 100.0 * sparkle.uncertainty,
        "coat_contrast_of_neighbours": sparkle.neighbours,
        "coat_glints": sparkle.glints,
    }


def _sigma_um(adopted: Adopted) -> float | None:
    points = adopted.points.point_map
    sigma_mm = points.sigma_z_mm[points.valid]
    return float(1e3 * np.median(sigma_mm)) if sigma_mm.size else None
