"""Compute energy, forces and tangent of a sheet on one grid with its bodies, at any position.

Forces are the gradient of the energy by the control points. The tangent is the exact second
derivative of the energy; on request, terms that can make it indefinite are left out ("convex").
"""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from reconstruction.arrays import BoolArray, FloatArray
from reconstruction.cells import box_of
from reconstruction.machine import threads
from twin.mechanics.sheet.friction import Friction, friction_at, friction_limit_kpa
from twin.mechanics.sheet.grid import SheetGrid, normal_of, thinning_of
from twin.mechanics.sheet.kernel import (
    SLOTS,
    Assembled,
    assemble_rows,
    scratch,
    surface_rows,
)
from twin.mechanics.sheet.laws import Grip, Laws, Touch
from twin.mechanics.sheet.linear_solver import (
    ACCURACY,
    Approximation,
    LinearSolver,
    linear_solver,
    threads_for,
)
from twin.mechanics.sheet.point import ContactState, EvaluationOptions
from twin.mechanics.sheet.rim import RimSpring, rim_springs
from twin.mechanics.sheet.stencil import Stencil, control_areas, stencil
from twin.shape import Distances, SignedDistance
from twin.specimens.distance import is_clear_of

# A band is a block of cell rows for one thread; its forces reach two rows beyond it.
_BAND_ROWS = 8
# Shares of the cohesive range: anchored below the first, released above the second, where the pull
# is largest. Springs that act farther would increase the work of peeling: 10 % at 0.2 mm, 50 % at
# 0.1 mm.
_GRIPS, _LETS_GO = 0.25, 0.5

# Accuracy of the solution for a step of Newton's method: the next step corrects its error.
_OF_A_STEP = 1e-4


@dataclass(frozen=True, eq=False)
class Bodies:
    """Bodies that may touch the sheet: bodies moving with the specimen, and the frame's walls."""

    moving: Sequence[SignedDistance]
    fixed: Sequence[SignedDistance] = ()


