"""The `fem` model: press a configured specimen into a slab or a pad by finite elements."""

import numpy as np

from reconstruction.arrays import FloatArray
from twin.config.models import Elastomer, Press, Specimen
from twin.mechanics.errors import PressError
from twin.mechanics.hardness import young_modulus
from twin.mechanics.layouts import preload_of
from twin.mechanics.press import PressedElastomer
from twin.mechanics.reference.fem3d import Face, PadPress, press_pad
from twin.mechanics.reference.pad import Pad, SlabSupport, slab_pad
from twin.mechanics.reference.pad_mesh import DEFAULT_COUNT, mesh_pad
from twin.mechanics.reference.result import Scattered, on_grids
from twin.specimens import Shape, shape_of

_TYPICAL_RADIUS_MM = 4.0


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
    """Press `specimen` into `elastomer` as `load` says, by P2/P1 tetrahedra.

    Parameters
    ----------
    specimen : Specimen
        What is pressed, in its pose.
    elastomer : Elastomer
        Slab; with a `pad` only its modulus, layout and outline (for the grids) matter.
    load : Press
        Depth or force, preloads and pitches, as for the spectral press.
    support : {"simple", "clamped", "ledge", "bonded", "window"}, optional
        What holds the slab; by default a simple rim (opposite face) or the window behind a finite
        pad with free sides (contact face).
    ledge_mm : float, mm
        Width of the frame on which a slab on a `ledge` rests, beyond its free span.
    pad : Pad, optional
        Another body than the slab.
    count : int
        About how many tetrahedra.
    timeout_s : float, s
        For meshing.

    Returns
    -------
    PressedElastomer
        As from the spectral press; the relief grid is clipped to the pad's outline in plan.

    Raises
    ------
    PressError
        The specimen lies beside the pad, a film, or a support that does not fit the layout.
    SolverError
        Meshing failed, or the contact did not converge.
    """
    check_fem(elastomer, support)
    shape, modulus_kpa = shape_of(specimen), young_modulus(elastomer).best_kpa
    body = pad or _slab(elastomer, support, ledge_mm)
    force = None if load.force_n is None else load.force_n / (modulus_kpa * 1e-3)
    depth_guess = load.depth_mm or _depth_guess(shape, elastomer, force or 0.0)
    mesh = mesh_pad(shape, body, depth_guess, count=count, timeout_s=timeout_s)
    preload = preload_of(elastomer, load, modulus_kpa)
    found = press_pad(
        shape,
        body,
        mesh,
        depth_mm=load.depth_mm,
        force_over_modulus_mm2=force,
        preload=preload,
    )
    _check_depth(found.depth_mm, elastomer)
    return on_grids(_scattered(found), shape, elastomer, load, modulus_kpa)


def check_fem(elastomer: Elastomer, support: SlabSupport | None) -> None:
    """Refuse what this model does not know.

    Raises
    ------
    PressError
        A film, or a support that does not fit the layout.
    """
    if elastomer.film is not None:
        raise PressError(
            "elastomer.film: mechanics.model = 'fem' knows no film; remove one of them"
        )
    on_window = elastomer.layout == "contact_face"
    chosen = _support(elastomer, support)
    if (chosen in ("bonded", "window")) != on_window:
        raise PressError(
            f"support '{chosen}' does not fit elastomer.layout = '{elastomer.layout}'; allowed: "
            + ("bonded, window" if on_window else "simple, clamped, ledge")
        )


def _support(elastomer: Elastomer, support: SlabSupport | None) -> SlabSupport:
    return support or ("bonded" if elastomer.layout == "contact_face" else "simple")


def _slab(elastomer: Elastomer, support: SlabSupport | None, ledge_mm: float) -> Pad:
    span, chosen = (elastomer.length_x_mm, elastomer.length_y_mm), _support(elastomer, support)
    return slab_pad(span, elastomer.thickness_mm, elastomer.poisson_ratio, chosen, ledge_mm)


def _depth_guess(shape: Shape, elastomer: Elastomer, force_over_modulus_mm2: float) -> float:
    """Return about how far a force presses a ball in (Hertz); it only sizes the mesh."""
    radius = min((ball.radius_mm for ball in shape.spheres()), default=_TYPICAL_RADIUS_MM)
    hertz = float(np.cbrt((0.75 * 0.75 * force_over_modulus_mm2) ** 2 / radius))
    return min(hertz, 0.5 * elastomer.thickness_mm)


def _check_depth(depth_mm: float, elastomer: Elastomer) -> None:
    if depth_mm >= elastomer.thickness_mm:
        raise PressError(
            f"press: needs a depth of {depth_mm:.3g} mm, which is not less than the slab's "
            f"thickness of {elastomer.thickness_mm:g} mm; press less or use a thicker slab"
        )


def _scattered(found: PadPress) -> Scattered:
    facets = found.touched.facets
    return Scattered(
        touched=lambda x, y: _deformed(found.touched, x, y),
        coated=lambda x, y: _deformed(found.coated, x, y),
        at_mm=facets.points_mm[:, :2],
        force=found.pressure_over_modulus * facets.plan_mm2,
        plan_mm2=facets.plan_mm2,
        points_per_facet=facets.plan_mm2.size // facets.nodes.shape[0],
        depth_mm=found.depth_mm,
        iterations=found.iterations,
    )


def _deformed(face: Face, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
    return face.undeformed_mm(x_mm, y_mm) + face.deflection_mm(x_mm, y_mm)
