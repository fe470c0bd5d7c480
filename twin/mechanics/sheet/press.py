"""Press a specimen into a thin sheet: the `sheet` model, from the experiment's data to its result.

World frame, mm: the coated face of the mounted sheet is z = 0, and the sheet spans the opening of
its frame. The specimen, on its plate, is pressed from below; at travel 0 it touches the lower face.
In the solver's own frame z = 0 is the undeformed surface midway between the faces.

The model has Kirchhoff-Love kinematics with an incompressible neo-Hookean solid, including the
change of thickness. Elements are quadratic B-splines with 2 x 2 Gauss points. For the contact's
penalty stiffness see `case`.
"""

from collections import OrderedDict
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from twin.config.models import Elastomer, Mechanics, Press, Specimen
from twin.mechanics.errors import PressError, SolverError
from twin.mechanics.press import PressedElastomer
from twin.mechanics.sheet.case import SheetCase, sheet_case
from twin.mechanics.sheet.cells import (
    COARSE_CELL_MM,
    cells_between,
    coarse_cells,
    finest_cells,
    finest_pitch_mm,
)
from twin.mechanics.sheet.energy import Sheet, SheetState
from twin.mechanics.sheet.equilibrium import Accuracy, settle, slips
from twin.mechanics.sheet.nested import NEAR, descended, wider_cells
from twin.mechanics.sheet.path import (
    TRAVEL_STEP_MM,
    LimitPressureError,
    Loads,
    Progress,
    advance,
    check_thickness,
    follow,
    refined,
)
from twin.mechanics.sheet.result import contact_force_n, pressed_of
from twin.mechanics.validity import THINNEST

# Largest ratio of coarse to fine cells without cells of intermediate width. A sheet thinner than
# its cells slips over edges point by point: from cells of nearly the finest width in half of the
# time.
_WIDEST_RATIO, _WIDEST_RATIO_THIN = 3.0, 1.9
# A slack sheet of 0.05 mm needs a hundred steps and more, and a path with half steps is no shorter.
_ROUGH = Accuracy(step_mm=1e-3, residual_kpa=0.1, most_steps=300)
# The finest cells follow from the coarse state, which need not be an equilibrium: the finest cells
# change it by far more than further steps on coarse cells.
_NEARLY = replace(NEAR, most_steps=8)
_BETWEEN = Accuracy(step_mm=5e-3, residual_kpa=1.0, most_steps=40, strict=False)
# On intermediate cells a sheet that sticks has its full contact stiffness: if it is not in
# equilibrium there, the finest cells start inside the specimen.
_BETWEEN_STUCK = replace(_BETWEEN, most_steps=150)
_FINE = Accuracy(residual_kpa=2e-3, most_steps=200, anchors_from_mm=0.03)
# A touch by some um has a contact pressure below 0.01 kPa. From its equilibrium a few more steps
# follow, to a share of this pressure; on very fine cells rounding may not allow it.
_LIGHT = replace(_FINE, most_steps=6, strict=False)
_OF_THE_PRESSURE, _LEAST_RESIDUAL_KPA = 0.01, 1e-4
_FORCE_TOLERANCE, _FORCE_STEPS = 1e-3, 40
# Travel below which a specimen only touches: 0.5 % of a step of the load.
_FIRST_TOUCH_MM = 1e-3
# Least thickness over its undeformed value of a pressure that is reported: far above the limit.
_HOLDS = 2 * THINNEST
# Tried if no load step is stable: smaller pressures are not used in practice.
_LOW_PRESSURES_KPA = (0.25, 0.1)
# Of contact during the load steps: its compliance, in cells, at the sheet's shear modulus.
_SOFT = 0.125
_KEPT_PATHS = 4
# Of a preview: its steps are limited, so that a large change of the input takes about 1 s, too.
_PREVIEW = Accuracy(step_mm=5e-3, residual_kpa=1.0, most_steps=8, strict=False)
_PREVIEW_RELIEF_MM = 0.1
# Loads in which presses of one path may differ.
_LOADS = {"control": "depth", "depth_mm": 1.0, "force_n": None, "back_pressure_kpa": 0.0}


