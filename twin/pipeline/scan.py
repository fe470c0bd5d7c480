"""Scan of a large part: measure or read the patches, register them, and fuse one height map.

Each rendered patch is a measurement of the base experiment with the specimen moved by the inverse
of the sensor's TRUE pose, which has the drawn errors of the stage. The registration uses only the
nominal poses. A finished patch in the folder is not measured again.

Only bare specimens (direct_fpp) are scanned. A coat touches the part in the contact only; the rest
of its surface differs between two presses, so that coats do not overlap as rigid surfaces.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from reconstruction.arrays import FloatArray, IntArray, Reason
from reconstruction.drawing import Drawing, draw_cells, gridded
from reconstruction.errors import InputError
from reconstruction.evaluate.surface import HeightGrid, typical_distance_mm, write_heights
from reconstruction.netcdf import write_arrays
from reconstruction.pipeline import read_reconstruction
from reconstruction.ply import write_ply
from reconstruction.reading import is_regular, read_json
from reconstruction.scan.elements import surface_elements
from reconstruction.scan.fusion import PartPoints, ScanMap, fuse, map_arrays, part_points
from reconstruction.scan.registration import Registration, moved, register, twist_of
from reconstruction.triangulation import PointMap
from reconstruction.writing import write_bytes, write_text
from twin.config import Experiment, digest, vary
from twin.config.digest import keyed_sequence
from twin.config.scan import LoadedScan, ScanPlan
from twin.optics.stack import Truth
from twin.output import (
    RESULT_FILE,
    adding,
    claimed,
    end_exchange,
    output_folder,
    versions,
    write_json,
)
from twin.pipeline.memory import Memory
from twin.pipeline.methods import measure_into
from twin.pipeline.progress import ProgressCallback, no_progress
from twin.pipeline.scan_record import COMMAND, MAP_FILE, StoredRegistration
from twin.results.parts import read_truth

TRUTH_FILE = "truth.nc"
_FILES = (
    RESULT_FILE,
    MAP_FILE,
    "scan.ply",
    "scan.png",
    "height_map.nc",
    "height_map.png",
    "height_map.png.json",
    "height_map.exr",
    "poses.csv",
)
_ALIKE_MM = 1e-9
"""Standard deviation of points without noise, for the map of the true surface."""


@dataclass(frozen=True, eq=False)
class Scanned:
    """Result of a scan.

    Attributes
    ----------
    plan : the plan
    registration : poses of all patches with their covariance
    fused : height map of the part
    true_motion : (patch, 6) true errors of the stage, mm and rad; None for measured patches
    true_map : map of the true surface on the same cells; None for measured patches
    figures : figures of result.json
    """

    plan: ScanPlan
    registration: Registration
    fused: ScanMap
    true_motion: FloatArray | None
    true_map: ScanMap | None
    figures: dict[str, Any]


def true_motions(plan: ScanPlan) -> FloatArray:
    """Return the true errors of the stage, (patch, 6), mm and rad, drawn with the plan's seed."""
    X = plan.stage.prior.factor(len(plan.positions))
    rng = np.random.default_rng(keyed_sequence(plan.seed, "stage", 0))
    return np.asarray(X @ rng.standard_normal(X.shape[1])).reshape(-1, 6)


def experiments_of(scan: LoadedScan) -> tuple[Experiment, ...]:
    """Return the experiment of each patch: the base with its specimen at the true place.

    Raises
    ------
    InputError : the base is not direct_fpp, or a specimen is moved out of its allowed range
    """
    base = scan.base
    if base is None:
        return ()
    if base.modality != "direct_fpp":
        raise InputError(
            f"scan: base: found modality '{base.modality}', allowed 'direct_fpp': two presses give "
            "a coat different surfaces outside the contact"
        )
    poses = moved(scan.plan.nominal_poses(), true_motions(scan.plan))
    return tuple(_placed(base, np.linalg.inv(T), number) for number, T in enumerate(poses))


