"""Photometric decoder on real presses of balls: `python benchmarks/photometric_balls.py FOLDER`.

FOLDER holds background.png and catalog.csv (first row a heading; then the folder of a press, which
holds gelsight.png, and the ball's diameter in mm): the layout of the calibration set published
with GelSLAM (rpl-cmu/gelslam, example_calibration: 67 presses of 6.31 and 9.5 mm balls). Images are
8-bit RGB of equal size, 0.0634 mm/px. They have no clear licence and are not in this repository.

Every second press calibrates, the others are measured, then the other way round. A press counts
when its contact lies wholly inside the image. `scale` is the height of the cap between its centre
and 0.8 contact radii over that of the ball. The last line of the output is one JSON object.
"""

import argparse
import csv
import json
from pathlib import Path

import numpy as np

from reconstruction.photometric import (
    BallPress,
    PhotometricDecoder,
    PhotometricOptions,
    calibrate_sensor,
)
from reconstruction.photometric.calibration_ball import ball_slopes, find_contact_circle
from reconstruction.photometric.images import mean_background, smoothed
from reconstruction.photometric.integrate import INTEGRATIONS
from reconstruction.photometric.press_files import read_rgb

PITCH_MM = 0.0634
EDGE_PX = 35.0
RING = 0.8


def presses_of(folder: Path) -> list[BallPress]:
    """Return the presses of the catalogue in its order."""
    with (folder / "catalog.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.reader(file))[1:]
    return [
        BallPress(read_rgb(folder / name / "gelsight.png"), float(diameter))
        for name, diameter in rows
    ]


def cap_mm(height_mm: np.ndarray, radii_px: np.ndarray, contact_px: float) -> float:
    """Return the height of the centre above the ring at 0.8 contact radii."""
    ring = np.abs(radii_px - RING * contact_px) < 0.7
    return float(height_mm[radii_px < 1.5].mean() - height_mm[ring].mean())


def score(decoder: PhotometricDecoder, press: BallPress, circle) -> tuple[float, float]:
    """Return cap height over true, and the RMS error of the slope inside the contact."""
    found = decoder.decode(press.image)
    row, col = np.indices(found.height_mm.shape)
    radii_px = np.hypot(row - circle.row_px, col - circle.col_px)
    ball_mm = press.ball_diameter_mm / 2.0
    true_mm = np.sqrt(np.maximum(ball_mm**2 - (radii_px * PITCH_MM) ** 2, 0.0))
    inside = radii_px < circle.radius_px - 4.0
    slopes = ball_slopes(circle, ball_mm, PITCH_MM, np.argwhere(inside).astype(float)).T
    error = np.sqrt(np.mean(np.sum((found.slopes[:, inside] - slopes) ** 2, axis=0)))
    heights = found.height_mm.astype(float), true_mm
    return np.divide(*(cap_mm(h, radii_px, circle.radius_px) for h in heights)), float(error)


def whole(circle, shape: tuple[int, ...]) -> bool:
    """Whether the contact lies inside the image."""
    return (
        EDGE_PX < circle.row_px < shape[0] - 1 - EDGE_PX
        and EDGE_PX < circle.col_px < shape[1] - 1 - EDGE_PX
    )


def held_out(presses: list[BallPress], still: np.ndarray, kind: str) -> dict[str, list]:
    """Return (diameter, scale, slope error) of all measured presses by integration."""
    flat = smoothed(mean_background([still]), 3)
    circles = [find_contact_circle(smoothed(press.image, 3), flat) for press in presses]
    results: dict[str, list] = {name: [] for name in INTEGRATIONS}
    for half in (0, 1):
        calibration = calibrate_sensor(presses[half::2], [still], PITCH_MM, kind)
        for name in INTEGRATIONS:
            decoder = PhotometricDecoder(calibration, PhotometricOptions(name))
            for press, circle in zip(presses[1 - half :: 2], circles[1 - half :: 2], strict=True):
                if whole(circle, still.shape):
                    measured = score(decoder, press, circle)
                    results[name].append((press.ball_diameter_mm, *measured))
    return results


def main() -> None:
    """Print a line per map, scheme and ball, then everything as JSON."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args().folder
    presses, still = presses_of(folder), read_rgb(folder / "background.png")
    figures = {}
    for kind in ("polynomial", "table"):
        for name, rows in held_out(presses, still, kind).items():
            values = np.array(rows)
            for diameter in np.unique(values[:, 0]):
                part = values[values[:, 0] == diameter]
                mean, spread = part[:, 1].mean(), part[:, 1].std(ddof=1)
                print(
                    f"{kind:10s} {name:9s} {diameter:5.2f} mm, n = {len(part):2d}: "
                    f"scale {mean:.3f} +- {spread:.3f}, slope error {part[:, 2].mean():.3f}"
                )
                figures[f"{kind}_{name}_{diameter:g}"] = round(float(mean), 4)
    print(json.dumps(figures))


if __name__ == "__main__":
    main()