def press_sheet(
    specimen: Specimen,
    elastomer: Elastomer,
    load: Press,
    mechanics: Mechanics,
    progress: Progress | None = None,
) -> PressedElastomer:
    """Press `specimen` into a thin sheet by `load`.

    Parameters
    ----------
    specimen : Specimen
        The specimen in its pose. A plate under it, which covers the whole opening of the frame,
        moves with it.
    elastomer : Elastomer
        Sheet of 0.05 to 1 mm thickness without film, in the layout `opposite_face`.
    load : Press
        Depth or force, back pressure, gravity; `cell_mm` is the width of the finest cells.
    mechanics : Mechanics
        `support` is "simple" or "clamped"; None: clamped.
    progress : called with the finished fraction of the press, 0 to 1

    Returns
    -------
    PressedElastomer
        Both faces as height maps from above, with `sheet` fields at the coated face's nodes.

    Raises
    ------
    PressError
        The sheet model cannot compute this press (see `check_sheet`), or the force is not reached.
        Or the sheet is unstable at the back pressure; the message then states a stable pressure.
    SolverError
        The sheet has no equilibrium at the travel. The message states the last travel reached.
    """
    return settled_sheet(specimen, elastomer, load, mechanics, progress).result()


@dataclass(frozen=True, eq=False)
class SettledSheet:
    """A pressed sheet in equilibrium: its data, and the state of the solver on the finest cells."""

    case: SheetCase
    elastomer: Elastomer
    load: Press
    sheet: Sheet
    state: SheetState

    def result(self) -> PressedElastomer:
        """Return the pressed elastomer at this equilibrium."""
        return pressed_of(self.case, self.elastomer, self.load, self.sheet, self.state)


def settled_sheet(
    specimen: Specimen,
    elastomer: Elastomer,
    load: Press,
    mechanics: Mechanics,
    progress: Progress | None = None,
) -> SettledSheet:
    """Press as `press_sheet`, and return the equilibrium as a state of the solver.

    Raises
    ------
    PressError, SolverError
        As `press_sheet`.
    """
    path = _path(specimen, elastomer, load, mechanics)
    sheet, state = _equilibrium(path, load, progress)
    return SettledSheet(path.case, elastomer, load, sheet, state)


def coarse_sheet(
    specimen: Specimen,
    elastomer: Elastomer,
    load: Press,
    mechanics: Mechanics,
    near: SettledSheet | None = None,
) -> SettledSheet:
    """Press on the coarse cells of the load steps only: a preview of `settled_sheet`.

    Parameters
    ----------
    near : result of an earlier call, from whose state the load steps start; None: from the mounted
        sheet. A sheet that sticks always starts from the mounted sheet. A sheet under pressure
        without friction and tack needs no load steps and no earlier call

    Raises
    ------
    PressError, SolverError
        As `press_sheet`.
    """
    path = _Path.of(sheet_case(specimen, elastomer, load, mechanics))
    sheet, state = path.sheet, _previewed(path, load, near)
    if load.force_n is not None:
        state = _to_force(sheet, state, load.force_n, _PREVIEW, _silent)
    shown = load.model_copy(update={"relief_pitch_mm": _PREVIEW_RELIEF_MM})
    return SettledSheet(path.case, elastomer, shown, sheet, state)


def _previewed(path: "_Path", load: Press, near: SettledSheet | None) -> SheetState:
    """Return the state of the coarse sheet as `coarse_sheet`, at the depth of a load."""
    sheet, goal = path.sheet, Loads(load.depth_mm or TRAVEL_STEP_MM, load.back_pressure_kpa)
    if slips(sheet, goal.pressure_kpa):
        with suppress(SolverError):
            return descended([*path.wider, sheet], goal, NEAR)
    if near is None or sheet.sticks:
        return follow(sheet, goal, _ROUGH)
    start = refined(near.sheet, sheet, near.state)
    goal = replace(goal, travel_mm=load.depth_mm or start.travel_mm)
    return advance(sheet, start, start, goal, _PREVIEW)[0]


