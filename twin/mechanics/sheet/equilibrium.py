"""Equilibrium of the sheet at one travel: Newton's method on its energy.

One energy with its exact tangent. Where that tangent is not positive definite, a convexified one
with a little viscosity replaces it for some steps; a line search on the energy and a limit on how
far a normal may turn per step keep cells from flipping.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.machine import threads
from twin.mechanics.errors import SolverError
from twin.mechanics.sheet.grid import SheetGrid, functions_of, normal_of, thinning_of
from twin.mechanics.sheet.kernel import SLOTS, Assembled, assemble_rows, scratch, surface_rows
from twin.mechanics.sheet.laws import Grip, Laws, Touch
from twin.mechanics.sheet.linear_solver import LinearSolver, linear_solver
from twin.mechanics.sheet.point import Asked, Felt
from twin.mechanics.sheet.spots import settled_spots
from twin.mechanics.sheet.stencil import control_areas, stencil
from twin.specimens.distance import Distances, SignedDistance, is_clear_of

# A band is a block of cell rows that one thread takes; its forces reach two rows beyond it.
_BAND_ROWS = 8
_LARGEST_MOVE_MM, _SMALLEST_SHARE, _SUFFICIENT = 0.5, 1e-3, 1e-4
#: cosine of the largest turn of a normal in one step
_LARGEST_TURN = 0.5
_REGRIP_EVERY = 4
#: thickness over its undeformed value
_FILM = 0.1
# Shares of the cohesive range: anchored below the first, let go above the second, where the pull is
# largest. Springs held farther would add to the work of peeling: 10 % at 0.2 mm, 50 % at 0.1 mm.
_GRIPS, _LETS_GO = 0.25, 0.5
_LEAST_VISCOSITY, _CONVEX_FROM, _MOST_VISCOSITY = 1.0, 1e4, 1e15
# Little viscosity keeps most of what the exact tangent knows. As much as the worst point of a sheet
# that slips may need would hold all of it back.
_CONVEX_FROM_SLIPPING = 64.0
# A tangent that was not definite is asked again after 1 step, 2, 4 and at most so many.
_MOST_CONVEX_STEPS = 16
_GROWTH = 8.0
# Spots that want this much settle by themselves.
_SPOTS_FROM = 8.0
# Of a step's promised gain.
_POOR, _GOOD = 0.5, 0.75
# Of the fall that the slope at a step's start promises; a quadratic of the step's own length has
# half of it.
_STILL_STEEP = 0.75
# Factors serve a second step where the residual is less than this many times the one asked for.
_FACTORS_SERVE = 100.0


@dataclass(frozen=True)
class Accuracy:
    """When the sheet counts as being in equilibrium."""

    step_mm: float = 2e-4
    residual_kpa: float = 0.02
    most_steps: int = 80
    #: refuse what is not in equilibrium after the most steps; or take it, as a stop on the way
    strict: bool = True
    #: anchors are told again after any step shorter than this, and after every fourth
    anchors_from_mm: float = 0.0


@dataclass(frozen=True, eq=False)
class Bodies:
    """What the sheet may touch: bodies that travel with the specimen, and the frame's walls."""

    moving: Sequence[SignedDistance]
    fixed: Sequence[SignedDistance] = ()


@dataclass(frozen=True, eq=False)
class SheetState:
    """A sheet in equilibrium, or on its way there."""

    control_mm: FloatArray
    grip: Grip
    travel_mm: float = 0.0
    pressure_kpa: float = 0.0
    steps: int = 0


@dataclass(frozen=True)
class _Damping:
    """What makes a tangent definite: viscosity, and a convex one in its place for some steps."""

    viscosity: float = 0.0
    #: so many steps more
    convex_steps: int = 0
    #: for how many the last refusal was
    refused: int = 0

    @property
    def convex(self) -> bool:
        """The next tangent is to be convex."""
        return self.convex_steps > 0

    def times(self, factor: float) -> "_Damping":
        """Return it with more viscosity."""
        return replace(self, viscosity=factor * self.viscosity)

    def refusing(self) -> "_Damping":
        """Return it convex, for twice as many steps as after the refusal before."""
        steps = min(max(2 * self.refused, 1), _MOST_CONVEX_STEPS)
        return replace(self, convex_steps=steps, refused=steps)


