"""A pressed slab, and the motion of its coat with specimen, travel and thickness, to first order.

While the contact area is constant the gap A p + S - d is zero there: for any parameter t of
specimen or travel

    A_CC dp/dt = d(d)/dt - dS/dt  on the contact C,   dp/dt = 0 outside it,

which is the implicit function theorem on the contact's equations. At the contact's edge the
pressure is zero, so that the motion of the edge is of second order; that holds where the object is
round, and on an edge as far as cells resolve its rounding.

Arrays are (row, col) on the layer's cells. Pressures are divided by Young's modulus; with a given
travel, the displacement does not depend on the modulus.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from reconstruction.arrays import BoolArray, FloatArray
from twin.config.models import Elastomer, Press, Specimen
from twin.mechanics.contact import Contact, solve_on_layer
from twin.mechanics.control import DepthControl, inner
from twin.mechanics.errors import PressError, SolverError
from twin.mechanics.hardness import young_modulus
from twin.mechanics.layer import FreeSlab
from twin.mechanics.layouts import Preload, build_layer, layer_on, preload_of
from twin.mechanics.patch import Patch, Span
from twin.mechanics.press import check_outline
from twin.shape import Shape
from twin.specimens import shape_of

_TOLERANCE, _MOST_PASSES = 1e-6, 400

SlabData = tuple[Elastomer, Press]


@dataclass(frozen=True, eq=False)
class CoatMove:
    """Rate of the coat's motion with one parameter.

    Attributes
    ----------
    coat_mm : (row, col) at the middles of the coat's cells, mm per unit
    force_mm2 : of the force over the modulus, mm^2 per unit
    """

    coat_mm: FloatArray
    force_mm2: float


@dataclass(frozen=True, eq=False)
class SolvedSlab:
    """A slab on a simply supported rim, pressed to a depth.

    Attributes
    ----------
    coat_cells : rows and columns of the coat's cells, over the whole slab
    height_mm : height of the specimen behind its foremost point, plus the sag; inf where absent
    """

    elastomer: Elastomer
    load: Press
    layer: FreeSlab
    preload: Preload
    height_mm: FloatArray
    contact: Contact
    coat_cells: tuple[int, int]

    @property
    def touching(self) -> BoolArray:
        """Where the specimen touches."""
        return self.contact.pressure > 0

    @property
    def force_mm2(self) -> float:
        """Force divided by Young's modulus."""
        return float(self.contact.pressure.sum()) * self.layer.cell_area_mm2

    @cached_property
    def coat_mm(self) -> FloatArray:
        """World z of the coat at the middles of its cells, (row, col)."""
        loaded = self.contact.pressure + self.preload.touched
        return self._at_middles(loaded, self.preload.coated)

    @property
    def touched_mm(self) -> FloatArray:
        """World z of the touched face at the layer's cells, (row, col)."""
        sag = self.preload.deflection(self.layer)
        return np.asarray(self.contact.deflection_mm + sag - self.layer.thickness_mm)

    @cached_property
    def raised_mm(self) -> FloatArray:
        """The part of `coat_mm` that the contact causes, (row, col); the rest is preload."""
        return self._at_middles(self.contact.pressure, 0.0)

    def moved_by(self, rate_mm: FloatArray) -> CoatMove:
        """Return the coat's motion if the specimen's face advances.

        Parameters
        ----------
        rate_mm : (row, col) on `touched_cells`, of the specimen's face along the press, mm per
            unit; used where it touches
        """
        return self._move(self._pressure_for(rate_mm))

    def moved_by_travel(self) -> CoatMove:
        """Return the coat's motion per mm of travel."""
        return self.moved_by(np.ones_like(self.height_mm[self.touched_cells]))

    def moved_by_layer(self, low: SlabData, high: SlabData, step: float) -> CoatMove:
        """Return the coat's motion with a parameter of the layer or its load.

        Parameters
        ----------
        low, high : elastomer and load with the parameter `step` lower and higher; a small step, as
            all but the pressure is differenced
        """
        thin, thick = self._under(low), self._under(high)
        pressure = self.contact.pressure
        raised = thick.layer.deflect(pressure) - thin.layer.deflect(pressure)
        raised += thick.preload.deflection(thick.layer) - thin.preload.deflection(thin.layer)
        own = self._move(self._pressure_for(-raised[self.touched_cells] / (2 * step)))
        return replace(own, coat_mm=own.coat_mm + (thick.coat_mm - thin.coat_mm) / (2 * step))

    def _under(self, data: SlabData) -> "SolvedSlab":
        """Return a changed layer under this one's pressure: its contact is not closed."""
        elastomer, load = data
        modulus = young_modulus(elastomer).best_kpa
        layer = layer_on(elastomer, self.layer.x_mm, self.layer.y_mm, modulus)
        assert isinstance(layer, FreeSlab)
        preload = preload_of(elastomer, load, modulus)
        return replace(self, elastomer=elastomer, load=load, layer=layer, preload=preload)

    def _move(self, pressure: FloatArray) -> CoatMove:
        coat = self._at_middles(pressure, 0.0)
        return CoatMove(coat, float(pressure.sum()) * self.layer.cell_area_mm2)

    def _at_middles(self, pressure: FloatArray, uniform: float) -> FloatArray:
        """Evaluate the far face at the middles of the coat's cells: every other node of a grid."""
        rows, cols = self.coat_cells
        return self.layer.opposite_at_nodes(pressure, 2 * rows, 2 * cols, uniform)[1::2, 1::2]

    @property
    def touched_cells(self) -> tuple[slice, slice]:
        """Rows and columns of the contact, as an index."""
        return self._patch.cells

    @cached_property
    def _patch(self) -> Patch:
        row, col = np.nonzero(self.touching)
        return self.layer.patch(
            Span.around(row, self.layer.rows), Span.around(col, self.layer.cols)
        )

    def _pressure_for(self, advance_mm: FloatArray) -> FloatArray:
        """Return the pressure on the contact for a given advance of its cells, (row, col)."""
        inside = self.touching[self.touched_cells]
        pressure = np.zeros_like(self.height_mm)
        pressure[self.touched_cells] = _solved(
            self._patch, inside, np.where(inside, advance_mm, 0.0)
        )
        return pressure


