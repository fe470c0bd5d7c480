"""Frictionless contact of a rigid height field with an elastic layer.

Polonsky, I. A., Keer, L. M. (1999): A numerical method for solving rough contact problems based
on the multi-level multi-summation and conjugate gradient techniques. Wear 231(2), 206-219.

Find p >= 0 and g >= 0 with p g = 0, where the gap is g = A p + S - d: deflection plus the
specimen's height behind its foremost point minus the depth. Arrays are (row, col).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
import numpy.typing as npt

from twin.mechanics.errors import SolverError
from twin.mechanics.transfer import FloatArray

BoolArray = npt.NDArray[np.bool_]
Deflect = Callable[[FloatArray], FloatArray]


# Largest gap of a touching cell over the largest deflection: faint pressures do not show in sums.
_CLOSED = 3e-5


class Scaling(Protocol):
    """An approximate inverse of the deflection, symmetric and positive."""

    @property
    def cell(self) -> float:
        """Pressure per deflection of one cell."""
        ...

    def apply(self, gap: FloatArray) -> FloatArray:
        """Return about the pressure that closes `gap`."""
        ...


@dataclass(frozen=True)
class Unscaled:
    """Plain conjugate gradients."""

    cell: float = 1.0

    def apply(self, gap: FloatArray) -> FloatArray:
        """Return the gap itself."""
        return gap


class Control(Protocol):
    """What distinguishes a press to a depth from a press with a force."""

    def start(self, height: FloatArray, present: BoolArray) -> FloatArray:
        """Return the first pressure."""
        ...

    def gap(self, raised: FloatArray, touching: BoolArray) -> FloatArray:
        """Return the gap from `raised` = A p + S."""
        ...

    def balanced(
        self, direction: FloatArray, touching: BoolArray, scaling: "Scaling"
    ) -> FloatArray:
        """Remove from a search direction what the control forbids."""
        ...

    def scale(self, pressure: FloatArray) -> float:
        """Return the factor by which the pressure meets a prescribed force."""
        ...

    def depth_mm(self, raised: FloatArray, touching: BoolArray) -> float:
        """Return the travel after first touch."""
        ...

    def coarsened(self, factor: int) -> "Control":
        """Return the same control on cells `factor` times as wide."""
        ...


@dataclass(frozen=True)
class DepthControl:
    """Press to a given travel after first touch."""

    depth: float

    def start(self, height: FloatArray, present: BoolArray) -> FloatArray:
        """Touch wherever the undeformed slab would be penetrated."""
        return np.where(present & (height < self.depth), 1e-6, 0.0)

    def gap(self, raised: FloatArray, touching: BoolArray) -> FloatArray:
        """Return A p + S - d."""
        return raised - self.depth

    def balanced(
        self, direction: FloatArray, touching: BoolArray, scaling: "Scaling"
    ) -> FloatArray:
        """Leave the direction as it is: nothing is forbidden."""
        return direction

    def scale(self, pressure: FloatArray) -> float:
        """Leave the pressure as it is."""
        return 1.0

    def depth_mm(self, raised: FloatArray, touching: BoolArray) -> float:
        """Return the given depth."""
        return self.depth

    def coarsened(self, factor: int) -> "DepthControl":
        """Return this control: cells do not matter."""
        return self


@dataclass(frozen=True)
class ForceControl:
    """Press with a given force; here force is divided by Young's modulus, mm^2."""

    force_over_modulus: float
    cell_area_mm2: float

    def start(self, height: FloatArray, present: BoolArray) -> FloatArray:
        """Spread the force over the foremost twentieth of the specimen."""
        foremost = present & (height <= np.quantile(height[present], 0.05))
        uniform = foremost.astype(np.float64)
        return uniform * self.scale(uniform)

    def gap(self, raised: FloatArray, touching: BoolArray) -> FloatArray:
        """Return A p + S less its mean over the contact: the depth follows from the force."""
        return raised - float(raised[touching].mean())

    def balanced(
        self, direction: FloatArray, touching: BoolArray, scaling: "Scaling"
    ) -> FloatArray:
        """Make the direction free of force, conjugate to a uniform displacement."""
        uniform = np.where(touching, scaling.apply(touching.astype(np.float64)), 0.0)
        balanced: FloatArray = direction - uniform * float(direction.sum() / uniform.sum())
        return balanced

    def scale(self, pressure: FloatArray) -> float:
        """Scale to the prescribed force."""
        return self.force_over_modulus / (float(pressure.sum()) * self.cell_area_mm2)

    def depth_mm(self, raised: FloatArray, touching: BoolArray) -> float:
        """Return the mean of A p + S over the contact."""
        return float(raised[touching].mean())

    def coarsened(self, factor: int) -> "ForceControl":
        """Return the control with wider cells."""
        return replace(self, cell_area_mm2=self.cell_area_mm2 * factor**2)


