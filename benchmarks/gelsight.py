"""The comparison method: a rendered GelSight Mini, decoded by its vendor's and a textbook method.

- 6.31 mm balls at random places: cap height over true by the vendor's integration (2025 and 2024
  forms) and the corrected one; 29 real presses gave 0.66, 1.32 and 1.007.
- Twins of 67 presses on one real unit (`real_presses`): the gel before contact compared with two
  units' published tables; on the spots of every contact the change of levels; the change across
  the contact's edge; noise of a single frame (high-pass), and its correlation between two presses.
- The same twins calibrated and measured as the real ones, by halves: slope error within the
  contact, and drift of gel without contact with and without relighting.
- Two joined 8 mm balls pressed to the same depth into both sensors, then with the same force:
  GelSight's sphere-fit RMSE over that of contact-FPP, mean over both balls; the paper states 10.7.

Last line: {"faithful_2025", "faithful_2024", "corrected", "background_rms_grey",
"rmse_ratio_faithful" (2025 form), "rmse_ratio_corrected", "reconstruct_ms", ...}; ratios without
suffix are those of the polynomial map at the same depth.
"""

import statistics
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import cv2
import numpy as np

from benchmarks._harness import print_figures, quick_parser, seconds
from benchmarks.cap_height import cap_height_ratio
from benchmarks.fit_lamps import UNITS
from benchmarks.photometric_balls import distance_px, held_out, held_out_drift, whole
from benchmarks.real_presses import WIDE_PAD, RealPresses, circle_of, read_presses, spots_of, twins
from reconstruction.colour_maps import DEFAULT_MAP
from reconstruction.photometric import BallPress, PhotometricDecoder, PhotometricOptions
from reconstruction.photometric.calibration_ball import ContactCircle, find_contact_circle
from reconstruction.photometric.images import mean_background, smoothed
from twin.config import load_experiment, seed_sequence
from twin.config.lamps import CHANNELS
from twin.optics.backed_coat import seen_face
from twin.pipeline import Memory, measure, press_specimen
from twin.pipeline.colours import calibrated_sensor
from twin.pipeline.comparison import PhotometricPlan, case_for
from twin.pipeline.reference_presses import with_ball
from twin.results.decoders import DecodedImage
from twin.specimens.kinds.ball import Ball

SENSORS = Memory()
"""Sensors that are calibrated once for all cases."""

SCHEMES = {"corrected": "corrected", "faithful_2025": "sdk_2025", "faithful_2024": "sdk_2024"}
PAPER_RATIO = 10.7
# Real presses: noise in levels by channel; change at the edge by distance in contact radii, of all
# channels (6.31 mm balls); the others for (6.31, 9.5 mm) balls, drift in um.
REAL_NOISE = {"red": 2.12, "green": 1.46, "blue": 2.45}
REAL_EDGE = {0.2: 24.1, 0.6: 39.7, 1.0: 52.9, 1.2: 42.6, 1.5: 21.6, 2.0: 7.9, 2.5: 4.1}
REAL = {"drift_um": (41, 54), "relit_drift_um": (14, 12), "slope_error": (0.047, 0.046)}
BALL_MM, DEPTH_MM = 6.31, 0.7
# Half the field over which balls are pressed at random, x and y: sensitivities differ by place.
PRESSES_MM = (6.5, 4.5)
FIRST_IMAGE = 5000
REPEATS = 20


@dataclass(frozen=True, eq=False)
class Shot:
    """An image of the pressed ball, and the detected contact."""

    image: Any
    circle: ContactCircle


@dataclass(frozen=True, eq=False)
class Twins:
    """The real presses, and the images of their rendered twins, with the detected contacts.

    Attributes
    ----------
    still : (row, col, 3) uint8, image without contact
    """

    real: RealPresses
    presses: list[BallPress]
    circles: list[ContactCircle]
    still: Any

    @classmethod
    def of(cls, experiment: Any) -> "Twins":
        """Photograph them."""
        sensor, real = calibrated_sensor(experiment, SENSORS)[0], read_presses()
        still = mean_background(sensor.backgrounds())
        pressed = twins(sensor, real.presses)
        flat = smoothed(still, 3)
        circles = [find_contact_circle(smoothed(press.image, 3), flat) for press in pressed]
        return cls(real, pressed, circles, still.astype(np.uint8))

    def beyond(self, number: int, radii: float) -> Any:
        """Return the pixels farther from a contact than so many of its radii."""
        circle = self.circles[number]
        return distance_px(self.still.shape, circle) > radii * circle.radius_px