@dataclass(frozen=True, eq=False)
class _Path:
    """A case's sheet on coarse cells, and states that its presses to different loads share."""

    case: SheetCase
    sheet: Sheet
    #: at the common travels of all paths, see `load_steps`; further ones are appended
    states: list[SheetState]

    @classmethod
    def of(cls, case: SheetCase) -> "_Path":
        """Return the path of a case, without states."""
        return cls(case, _soft(case.sheet(coarse_cells(case))), [])

    @cached_property
    def wider(self) -> list[Sheet]:
        """The sheet on wider cells, the widest first."""
        return [_soft(self.case.sheet(cells)) for cells in wider_cells(self.case)]


#: Paths of this process, the latest last: a study over travel, pressure or force continues them.
_paths: OrderedDict[str, _Path] = OrderedDict()


def forget_paths() -> None:
    """Clear the cached paths, so that the next press starts from the mounted sheet."""
    _paths.clear()


def _path(specimen: Specimen, elastomer: Elastomer, load: Press, mechanics: Mechanics) -> _Path:
    """Return the path of a case; it is cached for presses that differ only in their loads.

    The states of a cached path have the same bytes as those of a new one.
    """
    same = (specimen, elastomer, load.model_copy(update=_LOADS), mechanics)
    key = "\n".join(f"{type(part).__name__} {part.model_dump_json()}" for part in same)
    if key not in _paths:
        _paths[key] = _Path.of(sheet_case(specimen, elastomer, load, mechanics))
    _paths.move_to_end(key)
    while len(_paths) > _KEPT_PATHS:
        _paths.popitem(last=False)
    return _paths[key]


def _equilibrium(path: _Path, load: Press, progress: Progress | None) -> tuple[Sheet, SheetState]:
    pressed_states: list[SheetState] = []
    try:
        return _settled(path, load, pressed_states, progress or _silent)
    except LimitPressureError as limit:
        requested_kpa = load.back_pressure_kpa
        travel_mm = load.depth_mm or TRAVEL_STEP_MM
        stable_kpa = _held_kpa(path, pressed_states, Loads(travel_mm, requested_kpa))
        raise LimitPressureError(travel_mm, stable_kpa, requested_kpa, limit.reason) from limit


def _settled(
    path: _Path, load: Press, pressed_states: list[SheetState], report: Progress
) -> tuple[Sheet, SheetState]:
    """Return the finest sheet and its equilibrium.

    A sheet whose equilibrium depends on the load path follows the path, and so does a sheet for
    which nested iteration does not reach an equilibrium.
    """
    goal = Loads(load.depth_mm or TRAVEL_STEP_MM, load.back_pressure_kpa)
    if slips(path.sheet, goal.pressure_kpa):
        # The force of a state that is no equilibrium is not known.
        accuracy = _ROUGH if load.force_n is not None else _NEARLY
        with suppress(SolverError, LimitPressureError):
            state = descended([*path.wider, path.sheet], goal, accuracy)
            return _continued(path, load, state, report)
    state = follow(
        path.sheet,
        goal,
        _ROUGH,
        path.states,
        pressed_states=pressed_states,
        progress=lambda share: report(0.6 * share),
    )
    return _continued(path, load, state, report)


