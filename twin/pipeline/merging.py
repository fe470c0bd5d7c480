"""Reconstruct captures of one scene by several cameras with one projector, and merge the points."""

from collections.abc import Sequence
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
from reconstruction.evaluate.surface import grid_heights, typical_distance_mm, write_heights
from reconstruction.merging import CameraView, Merged, merge
from reconstruction.netcdf import PIXELS, LabelledArrays, write_arrays
from reconstruction.pipeline import Reconstruction, reconstruct, reconstruction_arrays, write_ply
from reconstruction.writing import write_bytes, write_text
from twin.config.digest import content_digest
from twin.config.models import Decode
from twin.output import EXPERIMENT_FILE, output_folder, write_outcome
from twin.pipeline.captures import options_of, require_points
from twin.pipeline.progress import ProgressCallback, no_progress

LARGE_BIRGE_RATIO = 3.0
"""Ratio above which the calibrations, not the noise, determine the error of the merged points."""


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
        views, results, digests = [], [], []
        for number, path in enumerate(captures):
            watch("reconstruct", number / len(captures))
            capture = read_capture(path)
            result = reconstruct(capture, options_of(decode))
            explain = partial(best_period, capture)
            require_points(path, result.point_map.mask_reason, explain)
            views.append(CameraView(result.point_map, capture.calibration))
            results.append(result)
            digests.append(content_digest(decode, capture))
        watch("reconstruct", 1.0)
        watch("merge", 0.0)
        merged = merge(views)
        _write(folder, merged, results)
        watch("merge", 1.0)
        figures = merged_metrics(merged)
        settings = {
            "decode": decode.model_dump(mode="json"),
            "captures": [str(c) for c in captures],
        }
        write_text(folder / EXPERIMENT_FILE, tomli_w.dumps(settings))
        write_outcome(folder, "merge", figures, digest=" ".join(digests))
    return figures


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
    ratio = figures["birge_ratio"]
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
