"""Peeling a tacky sheet off a plate: the required force is the adhesion energy."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq

from tests.mechanics.sheets import laws
from twin.mechanics.sheet.energy import Bodies, Sheet, SheetState
from twin.mechanics.sheet.equilibrium import Accuracy, settle
from twin.mechanics.sheet.grid import Frame, sheet_grid
from twin.mechanics.sheet.laws import Laws
from twin.mechanics.sheet.path import mounted
from twin.mechanics.sheet.splines import SplineLine, graded_line
from twin.specimens.distance import plate

THICKNESS_MM, ADHESION_J_M2, WIDTH_MM = 0.2, 0.2, 3000.0
CELL_MM = 0.05
# The arm has no distributed load: a residual of 1e-3 kPa along it is 2 % of G.
CLOSE = Accuracy(step_mm=1e-6, residual_kpa=1e-4)


def taped(law: Laws, sticks: bool) -> Sheet:
    """Return a strip on a plate: one end free along x, to be lifted, the other held."""
    along = graded_line((0.0, 20.0), (4.5, 8.0), CELL_MM, CELL_MM / 3, 1.0)
    across = SplineLine(np.linspace(-WIDTH_MM / 2, WIDTH_MM / 2, 4))
    grid = sheet_grid(Frame(20.0, WIDTH_MM), along, across)
    free = np.zeros_like(grid.free)
    free[:, :-1, 0] = True
    free[:, 1:-1, 2] = True
    return Sheet(replace(grid, free=free), law, Bodies((plate(0.0),)), -THICKNESS_MM / 2, sticks)


def upright(sheet: Sheet, lift_mm: float) -> SheetState:
    """Return a flat strip that sticks, its end bent up by a quarter circle of 1 mm: a guess."""
    flat = mounted(sheet.grid)
    if sheet.sticks:
        flat = sheet.regripped(flat)
    control = flat.control_mm.copy()
    behind = lift_mm + np.pi / 2 - 1 - control[..., 0]
    angle = np.clip(behind, 0, np.pi / 2)
    control[..., 0] += np.maximum(behind, 0) - np.sin(angle)
    control[..., 2] = 1 - np.cos(angle) + np.maximum(behind - np.pi / 2, 0)
    return replace(flat, control_mm=control)


def lifting_force(sheet: Sheet, state: SheetState, lift_mm: float) -> tuple[float, SheetState]:
    """Settle with the end at a height; return its force per width, N/m, and the new state."""
    control = state.control_mm.copy()
    control[:, 0, 2] = lift_mm
    result = settle(sheet, replace(state, control_mm=control), CLOSE)
    sheet.evaluate(result.control_mm, result, tangent=False)
    held = np.zeros(control.shape[:2])
    held[~sheet.grid.free[..., 2]] = sheet.reactions()
    return float(held[:, 0].sum()) / WIDTH_MM, result


def upright_force(law: Laws) -> float:
    """Return the force per width F of a steady peel at right angles.

    Lifting by one undeformed length of strip does the work F (s - cos 90 deg) and stores w(s)
    in the upright arm of stretch s: F s - w = G, with F = dw/ds and in plane strain
    w = mu h / 2 (s^2 + s^-2 - 2).
    """
    stiff = law.shear_modulus_kpa * law.thickness_mm

    def left(s: float) -> float:
        return stiff * ((s - s**-3) * s - (s**2 + s**-2 - 2) / 2) - law.tack

    stretch = brentq(left, 1.0, 2.0)
    return stiff * (stretch - stretch**-3)


@pytest.mark.parametrize("sticks", [False, True])
def test_peeling_a_strip_at_right_angles_takes_its_adhesion(sticks: bool) -> None:
    """The mean over six cells: within a cell the force ripples by 0.5 %."""
    law = laws(THICKNESS_MM, tack=ADHESION_J_M2, tack_range_mm=0.08)
    sheet = taped(law, sticks)
    lifts = 5.0 + 0.375 * CELL_MM * np.arange(32)
    state, forces = upright(sheet, lifts[0]), []
    for lift in lifts:
        force, state = lifting_force(sheet, state, float(lift))
        forces.append(force)
    expected = upright_force(law)
    assert expected == pytest.approx(ADHESION_J_M2, rel=2e-3)
    assert np.mean(forces[16:]) == pytest.approx(expected, rel=0.03)
    slope = sheet.surface(state.control_mm)[0, 0, 0, 1]
    assert abs(slope[0]) < 0.02 * abs(slope[2])