def _continued(
    path: _Path, load: Press, state: SheetState, report: Progress
) -> tuple[Sheet, SheetState]:
    """Return the finest sheet and its equilibrium, from a state of the coarse sheet."""
    if load.force_n is not None:
        ahead = partial(_between_shares, report, 0.6, 0.7)
        state = _to_force(path.sheet, state, load.force_n, _ROUGH, ahead)
    report(0.7)
    try:
        fine, equilibrium = _on_fine_cells(path.case, path.sheet, state)
    except SolverError as error:
        if state.pressure_kpa == 0:
            raise
        # Coarse cells are stable where fine ones, which resolve sharper bends, are not.
        raise LimitPressureError(
            state.travel_mm, state.pressure_kpa, state.pressure_kpa, str(error)
        ) from error
    if load.force_n is not None:
        ahead = partial(_between_shares, report, 0.9, 1.0)
        equilibrium = _to_force(fine, equilibrium, load.force_n, _FINE, ahead)
    report(1.0)
    return fine, equilibrium


def _on_fine_cells(case: SheetCase, coarse: Sheet, state: SheetState) -> tuple[Sheet, SheetState]:
    """Return a sheet with the case's finest cells, and its equilibrium at the loads of `state`.

    The solution starts from `state`, that of the coarse sheet.
    """
    cell_mm = finest_pitch_mm(case, coarse, state)
    is_thin = case.laws.thickness_mm < cell_mm
    if cell_mm * (_WIDEST_RATIO_THIN if is_thin else _WIDEST_RATIO) < COARSE_CELL_MM:
        try:
            return _finest(*_begun(case, cell_mm, *_between(case, coarse, state)))
        except SolverError:
            # A sheet that sticks may fold over an edge on intermediate cells and remain folded.
            if state.pressure_kpa > 0 or not coarse.sticks:
                raise
    return _finest(*_begun(case, cell_mm, coarse, state))


def _between(case: SheetCase, coarse: Sheet, state: SheetState) -> tuple[Sheet, SheetState]:
    """Return a sheet with cells between the coarse and the finest, nearly in equilibrium."""
    between = _soft(case.sheet(cells_between(case, coarse, state)))
    accuracy = _BETWEEN_STUCK if between.sticks else _BETWEEN
    return between, settle(between, refined(coarse, between, state), accuracy)


def _begun(
    case: SheetCase, cell_mm: float, coarser: Sheet, state: SheetState
) -> tuple[Sheet, SheetState]:
    """Return the finest sheet, and as its first state the interpolated one of the coarser sheet.

    It is a function so that the factors of the coarser sheet are freed at its end: the next step
    needs much memory.
    """
    fine = case.sheet(finest_cells(case, coarser, state, cell_mm))
    return fine, refined(coarser, fine, state)


def _finest(fine: Sheet, start: SheetState) -> tuple[Sheet, SheetState]:
    accuracy = replace(_FINE, starts_convex=slips(fine, start.pressure_kpa))
    equilibrium = settle(fine, start, accuracy)
    residual_kpa = max(_OF_THE_PRESSURE * _largest_kpa(fine, equilibrium), _LEAST_RESIDUAL_KPA)
    if residual_kpa < accuracy.residual_kpa:
        equilibrium = settle(fine, equilibrium, replace(_LIGHT, residual_kpa=residual_kpa))
    check_thickness(fine, equilibrium)
    return fine, equilibrium


def _largest_kpa(sheet: Sheet, state: SheetState) -> float:
    """Return the largest contact pressure, kPa."""
    surface = sheet.surface(state.control_mm)
    gap = sheet.gap_mm(surface, sheet.touch(surface[..., 0, :], state.travel_mm))
    return float(sheet.laws.contact_stiffness * max(-gap.min(initial=0.0), 0.0))


def _soft(sheet: Sheet) -> Sheet:
    """Return the sheet with a contact stiffness limited according to its cells, for load steps.

    On cells much wider than its thickness, a sheet slips over an edge point by point. The stiffer
    the contact is, the more equilibria are close together. For a sheet that sticks the stiffness is
    not limited, because its result depends on the load path.
    """
    if sheet.sticks:
        return sheet
    stiffest = sheet.laws.shear_modulus_kpa / (_SOFT * sheet.cell_mm)
    softened = min(sheet.laws.contact_stiffness, stiffest)
    sheet.laws = sheet.laws._replace(contact_stiffness=softened)
    return sheet


