"""Accuracy of decoder, press and photometric stereo, by the functions of their own benchmarks."""

import statistics

from benchmarks import mechanics
from benchmarks.cap_height import cap_height_ratio
from benchmarks.decode import ideal_rms_px
from benchmarks.direct import energy_gap
from benchmarks.gelsight import (
    BALL_MM,
    DEPTH_MM,
    FIRST_IMAGE,
    SCHEMES,
    SENSORS,
    Shot,
    photographed,
)
from benchmarks.regression.cases import repeated
from benchmarks.regression.figures import Values
from reconstruction.photometric import PhotometricDecoder, PhotometricOptions
from twin.config import Experiment, load_experiment
from twin.pipeline.colours import calibrated_sensor, with_ball
from twin.specimens.kinds.ball import Ball

FEW_PRESSES = {"photometric.presses.count": 16}
PLACES_MM = ((0.0, 0.0), (5.0, 2.5), (-4.0, -3.0), (4.0, -3.0), (-5.0, 2.5))


def decode(seeds: int = 5) -> Values:
    """Decode exact and 8-bit frames at random coordinates."""

    def once(seed: int) -> dict[str, float]:
        return {f"decode_{name}": value for name, value in ideal_rms_px(seed).items()}

    return repeated(seeds, once)


def press() -> Values:
    """Press a paraboloid on a half-space, balls on bonded layers, and one beyond small strain."""
    values = {
        "press_hertz_force_rel": mechanics.hertz_force_rel(),
        "press_fredholm_force_rel": mechanics.fredholm_max_rel(),
        "press_large_strain_face_um": mechanics.nh_face_rms_um(quick=True),
    }
    return {name: [value] for name, value in values.items() if value is not None}


def photons(seeds: int = 3) -> Values:
    """Follow light into the clear brick, and ask where it all went."""
    settings = {"camera.binning": 4, "modality": "direct_fpp"}
    experiment = load_experiment("paper/brick", settings)
    return repeated(seeds, lambda seed: {"photons_energy_gap_rel": energy_gap(experiment, seed)})


def gelsight(seeds: int = 4) -> Values:
    """Measure caps of a ball with a GelSight-like sensor: few calibration balls, anew every time.

    The places are the same for all seeds: a place differs from the next by more (6 %) than its mean
    over the places does from seed to seed.
    """
    return repeated(seeds, caps)


def caps(seed: int) -> dict[str, float]:
    """Return heights of the cap over the true one, mean over the places, by integration."""
    experiment = load_experiment("examples/gelsight_ball", FEW_PRESSES | {"seed": seed})
    sensor, rendered = calibrated_sensor(experiment, SENSORS)
    shots = [photograph(experiment, number) for number in range(len(PLACES_MM))]
    found = {}
    for name, scheme in SCHEMES.items():
        decoder = PhotometricDecoder(rendered, PhotometricOptions(integration=scheme))
        ratios = [cap_ratio(decoder, shot, sensor.pitch_mm) for shot in shots]
        found[f"gelsight_cap_{name}"] = statistics.fmean(ratios)
    return found


def photograph(experiment: Experiment, number: int) -> Shot:
    """Photograph the ball in one of the places; find its contact as in practice."""
    x_mm, y_mm = PLACES_MM[number]
    ball = Ball(diameter_mm=BALL_MM, x_mm=x_mm, y_mm=y_mm)
    return photographed(experiment, with_ball(experiment, ball, DEPTH_MM), FIRST_IMAGE + number)


def cap_ratio(decoder: PhotometricDecoder, shot: Shot, pitch_mm: float) -> float:
    """Return the height of the cap over the true one."""
    height_mm = decoder.decode(shot.image).height_mm
    return cap_height_ratio(height_mm, shot.circle, BALL_MM / 2, pitch_mm)


def fem() -> Values:
    """Press a ball into a free slab of tetrahedra; their mesh differs from run to run."""
    found_um = mechanics.free_fem_face_um()
    return {} if found_um is None else {"fem_face_um": [found_um]}
