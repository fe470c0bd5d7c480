"""From scattered results of a reference to the grids of `PressedElastomer`."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import LinearNDInterpolator

from reconstruction.arrays import FloatArray
from twin.config.models import Elastomer, Press
from twin.mechanics.control import BoolArray
from twin.mechanics.errors import PressError
from twin.mechanics.layouts import face_nodes
from twin.mechanics.press import PressedElastomer
from twin.mechanics.validity import Validity, assess, margin_mm, max_slope_deg
from twin.specimens import Shape

# Share of loaded points round a cell from which on it touches: a curved specimen leaves some points
# of a facet free.
_TOUCHING = 0.3

# Height error over depth of the default bricks (spectral press at small strain, halved elements).
_ELEMENT_ERROR = 5e-3

FaceHeight = Callable[[FloatArray, FloatArray], FloatArray]


@dataclass(frozen=True)
class Scattered:
    """A solved press at points; lengths in mm, world frame."""

    #: world z of each face at points (...) of x and y
    touched: FaceHeight
    coated: FaceHeight
    #: (point, [x, y]), force over modulus and area in plan at the touched face's points
    at_mm: FloatArray
    force: FloatArray
    plan_mm2: FloatArray
    #: the points run facet by facet
    points_per_facet: int
    depth_mm: float
    iterations: int
    #: solved at large strain: what a linear slab leaves out is in
    large_strain: bool = False


def on_grids(
    found: Scattered, shape: Shape, elastomer: Elastomer, load: Press, modulus_kpa: float
) -> PressedElastomer:
    """Sample a reference's press on the solver's cells and the relief's nodes.

    Pressure is averaged over the cells' neighbourhood and scaled so that its sum is the force.

    Raises
    ------
    PressError : the contact is too small for the cells
    """
    x, y = _centres(elastomer.length_x_mm, load), _centres(elastomer.length_y_mm, load)
    nodes_x, nodes_y = (
        face_nodes(length, load) for length in (elastomer.length_x_mm, elastomer.length_y_mm)
    )
    cell_mm2 = float((x[1] - x[0]) * (y[1] - y[0]))
    pressure = _pressure(found, x, y, cell_mm2)
    force = float(found.force.sum())
    face_z = found.coated(*np.meshgrid(nodes_x, nodes_y))
    contact = pressure > 0
    return PressedElastomer(
        x_mm=x,
        y_mm=y,
        pressure_kpa=pressure * modulus_kpa,
        contact=contact,
        touched_face_mm=found.touched(*np.meshgrid(x, y)),
        # kPa mm^2 = 1e-3 N
        force_n=force * modulus_kpa * 1e-3,
        depth_mm=found.depth_mm,
        young_modulus_kpa=modulus_kpa,
        face_x_mm=nodes_x,
        face_y_mm=nodes_y,
        face_z_mm=face_z,
        validity=_validity(found, shape, elastomer, (x, y, contact), float(np.abs(face_z).max())),
        iterations=found.iterations,
        converged=True,
    )


def check_depth(depth_mm: float, elastomer: Elastomer) -> None:
    """Refuse a force that needs as deep a press as the slab is thick.

    Raises
    ------
    PressError : it does
    """
    if depth_mm >= elastomer.thickness_mm:
        raise PressError(
            f"press: needs a depth of {depth_mm:.3g} mm, which is not less than the slab's "
            f"thickness of {elastomer.thickness_mm:g} mm; press less or use a thicker slab"
        )


def _validity(
    found: Scattered,
    shape: Shape,
    elastomer: Elastomer,
    cells: tuple[FloatArray, FloatArray, BoolArray],
    peak_mm: float,
) -> Validity:
    x, y, contact = cells
    pitch = float(np.sqrt((x[1] - x[0]) * (y[1] - y[0])))
    half = elastomer.length_x_mm / 2, elastomer.length_y_mm / 2

    def judge(depth_mm: float, deflection_mm: float) -> Validity:
        return assess(
            layout=elastomer.layout,
            depth_mm=depth_mm,
            thickness_mm=elastomer.thickness_mm,
            radius_mm=min((ball.radius_mm for ball in shape.spheres()), default=None),
            deflection_mm=deflection_mm,
            slope_deg=max_slope_deg(shape.height_above_lowest(x, y), contact, pitch),
            margin_to_rim_mm=margin_mm(contact, x, y, half),
            cells_across=float(np.sqrt(4 / np.pi * contact.sum() / max(1, len(shape.spheres())))),
        )

    judged = judge(found.depth_mm, peak_mm)
    if not found.large_strain:
        return judged
    # Depth and deflection need no warning here: those of a press without any remain.
    remaining = judge(0.0, 0.0).warnings
    error_mm = _ELEMENT_ERROR * found.depth_mm
    return replace(judged, height_error_mm=error_mm, warnings=remaining)


def _centres(length_mm: float, load: Press) -> FloatArray:
    count = int(np.ceil(length_mm / load.solver_pitch_mm - 1e-9))
    half = length_mm / 2
    return np.linspace(-half, half, 2 * count + 1)[1::2]


def _pressure(found: Scattered, x: FloatArray, y: FloatArray, cell_mm2: float) -> FloatArray:
    """Return pressure over modulus (row, col), 0 where the faces are apart."""
    # Pressures of single points ripple: take whole facets.
    at, force, area = (
        data.reshape(-1, found.points_per_facet, *data.shape[1:])
        for data in (found.at_mm, found.force, found.plan_mm2)
    )
    mean, loaded = force.sum(axis=1) / area.sum(axis=1), np.mean(force > 0, axis=1)
    values = np.stack((mean, loaded), axis=1)
    seen = LinearNDInterpolator(at.mean(axis=1), values, fill_value=0.0)(*np.meshgrid(x, y))
    near = seen[..., 1] > min(_TOUCHING, 0.5 * float(loaded.max()))
    pressure: FloatArray = np.where(near, np.maximum(seen[..., 0], 0.0), 0.0)
    total = float(pressure.sum()) * cell_mm2
    if total <= 0:
        raise PressError(
            "press: the contact is smaller than a cell; use a finer press.solver_pitch_mm"
        )
    return np.asarray(pressure * (float(found.force.sum()) / total))
