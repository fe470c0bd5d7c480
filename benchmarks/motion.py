"""Frames of a moving scene: accuracy against scenes at rest, and time relative to one at rest.

Accuracy: a plane and a ball on a stage move along z, and across the view, at 0.1, 1 and 10 mm/s.
Frames of each sequence, a phase frame and a code frame at both ends and one in between, are
compared with the mean of stacks at rest, one at each Gauss node of the exposure, with a displaced
and separately loaded mesh. The error of the projector coordinate is that of random pixels, each
traced at its own time. The last line has the largest of all cases.

Time: loading and rendering of the shipped moving ball, all frames of 18 steps along both axes,
relative to the ball at rest; median of alternating turns after a warm-up of each.

Decoding and scan: the figures of `motion_decoding` and of `scan`, which have their own texts
(--quick: one speed, one scan).

Last line: {"radiance_rms_percent": percent of the mean white level, "coordinate_rms_px": px,
"time_over_rest": ratio, ..., "predicted_over_actual", "compensation_gain", ...,
"scan_map_error_ratio", "registration_error_over_sigma"}.
"""

from pathlib import Path
from typing import Any

import numpy as np

from benchmarks._harness import in_turns, print_figures, quick_parser
from benchmarks.motion_decoding import decoding_figures
from benchmarks.scan import SCANS, scan_figures
from twin.config import Experiment, load_experiment

SMALL = {"camera.binning": 4, "camera.width_px": 640, "camera.height_px": 480}
FAST = {"camera.exposure_ms": 2.8, "camera.frame_rate_hz": 130.0}
# The plane is a disc. Its centre, with thin facets that lose rays, is out of view.
DISC = Path(__file__).parents[1] / "tests" / "optics" / "disc_on_stage.toml"
SPECIMENS: dict[str, tuple[str | Path, dict[str, Any]]] = {
    "ball": ("examples/moving_ball", {}),
    "plane": (DISC, {"specimen.diameter_mm": 60.0, "specimen.x_mm": 18.0}),
}
SPEEDS_MM_S = (0.1, 1.0, 10.0)
WHOLE = {"patterns.steps": 18, "patterns.axes": ["column", "row"]}
TURNS = 5


def main() -> None:
    """Print the errors of every case, and one JSON line."""
    quick = quick_parser(__doc__, "one speed, 484 x 366 pixels, one scan").parse_args().quick
    speeds_mm_s = SPEEDS_MM_S[-1:] if quick else SPEEDS_MM_S
    figures = accuracy(speeds_mm_s) | time_over_rest(binning=4 if quick else 2)
    scanned = scan_figures(1 if quick else SCANS)
    shown = ("scan_map_error_ratio", "registration_error_over_sigma")
    figures |= decoding_figures(speeds_mm_s) | {name: scanned[name] for name in shown}
    print_figures(figures)


def accuracy(speeds_mm_s: tuple[float, ...]) -> dict[str, float]:
    """Return the largest errors of all specimens, directions and speeds."""
    cases = [
        case_of(specimen, direction, speed)
        for specimen in SPECIMENS
        for direction in ("x_mm_s", "z_mm_s")
        for speed in speeds_mm_s
    ]
    errors = [errors_of(case) for case in cases]
    return {name: max(error[name] for error in errors) for name in errors[0]}


def case_of(specimen: str, direction: str, speed_mm_s: float) -> Experiment:
    """Return a specimen that moves in one direction only."""
    (name, changes) = SPECIMENS[specimen]
    rest = {"motion.x_mm_s": 0.0, "motion.z_mm_s": 0.0}
    motion = rest | {f"motion.{direction}": speed_mm_s}
    return load_experiment(name, SMALL | FAST | changes | motion)


def errors_of(experiment: Experiment) -> dict[str, float]:
    """Return the errors of radiance, percent of white, and of the projector coordinate, px."""
    from tests.oracles.moving_frames import frame_of_instants
    from twin.pipeline import render_bare

    stack = render_bare(experiment)
    assert stack.motion is not None
    brightest = np.max(stack.frames, axis=0)
    white, count = float(brightest[brightest > 0].mean()), len(stack.frames)
    errors = [
        stack.frames[frame] - frame_of_instants(experiment, frame, stack.motion.exposure_nodes)
        for frame in (0, count // 2, count - 3)
    ]
    figures = {
        "radiance_rms_percent": 100.0 * float(np.sqrt(np.mean(np.square(errors)))) / white,
        "coordinate_rms_px": stack.motion.coordinate_rms_px,
    }
    print(experiment.specimen.kind, experiment.motion.shift_mm(1.0), figures, stack.motion)
    return figures


def time_over_rest(binning: int) -> dict[str, float]:
    """Return the time of a moving stack over that of one at rest, and both times, s."""
    from twin.pipeline import render_bare

    moving = load_experiment(
        "examples/moving_ball", WHOLE | FAST | {"camera.binning": binning, "motion.x_mm_s": 1.0}
    )
    rest = load_experiment(
        "examples/moving_ball",
        WHOLE | FAST | {"camera.binning": binning, "motion.x_mm_s": 0.0, "motion.z_mm_s": 0.0},
    )
    calls = {"moving": lambda: render_bare(moving), "rest": lambda: render_bare(rest)}
    for call in calls.values():
        call()
    turns = in_turns(calls, TURNS)
    ratios = [turn["moving"] / turn["rest"] for turn in turns]
    seconds = {f"{name}_s": float(np.median([turn[name] for turn in turns])) for name in calls}
    return {"time_over_rest": float(np.median(ratios))} | seconds


if __name__ == "__main__":
    main()
