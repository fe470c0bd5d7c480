"""Compute the stored solids of sheets bent over a bar's edges: `python generate_bent_edges.py`.

Plane strain, as in `generate_solid_sheets`: a clamped strip lifted by a bar, frictionless, without
air. Then the sheet is free between the edges, and on both sides of an edge it is loaded only by its
tension. Stored is the distance of that line of tension from the middle of the edge, less that of
the sheet's middle on the edge: above the top, and next to the bar. About fifteen minutes.
"""

import json
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from skfem.mapping.mapping_isoparametric import MappingIsoparametric

import tests.mechanics.reference.generate_solid_sheets as sheets
from tests.oracles.round_grid import RoundGrid
from twin.mechanics.errors import SolverError
from twin.mechanics.reference.grid import graded
from twin.mechanics.reference.mixed import MixedBody, moduli, neo_hookean
from twin.mechanics.reference.newton import Equilibrium, NewtonOptions, Problem, press_to

STORED = Path(__file__).with_name("bent_edges.json")
WIDTH_MM = 4.81
# Hoop strain below 1e-4; elements of 0.01 mm would be lost in the coordinates of a wider ring.
RING_MM = 1e4
# skfem locates a point of an element to 1e-12 of it, which those coordinates do not resolve.
MappingIsoparametric.invF.__defaults__ = (None, 50, 1e-7)


@dataclass(frozen=True)
class Edge:
    thickness_mm: float
    edge_mm: float
    rim_mm: float
    finest_mm: float
    #: start of the part of the sheet that moves onto the edge
    focus_mm: float
    travels_mm: tuple[float, ...]

    @property
    def name(self):
        return f"h{self.thickness_mm:g}_r{self.edge_mm:g}"


CASES = (
    Edge(0.08, 0.11, 4.4, 0.008, 1.95, (2.0, 2.4)),
    Edge(0.2, 0.3, 4.4, 0.018, 1.95, (2.0, 2.4, 2.8)),
    Edge(0.2, 0.1, 4.9, 0.025, 2.1, (1.5, 2.0, 2.5)),
)


def solve(case):
    """Return the stored values of a case at each travel."""
    sheets.RING_MM, sheets.RIM_MM = RING_MM, case.rim_mm
    sheets.BAR_MM, sheets.EDGE_MM = WIDTH_MM, case.edge_mm
    bar = sheets.Case(case.thickness_mm, "bar")
    r = RING_MM + sheets._edges(bar, case.focus_mm, case.finest_mm)
    through = max(3, round(case.thickness_mm / case.finest_mm / 1.5))
    body = MixedBody(
        RoundGrid((r, graded(case.thickness_mm, through, 1.05))),
        neo_hookean,
        moduli(sheets.POISSON_RATIO),
    )
    contact = sheets._contact(bar, body, body.grid.surface(5), case.finest_mm)
    still = np.zeros_like(body.grid.nodes_mm)
    at = Equilibrium(np.zeros(body.unknowns), contact, 0.0, contact.evaluate(still, 0.0, None), 0)
    options = NewtonOptions(largest_move_mm=case.finest_mm, tolerance=1e-6)
    problem, result = Problem(body, sheets._free(bar, body), options), []
    for aim in (0.02, 0.05, *np.arange(1, round(max(case.travels_mm) / 0.1) + 1) * 0.1):
        try:
            at = press_to(problem, at, float(aim))
        except SolverError as end:
            print(case.name, end, flush=True)
            break
        if np.abs(np.array(case.travels_mm) - aim).min() < 1e-9:
            result.append(_hanging(case, body, at))
            print(case.name, result[-1], flush=True)
    return result


def _hanging(case, body, at):
    """Return the lines of tension on both sides of the edge, outside its middle."""
    grid = body.grid
    after = (grid.nodes_mm + body.displacement_mm(at.state)).reshape(
        grid.lines_mm[0].size, grid.lines_mm[1].size, 2
    )
    lower, upper = (after[:, side] - [RING_MM, 0.0] for side in (0, -1))
    middle, local = (lower + upper) / 2, np.hypot(*(upper - lower).T)
    span = (middle[:, 0] > WIDTH_MM / 2 + 0.6) & (middle[:, 0] < case.rim_mm - 0.8)
    slope, height = np.polyfit(*middle[span].T, 1)
    turn = -math.atan(slope)
    edge = np.array([WIDTH_MM / 2 - case.edge_mm, at.depth_mm - case.edge_mm])
    normal = np.array([math.sin(turn), math.cos(turn)])
    thickness = float(np.median(local[span]))
    on_edge = case.edge_mm + thickness / 2
    return {
        "travel_mm": round(at.depth_mm, 6),
        "turn_deg": round(math.degrees(turn), 3),
        "local_mm": round(thickness, 6),
        "beside_um": round(1e3 * (normal @ ([0.0, height] - edge) - on_edge), 3),
        "above_um": round(1e3 * (middle[0, 1] - edge[1] - on_edge), 3),
    }


def main():
    stored = {
        case.name: {
            "thickness_mm": case.thickness_mm,
            "edge_mm": case.edge_mm,
            "travels": solve(case),
        }
        for case in CASES
    }
    lines = (f"{json.dumps(name)}: {json.dumps(values)}" for name, values in stored.items())
    STORED.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")


if __name__ == "__main__":
    main()
