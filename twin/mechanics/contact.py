"""Frictionless contact of a rigid height field with an elastic layer.

Polonsky, I. A., Keer, L. M. (1999): A numerical method for solving rough contact problems based
on the multi-level multi-summation and conjugate gradient techniques. Wear 231(2), 206-219.

Find p >= 0 and g >= 0 with p g = 0, where the gap is g = A p + S - d: deflection plus the
specimen's height behind its foremost point minus the depth. Arrays are (row, col).
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from twin.mechanics.errors import SolverError
from twin.mechanics.transfer import FloatArray

BoolArray = npt.NDArray[np.bool_]
Deflect = Callable[[FloatArray], FloatArray]


class Control(Protocol):
    """What distinguishes a press to a depth from a press with a force."""

    def start(self, height: FloatArray, present: BoolArray) -> FloatArray:
        """Return the first pressure."""
        ...

    def gap(self, raised: FloatArray, touching: BoolArray) -> FloatArray:
        """Return the gap from `raised` = A p + S."""
        ...

    def centred(self, field: FloatArray, touching: BoolArray) -> FloatArray:
        """Remove from a search direction's image what the control leaves free."""
        ...

    def scaled(self, pressure: FloatArray) -> FloatArray:
        """Return the pressure that meets a prescribed force."""
        ...

    def depth_mm(self, raised: FloatArray, touching: BoolArray) -> float:
        """Return the travel after first touch."""
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

    def centred(self, field: FloatArray, touching: BoolArray) -> FloatArray:
        """Leave the field as it is: nothing is free."""
        return field

    def scaled(self, pressure: FloatArray) -> FloatArray:
        """Leave the pressure as it is."""
        return pressure

    def depth_mm(self, raised: FloatArray, touching: BoolArray) -> float:
        """Return the given depth."""
        return self.depth


@dataclass(frozen=True)
class ForceControl:
    """Press with a given force; here force is divided by Young's modulus, mm^2."""

    force_over_modulus: float
    cell_area_mm2: float

    def start(self, height: FloatArray, present: BoolArray) -> FloatArray:
        """Spread the force over the foremost twentieth of the specimen."""
        return self.scaled(
            np.where(present & (height <= np.quantile(height[present], 0.05)), 1.0, 0.0)
        )

    def gap(self, raised: FloatArray, touching: BoolArray) -> FloatArray:
        """Return A p + S less its mean over the contact: the depth follows from the force."""
        return self.centred(raised, touching)

    def centred(self, field: FloatArray, touching: BoolArray) -> FloatArray:
        """Subtract the mean over the contact."""
        return field - float(field[touching].mean())

    def scaled(self, pressure: FloatArray) -> FloatArray:
        """Scale to the prescribed force."""
        return pressure * (self.force_over_modulus / (float(pressure.sum()) * self.cell_area_mm2))

    def depth_mm(self, raised: FloatArray, touching: BoolArray) -> float:
        """Return the mean of A p + S over the contact."""
        return float(raised[touching].mean())


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

    Raises
    ------
    SolverError
        The passes were used up.
    """
    present = np.isfinite(height_mm)
    height = np.where(present, height_mm, 0.0)
    pressure = control.start(height, present)
    direction, norm_before, conjugate = np.zeros_like(height), 1.0, 0.0
    for iteration in range(1, max_iterations + 1):
        touching = pressure > 0
        gap = control.gap(deflect(pressure) + height, touching)
        norm = float(np.sum(gap[touching] ** 2))
        turned = gap + conjugate * norm / norm_before * direction
        direction, step = _search(deflect, control, gap, turned, touching)
        advanced = np.maximum(pressure - step * direction, 0.0)
        overlapping = (advanced == 0) & (gap < 0) & present
        advanced = control.scaled(np.where(overlapping, -step * gap, advanced))
        change = float(np.abs(advanced - pressure).sum())
        pressure, norm_before = advanced, norm
        # A changed contact set ends the conjugacy of the directions.
        conjugate = 0.0 if overlapping.any() else 1.0
        settled = change < tolerance * float(pressure.sum())
        if settled and conjugate and iteration >= 4:
            return _finish(deflect, height, pressure, control, iteration)
    raise SolverError(
        f"press: no contact solution within {max_iterations} passes; "
        "use a thicker slab, a shorter span or a coarser press.solver_pitch_mm"
    )


def _search(
    deflect: Deflect, control: Control, gap: FloatArray, turned: FloatArray, touching: BoolArray
) -> tuple[FloatArray, float]:
    """Return direction and step length; steepest descent where the turned direction fails."""
    for candidate in (turned, gap):
        direction = np.where(touching, candidate, 0.0)
        # Outside the contact the direction is zero: the sums run over the contact alone.
        image = control.centred(deflect(direction), touching)
        curvature = float(np.vdot(image, direction))
        if curvature > 0:
            break
    return direction, float(np.vdot(gap, direction)) / curvature if curvature > 0 else 0.0


def _finish(
    deflect: Deflect, height: FloatArray, pressure: FloatArray, control: Control, iterations: int
) -> Contact:
    deflection = deflect(pressure)
    depth = control.depth_mm(deflection + height, pressure > 0)
    return Contact(pressure, deflection, depth, iterations)
