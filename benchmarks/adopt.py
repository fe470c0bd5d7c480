"""Adopt rendered rigs with hidden parameters, and count how often the twin covers them.

Forty random rigs (--quick: four; --rigs N) take captures of a bump on the coat as image files:
three phase steps of 18 px numbered by plain Gray code, two times; the same with 26 px; a matte
reference; dark and flat frames. `twin adopt` makes their rig files. 95 % of the estimates must be
inside their 95 % intervals (binomial: of 280, three standard deviations are 4 %).

Orders of plain Gray code are compared with the truth: `wrong_order_share` of the valid pixels, and
the predicted share, `order_error_mean`.

Twins of 67 real presses under a rendered GelSight show the effect of relighting on the drift of gel
without contact, see `benchmarks.gelsight`.

Last line: {"coverage_95", "intervals", "gain_rel", "read_noise_rel", "blur_error_px",
"gamma_error", "albedo_rel", "pose_misfit_px", "two_period_chi2", "wrong_order_share",
"order_error_mean", "drift_um", "relit_drift_um", "slope_error", "rigs", "seconds"}; errors are RMS
over the rigs, chi-square, drift and slope error are means.
"""

import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import imageio.v3 as imageio
import numpy as np
import trimesh

from benchmarks._harness import print_figures, quick_parser
from benchmarks.gelsight import Twins, halves
from benchmarks.real_presses import WIDE_PAD
from reconstruction.capture.frame_set import write_frame_set
from reconstruction.characterise import UncertainValue
from reconstruction.decoding.decode import decode
from reconstruction.rig.calibration import write_calibration
from reconstruction.rig.sensor import SensorNoise
from twin.adoption.adopt import Adopted, Given, adopt
from twin.adoption.capture_fits import UNFILTERED
from twin.adoption.write import write_adopted
from twin.camera import expose
from twin.camera.sensor import choose_exposure_ms
from twin.config import Experiment, load_experiment, vary
from twin.optics.light import pattern_set
from twin.optics.rig import true_calibration
from twin.optics.stack import RadianceStack
from twin.pipeline.fringes import render
from twin.specimens.solids import grid_facets
from twin.study.workers import local_workers

RIGS, QUICK_RIGS = 40, 4
REFERENCE_ALBEDO = UncertainValue(0.8, 0.008)
FLAT_FRAMES = 8
REFERENCES = 16
PERIODS_PX = (18.0, 26.0)
# Ranges of the hidden parameters; the gain follows from the full well.
HIDDEN = {
    "camera.full_well_e": (9000.0, 40000.0),
    "camera.read_noise_e": (4.0, 12.0),
    "camera.prnu_percent": (0.3, 1.5),
    "projector.gamma": (0.8, 2.2),
    "projector.blur_px": (0.4, 1.2),
    "projector.contrast": (80.0, 500.0),
    "coating.base_albedo": (0.15, 0.7),
    "projector.pose.polar_deg": (20.0, 32.0),
    "camera.pose.standoff_mm": (195.0, 235.0),
}
JUDGED = tuple(HIDDEN)[:7]


@dataclass(frozen=True)
class AdoptedCase:
    """One rig: hidden parameters, their estimates, and its orders of plain Gray code.

    Attributes
    ----------
    estimates : value and standard uncertainty by field; a field may have none
    misfit_px : of the poses, the larger of both devices
    """

    hidden: dict[str, float]
    estimates: dict[str, tuple[float, float]]
    misfit_px: float
    two_period_chi2: float | None
    wrong_share: float
    predicted_share: float

    def row(self, path: str) -> tuple[float, float, float]:
        """Return hidden value, estimate and standard uncertainty; without estimate: 0."""
        return self.hidden[path], *self.estimates.get(path, (0.0, 0.0))


def hidden_rig(seed: int) -> tuple[Experiment, dict[str, float]]:
    """Return a random rig and its hidden parameters."""
    rng = np.random.default_rng((17, seed))
    hidden = {path: float(rng.uniform(*ends)) for path, ends in HIDDEN.items()}
    sources = {
        path: {"value": value, "range": list(HIDDEN[path]), "source": "hidden"}
        for path, value in hidden.items()
    }
    # Large pixels instead of binning: binned noise is below the resolution of 12 bits.
    changes = {
        "patterns.steps": 3,
        "patterns.code": "gray",
        "camera.width_px": 480,
        "camera.height_px": 360,
        "camera.pixel_pitch_um": {"value": 18.0, "range": [2.0, 20.0], "source": "benchmark"},
    }
    base = load_experiment("examples/slab_ball", changes)
    return vary(base, {**sources, "seed": seed}), hidden


