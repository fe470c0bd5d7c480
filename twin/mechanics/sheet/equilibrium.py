"""Equilibrium of the sheet at given travel and pressure: Newton's method on its energy.

If the exact tangent is not positive definite, viscosity is added, or a convex tangent replaces it
for some steps. A line search on the energy, and a limit on the rotation of normals per step,
prevent cells from flipping.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from reconstruction.arrays import FloatArray
from twin.mechanics.errors import SolverError
from twin.mechanics.sheet.damping import (
    GROWTH,
    LEAST_VISCOSITY,
    MOST_VISCOSITY,
    Damping,
    adapted,
    exact_viscosity,
)
from twin.mechanics.sheet.energy import Evaluation, Sheet, SheetState
from twin.mechanics.sheet.grid import thinning_of
from twin.mechanics.sheet.laws import Grip

_LARGEST_MOVE_MM, _SMALLEST_SHARE, _SUFFICIENT = 0.5, 1e-3, 1e-4
#: cosine of the largest turn of a normal in one step
_LARGEST_TURN = 0.5
_REGRIP_EVERY = 4
#: thickness over its undeformed value
_FILM = 0.1
# Of the decrease that the slope at a step's start predicts; a quadratic of the step's own length
# has 50 % of it.
_STILL_STEEP = 0.75
# Of the energy: a step that predicts less is judged by the residual forces.
_ROUNDING, _LEAST_BY_FORCES = 1e-11, 0.25
# Factors serve a second step if the residual is below this many times the tolerance. Such a step
# takes 1/5 of the time of a new tangent and its factors. For a sheet whose equilibrium does not
# depend on its path they serve from larger residuals, as long as each step reduces the residual.
_FACTORS_SERVE, _SERVE_LONGER, _CONVERGES = 100.0, 10.0, 0.4
# Of the tolerance of a step: after a step not longer than this the factors are expected to serve.
_SHORT = 30.0
# With factors of an earlier step as preconditioner. Of the tolerance of a step: after a step not
# longer than this an equilibrium is expected. And the largest residual of a step that is used; new
# factors follow it if it is larger than that of `Approximation.is_accurate`.
_SHORT_KEPT, _USEFUL = 0.25, 0.25
# Of the tolerance of a step: the damped steps of a soft sheet are much shorter than its distance to
# the equilibrium.
_DAMPED = 0.1
# Of a step: a shorter share of it does not measure the distance to the equilibrium, unless the
# whole step is shorter than the tolerance: energies and forces do not resolve such a step.
_NEARLY_WHOLE = 0.9


@dataclass(frozen=True)
class Accuracy:
    """Tolerances of an equilibrium: largest Newton step, mm, residual, kPa, and number of steps."""

    step_mm: float = 2e-4
    residual_kpa: float = 0.02
    most_steps: int = 80
    #: raise an error without equilibrium after the most steps; or accept it, during the load steps
    strict: bool = True
    #: anchors are updated after any step shorter than this, and after every fourth
    anchors_from_mm: float = 0.0
    #: the first tangent is convex: that of a state from wider cells is hardly ever definite
    starts_convex: bool = False


def settle(sheet: Sheet, state: SheetState, accuracy: Accuracy) -> SheetState:
    """Return the equilibrium that is reached from `state` by a descent in energy.

    If `accuracy.strict` is False, the state after the last step is returned without equilibrium.

    Raises
    ------
    SolverError
        The sheet thins to a film, no direction lowers its energy, or, if `accuracy.strict` is True,
        there is no equilibrium within `accuracy.most_steps` steps.
    """
    return _settled(_Descent(sheet, state, accuracy))


@dataclass(eq=False)
class _Descent:
    """A sheet during the descent, and the results of the last step."""

    sheet: Sheet
    state: SheetState
    accuracy: Accuracy
    control_mm: FloatArray = field(init=False)
    #: evaluation that the sheet's forces and tangent belong to
    now: Evaluation = field(init=False)
    damping: Damping = field(init=False, default=Damping())
    #: the last factors and their tangent are used for the next step
    serves: bool = field(init=False, default=False)
    #: the last factors are tried as preconditioner of the next tangent
    keeps: bool = field(init=False, default=False)
    #: they were the preconditioner of the last step's tangent
    kept: bool = field(init=False, default=False)
    step_mm: FloatArray = field(init=False)
    viscosity: float = field(init=False, default=0.0)
    share: float = field(init=False, default=1.0)
    #: decrease of the energy over that of the quadratic model
    gain: float = field(init=False, default=1.0)
    #: residual before the last step, kPa
    before_kpa: float = field(init=False, default=np.inf)

    def __post_init__(self) -> None:
        if self.accuracy.starts_convex:
            self.damping = Damping().convexified()
        self.move(self.state.control_mm)

    @property
    def here(self) -> SheetState:
        """The state with the current control points."""
        return replace(self.state, control_mm=self.control_mm)

    @property
    def residual_kpa(self) -> float:
        """Largest component of a control point's force over its area, kPa."""
        return float(self.sheet.residuals_kpa().max())

    def move(self, control_mm: FloatArray) -> None:
        """Set the control points, and evaluate energy, forces and tangent there."""
        self.control_mm = control_mm
        self.now = self.sheet.evaluate(
            control_mm, self.state, tangent=True, convex=self.damping.convex
        )

    def descend(self) -> None:
        """Take one Newton step, shortened by the line search; store step, share and gain."""
        self.before_kpa = self.residual_kpa
        step = self._step_mm()
        gradient = self.sheet.forces()
        slope = float(gradient @ step[self.sheet.grid.free])
        energy = self.now.energy
        self.share, self.now = _searched(self, step, slope)
        self.gain = (self.now.energy - energy) / min(
            slope * self.share * (1 - self.share / 2), -1e-300
        )
        self.control_mm = self.control_mm + self.share * step
        self.step_mm, self.viscosity = step, self.damping.viscosity

    def _step_mm(self) -> FloatArray:
        """Return Newton's step, by the last factors where they are sufficient, else by new ones."""
        self.kept = False
        if self.serves:
            return self.sheet.newton_step_mm()
        if not self.now.tangent:
            self.move(self.control_mm)
        if self.keeps:
            step, near = self.sheet.approximate_step_mm(self.damping.viscosity)
            self.keeps, self.kept = near.is_accurate, near.residual <= _USEFUL
            if self.kept:
                self.damping = self.damping.after_step()
                return step
        return self._step_by_new_factors_mm()

    def _step_by_new_factors_mm(self) -> FloatArray:
        """Return Newton's step, by new factors of the tangent or of a convex one."""
        self.damping = _definite(self, self.damping)
        step = self.sheet.newton_step_mm()
        if self.damping.viscosity and np.abs(step).max() > _LARGEST_MOVE_MM:  # nearly indefinite
            self.damping = _definite(self, self.damping.times(GROWTH))
            step = self.sheet.newton_step_mm()
        # A path of equilibria would depend on the error of such a solution.
        is_free = slips(self.sheet, self.state.pressure_kpa)
        self.keeps = is_free and self.sheet.system.solver.keeps_factors
        return step

    def anchor(self) -> None:
        """Update the anchors, see `Sheet.regripped`; evaluate again if an anchor was changed."""
        grip, self.state = self.state.grip, self.sheet.regripped(self.here)
        if _differs(self.state.grip, grip):
            self.move(self.control_mm)

    def damp(self) -> None:
        """Set the damping of the next step, and whether that step uses the last factorisation."""
        converges = not self.serves
        most_kpa = _FACTORS_SERVE * self.accuracy.residual_kpa
        if slips(self.sheet, self.state.pressure_kpa):
            converges = self.residual_kpa < _CONVERGES * self.before_kpa
            most_kpa *= _SERVE_LONGER
        unhindered = self.viscosity == 0 and self.share == 1.0 and not self.kept
        self.serves = unhindered and converges and self.residual_kpa < most_kpa
        viscosity = adapted(self.viscosity, self.share, self.gain)
        self.damping = replace(self.damping, viscosity=viscosity)


