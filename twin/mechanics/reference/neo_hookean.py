"""The `neo_hookean` model: solid elements with large deflection and strain, for deep presses.

The elements are neo-Hookean Q2/Q1 bricks on a grid that is fine where the linear press has contact.
If specimen and slab are symmetric, 1/2 or 1/4 of the slab is solved. An elastomer that deflects by
about its thickness stretches as it bends, which a linear slab neglects. World frame, mm; in the
grid's own frame z counts from the touched face.

Contact with the rigid height field is frictionless, z is along the press, and the specimen's
surface is z = d - S(x, y) with the depth d. An augmented Lagrangian with a penalty acts on the
overlap d - S - z at the integration points in the current configuration. The negative gradient of
the overlap, g = (S_x, S_y, 1), is the surface's normal divided by its component along the press.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CloughTocher2DInterpolator, NearestNDInterpolator

from reconstruction.arrays import BoolArray, FloatArray, IntArray
from twin.config.models import Elastomer, Press, Specimen
from twin.mechanics.errors import PressError
from twin.mechanics.hardness import young_modulus
from twin.mechanics.layouts import preload_of
from twin.mechanics.press import PressedElastomer, press
from twin.mechanics.reference.grid import ElementGrid, Surface, graded
from twin.mechanics.reference.mixed import MixedBody, moduli, neo_hookean
from twin.mechanics.reference.mixed import linear as small_strain
from twin.mechanics.reference.newton import (
    Equilibrium,
    NewtonOptions,
    Problem,
    Pushed,
    press_to,
    push,
)
from twin.mechanics.reference.result import (
    FaceHeight,
    HeightField,
    Scattered,
    check_depth,
    on_grids,
    sample,
)
from twin.specimens import shape_of

_SURFACE_POINTS = 3
_PENALTY_OVER_SHEAR = 60.0
_SYMMETRY_MM = 1e-6
_SECANTS = 12
_FORCE_TOLERANCE = 1e-4


@dataclass(frozen=True)
class HeightContact:
    """Contact of a rigid specimen with the touched face, by an augmented Lagrangian."""

    surface: Surface
    #: (node, xyz) undeformed positions
    nodes_mm: FloatArray
    field: HeightField
    #: pressure over modulus per mm of overlap
    penalty: float
    #: True: contact acts along the press on the undeformed face, as in the linear slab
    linear: bool
    #: (point,) Lagrange multiplier: pressure over modulus at an overlap of 0
    carried: FloatArray

    def evaluate(self, moved_mm: FloatArray, depth_mm: float, active: BoolArray | None) -> Pushed:
        """Return forces and stiffness of the specimen on the surface.

        Parameters
        ----------
        moved_mm : (node, xyz) displacement
        depth_mm : travel of the specimen after first touch
        active : (point,) whether a point is in contact; None: if its pressure is positive
        """
        at = self.surface.trace @ (self.nodes_mm + moved_mm)
        x, y = (self.surface.trace @ self.nodes_mm if self.linear else at)[:, :2].T
        height = self.field.value(x, y)
        overlap = np.where(np.isfinite(height), depth_mm - height - at[:, 2], -np.inf)
        raw = self.carried + self.penalty * overlap
        touching = raw > 0 if active is None else active & np.isfinite(raw)
        pressure = np.where(touching, raw, 0.0)
        normal, bend = self._shape(x, y)
        stiffness = self.penalty * np.einsum("qi,qj->qij", normal, normal)
        stiffness[:, :2, :2] -= pressure[:, None, None] * bend
        return push(
            self.surface,
            pressure[:, None] * normal,
            np.where(touching[:, None, None], stiffness, 0.0),
            pressure,
        )

    def settle(self, moved_mm: FloatArray, depth_mm: float) -> "HeightContact":
        """Return this contact unchanged: it has no friction, and no contact set is rejected."""
        return self

    def carry(self, pressure: FloatArray) -> "HeightContact":
        """Return the contact with the Lagrange multiplier `pressure` (point,)."""
        return replace(self, carried=pressure)

    def _shape(self, x_mm: FloatArray, y_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return g (point, xyz), see the module, and the second derivatives of S (point, 2, 2)."""
        normal = np.zeros((x_mm.size, 3))
        normal[:, 2] = 1.0
        if self.linear:
            return normal, np.zeros((x_mm.size, 2, 2))
        normal[:, :2] = self.field.slope(x_mm, y_mm)
        return normal, self.field.curvature(x_mm, y_mm)