def bump(height_mm: float) -> trimesh.Trimesh:
    """Return a coat of 32 x 26 mm with a bump in its middle."""
    x, y = np.meshgrid(np.linspace(-16.0, 16.0, 257), np.linspace(-13.0, 13.0, 209))
    z = height_mm * np.exp(-(x**2 + y**2) / 18.0)
    nodes = np.stack([x, y, z], axis=-1).reshape(-1, 3)
    mesh = trimesh.Trimesh(nodes, grid_facets(*x.shape), process=False, validate=False)
    mesh.metadata["name"] = "coated_face"
    return mesh


def with_period(experiment: Experiment, period_px: float) -> Experiment:
    """Return the rig with another fringe period."""
    shown = experiment.patterns.model_copy(update={"period_px": period_px})
    return experiment.model_copy(update={"patterns": shown})


def write_set(folder: Path, experiment: Experiment, radiance: RadianceStack, trial: int) -> None:
    """Record a rendered stack and write it in the format of a real rig."""
    folder.mkdir(parents=True)
    patterns = pattern_set(experiment.projector, experiment.patterns)
    white = patterns.index("white").start
    exposed = expose(experiment, radiance.frames, white, trial)
    # The data sheet of a camera may be wrong by 30 %: `adopt` estimates these values.
    stated = SensorNoise(
        1.3 * exposed.sensor.gain_dn_per_e,
        0.7 * exposed.sensor.read_noise_e,
        exposed.sensor.black_level_dn,
        exposed.sensor.saturation_dn,
    )
    write_frame_set(folder, exposed.stack, patterns, stated, experiment.camera.bit_depth)
    write_calibration(folder / "calibration.yaml", true_calibration(experiment))


def with_exposure(experiment: Experiment, exposure_ms: float | str) -> Experiment:
    """Return the rig with another exposure time."""
    camera = experiment.camera.model_copy(update={"exposure_ms": exposure_ms})
    return experiment.model_copy(update={"camera": camera})


