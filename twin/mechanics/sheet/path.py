"""Load stepping of a press on one grid: first the travel increases, then the back pressure.

Each step starts from a state on the line through the last two states. Only the last step must reach
equilibrium. A step that fails, for example because the sheet becomes too thin, is halved. If a step
of 1/16 fails as well, the error states the last stable travel or pressure.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import RegularGridInterpolator

from reconstruction.arrays import FloatArray
from twin.mechanics.errors import PressError, SolverError
from twin.mechanics.sheet.energy import Sheet, SheetState
from twin.mechanics.sheet.equilibrium import Accuracy, settle
from twin.mechanics.sheet.grid import SheetGrid, thinning_of
from twin.mechanics.sheet.laws import Grip
from twin.mechanics.validity import THINNEST

TRAVEL_STEP_MM, PRESSURE_STEPS_KPA = 0.2, (0.5, 1.0, 2.0, 3.0, 4.5, 6.0, 8.0, 10.0)
_PRESSURE_STEP_BEYOND_KPA = 2.0
#: of a step; below this the path has ended
_SMALLEST_STEP = 1 / 16
# A load step is no result: if many equilibria are close together, as on a slack sheet, the next
# load step starts before one of them is reached.
_MOST_STEPS_PER_LOAD = 20
_ROUGH_STEP_MM, _ROUGH_RESIDUAL_KPA = 5e-3, 1.0
# The whole step is far too large where a sheet that spans free moves onto the specimen.
_PREDICTED_SHARES = (1.0, 0.5, 0.25, 0.0)

Progress = Callable[[float], None]


class LimitPressureError(PressError):
    """Error for a pressure without equilibrium, mostly because the sheet thins without limit."""

    def __init__(self, travel_mm: float, held_kpa: float, lost_kpa: float, reason: str) -> None:
        stable = f"is stable up to {held_kpa:.2f} kPa" if held_kpa > 0 else "is not stable"
        super().__init__(
            f"press.back_pressure_kpa: the sheet {stable} at {travel_mm:.3g} mm of travel, and has "
            f"no equilibrium towards {lost_kpa:.2f} kPa ({reason}); use less pressure, a "
            "thicker or a harder sheet"
        )
        self.held_kpa = held_kpa
        self.reason = reason


@dataclass(frozen=True)
class Loads:
    """Loads of a state: travel after first touch, mm, and back pressure, kPa."""

    travel_mm: float
    pressure_kpa: float = 0.0


def mounted(grid: SheetGrid) -> SheetState:
    """Return the state of the mounted sheet without loads and anchors."""
    points = grid.rest.area_mm2.shape
    no_limit = np.full(points, np.inf)
    grip = Grip(np.zeros(points), np.zeros((*points, 3)), np.zeros((*points, 3)), no_limit)
    return SheetState(grid.mounted_mm, grip)


def load_steps(goal: Loads) -> list[Loads]:
    """Return the load steps of a path: travel in equal steps, then pressure.

    The travels before the last do not depend on the goal, so that presses to different travels
    share the first steps of their paths.
    """
    count = int(np.ceil(goal.travel_mm / TRAVEL_STEP_MM - 1e-9))
    steps = [*(Loads(_common_travel(k)) for k in range(1, count)), Loads(goal.travel_mm)]
    last = PRESSURE_STEPS_KPA[-1]
    beyond = np.arange(
        last + _PRESSURE_STEP_BEYOND_KPA, goal.pressure_kpa, _PRESSURE_STEP_BEYOND_KPA
    )
    pressures = [p for p in (*PRESSURE_STEPS_KPA, *beyond) if p < goal.pressure_kpa]
    if goal.pressure_kpa > 0:
        pressures.append(goal.pressure_kpa)
    return steps + [Loads(goal.travel_mm, float(p)) for p in pressures]


def follow(
    sheet: Sheet,
    goal: Loads,
    accuracy: Accuracy,
    shared: list[SheetState] | None = None,
    *,
    pressed_states: list[SheetState] | None = None,
    progress: Progress | None = None,
) -> SheetState:
    """Return the equilibrium of a sheet at the loads `goal`, by load steps from the mounted sheet.

    Parameters
    ----------
    accuracy : tolerances of the equilibrium
    shared : list of SheetState, optional
        States at the first travels of `load_steps`, from earlier paths of this sheet. New states at
        these travels are appended.
    pressed_states : list of SheetState, optional
        The states of load steps with a back pressure are appended to this list.
    progress : called with the finished fraction of the load steps, 0 to 1

    Raises
    ------
    LimitPressureError
        The sheet has no equilibrium at the pressure. The message states the largest pressure of a
        load step that the sheet reached.
    SolverError
        The sheet has no equilibrium at the travel. The message states the last travel reached.
    """
    stops, shared = load_steps(goal), [] if shared is None else shared
    during_load_steps = _during_load_steps(sheet, accuracy)
    common = [stop for stop in stops if _is_common(stop)]
    known = [mounted(sheet.grid), *shared[: len(common)]]
    state, before = known[-1], known[max(len(known) - 2, 0)]
    for number in range(len(known) - 1, len(stops)):
        state, before = advance(
            sheet, state, before, stops[number], during_load_steps, pressed_states=pressed_states
        )
        if number == len(shared) and number < len(common):
            shared.append(state)
        if progress is not None:
            progress((number + 1) / len(stops))
    try:
        equilibrium = settle(sheet, state, accuracy)
        check_thickness(sheet, equilibrium)
    except SolverError as error:
        raise _ended(before, goal, error) from error
    return equilibrium


def _during_load_steps(sheet: Sheet, accuracy: Accuracy) -> Accuracy:
    less = replace(accuracy, most_steps=_MOST_STEPS_PER_LOAD, strict=False)
    if sheet.sticks:  # its anchors depend on its path
        return less
    return replace(
        less,
        step_mm=max(accuracy.step_mm, _ROUGH_STEP_MM),
        residual_kpa=max(accuracy.residual_kpa, _ROUGH_RESIDUAL_KPA),
    )


def _common_travel(step: int) -> float:
    # Rounded, so that a goal of 0.6 mm is the third step and not its neighbour in binary.
    return round(step * TRAVEL_STEP_MM, 9)


def _is_common(stop: Loads) -> bool:
    step = round(stop.travel_mm / TRAVEL_STEP_MM)
    return stop.pressure_kpa == 0 and stop.travel_mm == _common_travel(step)


def advance(
    sheet: Sheet,
    state: SheetState,
    before: SheetState,
    goal: Loads,
    accuracy: Accuracy,
    *,
    pressed_states: list[SheetState] | None = None,
) -> tuple[SheetState, SheetState]:
    """Change the loads from those of `state` to `goal`; return the last two states of the steps.

    The new state is the first of the two.

    Parameters
    ----------
    before : state before `state`, for the prediction of the first step
    accuracy : tolerances of each step
    pressed_states : list to which the states with a back pressure are appended; None: no list

    Raises
    ------
    LimitPressureError, SolverError
        A step of 1/16 of the change fails, see `follow`.
    """
    step = 1.0
    done = 0.0
    start = Loads(state.travel_mm, state.pressure_kpa)
    while done < 1:
        share = min(1.0, done + step)
        loads = _between(start, goal, share)
        try:
            new = settle(sheet, _predicted(sheet, state, before, loads), accuracy)
            check_thickness(sheet, new)
        except SolverError as error:
            step /= 2
            if step < _SMALLEST_STEP:
                raise _ended(state, goal, error) from error
            continue
        state, before, done = new, state, share
        if pressed_states is not None and state.pressure_kpa > 0:
            pressed_states.append(state)
    return state, before


def refined(coarse: Sheet, fine: Sheet, state: SheetState) -> SheetState:
    """Return a state of the coarse sheet, interpolated on the grid of the fine sheet."""
    control = fine.grid.moved_from(coarse.grid, state.control_mm)
    grip = mounted(fine.grid).grip
    moved = replace(state, control_mm=control, grip=grip)
    if not coarse.sticks:
        return moved
    # The springs to the anchors keep their stretch; new ones are added where the fine sheet touches
    stretch = np.where(
        state.grip.held[..., None] > 0,
        coarse.surface(state.control_mm)[..., 0, :] - _lifted(state),
        0.0,
    )
    carried = _at_points(coarse.grid, fine.grid, stretch)
    gripped = fine.regripped(moved)
    anchor = gripped.grip.anchor_mm - np.where(gripped.grip.held[..., None] > 0, carried, 0.0)
    return replace(gripped, grip=gripped.grip._replace(anchor_mm=anchor))


def _lifted(state: SheetState) -> FloatArray:
    lifted: FloatArray = state.grip.anchor_mm + np.array([0.0, 0.0, state.travel_mm])
    return lifted


def _at_points(coarse: SheetGrid, fine: SheetGrid, values: FloatArray) -> FloatArray:
    """Interpolate values (row, col, 4, k) from the coarse to the fine grid's Gauss points."""
    rows, cols, _, count = values.shape
    regular = values.reshape(rows, cols, 2, 2, count).transpose(0, 2, 1, 3, 4)
    table = RegularGridInterpolator(
        (coarse.y.points.ravel(), coarse.x.points.ravel()),
        regular.reshape(2 * rows, 2 * cols, count),
        bounds_error=False,
        fill_value=None,
    )
    y, x = np.meshgrid(fine.y.points.ravel(), fine.x.points.ravel(), indexing="ij")
    interpolated = table(np.stack((y, x), axis=-1))
    shape = (fine.y.cells, 2, fine.x.cells, 2, count)
    moved: FloatArray = interpolated.reshape(shape).transpose(0, 2, 1, 3, 4)
    return np.ascontiguousarray(moved).reshape(fine.y.cells, fine.x.cells, 4, count)


