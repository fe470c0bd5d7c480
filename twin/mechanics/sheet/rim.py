"""A compliant rim: independent springs along the frame hold the edge of the sheet.

Glue yields, and a sheet slips in a clamp. The edge moves in the frame's plane by u under the
increase of the line tension N above that of the mounted sheet, N_0: k u = N - N_0, with
k = 1 / compliance, per length of the mounted edge. The mounted sheet is in equilibrium. N_0 =
mu h (1 - s^-6) is along the outward normal: the tension of an incompressible neo-Hookean sheet that
is stretched by s along x and y.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from reconstruction.arrays import FloatArray
from twin.mechanics.sheet.grid import SheetGrid
from twin.mechanics.sheet.kernel import SLOTS
from twin.mechanics.sheet.laws import Laws
from twin.mechanics.sheet.splines import SplineLine

# N/mm to mN/mm, the solver's unit.
_MILLI = 1e3
#: Edges of the grid: the axis across them, and which end of it.
EDGES = ((0, 0), (0, -1), (1, 0), (1, -1))


@dataclass(frozen=True, eq=False)
class RimSpring:
    """Springs of one edge of the grid.

    Attributes
    ----------
    axis, end : the edge consists of the control points with index `end` (0: first, -1: last) along
        the grid's axis 0 (rows) or 1 (columns)
    mounted_mm : (point, xy) positions of these control points in the mounted sheet
    stiffness : (offset, point) mN/mm, coupling of a control point to the one 0, 1 or 2 further
        along the edge
    tension : (point, xy) force of the mounted sheet's tension on the edge, mN, outwards
    """

    axis: int
    end: int
    mounted_mm: FloatArray
    stiffness: FloatArray
    tension: FloatArray

    def add(self, control_mm: FloatArray, forces: FloatArray, tangent: FloatArray | None) -> float:
        """Add the springs' forces and tangent to those of the sheet; return their energy, uJ.

        Parameters
        ----------
        control_mm, forces : (row + 2, col + 2, xyz)
        tangent : (row + 2, col + 2, slot, xyz, xyz), see `kernel.SLOTS`; None: not computed
        """
        moved = self._edge(control_mm)[:, :2] - self.mounted_mm
        pulled = self._times(moved)
        self._edge(forces)[:, :2] += pulled - self.tension
        if tangent is not None:
            for offset, values in enumerate(self.stiffness):
                slot = SLOTS.index((0, offset) if self.axis == 0 else (offset, 0))
                for xy in (0, 1):
                    self._edge(tangent)[:, slot, xy, xy] += values
        return float(np.sum(moved * (pulled / 2 - self.tension)))

    def _edge(self, of_grid: FloatArray) -> FloatArray:
        edge: FloatArray = of_grid[self.end] if self.axis == 0 else of_grid[:, self.end]
        return edge

    def _times(self, moved: FloatArray) -> FloatArray:
        total: FloatArray = self.stiffness[0][:, None] * moved
        for offset in (1, 2):
            along = self.stiffness[offset][:-offset, None]
            total[:-offset] += along * moved[offset:]
            total[offset:] += along * moved[:-offset]
        return total


def rim_springs(
    grid: SheetGrid, laws: Laws, edges: Sequence[tuple[int, int]] = EDGES
) -> tuple[RimSpring, ...]:
    """Return the springs of a grid's edges, one `RimSpring` per edge; () for a rigid rim.

    Parameters
    ----------
    edges : axis and end of each edge, see `RimSpring`
    """
    compliance = grid.frame.rim_compliance_mm2_per_n
    if not compliance:
        return ()
    # kPa mm = mN/mm
    strain = 1 - grid.frame.pre_stretch**-6
    tensions = (laws.shear_modulus_kpa * _thickness_mm(grid, laws, edge) * strain for edge in edges)
    return tuple(
        _spring(grid, edge, _MILLI / compliance, tension)
        for edge, tension in zip(edges, tensions, strict=True)
    )


def _thickness_mm(grid: SheetGrid, laws: Laws, edge: tuple[int, int]) -> FloatArray:
    """Return the undeformed thickness at the Gauss points of an edge, (cell, 2)."""
    line = grid.x if edge[0] == 0 else grid.y
    along, across = line.points.ravel(), (grid.y if edge[0] == 0 else grid.x).edges[[edge[1]]]
    places = (along, across) if edge[0] == 0 else (across, along)
    material_mm = grid.evaluate(grid.mounted_mm, *places)[..., 0, :2]
    local_mm = laws.thickness_mm + grid.deviation_mm(material_mm)
    return np.asarray(local_mm.reshape(line.cells, 2))


def _spring(
    grid: SheetGrid, edge: tuple[int, int], stiffness: float, tension: FloatArray
) -> RimSpring:
    axis, end = edge
    line = grid.x if axis == 0 else grid.y
    mounted = (grid.mounted_mm[end] if axis == 0 else grid.mounted_mm[:, end])[:, :2]
    by_length = np.stack([_on_cells(line, mounted[:, xy]) for xy in (0, 1)], axis=-1)
    # Rows run along x: outwards is to the right at the first; columns along y: to the left.
    turned = np.stack((by_length[..., 1], -by_length[..., 0]), axis=-1)
    outwards = turned if (axis == 0) == (end == 0) else -turned
    values = line.table[:, :, 0]
    weight = line.weights * np.hypot(by_length[..., 0], by_length[..., 1])
    shares = np.einsum("cg,cga,cgb->cab", stiffness * weight, values, values)
    pulls = np.einsum("cg,cga,cgx->cax", tension * line.weights, values, outwards)
    between, total = np.zeros((3, line.size)), np.zeros((line.size, 2))
    for a in range(3):
        total[a : a + line.cells] += pulls[:, a]
        for offset in range(3 - a):
            between[offset, a : a + line.cells] += shares[:, a, a + offset]
    return RimSpring(axis, end, mounted, between, total)


def _on_cells(line: SplineLine, control: FloatArray) -> FloatArray:
    """Return the derivative of a spline along its line at the Gauss points, (cell, 2).

    `control` (function,) are the coefficients of the spline.
    """
    local = np.stack([control[a : a + line.cells] for a in range(3)], axis=-1)
    slope: FloatArray = np.einsum("cga,ca->cg", line.table[:, :, 1], local)
    return slope