def _differs(grip: Grip, before: Grip) -> bool:
    """Return True if points have been anchored or released, or limits of friction have changed."""
    return bool(
        (grip.held != before.held).any()
        or (grip.limit_kpa != before.limit_kpa)[grip.held > 0].any()
    )


def _settled(descent: _Descent) -> SheetState:
    """Return the result of a descent, as `settle`.

    Raises
    ------
    SolverError
        For the reasons of `settle`.
    """
    sheet, accuracy = descent.sheet, descent.accuracy
    for count in range(accuracy.most_steps):
        descent.descend()
        _check_film(descent.now.surface, descent.state)
        if sheet.sticks and (count % _REGRIP_EVERY == _REGRIP_EVERY - 1 or _is_near(descent)):
            descent.anchor()
        end = _end(descent)
        if end is not None:
            return sheet.slid(replace(end, steps=descent.state.steps + count + 1))
        descent.damp()
    if not accuracy.strict:
        return sheet.slid(replace(descent.here, steps=descent.state.steps + accuracy.most_steps))
    raise SolverError(
        f"sheet: no equilibrium at {descent.state.travel_mm:.3g} mm of travel and "
        f"{descent.state.pressure_kpa:.3g} kPa within {accuracy.most_steps} steps (last step "
        f"{1e3 * descent.share * float(np.abs(descent.step_mm).max()):.2g} um, residual "
        f"{descent.residual_kpa:.2g} kPa)"
    )


