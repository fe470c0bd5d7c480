"""Compute the stored solids in space for comparison with sheets: `python ... [case ...]`.

Neo-Hookean Q2/Q1 bricks (the project's own) of a clamped sheet of 10 x 10 mm over a short bar:
neither round nor in plane strain. One quarter, by symmetry; frictionless, along exact signed
distances. Newton's method starts from the sheet's own face and ends at the solid's equilibrium.
Elements are finest where it touches and at the rim, where the clamp holds the whole thickness.
Each case is solved on two meshes; their difference is stored with the result of the finer mesh.
Needs pypardiso; about ten minutes a case on idle cores.
"""

import json
import math
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from pypardiso import PyPardisoSolver
from scipy import sparse
from scipy.interpolate import CloughTocher2DInterpolator

from tests.mechanics.solids_in_space import (
    CASES,
    FRAME_MM,
    POISSON_RATIO,
    SpaceCase,
    bar,
    seen_at,
    wrapped,
)
from twin.mechanics.reference import newton
from twin.mechanics.reference.grid import ElementGrid, Surface, graded
from twin.mechanics.reference.mixed import MixedBody, moduli, neo_hookean
from twin.mechanics.reference.newton import Equilibrium, NewtonOptions, Problem, press_to, push
from twin.shape import SignedDistance

STORED = Path(__file__).with_name("solid_in_space.json")
PENALTY_OVER_SHEAR = 60.0
# Along x and y: the corner of the bar, which supports the sheet.
FOCUS_MM = (0.7, 2.2)


@dataclass(frozen=True)
class Mesh:
    """Sizes of elements, mm, in the contact and outside, and their number through the thickness."""

    finest_mm: float
    coarsest_mm: float
    through: int


COARSE, FINE = Mesh(0.15, 0.6, 2), Mesh(0.1, 0.4, 3)


@dataclass(frozen=True)
class DistanceContact:
    """Rigid bodies against the touched face, frictionless, along signed distances."""

    surface: Surface
    nodes_mm: np.ndarray
    bodies: tuple[SignedDistance, ...]
    penalty: float
    carried: np.ndarray

    def evaluate(self, moved_mm, depth_mm, active):
        at = self.surface.trace @ (self.nodes_mm + moved_mm) - [0.0, 0.0, depth_mm]
        distances = [body.evaluate(at, 1.0) for body in self.bodies]
        nearest = np.argmin([part[0] for part in distances], axis=0)
        point = np.arange(nearest.size)
        distance, n, bend = (
            np.stack(parts)[nearest, point] for parts in zip(*distances, strict=True)
        )
        raw = self.carried - self.penalty * distance
        touching = raw > 0 if active is None else active
        pressure = np.where(touching, raw, 0.0)
        stiffness = self.penalty * np.einsum("qi,qj->qij", n, n) - pressure[:, None, None] * bend
        stiffness[~touching] = 0.0
        return push(self.surface, pressure[:, None] * n, stiffness, pressure)

    def settle(self, moved_mm, depth_mm):
        return self  # a tight sheet has no pressure on the flat between the edges: holes are real

    def carry(self, pressure):
        return replace(self, carried=pressure)


def solve(case: SpaceCase, mesh: Mesh) -> list[dict]:
    """Return force and upper face at the case's travels."""
    x, y = (_edges(focus, mesh) for focus in FOCUS_MM)
    grid = ElementGrid((x, y, graded(case.thickness_mm, mesh.through, 1.1)))
    body = MixedBody(grid, neo_hookean, moduli(POISSON_RATIO))
    surface, free = grid.surface(4), _free(grid)
    penalty = PENALTY_OVER_SHEAR * body.moduli.shear / mesh.finest_mm
    rest = np.zeros_like(surface.weight_mm2)
    contact = DistanceContact(surface, grid.nodes_mm, bar().moving, penalty, rest)
    options = NewtonOptions(4 * mesh.finest_mm, tolerance=1e-5, augmentations=2)
    print(case.name, [e.size - 1 for e in grid.edges_mm], body.unknowns, flush=True)
    travels = []
    for travel_mm in case.travels_mm:
        state = np.zeros(body.unknowns)
        held = np.setdiff1d(np.arange(body.displacements), free)
        state[: body.displacements] = _guess(case, travel_mm, grid.nodes_mm).ravel()
        state[held] = 0.0
        pushed = contact.evaluate(body.displacement_mm(state), travel_mm, None)
        near = Equilibrium(state, contact, travel_mm - 1e-3, pushed, 0)
        at = press_to(Problem(body, free, options), near, travel_mm)
        travels.append(_seen(case, body, at))
        print(travel_mm, 4 * at.pushed.along, at.iterations, flush=True)
    return travels