def solve_slab(
    specimen: Specimen, elastomer: Elastomer, load: Press, coat_cells: tuple[int, int]
) -> SolvedSlab:
    """Press a slab to `load.depth_mm` by the spectral model.

    Parameters
    ----------
    coat_cells : rows and columns of the coat's cells, over the whole slab

    Raises
    ------
    PressError : no slab in the opposite-face layout, no depth, or the specimen reaches over it
    SolverError : the contact did not converge
    """
    shape: Shape = shape_of(specimen)
    check_outline(shape, elastomer)
    modulus = young_modulus(elastomer).best_kpa
    layer = build_layer(elastomer, load, shape, modulus)
    if not isinstance(layer, FreeSlab) or load.depth_mm is None:
        raise PressError("slab: found no free slab pressed to a depth, which is required here")
    preload = preload_of(elastomer, load, modulus)
    height = shape.height_above_lowest(layer.x_mm, layer.y_mm) + preload.deflection(layer)
    contact = solve_on_layer(layer, height, DepthControl(load.depth_mm))
    return SolvedSlab(elastomer, load, layer, preload, height, contact, coat_cells)


def _solved(patch: Patch, inside: BoolArray, wanted_mm: FloatArray) -> FloatArray:
    """Solve A p = target on the cells inside, by conjugate gradients scaled as the contact's."""
    pressure, rest = np.zeros_like(wanted_mm), wanted_mm
    scaled = np.where(inside, patch.apply(rest), 0.0)
    direction, size = scaled, inner(rest, scaled)
    least = _TOLERANCE**2 * size
    for _ in range(_MOST_PASSES):
        if size <= least:
            return pressure
        image = np.where(inside, patch.deflect(direction), 0.0)
        step = size / inner(direction, image)
        pressure, rest = pressure + step * direction, rest - step * image
        scaled = np.where(inside, patch.apply(rest), 0.0)
        before, size = size, inner(rest, scaled)
        direction = scaled + size / before * direction
    raise SolverError(f"slab: no derivative within {_MOST_PASSES} passes; use a coarser grid")
