"""The `fem` model: a specimen pressed into a slab or a pad of any shape, by finite elements.

The model is linear and frictionless, as the spectral slab is. Contact acts along the press (+z) on
the undeformed face. Unknowns of the contact are the forces at the integration points of the touched
face. A stiff foundation between face and specimen prevents these forces from over-constraining the
quadratic facets.
"""

from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
from scipy.interpolate import CloughTocher2DInterpolator

from reconstruction.arrays import BoolArray, FloatArray
from twin.config.models import Elastomer, Press, Specimen
from twin.mechanics.errors import PressError
from twin.mechanics.hardness import young_modulus
from twin.mechanics.layouts import Preload, preload_of
from twin.mechanics.press import PressedElastomer
from twin.mechanics.reference.active_set import ContactPoints, press_points
from twin.mechanics.reference.pad import (
    DEFAULT_COUNT,
    Pad,
    SlabSupport,
    mesh_pad,
    slab_pad,
    smooth_face,
)
from twin.mechanics.reference.result import Scattered, check_depth, on_grids, sample
from twin.mechanics.reference.taylor_hood import ElasticBody, Facets
from twin.mechanics.reference.tetrahedra import Tetrahedra
from twin.shape import Shape
from twin.specimens import shape_of

# Foundation stiffness times element size over Young's modulus: it deforms by some 0.5 um.
_FOUNDATION = 200.0
_SAMPLES_PER_FACET = 24
_FLAT_MM = 1e-9
_TYPICAL_RADIUS_MM = 4.0