def _placed(base: Experiment, T_sensor_from_part: FloatArray, number: int) -> Experiment:
    at = base.specimen
    x, y, _ = T_sensor_from_part[:3, :3] @ [at.x_mm, at.y_mm, 0.0] + T_sensor_from_part[:3, 3]
    turn = np.degrees(np.arctan2(T_sensor_from_part[1, 0], T_sensor_from_part[0, 0]))
    yaw = (at.yaw_deg + turn + 180.0) % 360.0 - 180.0
    place = {"specimen.x_mm": float(x), "specimen.y_mm": float(y), "specimen.yaw_deg": float(yaw)}
    seed = int(keyed_sequence(base.seed, "patch", number).generate_state(1)[0])
    return vary(base, place | {"seed": seed})


def run_scan(
    scan: LoadedScan, out: Path, watch: ProgressCallback = no_progress, inputs: Sequence[Path] = ()
) -> Scanned:
    """Measure the patches of a plan that are not in `out` yet, register and fuse them, write.

    Files: result.json, scan.nc, .ply and .png, height_map.*, poses.csv, and patches/N/ of each
    rendered patch.

    Raises
    ------
    InputError : a patch cannot be measured or read, the patches do not overlap, or `out` cannot be
        written
    """
    experiments = experiments_of(scan)
    with claimed(out, COMMAND, _FILES, inputs):
        folders = _measured(experiments, out, watch) if experiments else list(scan.results)
        watch("register", 0.0)
        done = join(scan.plan, [_points_of(folder) for folder in folders], _truths(scan, folders))
        _write(out, done)
        watch("register", 1.0)
    return done


def _measured(experiments: Sequence[Experiment], out: Path, watch: ProgressCallback) -> list[Path]:
    memory, folders = Memory(), []
    for number, experiment in enumerate(experiments):
        folder = out / "patches" / f"{number + 1:03d}"
        watch("measure", number / len(experiments))
        if not _is_finished(folder, experiment):
            with output_folder(folder) as working:
                measure_into(working, "measure", experiment, no_progress, memory)
        folders.append(folder)
    watch("measure", 1.0)
    return folders


def _is_finished(folder: Path, experiment: Experiment) -> bool:
    path = folder / RESULT_FILE
    if not is_regular(path):
        return False
    result = read_json(path)
    return result.get("digest") == digest(experiment) and result.get("versions") == versions()


def _points_of(folder: Path) -> PointMap:
    end_exchange(folder)
    path = folder / "reconstruction.nc"
    if not is_regular(path):
        raise InputError(f"{folder}: no reconstruction.nc; give a result folder of twin measure")
    return read_reconstruction(path).point_map


def _truths(scan: LoadedScan, folders: Sequence[Path]) -> list[Truth] | None:
    return [read_truth(folder / TRUTH_FILE) for folder in folders] if scan.base else None


def join(
    plan: ScanPlan, patches: Sequence[PointMap], truths: Sequence[Truth] | None = None
) -> Scanned:
    """Register and fuse patches, each in the frame of the sensor.

    Parameters
    ----------
    truths : true surface of each rendered patch; None: the scan has no true map

    Raises
    ------
    InputError : see `register` and `fuse`
    """
    poses, elements = plan.nominal_poses(), [surface_elements(patch) for patch in patches]
    registered = register(elements, poses, plan.stage.prior)
    pitch_mm = plan.map.pitch_mm or 1.5 * typical_distance_mm(patches[0])
    covariance = registered.covariance
    parts = [
        part_points(patch, T, covariance[6 * k : 6 * k + 6, 6 * k : 6 * k + 6])
        for k, (patch, T) in enumerate(zip(patches, registered.T_part_from_sensor, strict=True))
    ]
    fused = fuse(parts, pitch_mm)
    motion, true_map = None, None
    if truths is not None:
        motion = true_motions(plan)
        true_map = _true_map(truths, moved(poses, motion), pitch_mm)
    figures = _figures(registered, fused, parts)
    if motion is not None and true_map is not None:
        figures |= _errors(registered, fused, motion, true_map)
        figures |= _patch_errors(patches, truths or ())
    return Scanned(plan, registered, fused, motion, true_map, figures)