def write_uniform(folder: Path, experiment: Experiment, level: float, trial: int) -> None:
    """Write frames of uniform light, relative to the full well; 0: dark frames."""
    folder.mkdir()
    camera = experiment.camera
    shape = (camera.height_px // camera.binning, camera.width_px // camera.binning)
    unit = np.ones(shape, np.float32)
    full = choose_exposure_ms(with_exposure(experiment, "auto"), unit)
    assert not isinstance(camera.exposure_ms, str)
    even = unit * np.float32(level / camera.auto_level * full / camera.exposure_ms)
    stack = expose(experiment, [even] * FLAT_FRAMES, 0, trial).stack
    for number, frame in enumerate(stack):
        imageio.imwrite(folder / f"{number:02d}.png", frame)


def record(folder: Path, experiment: Experiment) -> tuple[Given, RadianceStack]:
    """Take all captures of a rig; return the inputs of `adopt` and the first rendered stack."""
    rigs = [with_period(experiment, period_px) for period_px in PERIODS_PX]
    stacks = [render(rig, bump(0.6)) for rig in rigs]
    matte = experiment.coating.model_copy(
        update={"base_albedo": REFERENCE_ALBEDO.value, "flake_fraction": 0.0}
    )
    reference = render(rigs[0].model_copy(update={"coating": matte}), bump(0.0))
    white = -2
    exposure_ms = min(
        choose_exposure_ms(rigs[0], stack.frames[white]) for stack in (stacks[0], reference)
    )
    fixed = [with_exposure(rig, exposure_ms) for rig in rigs]
    for number, (rig, stack) in enumerate([(0, 0), (0, 0), (1, 1)]):
        write_set(folder / f"coat_{number}", fixed[rig], stacks[stack], number)
    write_set(folder / "tile", fixed[0], reference, 3)
    write_uniform(folder / "dark", fixed[0], 0.0, 4)
    write_uniform(folder / "flat", fixed[0], 0.5, 5)
    given = Given(
        tuple(folder / f"coat_{number}" for number in range(3)),
        dark=folder / "dark",
        flat=folder / "flat",
        reference=folder / "tile",
        reference_albedo=REFERENCE_ALBEDO,
    )
    return given, stacks[0]


def orders(estimate: Adopted, truth: RadianceStack) -> tuple[float, float]:
    """Return the counted and the predicted share of wrong orders along columns."""
    capture = estimate.capture
    decoded = decode(
        capture.stack, capture.patterns, capture.sensor, UNFILTERED, response=capture.response
    )
    seen = decoded.valid & truth.truth.lit
    off_px = np.abs(decoded.column.coordinate_px - truth.truth.column_px)[seen]
    wrong = float(np.mean(off_px > 0.5 * capture.patterns.period_px))
    return wrong, float(decoded.column.order_error[seen].mean())


def adopted(seed: int) -> AdoptedCase:
    """Make one rig, take its captures and adopt it."""
    experiment, hidden = hidden_rig(seed)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        given, truth = record(folder, experiment)
        adopted = adopt(given)
        (folder / "out").mkdir()
        write_adopted(folder / "out", adopted, given)
    estimates = {
        path: (float(field.value), field.uncertainty)
        for path, field in adopted.fields.items()
        if field.uncertainty is not None
    }
    misfit_px = max(adopted.placed.misfit_px)
    return AdoptedCase(
        hidden, estimates, misfit_px, adopted.two_period_chi2, *orders(adopted, truth)
    )


def figures_of(cases: list[AdoptedCase]) -> dict[str, Any]:
    """Return coverage and errors over all rigs."""
    rows = {path: np.array([case.row(path) for case in cases]) for path in JUDGED}
    every = np.concatenate(list(rows.values()))
    inside = np.abs(every[:, 1] - every[:, 0]) <= 1.96 * every[:, 2]

    def rms(path: str, *, relative: bool) -> float:
        true, value, _ = rows[path].T
        error = (value - true) / (true if relative else 1.0)
        return float(np.sqrt(np.mean(error**2)))

    chi2 = [case.two_period_chi2 for case in cases]
    return {
        "coverage_95": float(inside.mean()),
        "intervals": len(inside),
        "gain_rel": rms("camera.full_well_e", relative=True),
        "read_noise_rel": rms("camera.read_noise_e", relative=True),
        "blur_error_px": rms("projector.blur_px", relative=False),
        "gamma_error": rms("projector.gamma", relative=False),
        "albedo_rel": rms("coating.base_albedo", relative=True),
        "pose_misfit_px": max(case.misfit_px for case in cases),
        "two_period_chi2": float(np.mean([c for c in chi2 if c is not None])),
        "wrong_order_share": float(np.mean([case.wrong_share for case in cases])),
        "order_error_mean": float(np.mean([case.predicted_share for case in cases])),
        "rigs": len(cases),
    }


def drifts() -> dict[str, float]:
    """Return the drift of gel without contact, without and with relighting."""
    few = {"photometric.presses.count": REFERENCES}
    return halves(Twins.of(load_experiment("examples/gelsight_ball", few | WIDE_PAD)))


def main() -> None:
    """Adopt every rig and print one JSON line."""
    parser = quick_parser(__doc__, "four rigs")
    parser.add_argument("--rigs", type=int, help="number of rigs")
    chosen = parser.parse_args()
    count = chosen.rigs or (QUICK_RIGS if chosen.quick else RIGS)
    start, cases = time.perf_counter(), []
    workers = local_workers(min(2, count))
    executor = workers.open()
    for seed, case in enumerate(executor.map(adopted, range(count))):
        cases.append(case)
        for path in JUDGED:
            true, value, sigma = case.row(path)
            steps = (value - true) / sigma if sigma else float("nan")
            print(f"rig {seed} {path}: {value:.5g}, true {true:.5g}, off {steps:+.2f} sigma")
        print(f"rig {seed} two_period_chi2: {case.two_period_chi2}", flush=True)
    workers.close(executor)
    result = figures_of(cases) | drifts()
    print_figures(result | {"seconds": time.perf_counter() - start})


if __name__ == "__main__":
    main()
