"""Control of a press: a prescribed depth or force. Arrays are (row, col); see `contact`."""

from dataclasses import dataclass, replace
from typing import Protocol, Self

import numpy as np

from reconstruction.arrays import BoolArray, FloatArray


class Scaling(Protocol):
    """An approximate inverse of the deflection, symmetric and positive."""

    @property
    def cell(self) -> float:
        """Pressure per deflection of one cell."""
        ...

    def apply(self, gap: FloatArray) -> FloatArray:
        """Return the approximate pressure that closes `gap`."""
        ...


class Control(Protocol):
    """Steps of the contact solver that depend on the control; `raised` = A p + S."""

    def start(self, height: FloatArray, present: BoolArray) -> FloatArray:
        """Return the first pressure."""
        ...

    def depth_mm(self, raised: FloatArray, touching: BoolArray) -> float:
        """Return the travel after first touch."""
        ...

    def energy(self, pressure: FloatArray, raised: FloatArray, height: FloatArray) -> float:
        """Return the energy that the contact minimises; its gradient is the gap plus a constant."""
        ...

    def gap(self, raised: FloatArray, touching: BoolArray) -> FloatArray:
        """Return A p + S - d."""
        return raised - self.depth_mm(raised, touching)

    def balanced(self, direction: FloatArray, touching: BoolArray, scaling: Scaling) -> FloatArray:
        """Return a search direction without its part that the control forbids; here unchanged."""
        return direction

    def scale(self, pressure: FloatArray) -> float:
        """Return the factor by which the pressure gives a prescribed force."""
        return 1.0

    def coarsened(self, factor: int) -> Self:
        """Return the same control on cells `factor` times as wide."""
        return self


@dataclass(frozen=True)
class DepthControl(Control):
    """Press to a given travel after first touch."""

    depth: float

    def start(self, height: FloatArray, present: BoolArray) -> FloatArray:
        """Touch at every cell that would penetrate the undeformed slab."""
        return np.where(present & (height < self.depth), 1e-6, 0.0)

    def depth_mm(self, raised: FloatArray, touching: BoolArray) -> float:
        """Return the given depth."""
        return self.depth

    def energy(self, pressure: FloatArray, raised: FloatArray, height: FloatArray) -> float:
        """Return p (A p / 2 + S - d), summed."""
        return inner(pressure, (raised + height) / 2 - self.depth)


@dataclass(frozen=True)
class ForceControl(Control):
    """Press with a given force; here force is divided by Young's modulus, mm^2."""

    force_over_modulus: float
    cell_area_mm2: float

    def start(self, height: FloatArray, present: BoolArray) -> FloatArray:
        """Spread the force over the foremost 5 % of the specimen's cells."""
        foremost = present & (height <= np.quantile(height[present], 0.05))
        uniform = foremost.astype(np.float64)
        return uniform * self.scale(uniform)

    def depth_mm(self, raised: FloatArray, touching: BoolArray) -> float:
        """Return the mean of A p + S over the contact: the depth follows from the force."""
        return float(raised[touching].mean())

    def energy(self, pressure: FloatArray, raised: FloatArray, height: FloatArray) -> float:
        """Return p (A p / 2 + S), summed: the force is the same for all pressures."""
        return inner(pressure, (raised + height) / 2)

    def balanced(self, direction: FloatArray, touching: BoolArray, scaling: Scaling) -> FloatArray:
        """Make the direction free of force, conjugate to a uniform displacement."""
        uniform = np.where(touching, scaling.apply(touching.astype(np.float64)), 0.0)
        return np.asarray(direction - uniform * float(direction.sum() / uniform.sum()))

    def scale(self, pressure: FloatArray) -> float:
        """Scale to the prescribed force."""
        return self.force_over_modulus / (float(pressure.sum()) * self.cell_area_mm2)

    def coarsened(self, factor: int) -> Self:
        """Return the control with wider cells."""
        return replace(self, cell_area_mm2=self.cell_area_mm2 * factor**2)


def inner(first: FloatArray, second: FloatArray) -> float:
    """Return the sum of products."""
    # Not np.vdot: its BLAS starts threads, which takes ten times as long as the sum itself.
    return float(np.einsum("ij,ij->", first, second))
