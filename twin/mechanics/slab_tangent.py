"""Derivatives of a pressed slab's coat by parameters of specimen, travel and layer.

In the contact C the gap A p + S - d is zero (symbols: see `contact`). If C does not change, for any
parameter t of specimen or travel

    A_CC dp/dt = d(d)/dt - dS/dt  on the contact C,   dp/dt = 0 outside it,

by the implicit function theorem. The pressure is zero at the contact's edge, so that a motion of
that edge has an effect of second order only. This is true for a round object; for an object with an
edge it is true if the cells resolve the edge's rounding.

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
    """Derivatives of coat and force by one parameter.

    Attributes
    ----------
    coat_mm : (row, col) derivative of z at the middles of the coat's cells, mm per unit of the
        parameter
    force_mm2 : derivative of force over modulus, mm^2 per unit of the parameter
    """

    coat_mm: FloatArray
    force_mm2: float


@dataclass(frozen=True, eq=False)
class SolvedSlab:
    """A slab on a simply supported rim, pressed to a depth.

    Attributes
    ----------
    height_mm : (row, col) height of the specimen behind its foremost point, plus the sag of the
        slab; inf outside the specimen
    coat_cells : numbers of rows and columns of the coat's cells, which cover the whole slab
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
        """Whether each cell touches the specimen, (row, col)."""
        return self.contact.pressure > 0

    @property
    def force_mm2(self) -> float:
        """Contact force divided by Young's modulus, mm^2."""
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
        """Part of `coat_mm`, (row, col), that the contact causes; the preload causes the rest."""
        return self._at_middles(self.contact.pressure, 0.0)

    def moved_by(self, rate_mm: FloatArray) -> CoatMove:
        """Return the derivatives of coat and force by a parameter that moves the specimen's face.

        Parameters
        ----------
        rate_mm : (row, col) on `touched_cells`; derivative of the position of the specimen's face
            along the press, mm per unit of the parameter. It has an effect in the contact only.
        """
        return self._move(self._pressure_for(rate_mm))

    def moved_by_travel(self) -> CoatMove:
        """Return the derivatives of coat and force by the travel, per mm."""
        return self.moved_by(np.ones_like(self.height_mm[self.touched_cells]))

    def moved_by_layer(self, low: SlabData, high: SlabData, step: float) -> CoatMove:
        """Return the derivatives of coat and force by a parameter of the layer or its load.

        Parameters
        ----------
        low, high : elastomer and load with the parameter smaller and larger by `step`
        step : small, because compliance and preload are differentiated by central differences; the
            derivative of the pressure follows from these by solving the contact's equations
        """
        thin, thick = self._under(low), self._under(high)
        pressure = self.contact.pressure
        raised = thick.layer.deflect(pressure) - thin.layer.deflect(pressure)
        raised += thick.preload.deflection(thick.layer) - thin.preload.deflection(thin.layer)
        own = self._move(self._pressure_for(-raised[self.touched_cells] / (2 * step)))
        return replace(own, coat_mm=own.coat_mm + (thick.coat_mm - thin.coat_mm) / (2 * step))

    def _under(self, data: SlabData) -> "SolvedSlab":
        """Return the slab with another elastomer and load, but with the pressure of this one.

        The contact is not solved again: its gap is not zero.
        """
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
        """Return z of the far face at the middles of the coat's cells, (row, col), mm.

        These are every second node of a grid with two intervals per cell.
        """
        rows, cols = self.coat_cells
        return self.layer.opposite_at_nodes(pressure, 2 * rows, 2 * cols, uniform)[1::2, 1::2]

    @property
    def touched_cells(self) -> tuple[slice, slice]:
        """Index (rows, columns) of the rectangle of cells that contains the contact."""
        return self._patch.cells

    @cached_property
    def _patch(self) -> Patch:
        row, col = np.nonzero(self.touching)
        return self.layer.patch(
            Span.around(row, self.layer.rows), Span.around(col, self.layer.cols)
        )

    def _pressure_for(self, advance_mm: FloatArray) -> FloatArray:
        """Return the pressure over modulus (row, col) for a given advance of the contact's cells.

        `advance_mm` is (row, col) on `touched_cells`, along the press.
        """
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
    coat_cells : numbers of rows and columns of the coat's cells, which cover the whole slab

    Raises
    ------
    PressError : the elastomer is no slab in the opposite-face layout, the load states no depth, or
        the specimen extends beyond the slab
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
    """Return p with A p = `wanted_mm` on the cells `inside`, 0 elsewhere.

    Solved by conjugate gradients with the preconditioner of the contact solver.
    """
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
