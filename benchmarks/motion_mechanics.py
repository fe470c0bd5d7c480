"""Accuracy of presses that relax and slide; run time of a slide.

Relaxation against time steps of the layer, sliding against Cattaneo and Mindlin, Masing's rule and
the balance of energy. Deviations are in percent, seconds are processor seconds. The last line of
the output is one JSON object. `--quick` uses coarser cells for the ball on a thick layer.
"""

import time

import numpy as np
from scipy.integrate import quad

from benchmarks._harness import print_figures, quick_parser
from twin.config.models import Elastomer, Mechanics, Press
from twin.config.relaxation import Relaxation
from twin.mechanics import PressedElastomer, press_with
from twin.mechanics.contact import solve_on_layer
from twin.mechanics.control import DepthControl, ForceControl
from twin.mechanics.layer import BondedLayer
from twin.mechanics.relaxation import creep_function, relaxation_function
from twin.mechanics.sliding import slide
from twin.specimens import height_above_lowest
from twin.specimens.kinds.ball import Ball

TERMS = Relaxation(shares=(0.15, 0.1, 0.05), times_s=(0.5, 5.0, 60.0))
RAMP_S, HOLD_S, DEPTH_MM, FORCE_N, MODULUS_MPA, MU = 2.0, 3.0, 0.5, 0.8, 0.5, 0.5
LAYER = BondedLayer(96, 96, 24.0, 24.0, 4.0, 0.49)


def pressed(pitch_mm: float = 0.25, mu: float | None = None, **load: object) -> PressedElastomer:
    """Press an 8 mm ball into a 24 x 24 x 4 mm gel of 0.5 MPa on a window."""
    gel = Elastomer(
        thickness_mm=4.0,
        length_x_mm=24.0,
        length_y_mm=24.0,
        young_modulus_kpa=1e3 * MODULUS_MPA,
        poisson_ratio=0.49,
        layout="contact_face",
        relaxation=TERMS if mu is None else None,
        friction_coefficient=mu,
    )
    values = {"solver_pitch_mm": pitch_mm, "relief_pitch_mm": 0.05} | load
    return press_with(Mechanics(model="spectral"), Ball(), gel, Press.model_validate(values))


def relaxation_figures() -> dict[str, float]:
    """Return deviations of force and travel from time steps, and that of r * dc from 1."""
    from tests.oracles.creeping_layer import press_by_steps

    height = height_above_lowest(Ball(), LAYER.x_mm, LAYER.y_mm)
    times = np.concatenate((np.linspace(0, RAMP_S, 9), RAMP_S + np.array([0.5, 1.5, HOLD_S])))
    travels = np.minimum(times / RAMP_S, 1.0)[1:] * DEPTH_MM
    controls = [DepthControl(float(depth)) for depth in travels]
    forces, _ = press_by_steps(LAYER, height, TERMS, times, controls)
    held = pressed(control="depth", depth_mm=DEPTH_MM, ramp_s=RAMP_S, hold_s=HOLD_S)
    later = np.array([0.0, 1e-6, 0.2, 0.6, 1.4, HOLD_S])
    step = [ForceControl(FORCE_N / MODULUS_MPA, LAYER.cell_area_mm2)] * 5
    _, depths = press_by_steps(LAYER, height, TERMS, later, step)
    crept = pressed(control="force", force_n=FORCE_N, hold_s=HOLD_S)
    return {
        "relaxed_force_percent": 100 * (held.force_n / (MODULUS_MPA * forces[-1]) - 1),
        "crept_travel_percent": 100 * (crept.depth_mm / depths[-1] - 1),
        "relaxation_times_creep_minus_1": stress_of_creep(7.0) - 1,
    }


def stress_of_creep(t_s: float) -> float:
    """Return r(t) + the integral of r(t - s) dc(s), which is 1."""
    r, c = relaxation_function(TERMS), creep_function(TERMS)

    def product(s: float) -> float:
        return r(t_s - s) * float(c.amplitudes @ (c.rates_per_s * np.exp(-c.rates_per_s * s)))

    return r(t_s) + float(quad(product, 0, t_s, epsabs=1e-13, epsrel=1e-12, limit=400)[0])


def partial_slip_figures(cells: int) -> dict[str, float]:
    """Return the largest deviations from Cattaneo and Mindlin, for T / (mu N) of 0.2 to 0.9."""
    from tests.oracles.partial_slip import solve_partial_slip

    solved = [solve_partial_slip(share, MU, cells) for share in (0.2, 0.4, 0.6, 0.8, 0.9)]
    return {
        "slip_force_percent": 100 * max(abs(one.force_ratio - 1) for one in solved),
        "stick_radius_percent": 100 * max(abs(one.radius_ratio - 1) for one in solved),
    }


def path_figures() -> dict[str, float]:
    """Return the deviations from Masing's rule and from the balance of energy."""
    height, control = height_above_lowest(Ball(), LAYER.x_mm, LAYER.y_mm), DepthControl(DEPTH_MM)
    rest = solve_on_layer(LAYER, height, control), control
    area = LAYER.cell_area_mm2
    half, whole, back = (
        state.force_mm2(area)[0]
        for state in slide(LAYER, height, rest, MU, [(0.1, 0.0), (0.2, 0.0), (0.0, 0.0)])
    )
    *_, end = slide(LAYER, height, rest, MU, [(0.05 * n, 0.0) for n in range(1, 17)])
    stored = (end.contact.pressure * end.contact.deflection_mm).sum()
    stored += sum((end.traction[axis] * end.displacement_mm[axis]).sum() for axis in (0, 1))
    stored -= (rest[0].pressure * rest[0].deflection_mm).sum()
    balance = stored / 2 * area + end.dissipated_mm3
    load = float(end.contact.pressure.sum()) * area
    return {
        "masing_percent": 100 * abs(back - (whole - 2 * half)) / whole,
        "energy_percent": 100 * abs(end.work_mm3 / balance - 1),
        "full_slip_over_limit": end.force_mm2(area)[0] / (MU * load),
    }


def main() -> None:
    """Compute all figures and print them."""
    chosen = quick_parser(str(__doc__), "coarser cells for the ball on a thick layer").parse_args()
    figures = relaxation_figures() | partial_slip_figures(768 if chosen.quick else 1536)
    figures |= path_figures()
    start = time.process_time()
    pressed(0.08, MU, control="depth", depth_mm=DEPTH_MM, slide_x_mm=0.2)
    print_figures(figures | {"slide_seconds": time.process_time() - start})


if __name__ == "__main__":
    main()
