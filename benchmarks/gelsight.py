"""The opponent: a rendered GelSight Mini, decoded as its vendor does and as a textbook would.

- 6.31 mm balls at random places: cap height over true by the vendor's integration (2025 and 2024
  forms) and the corrected one; 29 real presses gave 0.66, 1.32 and 1.007.
- The rendered background against the published tables of two units; of presses at nine places
  where such a unit was pressed: how levels change with the normal, and across the contact's edge.
- Untouched gel in those presses, and the same on 67 real ones: noise of a single frame (high-pass),
  what of it two presses have in common, drift of the height with and without relighting; slope
  error within the contact.
- Two joined 8 mm balls pressed to the same depth into both sensors, then with the same force:
  GelSight's sphere-fit RMSE over that of contact-FPP, mean over both balls; the paper states 10.7.

Last line: {"faithful_2025", "faithful_2024", "corrected", "background_rms_grey",
"rmse_ratio_faithful" (2025 form), "rmse_ratio_corrected", "reconstruct_ms", ...}; ratios without
suffix are those of the polynomial map at the same depth.
"""

import argparse
import json
import statistics
import time
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import cv2
import numpy as np

from benchmarks.cap_height import cap_height_ratio
from benchmarks.fit_lamps import (
    CAP_TOP_MM,
    CONTACT_MM,
    PLACES_MM,
    PRESSES_MM,
    SENSITIVITY,
    UNITS,
    azimuth_error_deg,
    sensitivity,
)
from reconstruction.photometric import PhotometricDecoder, PhotometricOptions
from reconstruction.photometric.calibration_ball import (
    ContactCircle,
    ball_slopes,
    find_contact_circle,
)
from reconstruction.photometric.images import mean_background, smoothed
from twin.config import load_experiment, seed_sequence
from twin.config.lamps import CHANNELS
from twin.config.models import Ball
from twin.mechanics import face_mesh
from twin.pipeline import Memory, measure, press_specimen
from twin.pipeline.colours import calibrated_sensor, with_ball
from twin.pipeline.comparison import PhotometricPlan, case_for
from twin.results.decoders import DecodedImage

SENSORS = Memory()
"""Sensors that are calibrated once for all cases."""

SCHEMES = {"corrected": "corrected", "faithful_2025": "sdk_2025", "faithful_2024": "sdk_2024"}
PAPER_RATIO = 10.7
# 67 presses of one real unit: levels by channel; um without and with relighting (6.31, 9.5 mm).
REAL_NOISE = {"red": 2.12, "green": 1.46, "blue": 2.45}
# 35 presses of 6.31 mm: by distance over contact radius, levels (all channels together).
REAL_EDGE = {0.2: 24.1, 0.6: 39.7, 1.0: 52.9, 1.2: 42.6, 1.5: 21.6, 2.0: 7.9, 2.5: 4.1}
REAL_DRIFT_UM = {"drift_um": (50, 63), "relit_drift_um": (35, 28)}
BALL_MM, DEPTH_MM = 6.31, 0.7
FIRST_IMAGE, FIRST_PLACED = 5000, 6000
REPEATS = 20


@dataclass(frozen=True, eq=False)
class Shot:
    """An image of the pressed ball, and the contact found in it."""

    image: Any
    circle: ContactCircle


