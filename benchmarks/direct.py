"""Bare metal and clear plastic: noise, energy and speed of the light traced from the projector.

For nut, brick and two balls, at the default samples: the stack rendered with two seeds.

- `firefly_rel`: largest relative difference of the white frame's 99.99th percentile between seeds;
- `energy_rel`: largest relative gap between the flux sent into the specimen and the sum absorbed,
  deposited, lost or escaped; paths that were cut short count as missing;
- `phase_noise_px`: largest robust spread of the difference between the two decoded projector
  columns over pixels valid in both: the noise that the random paths add to the sensor's noise;
- `stack_s`: seconds of the slowest stack, photons included, kernels compiled before.

Last line: {"firefly_rel": ..., "energy_rel": ..., "phase_noise_px": ..., "stack_s": ...}.
"""

from typing import Any

import numpy as np

from benchmarks._harness import print_figures, quick_parser, seconds
from reconstruction.decoding.decode import decode
from twin.camera import expose
from twin.config import Experiment, load_experiment
from twin.optics.direct import direct_scene
from twin.optics.light import pattern_set
from twin.optics.session import activate
from twin.pipeline import render_bare

SPECIMENS = ("nut", "brick", "two_balls")
SEEDS = (1, 2)


def main() -> None:
    """Measure every specimen and print one JSON line."""
    parser = quick_parser(__doc__, "484 x 366 instead of 968 x 732")
    binning = 4 if parser.parse_args().quick else 2
    print(activate().variant)
    results = [measure(name, binning) for name in SPECIMENS]
    worst = {key: max(figures[key] for figures in results) for key in results[0]}
    print_figures(worst | {"specimens": len(results), "binning": binning})


def measure(name: str, binning: int) -> dict[str, float]:
    """Return the figures of one specimen."""
    settings = {"camera.binning": binning, "modality": "direct_fpp", "camera.noise": False}
    runs = [load_experiment(f"paper/{name}", settings | {"seed": seed}) for seed in SEEDS]
    render_bare(runs[0].model_copy(update={"seed": 99}))  # compiles the kernels
    stacks: list[Any] = []
    stacks_s = seconds(lambda: stacks.extend(render_bare(run).frames for run in runs))
    patterns = pattern_set(runs[0].projector, runs[0].patterns)
    white = patterns.index("white").start
    bright = [float(np.percentile(stack[white], 99.99)) for stack in stacks]
    figures = {
        "firefly_rel": abs(bright[0] - bright[1]) / max(bright),
        "energy_rel": energy_gap(runs[0]),
        "phase_noise_px": phase_noise_px(runs, stacks),
        "stack_s": stacks_s / len(stacks),
    }
    print(name, {key: round(value, 5) for key, value in figures.items()}, flush=True)
    return figures


def energy_gap(experiment: Experiment, seed: int = 3) -> float:
    """Relative gap of the photons' balance; 0 if no surface is clear or polished."""
    from twin.optics.photons import trace_photons
    from twin.optics.scene import rig_of

    built, rig = direct_scene(experiment), rig_of(experiment)
    if not built.surfaces.sharp:
        return 0.0
    count = experiment.render.photons
    balance = trace_photons(built.scene, built.surfaces, rig, count=count, seed=seed).balance
    arrived = balance.absorbed + balance.deposited + balance.escaped + balance.lost
    return abs(balance.sent - arrived) / balance.sent


def phase_noise_px(runs: list[Experiment], stacks: list[Any]) -> float:
    """Spread of the decoded column between two seeds, over the square root of two."""
    patterns = pattern_set(runs[0].projector, runs[0].patterns)
    results = []
    for run, stack in zip(runs, stacks, strict=True):
        exposed = expose(run, stack, patterns.index("white").start, 0)
        results.append(decode(exposed.stack, patterns, exposed.sensor))
    both = results[0].valid & results[1].valid
    difference = results[0].column.coordinate_px[both] - results[1].column.coordinate_px[both]
    return float(1.4826 * np.median(np.abs(difference - np.median(difference))) / np.sqrt(2))


if __name__ == "__main__":
    main()
