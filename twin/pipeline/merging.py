"""Points from captures of one scene by several cameras with one projector."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from reconstruction.capture.folder import read_capture
from reconstruction.capture.period_search import best_period
from reconstruction.colouring import Intensity
from reconstruction.drawing import Drawing, draw_cells, gridded
from reconstruction.errors import InputError
from reconstruction.evaluate.surface import (
    grid_heights,
    typical_distance_mm,
    write_heights,
    write_surface,
)
from reconstruction.merging import CameraView, Merged, merge
from reconstruction.netcdf import PIXELS, LabelledArrays, write_arrays
from reconstruction.pipeline import (
    Reconstruction,
    reconstruct,
    reconstruction_arrays,
    write_reconstruction,
)
from reconstruction.ply import write_ply
from reconstruction.rig.calibration import Calibration
from reconstruction.stereo import DecodedView, triangulate_cameras
from reconstruction.triangulation import PointMap
from reconstruction.writing import write_bytes, write_text
from twin.config.digest import content_digest
from twin.config.models import Decode
from twin.output import EXPERIMENT_FILE, output_folder, write_outcome
from twin.pipeline.captures import options_of, require_points
from twin.pipeline.progress import ProgressCallback, no_progress

LARGE_BIRGE_RATIO = 3.0
"""Ratio above which the calibrations, not the noise, determine the error of the merged points."""


@dataclass(frozen=True, eq=False)
class _Seen:
    """Points of one camera, the rig that gave them, and the digest of the capture."""

    result: Reconstruction
    rig: Calibration
    digest: str


def merge_captures(
    captures: Sequence[Path], out: Path, decode: Decode, watch: ProgressCallback = no_progress
) -> dict[str, Any]:
    """Reconstruct and merge captures, and write the result folder `out`.

    Returns the figures of result.json. The files of `out` are points.ply, merged.png, camera_1.nc,
    camera_2.nc, ..., height_map.nc, .png and .exr, experiment.toml and result.json.

    Raises
    ------
    InputError : a capture is incomplete or damaged, no pixel of a capture gives a point, no two
        cameras see the same place, or `out` cannot be written
    """
    if len(captures) < 2:
        raise InputError(f"merge: found {len(captures)} capture; give two or more, one per camera")
    with output_folder(out, captures) as folder:
        seen = _reconstructed(captures, decode, watch)
        watch("merge", 0.0)
        merged = merge([CameraView(camera.result.point_map, camera.rig) for camera in seen])
        _write(folder, merged, [camera.result for camera in seen])
        figures = merged_metrics(merged)
        _write_settings(folder, captures, decode, "projector")
        write_outcome(folder, "merge", figures, digest=_digest(seen))
        watch("merge", 1.0)
    return figures


def triangulate_captures(
    captures: Sequence[Path], out: Path, decode: Decode, watch: ProgressCallback = no_progress
) -> dict[str, Any]:
    """Triangulate the first camera with the second one, and write the result folder `out`.

    Returns the figures of result.json. The files of `out` are those of `reconstruct_capture`.

    Raises
    ------
    InputError : there are not two captures, a capture is incomplete or damaged, has one axis only
        or clear layers, no pixel gives a point, or `out` cannot be written
    """
    if len(captures) != 2:
        raise InputError(f"merge --baseline cameras: found {len(captures)} captures; give two")
    with output_folder(out, captures) as folder:
        first, second = _reconstructed(captures, decode, watch)
        watch("triangulate", 0.0)
        alone, decoded = first.result.point_map, first.result.decoded
        partner = DecodedView(second.result.decoded, second.rig)
        points = triangulate_cameras(DecodedView(decoded, first.rig), partner, alone)
        require_points(captures[0], points.mask_reason)
        write_reconstruction(folder / "reconstruction.nc", decoded, points)
        write_surface(folder, points, intensity=Intensity(decoded.intensity_dn, points.valid))
        figures = _stereo_metrics(points, alone)
        _write_settings(folder, captures, decode, "cameras")
        write_outcome(folder, "merge", figures, digest=_digest([first, second]))
        watch("triangulate", 1.0)
    return figures


def _reconstructed(
    captures: Sequence[Path], decode: Decode, watch: ProgressCallback
) -> list[_Seen]:
    seen = []
    for number, path in enumerate(captures):
        watch("reconstruct", number / len(captures))
        capture = read_capture(path)
        result = reconstruct(capture, options_of(decode))
        require_points(path, result.point_map.mask_reason, partial(best_period, capture))
        seen.append(_Seen(result, capture.calibration, content_digest(decode, capture)))
    watch("reconstruct", 1.0)
    return seen


def _digest(seen: Sequence[_Seen]) -> str:
    return " ".join(camera.digest for camera in seen)


def _write_settings(folder: Path, captures: Sequence[Path], decode: Decode, baseline: str) -> None:
    tables = {
        "baseline": baseline,
        "captures": [str(capture) for capture in captures],
        "decode": decode.model_dump(mode="json"),
    }
    write_text(folder / EXPERIMENT_FILE, tomli_w.dumps(tables))


def _stereo_metrics(points: PointMap, by_projector: PointMap) -> dict[str, Any]:
    """Return figures of the points by two cameras and their distance from those by the projector.

    The distance is along the ray of the first camera.
    """
    both = points.valid & by_projector.valid
    difference_mm = (points.points_world_mm - by_projector.points_world_mm)[both]
    distance_mm = np.linalg.norm(difference_mm, axis=-1)
    return {
        "points": int(points.valid.sum()),
        "valid_share": float(points.valid.mean()),
        "sigma_z_median_um": float(1e3 * np.median(points.sigma_z_mm[points.valid])),
        "projector_offset_median_um": float(1e3 * np.median(distance_mm)),
    }


def merged_metrics(merged: Merged) -> dict[str, Any]:
    """Return number, sigma and agreement of the merged points, by figure name."""
    compared = merged.agreement
    sigma_mm = merged.of_all([points.sigma_z_mm for points in merged.maps])
    each = {
        f"camera_{number}_valid_share": float(points.valid.mean())
        for number, points in enumerate(merged.maps, start=1)
    }
    return {
        "points": len(sigma_mm),
        "sigma_z_median_um": float(1e3 * np.median(sigma_mm)),
        "offset_median_um": 1e3 * compared.offset_median_mm,
        "birge_ratio": compared.birge_ratio,
        "shared_points": compared.shared_points,
        "hidden_points": compared.hidden_points,
        "contradicted_points": compared.contradicted_points,
    } | each


def merging_doubts(figures: dict[str, Any]) -> list[str]:
    """Return a warning if the surfaces of the cameras differ by more than their noise."""
    ratio = figures.get("birge_ratio", 1.0)
    if ratio <= LARGE_BIRGE_RATIO:
        return []
    return [
        f"the surfaces of the cameras are {figures['offset_median_um']:.3g} um apart, {ratio:.3g} "
        "times their noise: calibrate all cameras on the same board poses with one projector"
    ]


def _write(folder: Path, merged: Merged, results: Sequence[Reconstruction]) -> None:
    cameras = zip(results, merged.maps, merged.kept, merged.repeated, strict=True)
    for number, (result, points, kept, repeated) in enumerate(cameras, start=1):
        arrays = reconstruction_arrays(result.decoded, points)
        masks = {
            "is_merged": (kept, "1 where the point is part of the merged points"),
            "is_repeated": (repeated, "1 where an earlier camera has a point at the same place"),
        }
        variables = dict(arrays.variables) | {
            name: (PIXELS, mask.astype(np.uint8), {"units": "1", "long_name": text})
            for name, (mask, text) in masks.items()
        }
        maps = LabelledArrays(variables, arrays.coords, arrays.attrs)
        write_arrays(folder / f"camera_{number}.nc", maps)
    _write_points(folder, merged, results)
    write_bytes(folder / "merged.png", _drawing_of(merged).png())
    heights_mm = merged.points_mm.astype(np.float64)
    pitch_mm = 1.5 * typical_distance_mm(merged.maps[0])
    write_heights(folder, grid_heights(heights_mm, pitch_mm))


def _write_points(folder: Path, merged: Merged, results: Sequence[Reconstruction]) -> None:
    """Write points.ply: points, normals, standard deviations, intensity and camera number."""
    images = [
        np.concatenate(
            [
                points.normals_world,
                points.sigma_xyz_mm,
                result.decoded.intensity_dn[..., np.newaxis],
                np.full((*points.valid.shape, 1), number),
            ],
            axis=-1,
        ).astype(np.float32)
        for number, (points, result) in enumerate(zip(merged.maps, results, strict=True), start=1)
    ]
    names = ["nx", "ny", "nz", "sigma_x_mm", "sigma_y_mm", "sigma_z_mm", "intensity_dn", "camera"]
    values = merged.of_all(images)
    scalars: dict[str, Any] = {name: values[:, i] for i, name in enumerate(names)}
    scalars["camera"] = values[:, -1].astype(np.uint8)
    shades = Intensity(values[:, 6], np.ones(len(values), np.bool_))
    scalars |= {name: shades.rgb[:, i] for i, name in enumerate(("red", "green", "blue"))}
    comments = ("frame world of the first camera's calibration, z up", "units mm", shades.legend)
    write_ply(folder / "points.ply", merged.points_mm, scalars, comments)


def _drawing_of(merged: Merged) -> Drawing:
    """Draw the heights, their standard deviation and the camera of each merged point."""
    points_mm = merged.points_mm.astype(np.float64)
    sigma_um = 1e3 * merged.of_all([points.sigma_z_mm for points in merged.maps])
    numbers = [
        np.full(points.valid.shape, number, np.float32)
        for number, points in enumerate(merged.maps, start=1)
    ]
    drawing = Drawing(3)
    panels = drawing.subplots(1, 3)
    draw_cells(panels[0], gridded(points_mm, points_mm[:, 2]), "merged heights", "z (mm)")
    draw_cells(panels[1], gridded(points_mm, sigma_um), "predicted sigma of z", "um")
    cameras = gridded(points_mm, merged.of_all(numbers))
    draw_cells(panels[2], cameras, "first camera with a point", "number")
    return drawing
