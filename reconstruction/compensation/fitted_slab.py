"""Fitted parameters of an object under a slab, with their covariance, and the object itself.

Arrays over cells are (row, col); lengths are in mm, pressures in kPa.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from reconstruction.arrays import BoolArray, FloatArray
from reconstruction.compensation.presentation import PresentedObject
from reconstruction.compensation.relief import Relief


@dataclass(frozen=True)
class FittedNumber:
    """One unknown parameter of the fit, with its starting value, range and prior.

    All values are in the unit that is part of `name`.

    Attributes
    ----------
    start, low, high : starting value and limits of the allowed range
    known, sigma : prior value and its standard uncertainty; infinite sigma: no prior
    """

    name: str
    start: float
    low: float
    high: float
    known: float = 0.0
    sigma: float = np.inf


@dataclass(frozen=True, eq=False)
class CoatSlopes:
    """Derivatives of the coat's heights, (n, row, col), and of the force, (n,), by each unknown."""

    coat_mm: FloatArray
    force_n: FloatArray


@dataclass(frozen=True, eq=False)
class SlabCoat:
    """Coat and force of the layer's solution for one set of values of the unknowns.

    Attributes
    ----------
    coat_mm : (row, col) heights of the coat
    force_n : force of the object along z
    slopes : function that computes the derivatives of `coat_mm` and `force_n` by the unknowns
    theory_mm : errors of the model: each entry (row, col) is one standard uncertainty of the
        heights, and its error is fully correlated over the cells
    """

    coat_mm: FloatArray
    force_n: float
    slopes: Callable[[], CoatSlopes]
    theory_mm: tuple[FloatArray, ...] = ()


SlabModel = Callable[[FloatArray], SlabCoat]
"""Function that maps values (n,) of the unknowns to the coat on the relief's cells. It raises
FitError if no press with these values exists."""


@dataclass(frozen=True)
class KnownForce:
    """Force of the object along z, measured by a gauge, and its standard uncertainty; N."""

    force_n: float
    sigma_n: float


@dataclass(frozen=True, eq=False)
class FittedSlab:
    """Fitted parameters of an object under a slab, with their covariance.

    Attributes
    ----------
    unknowns : the n fitted parameters
    values, covariance : (n,) and (n, n), in the order of `unknowns`
    bound : (n, n) covariance for independent errors of the size of the cells' sigma: the
        Cramer-Rao bound
    coat, slopes : solution of the layer at the fitted values, and its derivatives
    misfit_mm : RMS of measured minus modelled heights
    chi_square : sum of squares of the heights' residuals over sigma, per degree of freedom
    shared_cells : number of cells over which errors are correlated
    """

    unknowns: tuple[FittedNumber, ...]
    values: FloatArray
    covariance: FloatArray
    bound: FloatArray
    coat: SlabCoat
    slopes: CoatSlopes
    misfit_mm: float
    chi_square: float
    shared_cells: float

    def value(self, name: str) -> float:
        """Return the fitted value of the unknown with the given name."""
        return float(self.values[self._place(name)])

    def sigma(self, name: str) -> float:
        """Return the standard uncertainty of the unknown with the given name."""
        place = self._place(name)
        return float(np.sqrt(self.covariance[place, place]))

    def bound_sigma(self, name: str) -> float:
        """Return the Cramer-Rao bound of the named unknown's standard deviation.

        It is the least one possible for independent errors of the size of the cells' sigma.
        """
        place = self._place(name)
        return float(np.sqrt(self.bound[place, place]))

    @property
    def force_sigma_n(self) -> float:
        """Standard uncertainty of the force, N, from the covariance of the fitted unknowns."""
        slope = self.slopes.force_n
        return float(np.sqrt(slope @ self.covariance @ slope))

    def _place(self, name: str) -> int:
        return [unknown.name for unknown in self.unknowns].index(name)


@dataclass(frozen=True, eq=False, repr=False)
class CompensatedSlab(PresentedObject):
    """Object and contact computed from the coat of a slab; arrays (row, col) on the relief's cells.

    Attributes
    ----------
    relief : the measured coat
    contact : bool, True for cells in contact
    pressure_kpa : contact pressure of the object on the slab
    touched_mm : world z of the slab's face that touches the object; in contact also the object's z
    fitted : fitted parameters of the object, and the solution of the layer
    force_theory : relative standard uncertainty of the force because the model is linear
    """

    relief: Relief
    contact: BoolArray
    pressure_kpa: FloatArray
    touched_mm: FloatArray
    fitted: FittedSlab
    force_theory: float

    @property
    def sure(self) -> BoolArray:
        """Cells that are certainly in contact, (row, col) bool: all contact cells.

        The layer's solution gives the edge of the contact without blur.
        """
        return self.contact

    @property
    def theory_sigma_mm(self) -> FloatArray:
        """Standard uncertainty, mm, of each point by the model's errors, (row, col): 0.

        The covariance of the fitted parameters includes them.
        """
        return np.zeros(self.contact.shape)

    @property
    def normal(self) -> FloatArray:
        """Unit normals from the object towards the coat, (row, col, xyz): along +z everywhere."""
        return np.broadcast_to(np.array([0.0, 0.0, 1.0]), self.relief.points_mm.shape)

    @property
    def object_mm(self) -> FloatArray:
        """Points of the touched face, world (row, col, xyz), mm; in contact those of the object."""
        x, y = np.meshgrid(self.relief.x_mm, self.relief.y_mm)
        return np.stack((x, y, self.touched_mm), axis=-1)

    @property
    def blur_mm(self) -> float:
        """Width, mm, by which the edge of the contact is blurred: 0 for a slab."""
        return 0.0

    @property
    def area_mm2(self) -> float:
        """Area of the contact projected along z, mm^2."""
        return float(self.contact.sum()) * self.relief.cell_area_mm2

    @property
    def force_n(self) -> float:
        """Force of the object on the slab along z, N; positive when it presses."""
        return self.fitted.coat.force_n

    @property
    def force_sigma_n(self) -> float:
        """Standard uncertainty of the force, N, including the error of the linear model."""
        return float(np.hypot(self.fitted.force_sigma_n, self.force_theory * self.force_n))

    @property
    def layer_moves_mm(self) -> list[FloatArray]:
        """Shifts of the object's points by uncertain values of the layer: an empty list.

        The covariance of the fitted parameters includes the uncertain values of the layer.
        """
        return []

    def theory_mm(self, _: float) -> float:
        """Return the model's error of a radius, mm: 0, because the covariance includes it."""
        return 0.0