@dataclass(frozen=True)
class Bricks:
    """Numbers of elements and load steps."""

    #: elements along each half of x and y
    half: int = 10
    #: elements through the thickness; None: one per mm, but at least 2 and at most 4
    through: int | None = None
    #: elements along the half width of a contact
    contact: float = 3.0
    #: load steps to the depth of the linear slab; more steps if that depth exceeds the thickness
    steps: int = 6


def press_neo_hookean(
    specimen: Specimen,
    elastomer: Elastomer,
    load: Press,
    *,
    bricks: Bricks | None = None,
    linear: bool = False,
) -> PressedElastomer:
    """Press `specimen` into `elastomer` by `load`, at large strain.

    Parameters
    ----------
    elastomer : flat slab on a simply supported rim, or a pad with free sides bonded to a window
    load : depth or force, and pitches. The depth may exceed the thickness of a free slab.
    bricks : numbers of elements; None: the defaults of `Bricks`
    linear : True: small strain, and contact on the undeformed face, with the same elements. The
        difference from the spectral press is then the error of the elements.

    Returns
    -------
    Same fields as from `press`; the coated face is given at its deformed positions

    Raises
    ------
    PressError : an error of `press`, or the input has a film or a preload, which this model lacks
    SolverError : no equilibrium was reached
    """
    fineness, shape = bricks or Bricks(), shape_of(specimen)
    guess = press(specimen, elastomer, load, any_depth=True)
    modulus_kpa = guess.young_modulus_kpa
    check_neo_hookean(elastomer, load)
    field = sample(shape, elastomer.length_x_mm, elastomer.length_y_mm)
    grid, element_mm = _grid(guess, elastomer, field, fineness)
    body = MixedBody(grid, small_strain if linear else neo_hookean, moduli(elastomer.poisson_ratio))
    options = NewtonOptions(largest_move_mm=4 * element_mm, tolerance=1e-5, augmentations=1)
    problem = Problem(body, _free(body, elastomer), options)
    start = _untouched(body, field, element_mm, linear)
    if load.control == "depth":
        deep = max(1.0, guess.depth_mm / elastomer.thickness_mm)
        steps = int(np.ceil(fineness.steps * deep))
        equilibrium = _load_steps(problem, start, guess.depth_mm, steps)[-1]
    else:
        copies = float(2 ** sum(edge[0] == 0 for edge in grid.edges_mm[:2]))
        equilibrium = _to_force(problem, start, guess, fineness.steps, copies)
    if elastomer.layout == "contact_face":
        check_depth(equilibrium.depth_mm, elastomer)
    scattered = _scattered(body, equilibrium, elastomer, linear)
    return on_grids(scattered, shape, elastomer, load, modulus_kpa)


def _untouched(body: MixedBody, field: HeightField, element_mm: float, linear: bool) -> Equilibrium:
    grid = body.grid
    surface = grid.surface(_SURFACE_POINTS)
    penalty = _PENALTY_OVER_SHEAR * body.moduli.shear / element_mm
    carried = np.zeros_like(surface.weight_mm2)
    contact = HeightContact(surface, grid.nodes_mm, field, penalty, linear, carried)
    pushed = contact.evaluate(np.zeros_like(grid.nodes_mm), 0.0, None)
    return Equilibrium(np.zeros(body.unknowns), contact, 0.0, pushed, 0)


def check_neo_hookean(elastomer: Elastomer, load: Press) -> None:
    """Raise an error if the input has a film or a preload (back pressure or weight).

    Raises
    ------
    PressError : the message states the keys to remove
    """
    modulus_kpa = young_modulus(elastomer).best_kpa
    if elastomer.film is not None or preload_of(elastomer, load, modulus_kpa):
        raise PressError(
            "mechanics.model = 'neo_hookean' has neither film, back pressure nor weight; "
            "remove elastomer.film, press.back_pressure_kpa and press.gravity_deg"
        )


