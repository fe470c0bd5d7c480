"""Decoded frames of a moving plane and ball: predicted over actual error, gain of compensation.

    ./run bench motion_decoding [--quick]

A plane and a matt ball move along z, and across the view, at 0.1, 1 and 10 mm/s (--quick: 10). The
actual error of a coordinate is that of noise-free frames against the scene at rest in the middle of
the phase frames, or at time 0 with an encoder. A plane that moves across the view has none.

- `predicted_over_actual`: of four steps with noise; median over the pixels whose actual error
  exceeds its noise. Of all cases with 5 % such pixels the one farthest from 1. Target: 0.8 to 1.25.
- `whole_predicted_over_actual`: the same of world z against the truth of time 0, with the lag of
  the phase frames: the figure `motion_predicted_over_actual` of result.json.
- `compensation_gain`: RMS error of four steps over that of six cyclic steps and that of four steps
  with an encoder, of motion along z; the smallest. Target: 5.
- `gain_across_encoder`, `gain_across_binomial`, `gain_across_windowed`: the same of the ball that
  moves across the view, whose shading and slope change at each pixel; windowed: 7 cyclic frames.

Errors are those of pixels at least `MARGIN_PX` from the edges of the specimen, on slopes below 60
degrees, modulo the period: a Gray frame at another time may give a wrong order. Last line: these
figures.
"""

from typing import Any

import numpy as np
from scipy import ndimage

from benchmarks._harness import print_figures, quick_parser
from reconstruction.arrays import BoolImage, FloatArray
from twin.config import Experiment

SPEEDS_MM_S = (0.1, 1.0, 10.0)
CASES = (("plane", "z_mm_s"), ("ball", "z_mm_s"), ("ball", "x_mm_s"))
FOUR: dict[str, Any] = {"patterns.steps": 4}
SEQUENCES: dict[str, dict[str, Any]] = {
    "four steps": FOUR,
    "binomial": {"patterns.steps": 6, "patterns.stepping": "cyclic"},
    "windowed": {"patterns.steps": 7, "patterns.stepping": "windowed"},
    "quarter pairs": {"patterns.steps": 6, "patterns.stepping": "quarter_pairs"},
    "encoder": FOUR | {"motion.encoder": True},
}
_ACROSS = ("encoder", "binomial", "windowed")
MARGIN_PX, LEAST_NORMAL_Z = 6, 0.5
LEAST_SHARE = 0.05


def main() -> None:
    """Print the errors of every case, and one JSON line."""
    quick = quick_parser(__doc__, "one speed").parse_args().quick
    print_figures(decoding_figures(SPEEDS_MM_S[-1:] if quick else SPEEDS_MM_S))


def decoding_figures(speeds_mm_s: tuple[float, ...]) -> dict[str, float]:
    """Return predicted over actual errors, and gains of compensation, of all cases."""
    ratios, whole, gains = [], [], []
    across: dict[str, float] = {}
    for specimen, direction in CASES:
        for speed_mm_s in speeds_mm_s:
            ratio, whole_ratio = predicted_over_actual(specimen, direction, speed_mm_s)
            ratios += [] if ratio is None else [ratio]
            whole += [] if whole_ratio is None else [whole_ratio]
        of_case = gains_of(specimen, direction, speeds_mm_s[-1])
        if direction == "x_mm_s":
            across = {f"gain_across_{name}": of_case[name] for name in _ACROSS}
        else:
            gains += [of_case["binomial"], of_case["encoder"]]
    return {
        "predicted_over_actual": _farthest(ratios),
        "whole_predicted_over_actual": _farthest(whole),
        "compensation_gain": min(gains),
    } | across


def _farthest(ratios: list[float]) -> float:
    return max(ratios, key=lambda ratio: abs(np.log(ratio)))


def predicted_over_actual(
    specimen: str, direction: str, speed_mm_s: float
) -> tuple[float | None, float | None]:
    """Return predicted over actual error of the coordinate, and of z against time 0, or None."""
    import twin

    experiment = _case(specimen, direction, speed_mm_s, FOUR)
    measured = twin.measure(experiment)
    reconstruction = measured.fringes.reconstruction
    assert reconstruction.motion is not None
    actual_px, known = actual_error_px(experiment)
    predicted_px = reconstruction.motion.axes["column"].error_px
    clear = known & measured.points.valid
    count = int(clear.sum())
    clear &= np.abs(actual_px) > reconstruction.decoded.column.sigma_px
    share = float(clear.sum()) / count
    ratio = None
    if share > LEAST_SHARE:
        ratio = float(np.median(np.abs(predicted_px[clear]) / np.abs(actual_px[clear])))
    whole = measured.figures["motion_predicted_over_actual"]
    names = "z_rmse_um", "z_p95_um", "motion_error_rms_um", "motion_lag_rms_um"
    figures = {name: measured.figures[name] for name in names}
    print(specimen, direction, speed_mm_s, ratio, whole, f"{share:.0%}", figures, flush=True)
    return ratio, whole


def gains_of(specimen: str, direction: str, speed_mm_s: float) -> dict[str, float]:
    """Return the RMS error of four steps over that of each sequence."""
    rms_px = {}
    for name, keys in SEQUENCES.items():
        experiment = _case(specimen, direction, speed_mm_s, keys)
        error_px, inner = actual_error_px(experiment)
        rms_px[name] = float(np.sqrt(np.mean(np.square(error_px[inner]))))
    print(specimen, direction, speed_mm_s, "RMS error, px:", rms_px, flush=True)
    return {name: rms_px["four steps"] / value for name, value in rms_px.items()}


def actual_error_px(experiment: Experiment) -> tuple[FloatArray, BoolImage]:
    """Return the errors of the columns (row, col) by motion, and the pixels inside the specimen."""
    import twin
    from twin.config.instant import experiment_at
    from twin.optics.frame_times import mean_times_s

    camera = experiment.camera.model_copy(update={"noise": False})
    quiet = experiment.model_copy(update={"camera": camera})
    middle_s = float(mean_times_s(quiet)[: quiet.patterns.steps].mean())
    rest = experiment_at(quiet, 0.0 if quiet.motion.encoder else middle_s)
    moved, rested = twin.measure(quiet), twin.measure(rest)
    columns = [
        done.fringes.reconstruction.decoded.column.coordinate_px.astype(float)
        for done in (moved, rested)
    ]
    truth = rested.truth
    inside = truth.lit & truth.measured & (truth.normals_world[..., 2] > LEAST_NORMAL_Z)
    inside = ndimage.binary_erosion(inside, iterations=MARGIN_PX, border_value=1)
    period_px = experiment.patterns.period_px
    error_px = (columns[0] - columns[1] + period_px / 2.0) % period_px - period_px / 2.0
    return error_px, inside & moved.points.valid & rested.points.valid


def _case(specimen: str, direction: str, speed_mm_s: float, keys: dict[str, Any]) -> Experiment:
    from benchmarks.motion import FAST, SMALL, SPECIMENS
    from twin.config import load_experiment

    name, changes = SPECIMENS[specimen]
    rest = {"motion.x_mm_s": 0.0, "motion.z_mm_s": 0.0, "patterns.axes": ["column"]}
    motion = rest | {f"motion.{direction}": speed_mm_s}
    return load_experiment(name, SMALL | FAST | changes | motion | keys)


if __name__ == "__main__":
    main()
