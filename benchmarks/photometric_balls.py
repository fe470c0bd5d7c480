"""Photometric decoder on real presses of balls: `python benchmarks/photometric_balls.py FOLDER`.

FOLDER has background.png and catalog.csv (a heading; then per press its folder, with gelsight.png,
and the ball's diameter in mm): the layout of the calibration set published with GelSLAM
(rpl-cmu/gelslam, example_calibration: 67 presses of 6.31 and 9.5 mm balls). Images are 8-bit RGB of
equal size, 0.0634 mm/px. They have no clear licence and are not in this repository.

Every second press calibrates and the others are measured, then vice versa. A press counts if its
contact is completely inside the image. `scale`: height of the cap between its centre and 0.8
contact radii over that of the ball; slope error: RMS length of the error within the contact; drift:
standard deviation of the height beyond three contact radii. The last line of the output is one JSON
object.
"""

import argparse
import csv
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks._harness import print_figures
from benchmarks.cap_height import cap_height_ratio
from reconstruction.arrays import Levels
from reconstruction.colour_maps import maps_in_order
from reconstruction.integration_schemes import SCHEMES
from reconstruction.photometric import (
    BallPress,
    PhotometricDecoder,
    PhotometricOptions,
    SensorCalibration,
    calibrate_sensor,
)
from reconstruction.photometric.calibration_ball import (
    ContactCircle,
    ball_slopes,
    find_contact_circle,
)
from reconstruction.photometric.images import mean_background, smoothed
from reconstruction.photometric.press_files import read_rgb

PITCH_MM = 0.0634
EDGE_PX = 35.0


def presses_of(folder: Path) -> list[BallPress]:
    """Return the presses of the catalogue in its order."""
    with (folder / "catalog.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.reader(file))[1:]
    return [
        BallPress(read_rgb(folder / name / "gelsight.png"), float(diameter))
        for name, diameter in rows
    ]


@dataclass(frozen=True)
class Scored:
    """One measured press: height of the cap over true, and the slope error inside the contact."""

    ball_mm: float
    scale: float
    slope_error: float


def score(decoder: PhotometricDecoder, press: BallPress, circle: ContactCircle) -> Scored:
    """Measure a press 4 px within its contact's circle."""
    result, ball_mm = decoder.decode(press.image), press.ball_diameter_mm
    inside = distance_px(result.height_mm.shape, circle) < circle.radius_px - 4.0
    places = np.argwhere(inside).astype(float)
    slopes = ball_slopes(circle, ball_mm / 2.0, PITCH_MM, places).T
    error = np.sqrt(np.mean(np.sum((result.slopes[:, inside] - slopes) ** 2, axis=0)))
    scale = cap_height_ratio(result.height_mm, circle, ball_mm / 2.0, PITCH_MM)
    return Scored(ball_mm, scale, float(error))


def drift_um(decoder: PhotometricDecoder, press: BallPress, circle: ContactCircle) -> float:
    """Return the height's standard deviation beyond three contact radii."""
    height_mm = decoder.decode(press.image).height_mm
    beyond = distance_px(height_mm.shape, circle) > 3.0 * circle.radius_px
    return float(1e3 * height_mm[beyond].std(dtype=np.float64))


def distance_px(shape: tuple[int, ...], circle: ContactCircle) -> Any:
    """Return the distance of each pixel from the middle of the contact."""
    row, col = np.indices(shape[:2])
    return np.hypot(row - circle.row_px, col - circle.col_px)


def whole(circle: ContactCircle, shape: tuple[int, ...]) -> bool:
    """Return True if the contact is inside the image."""
    places = (circle.row_px, shape[0]), (circle.col_px, shape[1])
    return all(EDGE_PX < at < size - 1 - EDGE_PX for at, size in places)


def held_out(presses: Sequence[BallPress], still: Levels, kind: str) -> dict[str, list[Scored]]:
    """Return the score of each press by integration scheme."""
    results: dict[str, list[Scored]] = {name: [] for name in SCHEMES.names()}
    for calibration, press, circle in _halves(presses, still, kind):
        for name in SCHEMES.names():
            decoder = PhotometricDecoder(calibration, PhotometricOptions(name))
            results[name].append(score(decoder, press, circle))
    return results


def held_out_drift(
    presses: Sequence[BallPress], still: Levels, options: PhotometricOptions
) -> list[tuple[float, float]]:
    """Return (ball's diameter mm, drift um) of each press."""
    return [
        (press.ball_diameter_mm, drift_um(PhotometricDecoder(half, options), press, circle))
        for half, press, circle in _halves(presses, still, "polynomial")
    ]


def _halves(
    presses: Sequence[BallPress], still: Levels, kind: str
) -> Iterator[tuple[SensorCalibration, BallPress, ContactCircle]]:
    """Yield each press with the calibration on the other half of the presses."""
    flat = smoothed(mean_background([still]), 3)
    circles = [find_contact_circle(smoothed(press.image, 3), flat) for press in presses]
    for half in (0, 1):
        calibration = calibrate_sensor(presses[half::2], [still], PITCH_MM, kind)
        for press, circle in zip(presses[1 - half :: 2], circles[1 - half :: 2], strict=True):
            if whole(circle, still.shape):
                yield calibration, press, circle


def main() -> None:
    """Print a line per map, scheme and ball, then everything as JSON."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args().folder
    presses, still = presses_of(folder), read_rgb(folder / "background.png")
    figures = {}
    for kind in [own.name for own in maps_in_order()]:
        for name, rows in held_out(presses, still, kind).items():
            for ball_mm in sorted({row.ball_mm for row in rows}):
                part = [row for row in rows if row.ball_mm == ball_mm]
                scales = np.array([row.scale for row in part])
                error = np.mean([row.slope_error for row in part])
                spread = f"{scales.mean():.3f} +- {scales.std(ddof=1):.3f}, slope error {error:.3f}"
                print(f"{kind} {name} {ball_mm:5.2f} mm, n = {len(part):2d}: scale {spread}")
                figures[f"{kind}_{name}_{ball_mm:g}"] = float(scales.mean())
    for prefix, relighting in (("", False), ("relit_", True)):
        drifts = np.array(held_out_drift(presses, still, PhotometricOptions(relighting=relighting)))
        for ball_mm in np.unique(drifts[:, 0]):
            drift = drifts[drifts[:, 0] == ball_mm, 1].mean()
            figures[f"{prefix}drift_um_{ball_mm:g}"] = float(drift)
    print_figures(figures)


if __name__ == "__main__":
    main()
