"""Scan of a 60 x 20 mm part from 8 rendered patches: error of the map and of the poses.

    ./run bench scan [--quick]

The shipped plan `scans/plate` with 20 errors of the stage (--quick: 2), each drawn with another
seed; every patch is rendered, with noise, and decoded.

- `scan_map_error_ratio`: RMS error of the map, after the best common rigid motion, over that of the
  single patches; median over the scans. Target: 2 or less.
- `scan_map_on_stage_ratio`: the same without this motion, which only the stage determines.
- `registration_error_over_sigma`: RMS over all patches and coordinates of the error of a pose over
  its standard deviation. Target: 0.8 to 1.25.
- `seam_rms_um`: RMS difference of overlapping patches, median over the scans.
- `seconds`: wall-clock time of a scan.

Last line: {"scan_map_error_ratio", "scan_map_on_stage_ratio", "registration_error_over_sigma",
"seam_rms_um", "seconds"}.
"""

import tempfile
from dataclasses import replace
from pathlib import Path
from time import perf_counter

import numpy as np

from benchmarks._harness import print_figures, quick_parser
from twin.config.scan import LoadedScan, load_scan
from twin.pipeline.scan import run_scan

SCANS, QUICK_SCANS = 20, 2


def main() -> None:
    parser = quick_parser(__doc__ or "", "2 scans")
    print_figures(scan_figures(QUICK_SCANS if parser.parse_args().quick else SCANS))


def scan_figures(scans: int) -> dict[str, float]:
    """Scan the plate with several errors of the stage."""
    plan, start = load_scan(Path("scans/plate")), perf_counter()
    rows = [_scanned(plan, seed) for seed in range(scans)]
    squares = [row["registration_error_over_sigma"] ** 2 for row in rows]
    return {
        "scan_map_error_ratio": _median_ratio(rows, "map_form_rmse_um"),
        "scan_map_on_stage_ratio": _median_ratio(rows, "map_rmse_um"),
        "registration_error_over_sigma": float(np.sqrt(np.mean(squares))),
        "seam_rms_um": float(np.median([row["seam_rms_um"] for row in rows])),
        "seconds": (perf_counter() - start) / scans,
    }


def _scanned(loaded: LoadedScan, seed: int) -> dict[str, float]:
    plan = loaded.plan.model_copy(update={"seed": seed})
    with tempfile.TemporaryDirectory() as folder:
        figures = run_scan(replace(loaded, plan=plan), Path(folder) / "scan").figures
    shown = ("map_form_rmse_um", "map_rmse_um", "patch_rmse_um", "registration_error_over_sigma")
    print(f"seed {seed}: " + ", ".join(f"{name} {figures[name]:.3g}" for name in shown), flush=True)
    return figures


def _median_ratio(rows: list[dict[str, float]], name: str) -> float:
    return float(np.median([row[name] / row["patch_rmse_um"] for row in rows]))


if __name__ == "__main__":
    main()