def _load_steps(
    problem: Problem, start: Equilibrium, depth_mm: float, steps: int
) -> list[Equilibrium]:
    path = [start]
    for aim in np.linspace(start.depth_mm, depth_mm, steps + 1)[1:]:
        path.append(press_to(problem, path[-1], float(aim)))
    return path


def _to_force(
    problem: Problem, start: Equilibrium, guess: PressedElastomer, steps: int, copies: float
) -> Equilibrium:
    """Return the equilibrium at which the contact force is that of `guess`.

    The depth increases in equal steps until the force is reached; then the depth is determined
    between the last two steps. The solved part of a symmetric body is 1 / `copies` of the whole.
    """
    aim = guess.force_n / (guess.young_modulus_kpa * 1e-3) / copies
    below, step = start, guess.depth_mm / steps
    above = press_to(problem, below, below.depth_mm + step)
    while above.pushed.along < aim:
        below, above = above, press_to(problem, above, above.depth_mm + step)
    equilibrium = above
    low, high = (
        (below.depth_mm, below.pushed.along - aim),
        (above.depth_mm, above.pushed.along - aim),
    )
    for _ in range(_SECANTS):
        if abs(equilibrium.pushed.along - aim) < _FORCE_TOLERANCE * aim:
            break
        depth = low[0] - low[1] * (high[0] - low[0]) / (high[1] - low[1])
        equilibrium = press_to(problem, below, depth)
        miss = equilibrium.pushed.along - aim
        low, high = ((depth, miss), high) if miss < 0 else (low, (depth, miss))
    return equilibrium


def _grid(
    guess: PressedElastomer, elastomer: Elastomer, field: HeightField, fineness: Bricks
) -> tuple[ElementGrid, float]:
    """Return the grid of bricks, and the size of its smallest elements along x and y, mm."""
    edges, sizes = [], []
    for axis, (at, length) in enumerate(
        ((guess.x_mm, elastomer.length_x_mm), (guess.y_mm, elastomer.length_y_mm))
    ):
        touched = at[guess.contact.any(axis=axis)]
        half_width = float(np.sqrt(guess.contact.sum() / np.pi)) * float(at[1] - at[0])
        size = min(half_width, float(np.ptp(touched)) / 2 + half_width) / fineness.contact
        symmetric = _is_symmetric(field, axis)
        low, count = (0.0, fineness.half) if symmetric else (-length / 2, 2 * fineness.half)
        edges.append(_edges(touched, (low, length / 2), size, count))
        sizes.append(float(np.diff(edges[-1]).min()))
    through = fineness.through or int(np.clip(np.ceil(elastomer.thickness_mm), 2, 4))
    z = graded(elastomer.thickness_mm, through, 1.25)
    return ElementGrid((edges[0], edges[1], z)), min(sizes)


def _edges(
    touched: FloatArray, ends: tuple[float, float], size_mm: float, count: int
) -> FloatArray:
    """Return count + 1 edges between `ends`, mm, at intervals of `size_mm` or wider.

    Intervals are `size_mm` in contacts and increase with the distance from the contacts.

    `touched` are positions (n,) of cells in contact.
    """
    fine = np.linspace(*ends, 4001)
    distance = np.abs(fine[:, None] - touched).min(axis=1)
    # The contact of a stiffening sheet is wider than that of the linear slab.
    beyond = np.maximum(distance - 0.5 * size_mm, 0.0)
    low, high = 0.05, 20.0
    for _ in range(40):
        growth = np.sqrt(low * high)
        density = 1 / (size_mm + growth * beyond)
        elements = np.concatenate(([0.0], np.cumsum((density[1:] + density[:-1]) / 2)))
        elements *= fine[1] - fine[0]
        low, high = (growth, high) if elements[-1] > count else (low, growth)
    return np.asarray(np.interp(np.linspace(0, elements[-1], count + 1), elements, fine))