def _is_near(descent: _Descent) -> bool:
    """Return True if the last step was not shortened and is below `accuracy.anchors_from_mm`."""
    longest_mm = float(np.abs(descent.step_mm).max())
    return descent.share == 1.0 and longest_mm < descent.accuracy.anchors_from_mm


def _end(descent: _Descent) -> SheetState | None:
    """Return the equilibrium after a step, or None if it is not reached."""
    whole_mm = float(np.abs(descent.step_mm).max())
    if descent.share <= _NEARLY_WHOLE and whole_mm >= descent.accuracy.step_mm:
        return None
    rest = _rest_mm(descent, descent.share * descent.step_mm)
    if rest is None:
        return None
    descent.control_mm = descent.control_mm + rest
    before = descent.state.grip
    gripped = descent.sheet.regripped(descent.here) if descent.sheet.sticks else descent.here
    limits_differ = (gripped.grip.limit_kpa != before.limit_kpa)[gripped.grip.held > 0].any()
    if not ((gripped.grip.held < before.held).any() or limits_differ):
        return gripped
    # The released points had carried a part of the load, and limits of friction have changed.
    descent.state = gripped
    descent.move(descent.control_mm)
    return gripped if _rest_mm(descent, descent.step_mm) is not None else None


def _rest_mm(descent: _Descent, made_mm: FloatArray) -> FloatArray | None:
    """Return the next Newton step, which completes the equilibrium; None if it is still too long.

    It is computed with the last factorisation, so that no factorisation only confirms an
    equilibrium. With viscosity this step is too short, and with the factors of an earlier tangent
    it is not accurate; the step made before, `made_mm`, must then be short as well. With viscosity
    both must be shorter by `_DAMPED` for a sheet that is not slack.
    """
    if descent.residual_kpa >= descent.accuracy.residual_kpa:
        return None
    rest = descent.sheet.newton_step_mm()
    longest_mm = float(np.abs(rest).max())
    if descent.viscosity or descent.kept:
        longest_mm = max(longest_mm, float(np.abs(made_mm).max()))
    if descent.viscosity and slips(descent.sheet, descent.state.pressure_kpa):
        longest_mm /= _DAMPED
    return rest if longest_mm < descent.accuracy.step_mm else None


# ---- a definite tangent ----------------------------------------------------------------------


def slips(sheet: Sheet, pressure_kpa: float) -> bool:
    """Return True for a sheet under pressure without anchors and tack.

    Its equilibrium does not depend on the load path. With anchors or tack it does, and large steps
    would deviate from the path. A sheet without pressure may be slack, with many equilibria close
    together.
    """
    return not sheet.sticks and not sheet.laws.tack and pressure_kpa > 0


def _definite(descent: _Descent, damping: Damping) -> Damping:
    """Factorise the exact tangent or, if it is not positive definite, a convex one.

    Return the damping that was used.
    """
    once = slips(descent.sheet, descent.state.pressure_kpa)
    if not damping.convex:
        viscosity = exact_viscosity(descent.sheet, damping, once=once)
        if viscosity is not None:
            return Damping(viscosity)
        descent.sheet.evaluate(descent.control_mm, descent.state, tangent=True, convex=True)
        damping = damping.convexified() if once else Damping(convex_steps=1)
    viscosity = max(damping.viscosity, LEAST_VISCOSITY)
    while not descent.sheet.factorise(viscosity):
        viscosity *= GROWTH
        if viscosity > MOST_VISCOSITY:
            raise SolverError("sheet: no direction lowers its energy")
    return replace(damping, viscosity=viscosity).after_step()


# ---- line search -----------------------------------------------------------------------------