def main() -> None:
    """Measure and print one JSON line."""
    quick = quick_parser(__doc__, "fewer presses, coarser contact-FPP").parse_args().quick
    count = {"photometric.presses.count": 16 if quick else 50}
    experiment = load_experiment("examples/gelsight_ball", count | WIDE_PAD)
    figures = balls(experiment, shots_of(experiment, 4 if quick else 29))
    unit = Twins.of(experiment)
    figures |= lamps(unit) | noise(unit) | halves(unit) | two_balls(quick)
    print_figures(figures)


def shots_of(experiment: Any, count: int) -> list[Shot]:
    """Photograph a ball at random places; detect its contact as in practice."""
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
    image = sensor.image(seen_face(case, press_specimen(case)), number)
    return Shot(image, find_contact_circle(smoothed(image, 3), calibration.background))


def cap_ratios(experiment: Any, shots: list[Shot]) -> dict[str, list[float]]:
    """Return measured over true cap heights of every shot, by integration scheme."""
    sensor, calibration = calibrated_sensor(experiment, SENSORS)
    ratios = {}
    for name, scheme in SCHEMES.items():
        decoder = PhotometricDecoder(calibration, PhotometricOptions(integration=scheme))
        heights = ((decoder.decode(shot.image).height_mm, shot.circle) for shot in shots)
        ball = BALL_MM / 2, sensor.pitch_mm
        ratios[name] = [cap_height_ratio(*height, *ball) for height in heights]
    return ratios


def balls(experiment: Any, shots: list[Shot]) -> dict[str, float]:
    """Cap heights over true, and the time of a reconstruction."""
    figures = {}
    for name, values in cap_ratios(experiment, shots).items():
        print(f"{name}: {np.mean(values):.3f} +- {np.std(values):.3f} on {len(shots)} presses")
        figures[name] = float(np.mean(values))
    decoder = PhotometricDecoder(calibrated_sensor(experiment, SENSORS)[1])
    return figures | {"reconstruct_ms": decode_ms(decoder, shots[0].image)}


def decode_ms(decoder: PhotometricDecoder, image: Any) -> float:
    """Median wall-clock time of one image, after a first one."""
    times = [seconds(lambda: decoder.decode(image)) for _ in range(REPEATS + 1)]
    return 1e3 * statistics.median(times[1:])


def lamps(unit: Twins) -> dict[str, float]:
    """Compare the rendered images with those of real units, pressed at the same places."""
    rows, cols = (np.array_split(np.arange(n), 3) for n in unit.still.shape[:2])
    tiles = [[unit.still[np.ix_(r, c)].mean((0, 1)) for c in cols] for r in rows]
    print("rendered background\n", np.round(np.moveaxis(tiles, -1, 0), 1))
    change = np.concatenate([_spots(unit, number) for number in range(len(unit.presses))])
    off, real = change - unit.real.change, unit.real.change
    for name, part in (("rendered less real", off), ("real", real)):
        print(f"change on the spots, {name}, RMS by channel:", np.sqrt(np.mean(part**2, axis=0)))
    return {
        "background_rms_grey": _rms(UNITS - np.moveaxis(tiles, -1, 0)),
        "change_rms_grey": _rms(off),
        "change_rms_of_real": _rms(off) / _rms(real),
        "azimuth_error_deg": _azimuth_error_deg(unit.real, change),
    } | _edge(unit)


def _spots(unit: Twins, number: int) -> Any:
    """Return the change of levels on the spots of a real press, rendered, (spot, channel)."""
    image, circle = unit.presses[number].image, circle_of(unit.real.presses[number])
    return spots_of(image, circle)[1] - spots_of(unit.still, circle)[1]


def _azimuth_error_deg(real: RealPresses, change: Any) -> float:
    """Largest angle between the channels' directions of light, rendered and real, degrees."""
    angles = []
    for levels in (change, real.change):
        x, y, _ = np.linalg.lstsq(real.normals, levels, rcond=None)[0]
        angles.append(np.arctan2(y, x))
    turned = np.angle(np.exp(1j * (angles[0] - angles[1])))
    return float(np.degrees(np.abs(turned).max()))


