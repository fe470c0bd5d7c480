"""Files of an adopted rig.

| file | content |
|---|---|
| rig.toml | the rig: value, range and source of every field |
| experiment.toml | a ball pressed on it, resolved: runs with twin measure |
| response.toml | the projector's response, a table for capture.toml; where it was found |
| photon_transfer.csv | variance over mean, where it was found |
| result.json | figures, digest, versions |
"""

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
RIG_FILE, RESPONSE_FILE, NOISE_FILE = "rig.toml", "response.toml", "photon_transfer.csv"


def write_adopted(folder: Path, found: Adopted, given: Given) -> dict[str, Any]:
    """Write all but the report; returns the figures of result.json."""
    figures = adopted_metrics(found)
    write_rig(folder / RIG_FILE, given.captures[0].name, found.tables)
    write_text(folder / EXPERIMENT_FILE, to_toml(found.experiment))
    response = found.capture.response
    if found.fit is not None and response is not None:
        write_toml(folder / RESPONSE_FILE, {}, response_table(response))
    if found.noise is not None:
        noise = found.noise
        names = ("mean_dn", "variance_dn2", "variance_uncertainty_dn2")
        columns = np.stack([getattr(noise, name) for name in names], axis=1)
        rows = [dict(zip(names, row, strict=True)) for row in columns.tolist()]
        write_rows(folder / NOISE_FILE, rows, 8)
    named = content_digest(found.capture.stack, str(found.tables))
    write_outcome(folder, COMMAND, figures, digest=named)
    return figures


def adopted_metrics(found: Adopted) -> dict[str, Any]:
    """Return the figures: what was found with its uncertainty, and how much stays assumed."""
    figures: dict[str, Any] = {}
    if found.noise is not None:
        gain = found.noise.gain_dn_per_e
        figures |= {"gain_dn_per_e": gain.value, "gain_uncertainty_dn_per_e": gain.uncertainty}
    for field in found.fields.values():
        if field.uncertainty is None:
            continue
        name = field.path.replace(".", "_")
        figures |= {name: float(field.value), f"{name}_uncertainty": field.uncertainty}
    sources = [source for _, _, _, source in rows_of(found.tables)]
    figures |= {
        "camera_misfit_px": found.placed.misfit_px[0],
        "projector_misfit_px": found.placed.misfit_px[1],
        "fit_chi2": None if found.fit is None else found.fit.chi2,
        "two_period_chi2": found.two_period_chi2,
        **_sparkle_figures(found),
        "points": int(found.points.point_map.valid.sum()),
        "sigma_z_median_um": _sigma_um(found),
        "fields_found": sum(not source.startswith("assumed") for source in sources),
        "fields_assumed": sum(source.startswith("assumed") for source in sources),
        "warnings": list(found.notes),
    }
    return figures


def _sparkle_figures(found: Adopted) -> dict[str, Any]:
    """Return the local contrast of the white frame."""
    one = found.sparkle
    if one is None:
        return {}
    return {
        "coat_contrast_percent": 100.0 * one.contrast,
        "coat_contrast_uncertainty_percent": 100.0 * one.uncertainty,
        "coat_contrast_of_neighbours": one.neighbours,
        "coat_glints": one.glints,
    }


def _sigma_um(found: Adopted) -> float | None:
    points = found.points.point_map
    sigma_mm = points.sigma_z_mm[points.valid]
    return float(1e3 * np.median(sigma_mm)) if sigma_mm.size else None
