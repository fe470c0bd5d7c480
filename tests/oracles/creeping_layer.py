"""A relaxing layer by time steps: each contact is solved with the creep of all earlier steps.

The deflection is the sum of c(t - s) A dp(s), with the elastic compliance A and the creep function
c, which is computed by time steps from r * dc = 1. Neither shape nor growth of the contact is
assumed.
"""

from collections.abc import Sequence

import numpy as np

from reconstruction.arrays import FloatArray
from twin.config.relaxation import Relaxation
from twin.mechanics.contact import solve_on_layer
from twin.mechanics.control import Control, ForceControl
from twin.mechanics.layer import BondedLayer


def press_by_steps(
    layer: BondedLayer,
    height_mm: FloatArray,
    relaxation: Relaxation,
    times_s: FloatArray,
    controls: Sequence[Control],
) -> tuple[FloatArray, FloatArray]:
    """Return force over initial modulus, mm^2, and travel, mm, at each time, both (time,).

    Parameters
    ----------
    times_s : (time,) float; the first is the start, at which nothing touches
    controls : force or travel at each later time
    """
    forces, depths = np.zeros(times_s.size), np.zeros(times_s.size)
    before = np.zeros_like(height_mm)
    steps: list[tuple[float, FloatArray]] = []
    for number, control in enumerate(controls, 1):
        now, half = times_s[number], (times_s[number] - times_s[number - 1]) / 2
        own = creep_by_steps(relaxation, half)
        history = -own * before
        for at, by in steps:
            history += creep_by_steps(relaxation, now - at) * by
        if isinstance(control, ForceControl):
            control = ForceControl(control.force_over_modulus * own, control.cell_area_mm2)
        solved = solve_on_layer(layer, height_mm + layer.deflect(history), control)
        pressure = solved.pressure / own
        steps.append((now - half, pressure - before))
        before = pressure
        forces[number] = float(pressure.sum()) * layer.cell_area_mm2
        depths[number] = solved.depth_mm
    return forces, depths


def creep_by_steps(relaxation: Relaxation, t_s: float, count: int = 80) -> float:
    """Return c(t) by the midpoint rule for r(t) + integral of r(t - s) c'(s) ds = 1."""
    if t_s == 0:
        return 1.0
    shares, times = np.array(relaxation.shares), np.array(relaxation.times_s)
    ends = np.arange(1, count + 1) * t_s / count

    def r(t: FloatArray) -> FloatArray:
        return np.asarray(1 + np.expm1(-t[:, None] / times) @ shares)

    ages, wanted = r(ends - t_s / count / 2), 1 - r(ends)
    steps = np.zeros(count)
    for number in range(count):
        steps[number] = (wanted[number] - ages[number:0:-1] @ steps[:number]) / ages[0]
    return 1.0 + float(steps.sum())
