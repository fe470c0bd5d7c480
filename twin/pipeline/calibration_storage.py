"""Write a calibration into a folder; the names are the contract of `twin calibrate -o DIR`.

| file | content |
|---|---|
| result.json | metrics (units in their names), digest, versions |
| calibration.yaml | the calibration, OpenCV YAML |
| parameters.csv, poses.csv, features.csv | uncertainties, residuals by pose, every feature |
| experiment.toml | of a rendered calibration: the resolved experiment |
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from reconstruction.calibration.pipeline import pupil_diameter_mm
from reconstruction.rig.calibration import write_calibration
from twin.config import to_toml
from twin.output import EXPERIMENT_FILE, RESULT_FILE, versions, write_json
from twin.pipeline.calibration import BoardCalibration

CALIBRATION_FILE = "calibration.yaml"
PARAMETERS_FILE, POSES_FILE, FEATURES_FILE = "parameters.csv", "poses.csv", "features.csv"


def calibration_metrics(done: BoardCalibration) -> dict[str, Any]:
    """Return the figures of a calibration; `_expanded` is k = 2, `_error` found minus true."""
    found = done.result
    figures: dict[str, Any] = {
        "poses": len(found.poses),
        "features": sum(pose.features for pose in found.poses),
        "features_left_out": sum(pose.left_out for pose in found.poses),
        "camera_reprojection_rms_px": _rms([pose.camera_px for pose in found.poses]),
        "projector_reprojection_rms_px": _rms([pose.projector_px for pose in found.poses]),
        "epipolar_rms_px": _rms([pose.epipolar_px for pose in found.poses]),
        "camera_pupil_diameter_mm": pupil_diameter_mm(found.adjustment) or None,  # 0: not seen
    }
    truth = done.truth
    for parameter in found.parameters:
        figures[parameter.name] = parameter.value
        figures[f"{parameter.name}_expanded"] = parameter.expanded
        if truth is not None:
            figures[f"{parameter.name}_error"] = parameter.value - truth[parameter.name]
    return figures


def _rms(values: Sequence[float]) -> float:
    return math.sqrt(sum(value**2 for value in values) / len(values))


def write_board_calibration(folder: Path, done: BoardCalibration) -> dict[str, Any]:
    """Write calibration.yaml, the tables and result.json; returns the figures."""
    figures = calibration_metrics(done)
    write_calibration(folder / CALIBRATION_FILE, done.result.calibration)
    _write_table(folder / PARAMETERS_FILE, list(parameter_rows(done)))
    _write_table(folder / POSES_FILE, [asdict(pose) for pose in done.result.poses])
    _write_table(folder / FEATURES_FILE, list(_feature_rows(done)))
    if done.experiment is not None:
        text = to_toml(done.experiment)
        (folder / EXPERIMENT_FILE).write_text(text, encoding="utf-8")
    content = {"command": "calibrate", "digest": done.digest, "metrics": figures}
    write_json(folder / RESULT_FILE, {"schema_version": 1, "versions": versions(), **content})
    return figures


def parameter_rows(done: BoardCalibration) -> Iterator[dict[str, Any]]:
    """Yield one row per parameter: value, standard and expanded uncertainty, truth if known."""
    truth = done.truth
    for parameter in done.result.parameters:
        row: dict[str, Any] = {
            "parameter": parameter.name,
            "value": parameter.value,
            "sigma": parameter.sigma,
            "expanded": parameter.expanded,
        }
        if truth is not None:
            row |= {
                "truth": truth[parameter.name],
                "error": parameter.value - truth[parameter.name],
            }
        yield row


def _feature_rows(done: BoardCalibration) -> Iterator[dict[str, Any]]:
    found = done.result.adjustment
    for k, seen in enumerate(done.observations):
        for n, identity in enumerate(seen.ids):
            numbers = [*found.measured_px[k][n], *found.residuals_px[k][n]]
            names = ("camera_x_px", "camera_y_px", "projector_column_px", "projector_row_px")
            misses = tuple(f"miss_{name}" for name in names)
            yield {"pose": seen.name, "id": int(identity), "used": int(found.used[k][n])} | {
                name: float(number) for name, number in zip(names + misses, numbers, strict=True)
            }


def _write_table(path: Path, rows: list[dict[str, Any]]) -> None:
    lines = [",".join(rows[0])]
    for row in rows:
        cells = (f"{v:.10g}" if isinstance(v, float) else str(v) for v in row.values())
        lines.append(",".join(cells))
    path.write_text("\n".join([*lines, ""]), encoding="utf-8")