@dataclass(frozen=True, eq=False)
class Evaluation:
    """The energy at one place; its forces and tangent stay with the sheet until the next."""

    energy: float
    control_mm: FloatArray
    surface: FloatArray


@dataclass(eq=False)
class Sheet:
    """A sheet on one grid over its bodies: the solver's memory between states."""

    grid: SheetGrid
    laws: Laws
    bodies: Bodies
    #: specimen's z = 0 plane in the sheet's frame at zero travel
    touched_z_mm: float
    sticks: bool = False
    #: cells where it touches
    cell_mm: float = 0.0
    #: part of a sheet
    is_window: bool = field(init=False, default=False)
    solver: LinearSolver = field(init=False)
    factorisations: int = field(init=False, default=0)
    evaluations: int = field(init=False, default=0)

    def __post_init__(self) -> None:
        rows, cols = self.grid.free.shape[:2]
        self._stencil = stencil(self.grid.free)
        self.solver = linear_solver(self._stencil.start, self._stencil.columns)
        self._forces = np.zeros((rows, cols, 3))
        self._tangent = np.zeros((rows, cols, len(SLOTS), 3, 3))
        self.area_mm2 = control_areas(self.grid)
        self._pool = ThreadPoolExecutor(threads())

    # ---- evaluation ----------------------------------------------------------------------

    def evaluate(
        self, control_mm: FloatArray, state: SheetState, *, tangent: bool, convex: bool = False
    ) -> Evaluation:
        """Evaluate the energy and forces of `control_mm` under the state's loads."""
        surface = self.surface(control_mm)
        touch = self._near(surface[..., 0, :], state.travel_mm)
        laws = self.laws._replace(pressure_kpa=state.pressure_kpa)
        lifted = state.grip._replace(
            anchor_mm=state.grip.anchor_mm + np.array([0.0, 0.0, state.travel_mm])
        )
        rows = self.grid.y.cells
        energy = np.zeros(rows)
        self._forces[:] = 0.0
        if tangent:
            self._tangent[:] = 0.0
        tangents = self._tangent.reshape(*self._tangent.shape[:2], -1)
        felt, asked = Felt(laws, touch, lifted), Asked(tangent, convex)
        sums = Assembled(energy, self._forces, tangents)
        for parity in (0, 1):  # neighbouring bands write to the same control points
            self._over_bands(
                rows,
                parity,
                lambda a, b: assemble_rows(
                    (a, b), control_mm, self.grid.rest, felt, asked, scratch(), sums
                ),
            )
        self.evaluations += 1
        return Evaluation(float(energy.sum()), control_mm, surface)

    def surface(self, control_mm: FloatArray) -> FloatArray:
        """Return (row, col, 4, 3, xyz): place and derivatives at the Gauss points."""
        rows, cols = self.grid.y.cells, self.grid.x.cells
        out = np.zeros((rows, cols, 4, 3, 3))
        for parity in (0, 1):
            self._over_bands(
                rows,
                parity,
                lambda a, b: surface_rows(
                    a, b, control_mm, self.grid.rest, np.zeros((9, 3)), np.zeros(5), out
                ),
            )
        return out

    @property
    def reach_mm(self) -> float:
        """Distance of the middle surface from a body beyond which the two do not feel each other.

        Half a thickness, half as much again where the sheet is compressed, and the tack's range.
        """
        return 0.75 * self.laws.thickness_mm + self.laws.tack_range_mm

    def touch(self, place_mm: FloatArray, travel_mm: float) -> Touch:
        """Return the moving bodies' distances at the sheet's Gauss points (row, col, 4, xyz)."""
        points = self._lowered(place_mm, travel_mm)
        found = [body.evaluate(points, self.reach_mm) for body in self.bodies.moving]
        return _stacked(found, place_mm.shape[:3])

    def _near(self, place_mm: FloatArray, travel_mm: float) -> Touch:
        """Return the distances to those bodies and walls that the sheet feels anywhere."""
        found = []
        sides = (
            (self.bodies.moving, self._lowered(place_mm, travel_mm)),
            (self.bodies.fixed, place_mm.reshape(-1, 3)),
        )
        for bodies, points in sides:
            low, high = points.min(axis=0), points.max(axis=0)
            asked = [body for body in bodies if not is_clear_of(body, low, high, self.reach_mm)]
            found += [body.evaluate(points, self.reach_mm) for body in asked]
        felt = [one for one in found if one[0].min() <= self.reach_mm]
        return _stacked(felt, place_mm.shape[:3])

    def _lowered(self, place_mm: FloatArray, travel_mm: float) -> FloatArray:
        """Return points (n, xyz) in the frame of the specimen."""
        lift = np.array([0.0, 0.0, self.touched_z_mm + travel_mm])
        lowered: FloatArray = place_mm.reshape(-1, 3) - lift
        return lowered

    def _over_bands(self, rows: int, parity: int, run: Callable[[int, int], None]) -> None:
        firsts = range(parity * _BAND_ROWS, rows, 2 * _BAND_ROWS)
        list(self._pool.map(lambda a: run(a, min(a + _BAND_ROWS, rows)), firsts))

    def forces(self) -> FloatArray:
        """Return (unknown,) gradient of the last evaluation's energy."""
        free: FloatArray = self._forces[self.grid.free]
        return free

    def reactions(self) -> FloatArray:
        """Return (n,) forces of the rim on the sheet along z, mN, at the last evaluation."""
        held: FloatArray = self._forces[~self.grid.free[..., 2], 2]
        return held

    def gap_mm(self, surface: FloatArray, touch: Touch) -> FloatArray:
        """Return (body, row, col, 4) distance of the lower face from each body."""
        gap: FloatArray = touch.distance_mm - self.laws.thickness_mm / 2 * thinning_of(surface)
        return gap

    def curvature_squared(self, control_mm: FloatArray) -> FloatArray:
        """Return (row, col, 4) mean of the two squared principal curvatures, 1/mm^2."""
        # All functions of a fine grid at once are half a gibibyte.
        bands = (slice(a, a + _BAND_ROWS) for a in range(0, self.grid.y.cells, _BAND_ROWS))
        return np.concatenate([self._curvature_squared(control_mm, band) for band in bands])

    def _curvature_squared(self, control_mm: FloatArray, band: slice) -> FloatArray:
        functions = functions_of(self.grid.rest, band)
        rows, cols = functions.shape[:2]
        cell = np.arange(9)
        local = control_mm[
            np.arange(band.start, band.start + rows)[:, None, None] + cell // 3,
            np.arange(cols)[None, :, None] + cell % 3,
        ]
        v = np.einsum("jiqnd,jink->djiqk", functions, local)
        unit = normal_of(np.moveaxis(v[:3], 0, -2))
        b11, b22, b12 = ((v[d] * unit).sum(axis=-1) for d in (3, 4, 5))
        a11, a22, a12 = ((v[d] * v[e]).sum(axis=-1) for d, e in ((1, 1), (2, 2), (1, 2)))
        det = a11 * a22 - a12**2
        trace = (a22 * b11 + a11 * b22 - 2 * a12 * b12) / det
        square: FloatArray = trace**2 / 2 - (b11 * b22 - b12**2) / det
        return square

    def regripped(self, state: SheetState) -> SheetState:
        """Anchor what touches and free what has left: neither raises the energy."""
        surface = self.surface(state.control_mm)
        touch = self.touch(surface[..., 0, :], state.travel_mm)
        gap = self.gap_mm(surface, touch)
        nearest = gap.argmin(axis=0)[None]
        gap = gap.min(axis=0)
        normal = np.take_along_axis(touch.gradient, nearest[..., None], axis=0)[0]
        # Tabled distances have gradients that are not quite 1 long; springs need them so.
        normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-9)
        reach = self.laws.tack_range_mm if self.laws.tack > 0 else 0.0
        new = ((gap < _GRIPS * reach) & (state.grip.held == 0))[..., None]
        place = surface[..., 0, :] - np.array([0.0, 0.0, state.travel_mm])
        held = np.where(new[..., 0] | ((state.grip.held > 0) & (gap <= _LETS_GO * reach)), 1.0, 0.0)
        grip = Grip(
            held,
            np.where(new, place, state.grip.anchor_mm),
            np.where(new, normal, state.grip.normal),
        )
        return replace(state, grip=grip)

    def window(self, rows: slice, cols: slice) -> "Sheet":
        """Return some of its cells as a sheet of their own, held all round."""
        grid = self.grid.window(rows, cols)
        part = Sheet(grid, self.laws, self.bodies, self.touched_z_mm, cell_mm=self.cell_mm)
        part.is_window = True
        return part

    # ---- descent -------------------------------------------------------------------------

    def settle(self, state: SheetState, accuracy: Accuracy) -> SheetState:
        """Return the equilibrium that is reached from `state` by going down in energy.

        Raises
        ------
        SolverError
            No equilibrium within the steps allowed.
        """
        control, damping = state.control_mm, _Damping()
        now = self.evaluate(control, state, tangent=True)
        serves = False
        for count in range(accuracy.most_steps):
            gradient = self.forces()
            if not serves:
                damping = self._definite(control, state, damping)
            step = self._spread(-self.solver.solve(gradient))
            if damping.viscosity and np.abs(step).max() > _LARGEST_MOVE_MM:  # nearly indefinite
                damping = self._definite(control, state, damping.times(_GROWTH))
                step = self._spread(-self.solver.solve(gradient))
            viscosity = damping.viscosity
            slope = float(gradient @ step[self.grid.free])
            energy = now.energy
            share, now = self._search(step, slope, now, state, convex=damping.convex)
            # Of what the quadratic model promises.
            gain = (now.energy - energy) / min(slope * share * (1 - share / 2), -1e-300)
            control = control + share * step
            _refuse_film(now.surface, state)
            near = share == 1.0 and float(np.abs(step).max()) < accuracy.anchors_from_mm
            if self.sticks and (near or count % _REGRIP_EVERY == _REGRIP_EVERY - 1):
                held, state = state.grip.held, self.regripped(replace(state, control_mm=control))
                if (state.grip.held != held).any():
                    now = self.evaluate(control, state, tangent=True, convex=damping.convex)
            rest = self._rest(share * step, viscosity, accuracy) if share > 0.9 else None
            if rest is not None:
                control = control + rest
                settled = replace(state, control_mm=control, steps=state.steps + count + 1)
                gripped = self.regripped(settled) if self.sticks else settled
                if not (gripped.grip.held < state.grip.held).any():
                    return gripped
                # What let go had borne a share of the load.
                state = replace(gripped, steps=state.steps)
                now = self.evaluate(control, state, tangent=True, convex=damping.convex)
                if self._rest(step, viscosity, accuracy) is not None:
                    return gripped
            serves = (
                not serves
                and viscosity == 0
                and share == 1.0
                and self._residual_kpa() < _FACTORS_SERVE * accuracy.residual_kpa
            )
            damping = replace(damping, viscosity=_adapted(viscosity, share, gain))
            if (
                (viscosity >= _SPOTS_FROM or share < 1)
                and self._slips(state)
                and not self.is_window
            ):
                residual = np.abs(self._forces * self.grid.free).max(axis=2) / self.area_mm2
                here = replace(state, control_mm=control)
                control = settled_spots(self, here, residual, accuracy)
                now = self.evaluate(control, state, tangent=True, convex=damping.convex)
        if not accuracy.strict:
            return replace(state, control_mm=control, steps=state.steps + accuracy.most_steps)
        raise SolverError(
            f"sheet: no equilibrium at {state.travel_mm:.3g} mm of travel and "
            f"{state.pressure_kpa:.3g} kPa within {accuracy.most_steps} steps (last step "
            f"{1e3 * share * float(np.abs(step).max()):.2g} um, residual "
            f"{self._residual_kpa():.2g} kPa)"
        )

    def _residual_kpa(self) -> float:
        return float(np.abs(self.forces() / self._weights).max())

    def _rest(self, made_mm: FloatArray, viscosity: float, accuracy: Accuracy) -> FloatArray | None:
        """Return the step that is left after a step made, None where one of them is still long.

        With the last factors, so that no factorisation only confirms an equilibrium. Where they
        hold viscosity they make what is left look short, and the step made counts too.
        """
        if self._residual_kpa() >= accuracy.residual_kpa:
            return None
        rest = -self._spread(self.solver.solve(self.forces()))
        longest = max(float(np.abs(rest).max()), float(np.abs(made_mm).max()) if viscosity else 0.0)
        return rest if longest < accuracy.step_mm else None

    @property
    def _weights(self) -> FloatArray:
        return np.repeat(self.area_mm2[..., None], 3, axis=2)[self.grid.free]

    def _definite(self, control: FloatArray, state: SheetState, damping: _Damping) -> _Damping:
        """Factorise the tangent, or where it is not definite a convex one; return what it took."""
        slips = self._slips(state)
        if not damping.convex:
            viscosity = self._exact(damping, _CONVEX_FROM_SLIPPING if slips else _CONVEX_FROM)
            if viscosity is not None:
                return _Damping(viscosity)
            self.evaluate(control, state, tangent=True, convex=True)
            damping = damping.refusing() if slips else _Damping(convex_steps=1)
        viscosity = max(damping.viscosity, _LEAST_VISCOSITY)
        while not self._factorise(viscosity):
            viscosity *= _GROWTH
            if viscosity > _MOST_VISCOSITY:
                raise SolverError("sheet: no direction lowers its energy")
        return replace(damping, viscosity=viscosity, convex_steps=damping.convex_steps - 1)

    def _exact(self, damping: _Damping, most: float) -> float | None:
        """Factorise the exact tangent; return its viscosity, None where it wants more than `most`.

        After a refusal it is tried once.
        """
        if damping.refused:
            viscosity = max(damping.viscosity, _GROWTH)
            return viscosity if self._factorise(viscosity) else None
        viscosity = damping.viscosity
        # A lowered viscosity that is too low is nearly enough; more makes short steps for long.
        growth = float(np.sqrt(_GROWTH)) if viscosity else _GROWTH**2
        while not self._factorise(viscosity):
            viscosity = max(growth * viscosity, _LEAST_VISCOSITY)
            if viscosity > most:
                return None
        return viscosity

    def _slips(self, state: SheetState) -> bool:
        """Tell whether it slips over its bodies, pressed on them: no equilibrium remembers a way.

        What is anchored or held by tack ends where its way leads, which large steps would leave;
        what bears no pressure may be slack, with many equilibria side by side.
        """
        return not self.sticks and not self.laws.tack and state.pressure_kpa > 0

    def _factorise(self, viscosity: float) -> bool:
        values = self._tangent.reshape(-1)[self._stencil.taken]
        if viscosity:
            values[self._stencil.start[:-1]] += viscosity * self._weights
        self.factorisations += 1
        return self.solver.factorise(values)

    def _spread(self, unknowns: FloatArray) -> FloatArray:
        step = np.zeros(self._forces.shape)
        step[self.grid.free] = unknowns
        return step

    def _search(
        self,
        step: FloatArray,
        slope: float,
        now: Evaluation,
        state: SheetState,
        *,
        convex: bool,
    ) -> tuple[float, Evaluation]:
        """Return the share of the step that lowers the energy enough, and what is there."""
        share = min(1.0, _LARGEST_MOVE_MM / float(np.abs(step).max()))

        def at(control_mm: FloatArray) -> Evaluation:
            return self.evaluate(control_mm, state, tangent=True, convex=convex)

        new = at(now.control_mm + share * step)
        if _lowers(now, new, share * slope):
            evaluations = self.evaluations
            share, best = self._extended(step, now, new, state, share=share, slope=slope)
            # The last forces and tangent are those of what was tried last.
            return share, best if self.evaluations == evaluations else at(best.control_mm)
        while share >= _SMALLEST_SHARE:
            share *= 0.5
            new = self.evaluate(now.control_mm + share * step, state, tangent=False)
            if _lowers(now, new, share * slope):
                return share, at(new.control_mm)
        return 0.0, at(now.control_mm)

    def _extended(
        self,
        step: FloatArray,
        now: Evaluation,
        new: Evaluation,
        state: SheetState,
        *,
        share: float,
        slope: float,
    ) -> tuple[float, Evaluation]:
        """Return the share of the step, doubled while the energy falls as steeply as at its start.

        As it does where viscosity, and no stiffness of the sheet's, has made the step short.
        """
        best, largest_mm = new, float(np.abs(step).max())
        while (
            best.energy - now.energy < _STILL_STEEP * slope * share
            and 2 * share * largest_mm <= _LARGEST_MOVE_MM
        ):
            farther = self.evaluate(now.control_mm + 2 * share * step, state, tangent=False)
            if farther.energy >= best.energy or _turn(now, farther) <= _LARGEST_TURN:
                break
            share, best = 2 * share, farther
        return share, best