def main() -> None:
    """Measure and print one JSON line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="fewer presses, coarser contact-FPP")
    quick = parser.parse_args().quick
    experiment = load_experiment(
        "examples/gelsight_ball",
        {"photometric.presses.count": 16 if quick else 50},
    )
    shots = shots_of(experiment, 4 if quick else 29)
    figures = balls(experiment, shots) | lamps(experiment) | realism(experiment, shots)
    figures |= two_balls(quick)
    print(json.dumps({name: round(value, 3) for name, value in figures.items()}))


def shots_of(experiment: Any, count: int) -> list[Shot]:
    """Photograph one ball at random places; find its contact as in practice."""
    rng = np.random.default_rng(seed_sequence(experiment, "benchmark"))
    shots = []
    for number in range(count):
        x_mm, y_mm = rng.uniform(-1.0, 1.0, 2) * PRESSES_MM
        case = with_ball(experiment, Ball(diameter_mm=BALL_MM, x_mm=x_mm, y_mm=y_mm), DEPTH_MM)
        shots.append(photographed(experiment, case, FIRST_IMAGE + number))
    return shots


def photographed(experiment: Any, case: Any, number: int) -> Shot:
    """Photograph a press with the experiment's sensor; `number` keys the camera's noise."""
    sensor, calibration = calibrated_sensor(experiment, SENSORS)
    image = sensor.image(face_mesh(press_specimen(case)), number)
    return Shot(image, find_contact_circle(smoothed(image, 3), calibration.background))


def balls(experiment: Any, shots: list[Shot]) -> dict[str, float]:
    """Cap heights over true, and the time of a reconstruction."""
    sensor, calibration = calibrated_sensor(experiment, SENSORS)
    decoders = {
        name: PhotometricDecoder(calibration, PhotometricOptions(integration=scheme))
        for name, scheme in SCHEMES.items()
    }
    figures = {}
    for name, decoder in decoders.items():
        values = [
            cap_height_ratio(
                decoder.decode(shot.image).height_mm, shot.circle, BALL_MM / 2, sensor.pitch_mm
            )
            for shot in shots
        ]
        print(f"{name}: {np.mean(values):.3f} +- {np.std(values):.3f} on {len(shots)} presses")
        figures[name] = float(np.mean(values))
    return figures | {"reconstruct_ms": decode_ms(decoders["corrected"], shots[0].image)}


def decode_ms(decoder: PhotometricDecoder, image: Any) -> float:
    """Median wall-clock time of one image, after a first one."""
    times = []
    for _ in range(REPEATS + 1):
        start = time.perf_counter()
        decoder.decode(image)
        times.append(1e3 * (time.perf_counter() - start))
    return statistics.median(times[1:])


def lamps(experiment: Any) -> dict[str, float]:
    """Compare the rendered sensor with the images of real units, pressed at the same places."""
    sensor, _ = calibrated_sensor(experiment, SENSORS)
    background, pitch_mm = mean_background(sensor.backgrounds()), sensor.pitch_mm
    rows, cols = (np.array_split(np.arange(n), 3) for n in background.shape[:2])
    tiles = np.array([[background[np.ix_(r, c)].mean((0, 1)) for c in cols] for r in rows])
    shots = placed_shots(experiment)
    slopes = np.stack([_sensitivity(shot, background, pitch_mm) for shot in shots], axis=1)
    slopes = slopes.reshape(SENSITIVITY.shape)
    print("rendered background\n", np.round(np.moveaxis(tiles, -1, 0), 1))
    print("rendered sensitivity\n", np.round(slopes))
    found, real = (np.linalg.norm(s[..., :2], axis=-1) for s in (slopes, SENSITIVITY))
    return {
        "background_rms_grey": float(np.sqrt(np.mean((UNITS - np.moveaxis(tiles, -1, 0)) ** 2))),
        "azimuth_error_deg": azimuth_error_deg(slopes.mean(axis=(1, 2))),
        "sensitivity_ratio": float(found.mean() / real.mean()),
        "sensitivity_rms": float(np.sqrt(np.mean((slopes - SENSITIVITY)[..., :2] ** 2))),
    } | _edge(shots, background)


def placed_shots(experiment: Any) -> list[Shot]:
    """Photograph presses in the middles of nine tiles, as deep as the real ones."""
    places = [
        with_ball(experiment, Ball(diameter_mm=BALL_MM, x_mm=x_mm, y_mm=y_mm), CAP_TOP_MM)
        for x_mm, y_mm in PLACES_MM.reshape(9, 2)
    ]
    return [photographed(experiment, case, FIRST_PLACED + n) for n, case in enumerate(places)]


def _sensitivity(shot: Shot, background: Any, pitch_mm: float) -> Any:
    """Change of the level per unit of the normal in one press, (channel, xyz)."""
    inside = distance_px(shot) < CONTACT_MM / pitch_mm
    places = np.argwhere(inside).astype(float)
    slopes = ball_slopes(shot.circle, BALL_MM / 2, pitch_mm, places)
    normals = np.column_stack([-slopes[:, 1], slopes[:, 0], np.ones(len(slopes))])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return sensitivity((shot.image - background)[inside], normals)


def _edge(shots: list[Shot], background: Any) -> dict[str, float]:
    """Colour difference by distance over contact radius, beside that of real presses."""
    found = []
    for shot in shots:
        change = np.linalg.norm(shot.image - background, axis=-1)
        at = distance_px(shot) / shot.circle.radius_px
        found.append([change[abs(at - ratio) < 0.05].mean() for ratio in REAL_EDGE])
    ratios = np.mean(found, axis=0) / list(REAL_EDGE.values())
    print(
        "colour difference over real", dict(zip(REAL_EDGE, ratios.round(2).tolist(), strict=True))
    )
    names = {1.0: "edge_peak_ratio", 1.2: "edge_ratio", 1.5: "skirt_ratio"}
    by_place = dict(zip(REAL_EDGE, ratios, strict=True))
    return {name: float(by_place[ratio]) for ratio, name in names.items()}


def realism(experiment: Any, shots: list[Shot]) -> dict[str, float]:
    """Compare noise, texture and drift with those of 67 presses of a real unit."""
    _, calibration = calibrated_sensor(experiment, SENSORS)
    fine = [high_pass(shot.image) for shot in shots]
    apart = np.all([distance_px(shot) > 2.5 * shot.circle.radius_px for shot in shots], axis=0)
    noise = np.mean([image[apart].std(axis=0) for image in fine], axis=0)
    common = [np.corrcoef(a[apart].ravel(), b[apart].ravel())[0, 1] for a, b in pairwise(fine)]
    figures = {
        f"noise_{name}_levels": float(part) for name, part in zip(CHANNELS, noise, strict=True)
    }
    for name, relighting in (("drift_um", False), ("relit_drift_um", True)):
        options = PhotometricOptions(relighting=relighting)
        decoder = PhotometricDecoder(calibration, options)
        found = [untouched_drift_um(decoder, shot) for shot in shots]
        print(f"{name}: {np.mean(found):.1f} +- {np.std(found):.1f}, real {REAL_DRIFT_UM[name]}")
        figures[name] = float(np.mean(found))
    print("noise, real", REAL_NOISE)
    return figures | {
        "texture_in_common": float(np.mean(common)),
        "slope_error": float(np.mean([slope_error(decoder, shot) for shot in shots])),
    }


def high_pass(image: Any) -> Any:
    """Return what a Gaussian of 2 px removes, (row, col, channel)."""
    levels = image.astype(np.float32)
    return levels - cv2.GaussianBlur(levels, (0, 0), 2.0)


def distance_px(shot: Shot) -> Any:
    """Return the distance of each pixel from the middle of the contact."""
    row, col = np.indices(shot.image.shape[:2])
    return np.hypot(row - shot.circle.row_px, col - shot.circle.col_px)


def untouched_drift_um(decoder: PhotometricDecoder, shot: Shot) -> float:
    """Return the height's standard deviation beyond three contact radii."""
    height = decoder.decode(shot.image).height_mm[distance_px(shot) > 3.0 * shot.circle.radius_px]
    return float(1e3 * height.std(dtype=np.float64))


