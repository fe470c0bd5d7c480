"""Equilibria for small changes of the input, to first order, from one pressed sheet.

In equilibrium the forces g on the free control points c are zero, and remain zero if the data p of
elastomer, press or specimen change (implicit function theorem):

    K dc/dp = -dg/dp,    K: the tangent in equilibrium, exact

A neighbour is that step, Newton's first: g of the changed data at the control points of the
equilibrium. Its faces, pressure and force are then those of any press. Two neighbours on either
side give the derivative of all of them, with an error of second order in their distance.

Under a given force the travel s changes too: ds = (given force - force) / (dF/ds).
"""

from copy import copy
from dataclasses import dataclass, field, replace

from reconstruction.arrays import FloatArray
from twin.config.models import Elastomer, Mechanics, Press, Specimen
from twin.mechanics.errors import PressError, SolverError
from twin.mechanics.press import PressedElastomer
from twin.mechanics.sheet.case import sheet_case
from twin.mechanics.sheet.energy import Sheet, SheetState, System
from twin.mechanics.sheet.press import SettledSheet
from twin.mechanics.sheet.result import contact_force_n

# Of the travel, for the stiffness under a given force: so little that no further point touches.
_SMALL_SHARE = 1e-6


@dataclass(eq=False)
class Neighbourhood:
    """A sheet in equilibrium with the factors of its tangent.

    Raises
    ------
    PressError
        It sticks: its equilibrium depends on its path, which is unknown for a neighbour.
    SolverError
        Its tangent is not definite: other equilibria are close to it, and it has no derivative.
    """

    rest: SettledSheet
    _sheet: Sheet = field(init=False)
    _forces: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        sheet, state = copy(self.rest.sheet), self.rest.state
        sheet.system = System.of(sheet.grid.free)  # factors that no further sheet overwrites
        if sheet.sticks:
            raise PressError(
                "elastomer.friction: found 'stick', which depends on the path of the press and has "
                "no derivative by the press' data; set 'none', or press at two values"
            )
        sheet.evaluate(state.control_mm, state, tangent=True)
        self._sheet, self._forces = sheet, sheet.forces()
        if not sheet.factorise(0.0):
            raise SolverError(
                "sheet: other equilibria are close to this one, so that it has no derivative; "
                "press at two values"
            )

    def press(
        self, mechanics: Mechanics, specimen: Specimen, elastomer: Elastomer, load: Press
    ) -> PressedElastomer:
        """Return the pressed elastomer for a small change of the input, to first order.

        Raises
        ------
        PressError
            The data change the frame, or are rejected as by `press_sheet`.
        """
        return self.neighbour(mechanics, specimen, elastomer, load).result()

    def neighbour(
        self, mechanics: Mechanics, specimen: Specimen, elastomer: Elastomer, load: Press
    ) -> SettledSheet:
        """Return that press as the solver's state; see `press`."""
        case = sheet_case(specimen, elastomer, load, mechanics)
        if case.frame != self.rest.case.frame:
            raise PressError(
                "elastomer: a change of outline, lengths, pre-stretch, support or rim needs a new "
                "grid; there is no derivative by them: press at two values"
            )
        sheet = copy(self._sheet)
        range_mm = sheet.laws.tack_range_mm  # of the cells
        sheet.laws, sheet.bodies = case.laws._replace(tack_range_mm=range_mm), case.bodies
        sheet.touched_z_mm = case.touched_z_mm
        travel_mm = self.rest.state.travel_mm if load.depth_mm is None else load.depth_mm
        state = self._stepped(sheet, travel_mm, load.back_pressure_kpa)
        if load.force_n is not None:
            state = self._at_force(sheet, state, load.force_n)
        return SettledSheet(case, elastomer, load, sheet, state)

    def _stepped(self, sheet: Sheet, travel_mm: float, pressure_kpa: float) -> SheetState:
        """Return the state of the sheet to first order."""
        rest = self.rest.state
        there = replace(rest, travel_mm=travel_mm, pressure_kpa=pressure_kpa)
        sheet.evaluate(rest.control_mm, there, tangent=False)
        moved_mm = sheet.answer_mm(sheet.forces() - self._forces)
        return replace(there, control_mm=rest.control_mm + moved_mm)

    def _at_force(self, sheet: Sheet, state: SheetState, force_n: float) -> SheetState:
        """Return the state moved along the travel to a given force."""
        by_mm = _SMALL_SHARE * state.travel_mm
        travels_mm = state.travel_mm - by_mm, state.travel_mm + by_mm
        low, high = (self._stepped(sheet, value, state.pressure_kpa) for value in travels_mm)
        reached_n, low_n, high_n = (contact_force_n(sheet, point) for point in (state, low, high))
        along = (force_n - reached_n) / (high_n - low_n)
        control = state.control_mm + along * (high.control_mm - low.control_mm)
        return replace(state, control_mm=control, travel_mm=state.travel_mm + 2 * along * by_mm)