def _stacked(found: list[Distances], shape: tuple[int, ...]) -> Touch:
    """Return bodies' distances, gradients and Hessians at (row, col, 4) points."""
    count = len(found)
    return Touch(
        np.array([one[0] for one in found]).reshape(count, *shape),
        np.array([one[1] for one in found]).reshape(count, *shape, 3),
        np.array([one[2] for one in found]).reshape(count, *shape, 3, 3),
    )


def _refuse_film(surface: FloatArray, state: SheetState) -> None:
    """Refuse a sheet that flows away: no equilibrium lies behind so thin a film."""
    thinnest = float(thinning_of(surface).min())
    if thinnest < _FILM:
        raise SolverError(
            f"sheet: thins to {thinnest:.2f} of its thickness at {state.travel_mm:.3g} mm of "
            f"travel and {state.pressure_kpa:.3g} kPa"
        )


def _lowers(now: Evaluation, new: Evaluation, slope: float) -> bool:
    """Tell whether a step lowers the energy enough and turns no normal too far."""
    bound = now.energy + _SUFFICIENT * slope + 1e-12 * abs(now.energy)
    return bool(new.energy <= bound) and _turn(now, new) > _LARGEST_TURN


def _adapted(viscosity: float, share: float, gain: float) -> float:
    """Return the viscosity to try next, after a step's share and its gain over the promised one.

    As Levenberg and Marquardt: less after a step that was as good as its model, more after a cut or
    a poor one.
    """
    if share < 1:
        return max(viscosity, _LEAST_VISCOSITY / 2) * min(_GROWTH, 2 / max(share, 1 / _GROWTH))
    if gain < _POOR:
        return 2 * viscosity
    less = viscosity if gain < _GOOD else viscosity / _GROWTH
    return 0.0 if less < _LEAST_VISCOSITY / 4 else less


def _turn(before: Evaluation, after: Evaluation) -> float:
    """Return the least cosine between the normals of two surfaces."""
    normals = [normal_of(one.surface) for one in (before, after)]
    return float((normals[0] * normals[1]).sum(axis=-1).min())
