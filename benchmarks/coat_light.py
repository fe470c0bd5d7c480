"""Light that drifts and flickers during a sequence: error of z before and after its estimation.

One rendered stack of the paper's sensor, two balls pressed in, is exposed with steady light, with
a lamp that drifts by 1 % over the 18 frames of a fringe set, with flicker of 0.5 % from frame to
frame, and with both. All exposures have the same random numbers of the noise. The error is the RMS
over the pixels of z minus z under steady light; it contains the noise of the estimated gains. The
last line has the largest over all lamps with `decode.frame_gains`, the largest without, and the
largest change of a ball's fitted radius with and without.

Last line: {"drift_left_um": um, "drift_uncorrected_um": um, "radius_left_um": um,
"radius_uncorrected_um": um}.
"""

from typing import Any

import numpy as np

from benchmarks._harness import print_figures, quick_parser
from reconstruction.pipeline import Reconstruction, reconstruct
from twin.config import Experiment, load_experiment, vary
from twin.mechanics import PressedElastomer
from twin.optics.stack import RadianceStack
from twin.pipeline import press_specimen
from twin.pipeline.captures import options_of
from twin.pipeline.fringes import evaluate, expose_capture, record
from twin.pipeline.progress import Stopwatch

FLICKER_TRIALS = 3
DRIFT_PERCENT = 1.0
"""Drift over the frames of one fringe set, percent."""


def main() -> None:
    """Print the errors of z of every lamp, and one JSON line."""
    parser = quick_parser(__doc__, "484 x 366 instead of 968 x 732")
    print_figures(coat_light(parser.parse_args().quick))


def coat_light(quick: bool) -> dict[str, float]:
    """Return the errors of two balls under light that changes, see the module docstring."""
    binning = 4 if quick else 2
    experiment = load_experiment("examples/slab_balls", {"camera.binning": binning})
    pressed = press_specimen(experiment)
    recording = record(experiment, pressed)
    return drift_left_um(experiment, pressed, recording.radiance)


def drift_left_um(
    experiment: Experiment, pressed: PressedElastomer, radiance: RadianceStack
) -> dict[str, float]:
    """Return the figures of the last line.

    Parameters
    ----------
    radiance : rendered frames of `experiment` on the face of `pressed`
    """
    steady = {0: _measured(experiment, pressed, radiance, 0)}
    errors: dict[bool, list[tuple[float, float]]] = {True: [], False: []}
    for name, lamp, trial in _lamps(experiment, len(radiance.frames)):
        if trial not in steady:
            steady[trial] = _measured(experiment, pressed, radiance, trial)
        for corrected, differences in errors.items():
            changed = vary(experiment, {**lamp, "decode.frame_gains": corrected})
            result = _measured(changed, pressed, radiance, trial)
            z_um, radius_um = _difference_um(result, steady[trial])
            differences.append((z_um, radius_um))
            label = "estimated" if corrected else "neglected"
            print(f"{name}, light {label}: z {z_um:.3f} um, radius {radius_um:.2f} um")
    left, whole = (np.max(errors[corrected], axis=0) for corrected in (True, False))
    return {
        "drift_left_um": float(left[0]),
        "drift_uncorrected_um": float(whole[0]),
        "radius_left_um": float(left[1]),
        "radius_uncorrected_um": float(whole[1]),
    }


def _lamps(experiment: Experiment, frames: int) -> list[tuple[str, dict[str, Any], int]]:
    """Return name, settings and trial of every lamp; the trial selects its flicker."""
    drift = DRIFT_PERCENT * (frames - 1) / (experiment.patterns.steps - 1)
    drifting, flickering = {"projector.drift_percent": drift}, {"projector.flicker_percent": 0.5}
    warming = {"projector.drift_percent": 1.0, "projector.drift_frames": 10.0}
    return [
        ("linear drift", drifting, 0),
        ("exponential drift", warming, 0),
        *((f"flicker {trial}", flickering, trial) for trial in range(FLICKER_TRIALS)),
        ("drift and flicker", drifting | flickering, 0),
    ]


Measured = tuple[Reconstruction, dict[str, Any]]


def _measured(
    experiment: Experiment, pressed: PressedElastomer, radiance: RadianceStack, trial: int
) -> Measured:
    recording = expose_capture(experiment, radiance, Stopwatch(), trial)
    points = reconstruct(recording.capture, options_of(experiment.decode))
    return points, dict(evaluate(experiment, pressed, recording, points).metrics)


def _difference_um(result: Measured, expected: Measured) -> tuple[float, float]:
    """Return the RMS difference of z over all pixels, and the largest of the balls' radii."""
    maps = result[0].point_map, expected[0].point_map
    both = maps[0].valid & maps[1].valid
    z_mm = [points.points_world_mm[..., 2].astype(np.float64)[both] for points in maps]
    radii = [name for name in expected[1] if name.endswith("_radius_mm")]
    moved = [abs(result[1][name] - expected[1][name]) for name in radii]
    return 1e3 * float(np.sqrt(np.mean((z_mm[0] - z_mm[1]) ** 2))), 1e3 * max(moved)


if __name__ == "__main__":
    main()
