"""Compute the stored solids for comparison with sheets: `python generate_solid_sheets.py`.

Neo-Hookean Q2/Q1 elements (the project's own) of a clamped sheet: round under a ball of R 4,
frictionless or stuck, and in plane strain under a bar. Plane strain is a ring of vast radius: its
hoop strain is below 2e-5. Elements are finest under the edge of the contact and at the rim, where
a clamp holds the whole thickness. About four minutes in all.
"""

import json
import math
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline

from tests.oracles.ball_contact import BallContact
from tests.oracles.round_grid import RoundGrid
from tests.oracles.sections import bar_section
from twin.mechanics.errors import SolverError
from twin.mechanics.reference.grid import Surface, graded
from twin.mechanics.reference.mixed import MixedBody, moduli, neo_hookean
from twin.mechanics.reference.newton import Equilibrium, NewtonOptions, Problem, press_to, push

STORED = Path(__file__).with_name("solid_sheets.json")
RIM_MM, BALL_MM, TRAVELS_MM = 10.0, 4.0, (0.5, 1.0, 2.0)
BAR_MM, EDGE_MM = 4.0, 0.3
POISSON_RATIO = 0.499
RING_MM = 1e5
# As the prototype's: penetration remains far below a micrometre after the augmentations.
PENALTY_OVER_SHEAR = 60.0


@dataclass(frozen=True)
class Case:
    thickness_mm: float
    #: "free" or "stick" under the ball, "bar" in plane strain
    kind: str
    #: 1: as stored; 2: half the elements' size, for the remaining error
    fineness: float = 1.0

    @property
    def name(self):
        return f"{self.kind}_h{self.thickness_mm:g}"


CASES = (
    *(Case(h, "free") for h in (0.1, 0.2, 0.3, 0.5, 1.0)),
    *(Case(h, "stick") for h in (0.2, 0.5, 1.0)),
    *(Case(h, "bar") for h in (0.2, 0.5)),
)


@dataclass(frozen=True)
class BarContact:
    """A rigid bar against the touched face, frictionless, along signed distances."""

    surface: Surface
    nodes_mm: np.ndarray
    penalty: float
    carried: np.ndarray

    def evaluate(self, moved_mm, depth_mm, active):
        x, z = (self.surface.trace @ (self.nodes_mm + moved_mm)).T
        (part,) = bar_section(BAR_MM, EDGE_MM)
        near = part(x - RING_MM, z - depth_mm)
        raw = self.carried - self.penalty * near.distance_mm
        touching = raw > 0 if active is None else active
        pressure = np.where(touching, raw, 0.0)
        n = np.stack((near.normal_x, near.normal_z), axis=1)
        across = np.stack((near.normal_z, -near.normal_x), axis=1)
        stiffness = np.where(touching, self.penalty, 0.0)[:, None, None] * _square(n)
        stiffness -= (pressure * near.curvature_per_mm)[:, None, None] * _square(across)
        return push(self.surface, pressure[:, None] * n, stiffness, pressure)

    def settle(self, moved_mm, depth_mm):
        return self  # a tight sheet has no pressure on the flat between the edges: holes are real

    def carry(self, pressure):
        return replace(self, carried=pressure)


def _square(direction):
    return np.einsum("qi,qj->qij", direction, direction)


def solve(case):
    """Return the stored values of a case."""
    body, element_mm = _body(case)
    surface = body.grid.surface(5)
    contact = _contact(case, body, surface, element_mm)
    still = np.zeros_like(body.grid.nodes_mm)
    at = Equilibrium(np.zeros(body.unknowns), contact, 0.0, contact.evaluate(still, 0.0, None), 0)
    reach = 1 if case.kind == "bar" else 4
    options = NewtonOptions(largest_move_mm=reach * element_mm, tolerance=1e-6)
    problem = Problem(body, _free(case, body), options)
    stored = {"thickness_mm": case.thickness_mm, "kind": case.kind, "travels": []}
    for aim in (0.02, 0.05, *np.arange(1, round(max(TRAVELS_MM) / 0.1) + 1) * 0.1):
        try:
            at = press_to(problem, at, float(aim))
        except SolverError as end:
            print(case.name, end, flush=True)
            break
        if np.abs(np.array(TRAVELS_MM) - aim).min() < 1e-9:
            stored["travels"].append(_seen(case, body, surface, at))
            print(
                case, stored["travels"][-1]["travel_mm"], stored["travels"][-1]["force"], flush=True
            )
    return stored