@dataclass(frozen=True)
class Contact:
    """A solved contact; arrays (row, col)."""

    #: pressure over Young's modulus
    pressure: FloatArray
    #: deflection of the touched face, mm, positive along the press
    deflection_mm: FloatArray
    depth_mm: float
    iterations: int


def solve_contact(
    deflect: Deflect,
    height_mm: FloatArray,
    control: Control,
    tolerance: float = 1e-5,
    max_iterations: int = 1000,
    *,
    scaling: Scaling | None = None,
    start: FloatArray | None = None,
) -> Contact:
    """Solve the contact by Polonsky and Keer's conjugate gradients.

    Parameters
    ----------
    deflect : callable
        Pressure over modulus (row, col) to deflection of the touched face (row, col), mm.
    height_mm : (row, col) float, mm
        The specimen's height behind its foremost point, inf where absent.
    control : DepthControl or ForceControl
        What is prescribed.
    tolerance : float
        Largest relative change of the pressure per pass, as its sum of absolute values.
    max_iterations : int
        Passes before the solver gives up.
    scaling : Scaling, optional
        Approximate inverse of `deflect`; the passes then hardly grow with the grid.
    start : (row, col) float, optional
        First guess of the pressure over modulus.

    Raises
    ------
    SolverError
        The passes were used up.
    """
    present = np.isfinite(height_mm)
    height = np.where(present, height_mm, 0.0)
    pressure = control.start(height, present) if start is None else start * control.scale(start)
    search = _Search(deflect, control, scaling or Unscaled())
    deflection = deflect(pressure)
    for iteration in range(1, max_iterations + 1):
        touching = pressure > 0
        gap = control.gap(deflection + height, touching)
        direction, image, step = search.step(gap, touching)
        advanced = np.maximum(pressure - step * direction, 0.0)
        overlapping = (advanced == 0) & (gap < 0) & present
        # A single cell under a force has nowhere to step to: its neighbours join all the same.
        joined = -(step or 1.0) * search.scaling.cell * gap
        advanced = np.where(overlapping, joined, advanced)
        factor = control.scale(advanced)
        advanced *= factor
        change = float(np.abs(advanced - pressure).sum())
        closed = float(np.abs(gap[touching]).max(initial=0.0)) <= _CLOSED * float(deflection.max())
        # An unchanged contact moves the deflection along the known image: no transform.
        unchanged = not overlapping.any() and np.array_equal(advanced > 0, touching)
        deflection = factor * (deflection - step * image) if unchanged else deflect(advanced)
        pressure = advanced
        if overlapping.any():
            search.restart()  # a grown contact ends the conjugacy of the directions
        elif closed and change < tolerance * float(pressure.sum()) and iteration >= 4:
            return _finish(deflect, height, pressure, control, iteration)
    raise SolverError(
        f"press: no contact solution within {max_iterations} passes; "
        "use a thicker slab, a shorter span or a coarser press.solver_pitch_mm"
    )


class _Search:
    """Directions and step lengths of the conjugate gradients within the contact."""

    def __init__(self, deflect: Deflect, control: Control, scaling: Scaling) -> None:
        self.deflect, self.control, self.scaling = deflect, control, scaling
        self.direction: FloatArray | None = None
        self.gap: FloatArray = np.zeros((0, 0))
        self.norm = 0.0

    def restart(self) -> None:
        """Forget the last direction."""
        self.direction = None

    def step(self, gap: FloatArray, touching: BoolArray) -> tuple[FloatArray, FloatArray, float]:
        """Return direction, its image and the step length; steepest descent if that fails."""
        inside = np.where(touching, gap, 0.0)
        scaled = self._scaled(inside, touching)
        turned = scaled
        if self.direction is not None and self.norm > 0:
            # Polak and Ribiere: forgets by itself what a shrunken contact has made useless.
            turn = _inner(scaled, inside - self.gap) / self.norm
            turned = np.where(touching, scaled + max(turn, 0.0) * self.direction, 0.0)
        self.gap, self.norm = inside, _inner(scaled, inside)
        for direction in (turned, scaled):
            image = self.deflect(direction)
            curvature = _inner(image, direction)
            if curvature > 0:
                break
        self.direction = direction
        descent = _inner(inside, direction)
        return direction, image, descent / curvature if curvature > 0 else 0.0

    def _scaled(self, inside: FloatArray, touching: BoolArray) -> FloatArray:
        scaled = np.where(touching, self.scaling.apply(inside), 0.0)
        return self.control.balanced(scaled, touching, self.scaling)


def _inner(first: FloatArray, second: FloatArray) -> float:
    # Not np.vdot: its BLAS spins up threads, which costs ten times the sum itself.
    return float(np.einsum("ij,ij->", first, second))


def _finish(
    deflect: Deflect, height: FloatArray, pressure: FloatArray, control: Control, iterations: int
) -> Contact:
    deflection = deflect(pressure)
    depth = control.depth_mm(deflection + height, pressure > 0)
    return Contact(pressure, deflection, depth, iterations)