def _true_map(truths: Sequence[Truth], poses: FloatArray, pitch_mm: float) -> ScanMap:
    parts = []
    for true, T in zip(truths, poses, strict=True):
        reason = np.where(true.measured, Reason.VALID, Reason.NO_POINT).astype(np.uint8)
        sigma = np.full_like(true.points_world_mm, _ALIKE_MM)
        exact = PointMap(true.points_world_mm, sigma, reason, np.eye(4))
        parts.append(part_points(exact, T, np.zeros((6, 6))))
    return fuse([_with_unit_noise(part) for part in parts], pitch_mm)


def _with_unit_noise(part: PartPoints) -> PartPoints:
    """Return true points with a noise of 1 mm, so that none of them differs significantly."""
    return PartPoints(part.points_mm, part.normals, np.ones_like(part.noise_mm), part.pose_mm)


def _figures(
    registered: Registration, fused: ScanMap, parts: Sequence[PartPoints]
) -> dict[str, Any]:
    sigma = registered.sigma
    valid = fused.valid
    seams = np.array([overlap.rms_mm for overlap in registered.overlaps])
    return {
        "patches": len(parts),
        "overlaps": len(registered.overlaps),
        "cells": int(valid.sum()),
        "pitch_mm": fused.pitch_mm,
        "sigma_median_um": float(1e3 * np.median(fused.sigma_mm[valid])),
        "pose_sigma_x_um": float(1e3 * np.median(sigma[:, 0])),
        "pose_sigma_y_um": float(1e3 * np.median(sigma[:, 1])),
        "pose_sigma_angle_mrad": float(1e3 * np.median(sigma[:, 5])),
        "seam_rms_um": float(1e3 * np.sqrt(np.mean(seams**2))),
        "drift_x_um": float(1e3 * registered.drift_mm[0]),
        "drift_y_um": float(1e3 * registered.drift_mm[1]),
        "registration_birge_ratio": registered.birge_ratio,
        "map_birge_ratio": fused.birge_ratio,
        "left_out_heights": int(fused.left_out.sum()),
        "free_directions": len(registered.free),
    }


def map_error(fused: ScanMap, true_map: ScanMap) -> tuple[FloatArray, IntArray]:
    """Return the error of z, mm, in each cell of both maps, and the cells' row and column."""
    # Both grids have cell edges at multiples of the pitch.
    rows = np.rint((true_map.y_mm[0] - fused.y_mm) / fused.pitch_mm).astype(int)
    cols = np.rint((fused.x_mm - true_map.x_mm[0]) / fused.pitch_mm).astype(int)
    row, col = np.meshgrid(rows, cols, indexing="ij")
    inside = (row >= 0) & (row < len(true_map.y_mm)) & (col >= 0) & (col < len(true_map.x_mm))
    row, col = np.where(inside, row, 0), np.where(inside, col, 0)
    both = inside & fused.valid & true_map.valid[row, col]
    return (fused.z_mm - true_map.z_mm[row, col])[both], np.argwhere(both)


def _errors(
    registered: Registration, fused: ScanMap, motion: FloatArray, true_map: ScanMap
) -> dict[str, Any]:
    error, at = map_error(fused, true_map)
    if not len(error):
        return {}
    over = error / fused.sigma_mm[tuple(at.T)]
    moves = registered.sigma > 0.0
    ratio = ((registered.motion - motion)[moves] / registered.sigma[moves]) ** 2
    return {
        "map_rmse_um": float(1e3 * np.sqrt(np.mean(error**2))),
        "map_form_rmse_um": float(1e3 * np.sqrt(np.mean(_form_error(fused, error, at) ** 2))),
        "map_median_error_um": float(1e3 * np.median(np.abs(error))),
        "map_error_over_sigma": float(1.4826 * np.median(np.abs(over))),
        "registration_error_over_sigma": float(np.sqrt(np.mean(ratio))),
    }


