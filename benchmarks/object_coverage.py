"""Coverage of the object's lengths: how many 95 % intervals contain the true length.

A radius (ball of 6 mm), a width (bar of 4.81 mm) and a step height (0.3 mm), each under a thin
sheet, are measured by the whole chain. 25 presses (--quick: 3) are drawn from `inputs/handling`:
placement, travel, air, thickness, hardness. Each is measured with 8 sensors (--quick: 4).
`--presses N` and `--sensors N` set other numbers. A sensor has its own coat (texture), its own
noise, a rig drawn from the covariance of a calibration (--quick: the true rig), and assumed values
of thickness, air and hardness, drawn around the true values with the standard uncertainties that
`twin measure` assumes.

Target: 93 to 97 % of the intervals value +- U with k = 2 contain the true length. A press takes
about 10 s, a sensor 2 s.

Last line: {"radius_coverage", "radius_error_over_u", "radius_error_um", "radius_measured",
"width_...", "step_..."}. `..._error_over_u` is the RMS of error over standard uncertainty,
`..._error_um` the RMS error, `..._measured` the number of intervals over that of all sensors of
all presses.
"""

import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks._harness import print_figures, quick_parser
from reconstruction.errors import InputError
from twin.config import Experiment, load_experiment, vary
from twin.config.inputs import usual_inputs
from twin.config.sensor_layer import SensorLayer, sensor_layer_of
from twin.pipeline import Memory, measure
from twin.results.object_score import MeasuredQuantity
from twin.study.measuring import RigCovariance, calibrated, retriangulated
from twin.study.trials import draw, standard_uncertainty

PRESSES, SENSORS = 25, 8
QUICK_PRESSES, QUICK_SENSORS = 3, 4
SEED, BOARD = 50, "boards/paper_dots"
COAT = {
    "camera.binning": 4,
    "coating.texture.rms_um": 5.0,
    "coating.texture.correlation_mm": 0.15,
}
BALL = {"kind": "ball", "diameter_mm": 6.0}
STEP = {"kind": "step", "height_mm": 0.3, "length_x_mm": 8.0, "length_y_mm": 6.0}
CASES: dict[str, tuple[str, str, dict[str, Any]]] = {
    "radius": (
        "radius_1",
        "examples/wrapped_balls",
        {"specimen": BALL, "press.depth_mm": 0.6, "press.back_pressure_kpa": 2.0},
    ),
    "width": ("width_1", "paper/bars_b", {}),
    "step": (
        "step_height",
        "examples/wrapped_balls",
        {"specimen": STEP, "press.depth_mm": 0.8, "elastomer.thickness_mm": 0.15},
    ),
}
"""Measurand, base and settings of the experiment of each length."""


def presses(nominal: Experiment, count: int) -> Iterator[Experiment]:
    """Yield the experiment with drawn placement, load and sheet."""
    inputs = {
        name: given
        for name, given in usual_inputs(nominal).inputs.items()
        if given.group != "optics"
    }
    for number in range(1, count + 1):
        yield draw(nominal, inputs, SEED, number)


def assumed_layer(pressed: Experiment, rng: np.random.Generator) -> SensorLayer:
    """Return the true sheet and load of a press plus random errors of their assumed values."""
    layer, inputs = sensor_layer_of(pressed), usual_inputs(pressed).inputs
    tables = {"elastomer": layer.elastomer, "press": layer.press}
    for name in ("thickness", "hardness", "back_pressure"):
        given = inputs[name]
        table, _, key = given.key.partition(".")
        true = given.nominal_in(pressed)
        error = standard_uncertainty(given, true) * rng.normal()
        tables[table] = tables[table].model_copy(update={key: true + error})
    return layer.model_copy(update=tables)


def sensors(
    pressed: Experiment,
    name: str,
    count: int,
    rigs: RigCovariance | None,
    rng: np.random.Generator,
) -> Iterator[MeasuredQuantity]:
    """Yield a length of one press by sensors with different coats, noises, rigs, assumed layers.

    The error of a sensor that fails is printed.
    """
    memory = Memory()
    for number in range(1, count + 1):
        coated = vary(pressed, {"seed": int(rng.integers(2**31))})
        layer, drawn = assumed_layer(pressed, rng), int(rng.integers(1, 2**31))
        try:
            done = measure(coated, memory=memory, trial=number, layer=layer)
            if rigs is not None:
                rig = rigs.draw(done.fringes.capture.calibration, SEED, drawn)
                done = retriangulated(done, rig)
            length = done.object.quantity(name)
        except InputError as error:
            print(f"sensor {number}: {error}", flush=True)
        else:
            yield length


def coverage(case: str, counts: tuple[int, int], true_rig: bool) -> dict[str, float | None]:
    """Measure one length with all sensors; return its coverage and its error over uncertainty.

    Parameters
    ----------
    counts : number of presses, and of sensors per press
    true_rig : all sensors have the true rig, none that of a calibration
    """
    name, base, settings = CASES[case]
    nominal = load_experiment(base, settings | COAT)
    rng, over, errors = np.random.default_rng(SEED), [], []
    with tempfile.TemporaryDirectory() as folder:
        rigs = None if true_rig else calibrated(Path(folder), nominal, BOARD)
    for number, pressed in enumerate(presses(nominal, counts[0]), start=1):
        before = len(errors)
        for length in sensors(pressed, name, counts[1], rigs, rng):
            if length.error is not None:
                errors.append(length.error)
                over.append(length.error / length.uncertainty.standard)
        print(f"{case}, press {number}: errors (um) {np.round(errors[before:], 1)}", flush=True)
    inside = float(np.mean(np.abs(over) <= 2.0)) if over else None
    return {
        f"{case}_coverage": inside,
        f"{case}_error_over_u": float(np.sqrt(np.mean(np.square(over)))) if over else None,
        f"{case}_error_um": float(np.sqrt(np.mean(np.square(errors)))) if over else None,
        f"{case}_measured": len(over) / (counts[0] * counts[1]),
    }


def main() -> None:
    parser = quick_parser(__doc__ or "", "3 presses with 4 sensors each, the true rig")
    parser.add_argument("--only", choices=CASES, help="one length only")
    parser.add_argument("--presses", type=int, help="number of drawn presses of each length")
    parser.add_argument("--sensors", type=int, help="number of sensors of each press")
    chosen = parser.parse_args()
    usual = (QUICK_PRESSES, QUICK_SENSORS) if chosen.quick else (PRESSES, SENSORS)
    counts = (chosen.presses or usual[0], chosen.sensors or usual[1])
    figures: dict[str, float | None] = {}
    for case in (chosen.only,) if chosen.only else CASES:
        figures |= coverage(case, counts, chosen.quick)
    print_figures(figures)


if __name__ == "__main__":
    main()