def _is_symmetric(field: HeightField, axis: int) -> bool:
    """Return True if the specimen is symmetric about x = 0 (axis 0) or y = 0 (axis 1)."""
    height = np.where(np.isfinite(field.height_mm), field.height_mm, 1e3)
    at, flip = ((field.x_mm, np.s_[:, ::-1]), (field.y_mm, np.s_[::-1]))[axis]
    centred = abs(at[0] + at[-1]) < _SYMMETRY_MM
    return bool(centred and np.allclose(height, height[flip], atol=_SYMMETRY_MM))


def _free(body: MixedBody, elastomer: Elastomer) -> IntArray:
    """Return the numbers (n,) of the unknowns that neither support nor symmetry sets to zero."""
    nodes = body.grid.nodes_mm
    held = np.zeros(nodes.shape, dtype=bool)
    near = 1e-9 * elastomer.thickness_mm
    for axis, length in enumerate((elastomer.length_x_mm, elastomer.length_y_mm)):
        if body.grid.edges_mm[axis][0] == 0:
            held[np.abs(nodes[:, axis]) < near, axis] = True
        rim = np.abs(np.abs(nodes[:, axis]) - length / 2) < near
        if elastomer.layout == "opposite_face":
            # As in the spectral slab, only the displacement normal to a side of the rim is free.
            held[rim, 1 - axis] = True
            held[rim, 2] = True
    if elastomer.layout == "contact_face":
        held[nodes[:, 2] > elastomer.thickness_mm - near] = True
    return np.asarray(np.setdiff1d(np.arange(body.unknowns), np.flatnonzero(held)))


def _scattered(
    body: MixedBody, equilibrium: Equilibrium, elastomer: Elastomer, linear: bool
) -> Scattered:
    grid, plane = body.grid, elastomer.touched_plane_mm
    moved = body.displacement_mm(equilibrium.state)
    after = grid.nodes_mm + moved
    positions = np.column_stack(
        (grid.nodes_mm[:, :2] if linear else after[:, :2], after[:, 2] + plane)
    )
    touched = grid.nodes_mm[:, 2] == 0
    coated = touched if plane == 0 else grid.nodes_mm[:, 2] == grid.edges_mm[2][-1]
    contact = equilibrium.contact
    assert isinstance(contact, HeightContact)
    at = contact.surface.trace @ positions[:, :2]
    weight = contact.surface.weight_mm2
    points = np.column_stack((at, equilibrium.pushed.pressure * weight, weight))
    whole = _mirrored(points, grid)
    return Scattered(
        touched=_surface(_mirrored(positions[touched], grid)),
        coated=_surface(_mirrored(positions[coated], grid)),
        at_mm=whole[:, :2],
        force=whole[:, 2],
        plan_mm2=whole[:, 3],
        points_per_facet=_SURFACE_POINTS**2,
        depth_mm=equilibrium.depth_mm,
        iterations=equilibrium.iterations,
        large_strain=not linear,
    )


def _mirrored(points: FloatArray, grid: ElementGrid) -> FloatArray:
    """Return points (n, [x, y, ...]) and their mirror images in the planes of symmetry."""
    for axis in (0, 1):
        if grid.edges_mm[axis][0] == 0:
            image = points.copy()
            image[:, axis] *= -1
            points = np.concatenate((points, image))
    return points


def _surface(points: FloatArray) -> FaceHeight:
    """Return a function of x and y that interpolates z of points (n, [x, y, z]), mm.

    It is continuously differentiable; outside the points' outline it returns the nearest z.
    """
    # Nodes on a plane of symmetry are in the list twice.
    _, once = np.unique(np.round(points[:, :2], 9), axis=0, return_index=True)
    at, z = points[once, :2], points[once, 2]
    smooth, nearest = CloughTocher2DInterpolator(at, z), NearestNDInterpolator(at, z)

    def surface(x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
        inside = smooth(x_mm, y_mm)
        return np.asarray(np.where(np.isnan(inside), nearest(x_mm, y_mm), inside))

    return surface