def _searched(descent: _Descent, step: FloatArray, slope: float) -> tuple[float, Evaluation]:
    """Return the factor by which the step is multiplied, and the evaluation after that step.

    With this factor the energy decreases sufficiently; 0 if no factor is found.
    """
    sheet, now = descent.sheet, descent.now
    if -slope <= _ROUNDING * abs(now.energy):
        return _by_forces(descent, step)
    share = min(1.0, _LARGEST_MOVE_MM / float(np.abs(step).max()))
    new = _at(descent, now.control_mm + share * step)
    if _lowers(now, new, share * slope):
        share, best = _extended(descent, step, new, share=share, slope=slope)
        return share, _held(descent, best)
    while share >= _SMALLEST_SHARE:
        share *= 0.5
        new = sheet.evaluate(now.control_mm + share * step, descent.state, tangent=False)
        if _lowers(now, new, share * slope):
            return share, _held(descent, new)
    return 0.0, _held(descent, now)


def _at(descent: _Descent, control_mm: FloatArray) -> Evaluation:
    """Evaluate control points; the tangent only where the factors will probably not serve."""
    moved_mm = float(np.abs(control_mm - descent.now.control_mm).max())
    short_mm = (_SHORT_KEPT if descent.kept else _SHORT) * descent.accuracy.step_mm
    tangent = descent.damping.viscosity > 0 or moved_mm > short_mm
    tangent |= not slips(descent.sheet, descent.state.pressure_kpa)
    convex = descent.damping.convex
    return descent.sheet.evaluate(control_mm, descent.state, tangent=tangent, convex=convex)


def _held(descent: _Descent, place: Evaluation) -> Evaluation:
    """Return the evaluation `place`, repeated if the sheet does not have its forces."""
    if descent.sheet.latest is place:
        return place
    return _at(descent, place.control_mm)


def _by_forces(descent: _Descent, step: FloatArray) -> tuple[float, Evaluation]:
    """Return the first of the factors 1, 0.5 and 0.25 of a short step that reduces the residual.

    If none does, it is 0.25. Energies cannot be compared, because they differ by less than rounding
    errors. Without this test a point at the contact's edge may make steps alternate for ever.
    """
    before_kpa, share = descent.residual_kpa, 1.0
    while True:
        place, convex = descent.now.control_mm + share * step, descent.damping.convex
        new = descent.sheet.evaluate(place, descent.state, tangent=True, convex=convex)
        if descent.residual_kpa < before_kpa or share <= _LEAST_BY_FORCES:
            return share, new
        share *= 0.5


def _extended(
    descent: _Descent, step: FloatArray, new: Evaluation, *, share: float, slope: float
) -> tuple[float, Evaluation]:
    """Return the factor of the step and its evaluation, after doubling the factor where useful.

    It is doubled while the energy decreases about as steeply as at the start of the step. Then not
    the sheet's stiffness but the viscosity has made the step short.
    """
    now, best, largest_mm = descent.now, new, float(np.abs(step).max())
    while (
        best.energy - now.energy < _STILL_STEEP * slope * share
        and 2 * share * largest_mm <= _LARGEST_MOVE_MM
    ):
        place = now.control_mm + 2 * share * step
        farther = descent.sheet.evaluate(place, descent.state, tangent=False)
        if farther.energy >= best.energy or _turn(now, farther) <= _LARGEST_TURN:
            break
        share, best = 2 * share, farther
    return share, best


def _lowers(now: Evaluation, new: Evaluation, slope: float) -> bool:
    """Return True if a step lowers the energy enough and turns no normal too far."""
    bound = now.energy + _SUFFICIENT * slope + 1e-12 * abs(now.energy)
    return bool(new.energy <= bound) and _turn(now, new) > _LARGEST_TURN


def _turn(before: Evaluation, after: Evaluation) -> float:
    """Return the least cosine of the angle between the normals of two evaluations at a point."""
    # Component by component: over short rows Numpy takes ten times as long.
    along = zip(np.moveaxis(before.normal, -1, 0), np.moveaxis(after.normal, -1, 0), strict=True)
    return float(sum(first * second for first, second in along).min())


def _check_film(surface: FloatArray, state: SheetState) -> None:
    """Raise SolverError if the sheet is thinner than `_FILM`: it then reaches no equilibrium."""
    thinnest = float(thinning_of(surface).min())
    if thinnest < _FILM:
        raise SolverError(
            f"sheet: thins to {thinnest:.2f} of its thickness at {state.travel_mm:.3g} mm of "
            f"travel and {state.pressure_kpa:.3g} kPa"
        )