def _between(start: Loads, goal: Loads, share: float) -> Loads:
    if share >= 1:
        return goal
    return Loads(
        start.travel_mm + share * (goal.travel_mm - start.travel_mm),
        start.pressure_kpa + share * (goal.pressure_kpa - start.pressure_kpa),
    )


def _predicted(sheet: Sheet, state: SheetState, before: SheetState, loads: Loads) -> SheetState:
    """Return a first guess of the state at `loads`: the last state, moved on as in the last step.

    The distance moved is the one with the least energy out of four. If travel and pressure do not
    change as in the last step, the guess has the control points of the last state.
    """
    there = replace(state, travel_mm=loads.travel_mm, pressure_kpa=loads.pressure_kpa)
    made = np.array([state.travel_mm - before.travel_mm, state.pressure_kpa - before.pressure_kpa])
    change = np.array([loads.travel_mm - state.travel_mm, loads.pressure_kpa - state.pressure_kpa])
    along = made != 0
    if along.sum() != 1 or (along != (change != 0)).any():
        return there
    ratio = min(1.5, float(change[along][0] / made[along][0]))
    step_mm = ratio * (state.control_mm - before.control_mm)
    places = [state.control_mm + share * step_mm for share in _PREDICTED_SHARES]
    energies = [sheet.evaluate(place, there, tangent=False).energy for place in places]
    return replace(there, control_mm=places[int(np.nanargmin(energies))])


def check_thickness(sheet: Sheet, state: SheetState, least: float = THINNEST) -> None:
    """Raise an error if the sheet is thinner somewhere than real silicone can become.

    Parameters
    ----------
    least : smallest allowed ratio of local to undeformed thickness

    Raises
    ------
    SolverError : the smallest ratio is below `least`
    """
    thinnest = float(thinning_of(sheet.surface(state.control_mm)).min())
    if thinnest < least:
        raise SolverError(f"sheet: thins to {thinnest:.2f} of its thickness")


def _ended(state: SheetState, goal: Loads, error: SolverError) -> LimitPressureError | SolverError:
    if goal.pressure_kpa > state.pressure_kpa:
        return LimitPressureError(
            state.travel_mm, state.pressure_kpa, goal.pressure_kpa, str(error)
        )
    return SolverError(f"{error}; the last travel in equilibrium is {state.travel_mm:.3g} mm")