def _body(case):
    offset, focus = (RING_MM, BAR_MM / 2) if case.kind == "bar" else (0.0, 0.0)
    finest = (0.03 if case.kind == "bar" else 0.05) / case.fineness
    through = math.ceil((3 if case.thickness_mm <= 0.3 else 6) * case.fineness)
    r = offset + _edges(case, focus, finest)
    grid = RoundGrid((r, graded(case.thickness_mm, through, 1.0 + 0.1 / case.fineness)))
    return MixedBody(grid, neo_hookean, moduli(POISSON_RATIO)), finest


def _edges(case, focus_mm, finest_mm):
    """Return element edges on 0..rim, finest around the contact's edge and fine at the rim."""
    r = np.linspace(0, RIM_MM, 20001)
    reach = 0.4 if case.kind == "bar" else 1.5
    inner = finest_mm + 0.15 * np.maximum(np.abs(r - focus_mm) - reach, 0)
    outer = max(finest_mm, case.thickness_mm / 3 / case.fineness) / 2 + 0.15 * (RIM_MM - r)
    density = 1 / np.minimum(np.minimum(inner, outer), 0.3 / case.fineness)
    count = np.concatenate(([0.0], np.cumsum((density[1:] + density[:-1]) / 2))) * r[1]
    return np.interp(np.linspace(0, count[-1], math.ceil(count[-1]) + 1), count, r)


def _contact(case, body, surface, element_mm):
    nodes, rest = body.grid.nodes_mm, np.zeros_like(surface.weight_mm2)
    penalty = PENALTY_OVER_SHEAR * body.moduli.shear / element_mm
    if case.kind == "bar":
        return BarContact(surface, nodes, penalty, rest)
    friction = math.inf if case.kind == "stick" else 0.0
    ball = BallContact(surface, nodes, BALL_MM, penalty, friction, False, rest, rest, rest)
    return ball.settle(np.zeros_like(nodes), 0.0)


def _free(case, body):
    r = body.grid.nodes_mm[:, 0]
    held = np.zeros((r.size, 2), dtype=bool)
    held[r == r.min(), 0] = True
    held[r == r.max()] = True
    return np.setdiff1d(np.arange(body.unknowns), np.flatnonzero(held))


def _seen(case, body, surface, at):
    """Return force (N at 1 MPa; bar: N/mm), contact and the upper face over deformed radii."""
    grid, bar = body.grid, case.kind == "bar"
    moved = body.displacement_mm(at.state)
    offset = RING_MM if bar else 0.0
    after = (grid.nodes_mm + moved).reshape(grid.lines_mm[0].size, grid.lines_mm[1].size, 2)
    upper = after[:, -1] - [offset, case.thickness_mm]
    r = np.round(np.arange(0, RIM_MM, 0.1), 6)
    touched = (surface.trace @ (grid.nodes_mm + moved))[at.pushed.active, 0] - offset
    return {
        "travel_mm": round(at.depth_mm, 6),
        "force": round(at.pushed.along * (1 / (np.pi * RING_MM) if bar else 1), 9),
        "contact_radius_mm": round(float(touched.max()), 4),
        "upper_z_mm": CubicSpline(*upper.T)(r).round(5).tolist(),
    }


def main(names):
    stored = json.loads(STORED.read_text()) if STORED.exists() else {}
    for case in CASES:
        if names and case.name not in names:
            continue
        stored[case.name] = solve(case)
        lines = (f"{json.dumps(name)}: {json.dumps(stored[name])}" for name in sorted(stored))
        STORED.write_text("{\n" + ",\n".join(lines) + "\n}\n")


if __name__ == "__main__":
    main(sys.argv[1:])
