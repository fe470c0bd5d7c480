"""Render docs/example_capture: what a rig owner's own folder looks like, small enough to ship.

.venv/bin/python docs/make_example_capture.py       (writes the folder anew; needs Mitsuba)

Two steel balls pressed into the coat, 8 steps, the middle of the camera, 4 x 4 pixels in one,
8 bits.
`truth.json` holds the true heights, which a real rig does not have.
"""

import json
import shutil
import sys
from dataclasses import asdict
from pathlib import Path

import imageio.v3 as imageio
import numpy as np

from reconstruction.capture.description import file_names, write_patterns, write_toml
from reconstruction.capture.folder import Capture
from reconstruction.capture.recorded import FRAMES_FORMAT, FRAMES_VERSION
from reconstruction.rig.calibration import write_calibration
from twin.config import load_experiment
from twin.pipeline import Recording, press_specimen, record

FOLDER = Path(__file__).with_name("example_capture")
CAMERA = {"binning": 4, "width_px": 1280, "height_px": 960, "bit_depth": 8}
SETTINGS = {f"camera.{name}": value for name, value in CAMERA.items()} | {"patterns.steps": 8}
# One ball's crest and the flat coat beside it, as circles round world points, mm.
PLACES_MM = {"crest": (-4.0, 0.0), "flat": (0.0, -6.0)}
RADIUS_MM = 0.3


def main() -> None:
    """Render, and write images, description, manifest, calibration and true heights."""
    experiment = load_experiment("paper/two_balls", SETTINGS)
    recording = record(experiment, press_specimen(experiment))
    shutil.rmtree(FOLDER, ignore_errors=True)
    FOLDER.mkdir()
    write_frames(recording.capture)
    (FOLDER / "truth.json").write_text(json.dumps(true_heights(recording), indent=2) + "\n")
    size = sum(path.stat().st_size for path in FOLDER.iterdir())
    sys.stdout.write(f"wrote {FOLDER}: {size / 1e6:.2f} MB\n")


def write_frames(capture: Capture) -> None:
    """Write what a rig owner has: camera images, pattern manifest, calibration, description."""
    write_patterns(FOLDER, capture.patterns)
    # The camera's images take the names of the projected ones.
    for name, frame in zip(file_names(capture.patterns), capture.stack, strict=True):
        imageio.imwrite(FOLDER / name, frame.astype(np.uint8), optimize=True)
    write_calibration(FOLDER / "calibration.yaml", capture.calibration)
    header = {
        "format": FRAMES_FORMAT,
        "version": FRAMES_VERSION,
        "files": "{index:03d}_{name}.png",
        "bit_depth": capture.bit_depth,
        "patterns_file": "patterns.toml",
        "calibration_file": "calibration.yaml",
    }
    write_toml(FOLDER / "capture.toml", header, {"sensor": asdict(capture.sensor)})


def true_heights(recording: Recording) -> dict[str, float]:
    """Return the mean true z_mm of the coat at `PLACES_MM`."""
    points = recording.truth.points_world_mm
    heights = {}
    for name, (x_mm, y_mm) in PLACES_MM.items():
        near = np.hypot(points[..., 0] - x_mm, points[..., 1] - y_mm) < RADIUS_MM
        heights[f"{name}_z_mm"] = round(float(np.mean(points[near, 2])), 5)
    return heights


if __name__ == "__main__":
    main()
