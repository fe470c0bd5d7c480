"""Reconstruct a capture folder, rendered or from a real rig; no renderer is needed."""

from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from reconstruction.capture.folder import read_capture
from reconstruction.decoding.decode import Reason
from reconstruction.outputs import write_reconstruction
from reconstruction.pipeline import Reconstruction, filter_bias, reconstruct
from reconstruction.surface_files import write_surface
from reconstruction.triangulation.triangulate import Use
from twin.config.models import Decode
from twin.output import EXPERIMENT_FILE, RESULT_FILE, output_folder, versions, write_json
from twin.pipeline.fringes import options_of
from twin.pipeline.progress import Watcher, nobody


def reconstruct_capture(
    capture_folder: Path, out: Path, decode: Decode, watch: Watcher = nobody
) -> dict[str, Any]:
    """Reconstruct `capture_folder` into `out`; returns the figures also written to result.json.

    Raises
    ------
    InputError
        The capture is incomplete or damaged, or `out` cannot be written.
    """
    with output_folder(out, [capture_folder]) as folder:
        watch("read", 0.0)
        capture = read_capture(capture_folder)
        watch("read", 1.0)
        watch("reconstruct", 0.0)
        result = reconstruct(capture, options_of(decode))
        watch("reconstruct", 1.0)
        figures = reconstruction_metrics(result, decode.use)
        write_reconstruction(folder / "reconstruction.nc", result.decoded, result.point_map)
        write_surface(folder, result.point_map)
        settings = tomli_w.dumps({"decode": decode.model_dump(mode="json")})
        (folder / EXPERIMENT_FILE).write_text(settings, encoding="utf-8")
        content = {"command": "reconstruct", "metrics": figures, "versions": versions()}
        write_json(folder / RESULT_FILE, {"schema_version": 1, **content})
    return figures


def reconstruction_metrics(result: Reconstruction, use: Use) -> dict[str, Any]:
    """Count the valid points and, by reason, the masked pixels; say how well they are known."""
    reasons = result.point_map.mask_reason
    figures: dict[str, Any] = {
        "points": int(result.point_map.valid.sum()),
        "valid_share": float(result.point_map.valid.mean()),
    }
    if figures["points"]:
        sigma = result.point_map.sigma_z_mm[result.point_map.valid]
        figures["sigma_z_median_um"] = float(1e3 * np.median(sigma))
        bias_um, bias_share = filter_bias(result, use, result.point_map.valid)
        figures |= {"filter_bias_um": bias_um, "filter_bias_share": bias_share}
    for reason in Reason:
        if reason is not Reason.VALID:
            figures[f"masked_{reason.name.lower()}"] = int((reasons == reason).sum())
    return figures