@dataclass(frozen=True, eq=False)
class SheetState:
    """Control points, anchors and loads of a sheet in equilibrium, or during the iteration."""

    control_mm: FloatArray
    grip: Grip
    travel_mm: float = 0.0
    pressure_kpa: float = 0.0
    steps: int = 0


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Energy of a sheet, uJ, and its Gauss points, for one position of the control points.

    The sheet itself stores the forces and the tangent of its latest evaluation only.
    """

    energy: float
    control_mm: FloatArray
    surface: FloatArray
    #: whether the tangent was computed
    tangent: bool

    @cached_property
    def normal(self) -> FloatArray:
        """Unit normals at the Gauss points (row, col, 4, xyz)."""
        return normal_of(self.surface)


@dataclass(frozen=True, eq=False)
class System:
    """Linear system of a grid: sparsity pattern, and the solver with its factorisation."""

    stencil: Stencil
    solver: LinearSolver

    @classmethod
    def of(cls, free: BoolArray) -> "System":
        """Return the system of a grid; `free` (row + 2, col + 2, xyz) marks what may move."""
        pattern = stencil(free)
        return cls(pattern, linear_solver(pattern.start, pattern.columns))


@dataclass(eq=False)
class Sheet:
    """A sheet on one grid with its bodies, and the arrays that the solver reuses."""

    grid: SheetGrid
    laws: Laws
    bodies: Bodies
    #: specimen's z = 0 plane in the sheet's frame at zero travel
    touched_z_mm: float
    #: points that touch have anchors
    sticks: bool = False
    #: width of the cells in the contact
    cell_mm: float = 0.0
    #: largest friction over contact pressure of a sheet with anchors; infinite: it cannot slip
    friction_coefficient: float = np.inf
    system: System = field(init=False)
    pool: ThreadPoolExecutor = field(init=False)
    #: springs of a compliant rim
    rim: tuple[RimSpring, ...] = field(init=False, default=())
    #: evaluation that the stored forces and tangent belong to
    latest: Evaluation = field(init=False)
    evaluations: int = field(init=False, default=0)

    def __post_init__(self) -> None:
        rows, cols = self.grid.free.shape[:2]
        self.system = System.of(self.grid.free)
        self.pool = ThreadPoolExecutor(threads())
        self.rim = rim_springs(self.grid, self.laws)
        self._forces = np.zeros((rows, cols, 3))
        self._tangent = np.zeros((rows, cols, len(SLOTS), 3, 3))
        self.area_mm2 = control_areas(self.grid)

    # ---- evaluation ----------------------------------------------------------------------

    def evaluate(
        self, control_mm: FloatArray, state: SheetState, *, tangent: bool, convex: bool = False
    ) -> Evaluation:
        """Evaluate the energy of control points under the loads of a state; store the forces.

        Parameters
        ----------
        control_mm : (row + 2, col + 2, xyz)
        state : travel, pressure and anchors; its own control points are not used
        tangent : True: compute and store the tangent as well
        convex : True: leave out the terms of the tangent that can make it indefinite
        """
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
        data, options = ContactState(laws, touch, lifted), EvaluationOptions(tangent, convex)
        sums = Assembled(energy, self._forces, tangents)
        for parity in (0, 1):  # neighbouring bands write to the same control points
            self._over_bands(
                rows,
                parity,
                lambda a, b: assemble_rows(
                    (a, b), control_mm, self.grid.rest, data, options, scratch(), sums
                ),
            )
        springs = self._tangent if tangent else None
        of_rim = sum(spring.add(control_mm, self._forces, springs) for spring in self.rim)
        self.evaluations += 1
        self.latest = Evaluation(float(energy.sum()) + of_rim, control_mm, surface, tangent)
        return self.latest

    def surface(self, control_mm: FloatArray) -> FloatArray:
        """Return position and first derivatives at the Gauss points, (row, col, 4, 3, xyz).

        Index 0 of the fourth axis is the position, mm; 1 and 2 are the derivatives along the sheet.
        """
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
        """Distance, mm, of the middle surface from a body beyond which the body has no effect.

        It is 0.75 x the largest undeformed thickness plus the range of the tack. The factor is
        0.5 x 1.5, because the sheet may be up to 1.5 times as thick where it is compressed.
        """
        thickest_mm = self.laws.thickness_mm + self.grid.rest.deviation_mm.max(initial=0.0)
        return float(0.75 * thickest_mm + self.laws.tack_range_mm)

    @property
    def thickness_ratio(self) -> FloatArray:
        """Local over mean undeformed thickness at the Gauss points, (row, col, 4)."""
        rest = self.grid.rest
        if not rest.deviation_mm.size:
            return np.ones(rest.area_mm2.shape)
        return 1.0 + rest.deviation_mm / self.laws.thickness_mm

    def touch(self, place_mm: FloatArray, travel_mm: float, reach_mm: float | None = None) -> Touch:
        """Return the moving bodies' distances at positions `place_mm` (row, col, 4, xyz).

        A distance above `reach_mm` is only a lower limit of it; None: `Sheet.reach_mm`.
        """
        points = self._lowered(place_mm, travel_mm)
        reach_mm = self.reach_mm if reach_mm is None else reach_mm
        distances = [body.evaluate(points, reach_mm) for body in self.bodies.moving]
        return _stacked(distances, place_mm.shape[:3])

    def _near(self, place_mm: FloatArray, travel_mm: float) -> Touch:
        """Return the distances to those bodies and walls that are within reach of some point."""
        distances = []
        sides = (
            (self.bodies.moving, self._lowered(place_mm, travel_mm)),
            (self.bodies.fixed, place_mm.reshape(-1, 3)),
        )
        for bodies, points in sides:
            low, high = box_of(points)
            near = [body for body in bodies if not is_clear_of(body, low, high, self.reach_mm)]
            distances += [body.evaluate(points, self.reach_mm) for body in near]
        within_reach = [part for part in distances if part[0].min() <= self.reach_mm]
        return _stacked(within_reach, place_mm.shape[:3])

    def _lowered(self, place_mm: FloatArray, travel_mm: float) -> FloatArray:
        """Return points in the specimen's frame, (n, xyz), from the solver's frame (..., xyz)."""
        lift = np.array([0.0, 0.0, self.touched_z_mm + travel_mm])
        lowered: FloatArray = place_mm.reshape(-1, 3) - lift
        return lowered

    def _over_bands(self, rows: int, parity: int, run: Callable[[int, int], None]) -> None:
        firsts = range(parity * _BAND_ROWS, rows, 2 * _BAND_ROWS)
        bands = [(first, min(first + _BAND_ROWS, rows)) for first in firsts]
        if len(bands) < 2 or threads_for(self.grid.free.size) == 1:
            for band in bands:
                run(*band)
        else:
            list(self.pool.map(lambda band: run(*band), bands))

    def forces(self) -> FloatArray:
        """Return the gradient (unknown,), mN, of the energy at the latest evaluation."""
        free: FloatArray = self._forces[self.grid.free]
        return free

    def residuals_kpa(self) -> FloatArray:
        """Return the largest component of each control point's force over its area, kPa.

        The shape is (row + 2, col + 2). Only free components are included.
        """
        free = np.abs(self._forces * self.grid.free).max(axis=2)
        share: FloatArray = free / self.area_mm2
        return share

    def factorise(self, viscosity: float) -> bool:
        """Factorise the latest tangent plus a viscosity; return True if positive definite.

        The viscosity, kPa/mm, times each control point's area is added to the diagonal.
        """
        return self.system.solver.factorise(self._damped(viscosity))

    def _damped(self, viscosity: float) -> FloatArray:
        """Return the upper triangle (element,) of the latest tangent plus a viscosity, mN/mm."""
        values: FloatArray = self._tangent.reshape(-1)[self.system.stencil.taken]
        if viscosity:
            weights = np.repeat(self.area_mm2[..., None], 3, axis=2)[self.grid.free]
            values[self.system.stencil.start[:-1]] += viscosity * weights
        return values

    def newton_step_mm(self) -> FloatArray:
        """Return the Newton step, (row + 2, col + 2, xyz), from latest forces and factorisation."""
        return self.answer_mm(self.forces(), _OF_A_STEP)

    def approximate_step_mm(self, viscosity: float) -> tuple[FloatArray, Approximation]:
        """Return Newton's step, as `newton_step_mm`, for the latest tangent without its factors.

        The second result states how accurate it is, see `LinearSolver.approximate`.
        """
        near = self.system.solver.approximate(self._damped(viscosity), self.forces())
        step = np.zeros(self._forces.shape)
        step[self.grid.free] = -near.solution
        return step, near

    def answer_mm(self, forces: FloatArray, accuracy: float = ACCURACY) -> FloatArray:
        """Return minus the solution for forces (unknown,) by the latest factorisation, mm.

        The shape is (row + 2, col + 2, xyz), with 0 for components that are not free.
        """
        step = np.zeros(self._forces.shape)
        step[self.grid.free] = -self.system.solver.solve(forces, accuracy)
        return step

    def reactions(self) -> FloatArray:
        """Return the forces (n,) of the rim on the sheet along z, mN, at the latest evaluation."""
        held: FloatArray = self._forces[~self.grid.free[..., 2], 2]
        return held

    def gap_mm(
        self, surface: FloatArray, touch: Touch, ratio: FloatArray | float | None = None
    ) -> FloatArray:
        """Return the distance of the lower face from each body, (body, row, col, 4), mm.

        It is the distance of the middle surface minus half the local thickness.

        Parameters
        ----------
        surface : (row, col, 4, 3, xyz), as `Sheet.surface` returns it
        touch : distances of the bodies at these points
        ratio : local over mean undeformed thickness there; None: at the Gauss points
        """
        half_mm = self.laws.thickness_mm / 2 * (self.thickness_ratio if ratio is None else ratio)
        gap: FloatArray = touch.distance_mm - half_mm * thinning_of(surface)
        return gap

    def regripped(self, state: SheetState) -> SheetState:
        """Return the state with updated anchors and limits of the friction.

        Points that touch a body without an anchor get one; points that have left lose theirs. This
        does not increase the energy. The limits follow the contact pressure. With a friction
        coefficient points that have left have a limit of 0, and lose their anchors in `slid`: they
        may touch again within the load step.
        """
        surface = self.surface(state.control_mm)
        touch = self.touch(surface[..., 0, :], state.travel_mm)
        gap = self.gap_mm(surface, touch)
        nearest = gap.argmin(axis=0)[None]
        gap = gap.min(axis=0)
        limit_kpa = friction_limit_kpa(
            gap, self.laws, self.thickness_ratio, self.friction_coefficient
        )
        normal = np.take_along_axis(touch.gradient, nearest[..., None], axis=0)[0]
        # Tabulated distances have gradients that are not quite 1 long; springs need unit length.
        normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-9)
        reach = self.laws.tack_range_mm if self.laws.tack > 0 else 0.0
        new = ((gap < _GRIPS * reach) & (state.grip.held == 0))[..., None]
        place = surface[..., 0, :] - np.array([0.0, 0.0, state.travel_mm])
        near = (gap <= _LETS_GO * reach) | np.isfinite(limit_kpa)
        held = np.where(new[..., 0] | ((state.grip.held > 0) & near), 1.0, 0.0)
        turned = new
        if np.isfinite(self.friction_coefficient):
            place = self._first_touch(surface, gap, state)
            # The tangent plane of a point that slips on a curved body turns with it.
            turned = new | self.friction(surface, state).slips[..., None]
        grip = Grip(
            held,
            np.where(new, place, state.grip.anchor_mm),
            np.where(turned, normal, state.grip.normal),
            np.where(held > 0, limit_kpa, state.grip.limit_kpa),
        )
        return replace(state, grip=grip)

    def _first_touch(
        self, surface: FloatArray, gap_mm: FloatArray, state: SheetState
    ) -> FloatArray:
        """Return where points first touch in this load step, (row, col, 4, xyz), at travel 0.

        The gap decreases in proportion to the path from the position before the load step, see
        `slid`. Without a position before, and where the gap is not negative, it is the place now.
        """
        lift = np.array([0.0, 0.0, state.travel_mm])
        place = surface[..., 0, :] - lift
        known = np.isfinite(state.grip.limit_kpa)[..., None]
        before = np.where(known, state.grip.anchor_mm, place)
        touch = self.touch(before + lift, state.travel_mm)
        gap_before = self.gap_mm(surface, touch).min(axis=0)
        share = np.clip(gap_before / np.maximum(gap_before - gap_mm, 1e-12), 0.0, 1.0)
        return np.asarray(before + share[..., None] * (place - before))

    def friction(self, surface: FloatArray, state: SheetState) -> Friction:
        """Return the friction of specimen and plate at the Gauss points of a surface."""
        lift = np.array([0.0, 0.0, state.travel_mm])
        away = surface[..., 0, :] - state.grip.anchor_mm - lift
        return friction_at(away, state.grip, self.laws.stick_stiffness / self.thickness_ratio)

    def slid(self, state: SheetState) -> SheetState:
        """Return the state with anchors set back where it slips; the friction does not change.

        It is the return mapping of plasticity, once for each load step. Points without friction
        lose their anchors; their positions are stored for their first touch in the next load step.
        """
        if np.isinf(self.friction_coefficient):
            return state
        surface, grip = self.surface(state.control_mm), state.grip
        set_back = grip.anchor_mm + self.friction(surface, state).slip_mm
        held = np.where(grip.limit_kpa > 0, grip.held, 0.0)
        place = surface[..., 0, :] - np.array([0.0, 0.0, state.travel_mm])
        slid = grip._replace(
            held=held,
            anchor_mm=np.where(held[..., None] > 0, set_back, place),
            limit_kpa=np.where(held > 0, grip.limit_kpa, 0.0),
        )
        return replace(state, grip=slid)


def _stacked(distances: list[Distances], shape: tuple[int, ...]) -> Touch:
    """Return the results for each body, at n points, as arrays (body, *shape, ...)."""
    count = len(distances)
    return Touch(
        np.array([part[0] for part in distances]).reshape(count, *shape),
        np.array([part[1] for part in distances]).reshape(count, *shape, 3),
        np.array([part[2] for part in distances]).reshape(count, *shape, 3, 3),
    )