def _guess(case, travel_mm, nodes_mm):
    """Return the sheet's displacement: where Newton's method starts, not where it ends."""
    sheet, result = wrapped(case, travel_mm, 0.1)
    x, y, z = (np.unique(along) for along in nodes_mm.T)
    place, along_x, along_y = np.moveaxis(sheet.grid.evaluate(result.control_mm, x, y), 2, 0)
    across = np.cross(along_x, along_y)
    up = across / (across**2).sum(axis=-1)[..., None]
    offset = z - case.thickness_mm / 2
    moved = (place[..., None, :] + offset[:, None] * up[..., None, :]).swapaxes(0, 1)
    moved[..., 2] += case.thickness_mm / 2
    return moved.reshape(-1, 3) - nodes_mm


def _edges(focus, mesh):
    """Return element edges on 0..rim, finest around a place and fine at the rim."""
    half = FRAME_MM / 2
    at = np.linspace(0, half, 20001)
    near = mesh.finest_mm + 0.25 * np.maximum(np.abs(at - focus) - 0.5, 0)
    rim = mesh.finest_mm + 0.25 * (half - at)
    density = 1 / np.minimum(np.minimum(near, rim), mesh.coarsest_mm)
    count = np.concatenate(([0.0], np.cumsum((density[1:] + density[:-1]) / 2))) * at[1]
    return np.interp(np.linspace(0, count[-1], math.ceil(count[-1]) + 1), count, at)


def _free(grid):
    nodes = grid.nodes_mm
    held = np.zeros(nodes.shape, dtype=bool)
    for axis in (0, 1):
        held[nodes[:, axis] == 0, axis] = True
        held[nodes[:, axis] == FRAME_MM / 2] = True
    pressures = grid.element_corners.max() + 1
    return np.setdiff1d(np.arange(nodes.size + pressures), np.flatnonzero(held))


def _seen(case, body, at):
    """Return travel, force (N at 1 MPa) and the upper face's rise at the stored points."""
    nodes = body.grid.nodes_mm
    top = nodes[:, 2] == body.grid.edges_mm[2][-1]
    after = (nodes + body.displacement_mm(at.state))[top]
    for axis in (0, 1):  # its mirror images make it smooth across the planes of symmetry
        image = after[after[:, axis] > 1e-9] * np.where(np.arange(3) == axis, -1, 1)
        after = np.concatenate((after, image))
    face = CloughTocher2DInterpolator(after[:, :2], after[:, 2] - case.thickness_mm, tol=1e-10)
    return {
        "travel_mm": round(at.depth_mm, 6),
        "force": round(4 * at.pushed.along, 8),
        "upper_z_mm": face(*seen_at()).round(5).tolist(),
    }


class _Factors:
    """The sparse solver of two threads in place of the one that ships."""

    def __init__(self):
        self.solver = PyPardisoSolver(mtype=11)

    def __call__(self, matrix, right):
        result = self.solver.solve(sparse.csr_matrix(matrix), right)
        self.solver.free_memory(everything=True)
        return result


def main(names):
    newton._solve_linear = _Factors()
    stored = json.loads(STORED.read_text()) if STORED.exists() else {}
    for case in CASES:
        if names and case.name not in names:
            continue
        coarse, fine = (solve(case, mesh) for mesh in (COARSE, FINE))
        for coarser, finer in zip(coarse, fine, strict=True):
            faces = [np.array(part["upper_z_mm"]) for part in (coarser, finer)]
            finer["coarser_um"] = round(1e3 * float(np.abs(faces[0] - faces[1]).max()), 2)
            finer["coarser_force"] = round(coarser["force"] / finer["force"] - 1, 5)
            print({k: v for k, v in finer.items() if k != "upper_z_mm"}, flush=True)
        stored[case.name] = fine
        lines = (f"{json.dumps(name)}: {json.dumps(stored[name])}" for name in sorted(stored))
        STORED.write_text("{\n" + ",\n".join(lines) + "\n}\n")


if __name__ == "__main__":
    main(sys.argv[1:])