@dataclass(frozen=True)
class Face:
    """Touched or coated face of a solved pad as z over x and y."""

    facets: Facets
    #: (node, xyz) positions of all nodes of the pad before the press, and their displacements
    nodes_mm: FloatArray
    moved_mm: FloatArray
    #: z of the undeformed face over (x, y) if it is known better than by the nodes
    designed: CloughTocher2DInterpolator | None = None

    def undeformed_mm(self, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
        """Return z of the undeformed face at points (...), mm."""
        z = self.nodes_mm[self.facets.nodes, 2]
        if np.ptp(z) < _FLAT_MM:
            return np.full(np.shape(x_mm), float(z.mean()))
        return _within(self.designed or self._rest, x_mm, y_mm)

    def deflection_mm(self, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
        """Return the displacement along z at points (...), mm, continuously differentiable."""
        return _within(self._raised, x_mm, y_mm)

    @cached_property
    def _rest(self) -> CloughTocher2DInterpolator:
        # Only vertices: the midpoints of straight edges are not on a curved face.
        return _surface(self.nodes_mm, self.nodes_mm[:, 2], np.unique(self.facets.nodes[:, :3]))

    @cached_property
    def _raised(self) -> CloughTocher2DInterpolator:
        return _surface(self.nodes_mm, self.moved_mm[:, 2], np.unique(self.facets.nodes))


@dataclass(frozen=True)
class PadPress:
    """A solved press of a pad; forces are divided by Young's modulus; mm, world frame."""

    mesh: Tetrahedra
    touched: Face
    coated: Face
    #: (point,) pressure over Young's modulus at the touched face's integration points
    pressure_over_modulus: FloatArray
    force_over_modulus_mm2: float
    depth_mm: float
    #: number of loads for which the body was solved
    iterations: int

    @property
    def contact(self) -> BoolArray:
        """(point,) whether each integration point of the touched face touches the specimen."""
        return np.asarray(self.pressure_over_modulus > 0)


def press_pad(
    shape: Shape,
    pad: Pad,
    mesh: Tetrahedra,
    *,
    depth_mm: float | None = None,
    force_over_modulus_mm2: float | None = None,
    preload: Preload | None = None,
) -> PadPress:
    """Press a specimen from below into a meshed pad.

    Parameters
    ----------
    shape : the specimen in its pose
    depth_mm, force_over_modulus_mm2 : travel after first touch, or force over Young's modulus: set
        one of the two
    preload : uniform pressures over modulus on both faces, along +z; the depth counts from the
        plane of first touch of the unloaded pad

    Raises
    ------
    PressError : a selector of the pad selects no facet, or the specimen is outside the pad
    SolverError : the contact did not converge
    """
    body = ElasticBody(mesh, pad.poisson_ratio, pad.holds)
    touched, coated = body.facets(pad.touched), body.facets(pad.coated)
    loaded = _preloaded(body, touched, coated, preload or Preload())
    designed = smooth_face(pad) if pad.is_designed else None
    height = _gap(shape, Face(touched, body.nodes_mm, loaded, designed))
    yielding = touched.size_mm / (_FOUNDATION * touched.weight_mm2)
    gap = height + touched.trace @ loaded[:, 2]
    points = ContactPoints(touched.trace, body.nodes_mm, yielding, gap)
    aim = {"depth_mm": depth_mm, "force_over_modulus_mm2": force_over_modulus_mm2}
    contact = press_points(partial(_deflect, body, touched, yielding), points, **aim)
    moved = body.solve(_thrust(body, touched, contact.force)) + loaded
    return PadPress(
        mesh=mesh,
        touched=Face(touched, body.nodes_mm, moved, designed),
        coated=Face(coated, body.nodes_mm, moved, designed),
        pressure_over_modulus=contact.force / touched.plan_mm2,
        force_over_modulus_mm2=float(contact.force.sum()),
        depth_mm=contact.depth_mm,
        iterations=contact.loads,
    )


def _preloaded(body: ElasticBody, touched: Facets, coated: Facets, preload: Preload) -> FloatArray:
    if not preload:
        return np.zeros_like(body.nodes_mm)
    thrust = _thrust(body, touched, preload.touched * touched.plan_mm2)
    return body.solve(thrust + _thrust(body, coated, preload.coated * coated.plan_mm2))


def _deflect(
    body: ElasticBody, facets: Facets, yielding: FloatArray, force: FloatArray
) -> FloatArray:
    """Return the deflection (point,), mm, of a face with its foundation.

    `force` is the force over modulus at the integration points, (point,), mm^2, along +z.
    """
    moved = body.solve(_thrust(body, facets, force))
    return np.asarray(facets.trace @ moved[:, 2] + yielding * force)


def _thrust(body: ElasticBody, facets: Facets, force: FloatArray) -> FloatArray:
    """Return the nodal forces (node, xyz) that are equivalent to forces (point,) along +z."""
    nodal = np.zeros_like(body.nodes_mm)
    nodal[:, 2] = facets.trace.T @ force
    return nodal


def _gap(shape: Shape, face: Face) -> FloatArray:
    """Return the gap (point,), mm, at first touch: face to specimen, inf outside the specimen."""
    x, y = face.facets.points_mm[:, :2].T
    reach = 2 * np.abs(face.nodes_mm[:, :2]).max(axis=0)
    field = sample(shape, *reach)
    gap = field.value(x, y) + face.undeformed_mm(x, y)
    if not np.isfinite(gap).any():
        raise PressError("specimen: outside the pad's touched face; move it")
    # First touch may be between the integration points: sample the nearest facets densely.
    per_facet = gap.reshape(face.facets.nodes.shape[0], -1).min(axis=1)
    near = face.facets.nodes[np.argsort(per_facet)[:40], :3]
    i, j = np.indices((_SAMPLES_PER_FACET + 1,) * 2) / _SAMPLES_PER_FACET
    share = np.stack((i, j, 1 - i - j), axis=-1)[i + j <= 1 + 1e-9]
    x, y = np.einsum("sc,fcx->xfs", share, face.nodes_mm[near])[:2].reshape(2, -1)
    closest = field.value(x, y) + face.undeformed_mm(x, y)
    return np.asarray(gap - min(float(closest.min()), float(gap.min())))


def _surface(
    nodes: FloatArray, values: FloatArray, chosen: FloatArray
) -> CloughTocher2DInterpolator:
    return CloughTocher2DInterpolator(nodes[chosen, :2], values[chosen])


def _within(surface: CloughTocher2DInterpolator, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
    """Return z (...), mm, of an interpolated surface; points outside its bounds are moved inside.

    Points on the rim are moved by 1e-7 of the extent, because rounding may place them outside.
    """
    low, high = surface.points.min(axis=0), surface.points.max(axis=0)
    inside = [
        np.clip(at, a + 1e-7 * (b - a), b - 1e-7 * (b - a))
        for at, a, b in zip((x_mm, y_mm), low, high, strict=True)
    ]
    return np.asarray(surface(*inside))


def press_fem(
    specimen: Specimen,
    elastomer: Elastomer,
    load: Press,
    *,
    support: SlabSupport | None = None,
    ledge_mm: float = 2.0,
    pad: Pad | None = None,
    count: int = DEFAULT_COUNT,
    timeout_s: float = 60.0,
) -> PressedElastomer:
    """Press `specimen` into `elastomer` by `load`, with P2/P1 tetrahedra.

    Parameters
    ----------
    elastomer : slab; with a `pad` only its modulus, layout and outline (for the grids) are used
    load : depth or force, preloads and pitches, as for the spectral press
    support : {"simple", "clamped", "ledge", "bonded", "window"}; support of the slab, see
        `slab_pad`; None: "simple" in the opposite-face, "bonded" in the contact-face layout
    ledge_mm : width, beyond the free span, of the frame that supports a slab on a "ledge"
    pad : a body of another shape in place of the slab
    count : approximate number of tetrahedra

    Returns
    -------
    Fields as from `twin.mechanics.press.press`; beyond the bounds of the pad in plan, z is that at
    these bounds

    Raises
    ------
    PressError : the specimen is outside the pad, the elastomer has a film, or the support does not
        fit the layout
    SolverError : meshing failed, or the contact did not converge
    """
    check_fem(elastomer, support)
    shape, modulus_kpa = shape_of(specimen), young_modulus(elastomer).best_kpa
    span, chosen = (elastomer.length_x_mm, elastomer.length_y_mm), _support(elastomer, support)
    body = pad or slab_pad(span, elastomer.thickness_mm, elastomer.poisson_ratio, chosen, ledge_mm)
    force = None if load.force_n is None else load.force_n / (modulus_kpa * 1e-3)
    depth_guess = load.depth_mm or _depth_guess(shape, elastomer, force or 0.0)
    mesh = mesh_pad(shape, body, depth_guess, count=count, timeout_s=timeout_s)
    preload = preload_of(elastomer, load, modulus_kpa)
    aim = {"depth_mm": load.depth_mm, "force_over_modulus_mm2": force}
    solved = press_pad(shape, body, mesh, preload=preload, **aim)
    check_depth(solved.depth_mm, elastomer)
    return on_grids(_scattered(solved), shape, elastomer, load, modulus_kpa)


def check_fem(elastomer: Elastomer, support: SlabSupport | None) -> None:
    """Raise an error if the elastomer has a film or the support does not fit the layout.

    Raises
    ------
    PressError : the message states the key and the allowed values
    """
    if elastomer.film is not None:
        raise PressError("elastomer.film: mechanics.model = 'fem' has no film; remove one of them")
    on_window = elastomer.layout == "contact_face"
    chosen = _support(elastomer, support)
    if (chosen in ("bonded", "window")) != on_window:
        raise PressError(
            f"support '{chosen}' does not fit elastomer.layout = '{elastomer.layout}'; allowed: "
            + ("bonded, window" if on_window else "simple, clamped, ledge")
        )


def _support(elastomer: Elastomer, support: SlabSupport | None) -> SlabSupport:
    return support or ("bonded" if elastomer.layout == "contact_face" else "simple")


def _depth_guess(shape: Shape, elastomer: Elastomer, force_over_modulus_mm2: float) -> float:
    """Return the approximate depth, mm, of a ball under a force (Hertz); only the mesh uses it."""
    radius = min((ball.radius_mm for ball in shape.spheres()), default=_TYPICAL_RADIUS_MM)
    hertz = float(np.cbrt((0.75 * 0.75 * force_over_modulus_mm2) ** 2 / radius))
    return min(hertz, 0.5 * elastomer.thickness_mm)


def _scattered(pressed: PadPress) -> Scattered:
    facets = pressed.touched.facets
    return Scattered(
        touched=lambda x, y: _deformed(pressed.touched, x, y),
        coated=lambda x, y: _deformed(pressed.coated, x, y),
        at_mm=facets.points_mm[:, :2],
        force=pressed.pressure_over_modulus * facets.plan_mm2,
        plan_mm2=facets.plan_mm2,
        points_per_facet=facets.plan_mm2.size // facets.nodes.shape[0],
        depth_mm=pressed.depth_mm,
        iterations=pressed.iterations,
    )


def _deformed(face: Face, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
    return face.undeformed_mm(x_mm, y_mm) + face.deflection_mm(x_mm, y_mm)
