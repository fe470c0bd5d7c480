"""Compute equilibria of a sheet for small changes of the input, to first order, from one press.

In equilibrium the forces g on the free control points c are zero. They remain zero if the data p of
elastomer, press or specimen change (implicit function theorem):

    K dc/dp = -dg/dp,    K: the tangent in equilibrium, exact

A neighbour is the state after one Newton step with the changed data, from the equilibrium. Faces,
pressure and force are computed from it as for any press. Two neighbours, with the data changed by
+dp and -dp, give the derivatives of these results, with an error of second order in dp.

If the force is prescribed, the travel s changes too: ds = (prescribed force - force) / (dF/ds).
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
    """A sheet in equilibrium with its factorised tangent, for presses with slightly changed input.

    Raises
    ------
    PressError
        The sheet sticks: its equilibrium depends on its load path, so that it has no derivative.
    SolverError
        The tangent is not positive definite: other equilibria are close, and the sheet has no
        derivative.
    """

    rest: SettledSheet
    _sheet: Sheet = field(init=False)
    _forces: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        sheet, state = copy(self.rest.sheet), self.rest.state
        sheet.system = System.of(sheet.grid.free)  # factors that no further sheet overwrites
        if sheet.sticks:
            coefficient = self.rest.elastomer.friction_coefficient
            key = "friction: found 'stick'"
            if coefficient is not None:
                key = f"friction_coefficient: found {coefficient:g}"
            raise PressError(
                f"elastomer.{key}, which depends on the path of the press and has no derivative by "
                "the press' data; set friction = 'none', or press at two values"
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
            The new data have another frame, or `press_sheet` would reject them.
        """
        return self.neighbour(mechanics, specimen, elastomer, load).result()

    def neighbour(
        self, mechanics: Mechanics, specimen: Specimen, elastomer: Elastomer, load: Press
    ) -> SettledSheet:
        """Return the result of `press` with the same arguments as a state of the solver."""
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
        sheet.grid = sheet.grid.with_thickness(case.thickness)
        travel_mm = self.rest.state.travel_mm if load.depth_mm is None else load.depth_mm
        state = self._stepped(sheet, travel_mm, load.back_pressure_kpa)
        if load.force_n is not None:
            state = self._at_force(sheet, state, load.force_n)
        return SettledSheet(case, elastomer, load, sheet, state)

    def _stepped(self, sheet: Sheet, travel_mm: float, pressure_kpa: float) -> SheetState:
        """Return the state, to first order, of a sheet with new data at a travel and a pressure."""
        rest = self.rest.state
        there = replace(rest, travel_mm=travel_mm, pressure_kpa=pressure_kpa)
        sheet.evaluate(rest.control_mm, there, tangent=False)
        moved_mm = sheet.answer_mm(sheet.forces() - self._forces)
        return replace(there, control_mm=rest.control_mm + moved_mm)

    def _at_force(self, sheet: Sheet, state: SheetState, force_n: float) -> SheetState:
        """Return the state whose travel is changed so that the contact force is `force_n`."""
        by_mm = _SMALL_SHARE * state.travel_mm
        travels_mm = state.travel_mm - by_mm, state.travel_mm + by_mm
        low, high = (self._stepped(sheet, value, state.pressure_kpa) for value in travels_mm)
        reached_n, low_n, high_n = (contact_force_n(sheet, point) for point in (state, low, high))
        along = (force_n - reached_n) / (high_n - low_n)
        control = state.control_mm + along * (high.control_mm - low.control_mm)
        return replace(state, control_mm=control, travel_mm=state.travel_mm + 2 * along * by_mm)