def _edge(unit: Twins) -> dict[str, float]:
    """Colour difference by distance in contact radii, over that of real presses."""
    changes = []
    for press, circle in zip(unit.presses, unit.circles, strict=True):
        if press.ball_diameter_mm == BALL_MM and whole(circle, press.image.shape):
            change = np.linalg.norm(press.image - unit.still.astype(float), axis=-1)
            at = distance_px(press.image.shape, circle) / circle.radius_px
            changes.append([change[abs(at - ratio) < 0.05].mean() for ratio in REAL_EDGE])
    ratios = np.mean(changes, axis=0) / list(REAL_EDGE.values())
    print("colour difference over real, by contact radii", list(REAL_EDGE), ratios.round(2))
    by_place = dict(zip(REAL_EDGE, map(float, ratios), strict=True))
    names = {"edge_peak_ratio": 1.0, "edge_ratio": 1.2, "skirt_ratio": 1.5}
    return {name: by_place[place] for name, place in names.items()}


def noise(unit: Twins) -> dict[str, float]:
    """Noise of a single frame outside the contacts, and its correlation between two presses."""
    fine = [high_pass(press.image) for press in unit.presses]
    beyond = [unit.beyond(number, 2.5) for number in range(len(fine))]
    spread = np.mean(
        [noise[far].std(axis=0) for noise, far in zip(fine, beyond, strict=True)], axis=0
    )
    common = [
        np.corrcoef(a[near & far].ravel(), b[near & far].ravel())[0, 1]
        for (a, b), (near, far) in zip(pairwise(fine), pairwise(beyond), strict=True)
    ]
    print("noise, real", REAL_NOISE)
    figures = {
        f"noise_{name}_levels": float(part) for name, part in zip(CHANNELS, spread, strict=True)
    }
    return figures | {"texture_in_common": float(np.mean(common))}


def halves(unit: Twins) -> dict[str, float]:
    """Calibrate on every second twin, measure the others, and vice versa."""
    presses, still = unit.presses, unit.still
    rows = held_out(presses, still, "polynomial")["corrected"]
    figures = {
        "slope_error": _by_ball("slope_error", [(row.ball_mm, row.slope_error) for row in rows])
    }
    for name, relighting in (("drift_um", False), ("relit_drift_um", True)):
        options = PhotometricOptions(relighting=relighting)
        drifts = held_out_drift(presses, still, options)
        figures[name] = _by_ball(name, drifts)
    return figures


def _by_ball(name: str, values: Sequence[tuple[float, float]]) -> float:
    """Print the means of both balls and of real presses; return the mean of all presses."""
    table = np.array(values)
    for ball_mm, real in zip(np.unique(table[:, 0]), REAL[name], strict=True):
        part = table[table[:, 0] == ball_mm, 1]
        print(f"{name}, {ball_mm:g} mm balls: {part.mean():.3g} +- {part.std():.2g}, real {real}")
    return float(table[:, 1].mean())


def _rms(values: Any) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def high_pass(image: Any) -> Any:
    """Return the image less its Gaussian filter of 2 px, (row, col, channel)."""
    levels = image.astype(np.float32)
    return levels - cv2.GaussianBlur(levels, (0, 0), 2.0)


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
        for decoded in done.colours.decoded:
            figures[f"rmse_ratio_{_name(decoded)}{suffix}"] = _rmse_ratio(decoded, base_mm)
    return figures | {"rmse_ratio_faithful": figures["rmse_ratio_faithful_2025"]}


def _name(decoded: DecodedImage) -> str:
    scheme = next(name for name, scheme in SCHEMES.items() if scheme == decoded.integration)
    return scheme if decoded.colour_map == DEFAULT_MAP else f"{scheme}_{decoded.colour_map}"


def _rmse_ratio(decoded: DecodedImage, base_mm: float) -> float:
    """Print the fits of a decoded image; return its sphere-fit RMSE over that of contact-FPP."""
    rmse_mm, scored = _rmse_mm(decoded.score), decoded.score
    radii = ", ".join(f"{ball.measured.radius_mm:.3f}" for ball in scored.spheres)
    true_um = ", ".join(f"{1e3 * ball.true_face.stats.rmse_mm:.2f}" for ball in scored.spheres)
    ratio = f"{rmse_mm / base_mm:.2f} times contact-FPP (paper: {PAPER_RATIO})"
    fits = f"sphere fit RMSE {1e3 * rmse_mm:.2f} um (true coat {true_um}), radii {radii} mm"
    print(f"{_name(decoded)}: {fits}, {ratio}; z RMSE {decoded.errors.z_rmse_um:.1f} um")
    return rmse_mm / base_mm


def _rmse_mm(scored: Any) -> float:
    return float(np.mean([ball.measured.stats.rmse_mm for ball in scored.spheres]))


if __name__ == "__main__":
    main()
