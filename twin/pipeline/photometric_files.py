"""Measure a described press of a photometric-stereo sensor, rendered or real; needs no renderer."""

from pathlib import Path
from typing import Any

import numpy as np

from reconstruction.photometric import (
    HeightMap,
    PhotometricReason,
    reconstruct_photometric,
    write_height_map,
    write_height_points,
    write_sensor_calibration,
)
from twin.output import RESULT_FILE, output_folder, versions, write_json
from twin.pipeline.progress import Watcher, nobody


def reconstruct_press(description: Path, out: Path, watch: Watcher = nobody) -> dict[str, Any]:
    """Measure `description` (TOML) into `out`; returns the figures also written to result.json.

    Beside them stand height.nc, points.ply, and sensor_calibration.npz to measure with again.

    Raises
    ------
    InputError
        The description or an image is missing or damaged, no contact is found on a calibration
        image, or `out` cannot be written.
    """
    with output_folder(out, [description]) as folder:
        watch("reconstruct", 0.0)
        result = reconstruct_photometric(description)
        watch("reconstruct", 1.0)
        figures = height_metrics(result.height_map)
        write_height_map(folder / "height.nc", result.height_map)
        write_height_points(folder / "points.ply", result.height_map)
        write_sensor_calibration(folder / "sensor_calibration.npz", result.calibration)
        content = {"command": "reconstruct", "metrics": figures, "versions": versions()}
        write_json(folder / RESULT_FILE, {"schema_version": 1, **content})
    return figures


def height_metrics(height_map: HeightMap) -> dict[str, Any]:
    """Return the range of the valid heights and, by reason, how many pixels are coded."""
    heights_mm = height_map.height_mm[height_map.valid]
    figures: dict[str, Any] = {
        "points": int(height_map.valid.sum()),
        "valid_share": float(height_map.valid.mean()),
    }
    if figures["points"]:
        figures["highest_mm"] = float(np.max(heights_mm))
        figures["lowest_mm"] = float(np.min(heights_mm))
    for reason in PhotometricReason:
        if reason is not PhotometricReason.VALID:
            count = int((height_map.mask_reason == reason).sum())
            figures[f"masked_{reason.name.lower()}"] = count
    return figures