def _form_error(fused: ScanMap, error: FloatArray, at: IntArray) -> FloatArray:
    """Return the error of z, mm, after the best common rigid motion of the whole map.

    Only the stage determines the common motion; a flatness or a distance does not depend on it.
    """
    by_row = np.asarray(np.gradient(fused.z_mm, -fused.pitch_mm, axis=0))
    by_col = np.asarray(np.gradient(fused.z_mm, fused.pitch_mm, axis=1))
    row, col = at.T
    normals = np.column_stack([-by_col[row, col], -by_row[row, col], np.ones(len(at))])
    points = np.column_stack([fused.x_mm[col], fused.y_mm[row], fused.z_mm[row, col]])
    inner = cv2.erode(fused.valid.astype(np.uint8), np.ones((3, 3), np.uint8))
    known = inner[row, col] > 0
    motion = np.linalg.lstsq(twist_of(normals, points)[known], error[known], rcond=None)[0]
    left_mm = error - twist_of(normals, points) @ motion
    return np.asarray(left_mm[known], np.float64)


def _patch_errors(patches: Sequence[PointMap], truths: Sequence[Truth]) -> dict[str, Any]:
    """Return the error of z of the single patches on the specimen, without its edges."""
    squares: list[float] = []
    for points, true in zip(patches, truths, strict=True):
        own = part_points(points, np.eye(4), np.zeros((6, 6)))
        exact = _true_map([true], np.eye(4)[np.newaxis], 1.5 * typical_distance_mm(points))
        error, _ = map_error(fuse([own], exact.pitch_mm), exact)
        squares.append(float(np.mean(error**2)) if len(error) else np.nan)
    if np.all(np.isnan(squares)):
        return {}
    return {"patch_rmse_um": float(1e3 * np.sqrt(np.nanmean(squares)))}


def _write(out: Path, done: Scanned) -> None:
    fused = done.fused
    with adding(out, *_FILES) as folder:
        write_arrays(folder / MAP_FILE, map_arrays(fused))
        shown = {
            "sigma_z_mm": fused.sigma_mm[fused.valid].astype(np.float32),
            "patches": fused.patches[fused.valid].astype(np.int32),
        }
        comments = ("frame of the part, z up", "units mm")
        write_ply(folder / "scan.ply", fused.points_mm, shown, comments)
        grid = HeightGrid(
            fused.x_mm, fused.y_mm, fused.z_mm.astype(np.float32), fused.valid, fused.pitch_mm
        )
        write_heights(folder, grid)
        write_bytes(folder / "scan.png", _drawing_of(fused).png())
        write_text(folder / "poses.csv", _poses_csv(done))
        table = {
            "command": COMMAND,
            "metrics": done.figures,
            "plan": done.plan.model_dump(mode="json", exclude_none=True),
            "registration": StoredRegistration.of(done.registration, done.true_motion).model_dump(
                mode="json"
            ),
            "versions": versions(),
        }
        write_json(folder / RESULT_FILE, table)


def _drawing_of(fused: ScanMap) -> Drawing:
    points = fused.points_mm
    drawing = Drawing(3)
    panels = drawing.subplots(1, 3)
    for panel, values, title, unit in (
        (panels[0], fused.z_mm, "fused heights", "z (mm)"),
        (panels[1], 1e3 * fused.sigma_mm, "sigma of z", "um"),
        (panels[2], fused.patches.astype(np.float64), "patches per cell", "number"),
    ):
        draw_cells(panel, gridded(points, values[fused.valid]), title, unit)
    return drawing


def _poses_csv(done: Scanned) -> str:
    names = ("dx_um", "dy_um", "dz_um", "rx_mrad", "ry_mrad", "rz_mrad")
    head = ["patch", "x_mm", "y_mm", "rotation_deg", *names, *(f"sigma_{name}" for name in names)]
    lines = [",".join(head)]
    moves, sigma = done.registration.motion, done.registration.sigma
    for k, at in enumerate(done.plan.positions):
        values = [at.x_mm, at.y_mm, at.rotation_deg, *(1e3 * moves[k]), *(1e3 * sigma[k])]
        lines.append(",".join([str(k + 1), *(f"{value:.6g}" for value in values)]))
    return "\n".join(lines) + "\n"