def _held_kpa(path: _Path, pressed_states: list[SheetState], load: Loads) -> float:
    """Return a pressure, kPa, below the requested one that is stable with a margin; 0: none.

    It is the largest pressure of the load steps with an equilibrium on coarse cells. This pressure
    is also tested on intermediate cells. If that fails, the next lower pressure with an equilibrium
    on coarse cells is returned.
    """
    tried = False
    for state in _at_lower_pressures(path, pressed_states, load):
        with suppress(SolverError):
            equilibrium = settle(path.sheet, state, _ROUGH)
            check_thickness(path.sheet, equilibrium, _HOLDS)
            if not tried:
                tried = True
                between = _soft(path.case.sheet(cells_between(path.case, path.sheet, equilibrium)))
                start = refined(path.sheet, between, equilibrium)
                equilibrium = settle(between, start, replace(_BETWEEN, strict=True))
                check_thickness(between, equilibrium, _HOLDS)
            return float(np.floor(100 * state.pressure_kpa)) / 100
    return 0.0


def _at_lower_pressures(
    path: _Path, pressed_states: list[SheetState], load: Loads
) -> Iterator[SheetState]:
    """Yield states at pressures below the requested one: those of load steps, the largest first.

    Equilibria at the pressures `_LOW_PRESSURES_KPA` follow.
    """
    for state in sorted(pressed_states, key=lambda step: -step.pressure_kpa):
        if state.pressure_kpa < load.pressure_kpa:
            yield state
    for pressure_kpa in _LOW_PRESSURES_KPA:
        with suppress(SolverError, LimitPressureError):
            lower = Loads(load.travel_mm, pressure_kpa)
            yield follow(path.sheet, lower, _ROUGH, path.states)


def _silent(share: float) -> None:
    """Report no progress."""


def _between_shares(report: Progress, low: float, high: float, share: float) -> None:
    """Report the fraction `share` of a part of the press as a fraction, `low` to `high`, of it."""
    report(low + (high - low) * share)


def _to_force(
    sheet: Sheet, state: SheetState, force_n: float, accuracy: Accuracy, progress: Progress
) -> SheetState:
    """Return the state at the travel at which specimen and plate press on the sheet with a force.

    Raises
    ------
    PressError
        The force is not reached, or the air pressure causes a larger force already at first touch.
    """
    step = TRAVEL_STEP_MM
    before = state
    reached_n = contact_force_n(sheet, state)
    for number in range(_FORCE_STEPS):
        progress(number / _FORCE_STEPS)
        if abs(reached_n - force_n) <= _FORCE_TOLERANCE * force_n:
            return state
        if reached_n > force_n and state.travel_mm < _FIRST_TOUCH_MM:
            raise PressError(
                f"press.force_n: {force_n:g} N is less than the {reached_n:.3g} N with which air "
                f"of {state.pressure_kpa:g} kPa presses the sheet on the specimen at first touch; "
                "raise it, or lower press.back_pressure_kpa"
            )
        goal = Loads(max(state.travel_mm + step, state.travel_mm / 2), state.pressure_kpa)
        state, before = advance(sheet, state, state, goal, accuracy)
        last, reached_n = reached_n, contact_force_n(sheet, state)
        moved_mm = state.travel_mm - before.travel_mm
        secant = (force_n - reached_n) * moved_mm / (reached_n - last)
        step = float(np.clip(secant, -TRAVEL_STEP_MM, TRAVEL_STEP_MM))
    raise PressError(
        f"press.force_n: {force_n:g} N is not reached, found {reached_n:.4g} N at "
        f"{state.travel_mm:.3g} mm of travel; lower it, control the depth, or use a thicker or "
        "harder sheet on a narrower rim (elastomer.length_x_mm, length_y_mm)"
    )
