"""Control of a press by a prescribed depth or a prescribed force.

Arrays are (row, col). Pressures are divided by Young's modulus. Symbols: see `contact`.
"""

from dataclasses import dataclass, replace
from typing import Protocol, Self

import numpy as np

from reconstruction.arrays import BoolArray, FloatArray


class Scaling(Protocol):
    """Preconditioner of the contact solver: a symmetric, positive approximate inverse of A."""

    @property
    def cell(self) -> float:
        """Pressure over modulus on one cell per mm of deflection of that cell, 1/mm."""
        ...

    def apply(self, gap: FloatArray) -> FloatArray:
        """Return the pressure over modulus (row, col) that deflects the face by about `gap`, mm.

        The result approximates A^-1 `gap`.
        """
        ...


class Control(Protocol):
    """Steps of the contact solver that depend on whether depth or force is prescribed.

    The argument `raised` is A p + S, mm: deflection plus height of the specimen.
    """

    def start(self, height: FloatArray, present: BoolArray) -> FloatArray:
        """Return the first guess of the pressure, 0 outside the cells `present`."""
        ...

    def depth_mm(self, raised: FloatArray, touching: BoolArray) -> float:
        """Return the travel after first touch, mm."""
        ...

    def energy(self, pressure: FloatArray, raised: FloatArray, height: FloatArray) -> float:
        """Return the energy, mm, that the contact minimises: see the overrides for the formulas.

        Its derivative by the pressure of a cell is the gap there plus a constant.
        """
        ...

    def gap(self, raised: FloatArray, touching: BoolArray) -> FloatArray:
        """Return the gap A p + S - d between layer and specimen, mm."""
        return raised - self.depth_mm(raised, touching)

    def balanced(self, direction: FloatArray, touching: BoolArray, scaling: Scaling) -> FloatArray:
        """Return a search direction that keeps a prescribed force; default: `direction` itself."""
        return direction

    def scale(self, pressure: FloatArray) -> float:
        """Return the factor that scales the pressure to a prescribed force; by default 1."""
        return 1.0

    def coarsened(self, factor: int) -> Self:
        """Return the same control on cells `factor` times as wide."""
        return self


@dataclass(frozen=True)
class DepthControl(Control):
    """Control of a press to a given travel after first touch, `depth`, mm."""

    depth: float

    def start(self, height: FloatArray, present: BoolArray) -> FloatArray:
        """Return a small pressure on the cells in which the specimen overlaps the flat slab."""
        return np.where(present & (height < self.depth), 1e-6, 0.0)

    def depth_mm(self, raised: FloatArray, touching: BoolArray) -> float:
        """Return the prescribed travel after first touch, mm; the arguments have no effect."""
        return self.depth

    def energy(self, pressure: FloatArray, raised: FloatArray, height: FloatArray) -> float:
        """Return the sum of p (A p / 2 + S - d) over the cells, mm."""
        return inner(pressure, (raised + height) / 2 - self.depth)


@dataclass(frozen=True)
class ForceControl(Control):
    """Control of a press with a given force, divided by Young's modulus (mm^2)."""

    force_over_modulus: float
    cell_area_mm2: float

    def start(self, height: FloatArray, present: BoolArray) -> FloatArray:
        """Return a uniform pressure on the foremost 5 % of the cells, with the given force."""
        foremost = present & (height <= np.quantile(height[present], 0.05))
        uniform = foremost.astype(np.float64)
        return uniform * self.scale(uniform)

    def depth_mm(self, raised: FloatArray, touching: BoolArray) -> float:
        """Return the mean of A p + S over the contact, mm: the depth follows from the force."""
        return float(raised[touching].mean())

    def energy(self, pressure: FloatArray, raised: FloatArray, height: FloatArray) -> float:
        """Return the sum of p (A p / 2 + S) over the cells, mm.

        The term with the depth d is left out: it is constant, because the force is given.
        """
        return inner(pressure, (raised + height) / 2)

    def balanced(self, direction: FloatArray, touching: BoolArray, scaling: Scaling) -> FloatArray:
        """Return the search direction with a sum of 0, so that the force does not change.

        For this, a multiple of the pressure is subtracted that displaces the contact uniformly.
        """
        uniform = np.where(touching, scaling.apply(touching.astype(np.float64)), 0.0)
        return np.asarray(direction - uniform * float(direction.sum() / uniform.sum()))

    def scale(self, pressure: FloatArray) -> float:
        """Return the factor that scales the pressure to the given force."""
        return self.force_over_modulus / (float(pressure.sum()) * self.cell_area_mm2)

    def coarsened(self, factor: int) -> Self:
        """Return the same control on cells `factor` times as wide."""
        return replace(self, cell_area_mm2=self.cell_area_mm2 * factor**2)


def inner(first: FloatArray, second: FloatArray) -> float:
    """Return the sum of the products of the elements of two arrays (row, col)."""
    # Not np.vdot: its BLAS starts threads, which takes ten times as long as the sum itself.
    return float(np.einsum("ij,ij->", first, second))