def slope_error(decoder: PhotometricDecoder, shot: Shot) -> float:
    """Return the RMS length of the slope's error inside the contact, 4 px within its circle."""
    inside = distance_px(shot) < shot.circle.radius_px - 4.0
    found = decoder.decode(shot.image).slopes[:, inside].T
    true = ball_slopes(
        shot.circle, BALL_MM / 2, decoder.calibration.pitch_mm, np.argwhere(inside).astype(float)
    )
    return float(np.sqrt(np.mean(np.sum((found - true) ** 2, axis=1))))


def two_balls(quick: bool) -> dict[str, float]:
    """Sphere fits on the same specimen: both sensors, all decoders, same depth and same force."""
    paper = load_experiment("examples/slab_balls", {"camera.binning": 2} if quick else {})
    base_mm = _rmse_mm(measure(paper).score)
    print(f"contact-FPP: sphere fit RMSE {1e3 * base_mm:.2f} um")
    count = {"photometric.presses.count": 16 if quick else 50}
    same = {
        "press.depth_mm": paper.press.depth_mm,
        "score.roi_radius_mm": paper.score.roi_radius_mm,
    }
    cases = {
        "": load_experiment("paper/gelsight_two_balls", count | same),
        "_same_force": case_for(paper, "photometric_stereo", PhotometricPlan(settings=count)),
    }
    figures = {}
    for suffix, case in cases.items():
        done = measure(case, memory=SENSORS)
        pressed = done.press
        print(f"GelSight pressed {pressed.depth_mm:.3f} mm deep with {pressed.force_n:.3f} N")
        for one in done.colours.decoded:
            figures[f"rmse_ratio_{_name(one)}{suffix}"] = _told(one, base_mm)
    return figures | {"rmse_ratio_faithful": figures["rmse_ratio_faithful_2025"]}


def _name(one: DecodedImage) -> str:
    scheme = next(name for name, integration in SCHEMES.items() if integration == one.integration)
    return scheme if one.colour_map == "polynomial" else f"{scheme}_table"


def _told(one: DecodedImage, base_mm: float) -> float:
    rmse_mm, scored = _rmse_mm(one.score), one.score
    radii = ", ".join(f"{ball.measured.radius_mm:.3f}" for ball in scored.spheres)
    true_um = ", ".join(f"{1e3 * ball.true_face.stats.rmse_mm:.2f}" for ball in scored.spheres)
    print(
        f"{_name(one)}: sphere fit RMSE {1e3 * rmse_mm:.2f} um (true coat {true_um}), radii {radii}"
        f" mm, {rmse_mm / base_mm:.2f} times contact-FPP (paper: {PAPER_RATIO}); z RMSE"
        f" {one.errors.z_rmse_um:.1f} um"
    )
    return rmse_mm / base_mm


def _rmse_mm(scored: Any) -> float:
    return float(np.mean([ball.measured.stats.rmse_mm for ball in scored.spheres]))


if __name__ == "__main__":
    main()
