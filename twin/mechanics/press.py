"""Press a rigid specimen into the elastomer and return both faces, pressure and force.

Opposite-face layout, world frame, mm: the undeformed coated face is z = 0, the clear face is
z = -thickness, the slab is centred on the origin and the specimen comes from below. Arrays are
(row, col) with row along y and col along x, both ascending.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import fft

from twin.config.models import Elastomer, Press, Specimen
from twin.mechanics.contact import Contact, Control, DepthControl, ForceControl, solve_contact
from twin.mechanics.errors import PressError
from twin.mechanics.hardness import young_modulus
from twin.mechanics.layer import FreeSlab
from twin.mechanics.transfer import FloatArray
from twin.mechanics.validity import Validity, assess, margin_mm, max_slope_deg
from twin.specimens import Shape, shape_of


@dataclass(frozen=True)
class PressedElastomer:
    """A pressed slab; lengths in mm, world frame."""

    #: (col,) and (row,) solver cell centres
    x_mm: FloatArray
    y_mm: FloatArray
    #: (row, col) pressure on the clear face
    pressure_kpa: FloatArray
    #: (row, col) cells that touch the specimen
    contact: npt.NDArray[np.bool_]
    #: (row, col) world z of the clear face at the cell centres, -thickness where undeformed
    touched_face_mm: FloatArray
    force_n: float
    #: travel of the specimen after first touch
    depth_mm: float
    young_modulus_kpa: float
    #: (col,) and (row,) nodes of the coated face, rim included
    face_x_mm: FloatArray
    face_y_mm: FloatArray
    #: (row, col) world z of the coated face at the nodes, 0 on the rim
    face_z_mm: FloatArray
    validity: Validity
    iterations: int
    converged: bool


def press(specimen: Specimen, elastomer: Elastomer, load: Press) -> PressedElastomer:
    """Press `specimen` into `elastomer` as `load` says.

    Parameters
    ----------
    specimen : Specimen
        What is pressed, in its pose.
    elastomer : Elastomer
        Flat slab on a simply supported rim.
    load : Press
        Depth or force, back pressure, and the pitches of solver and relief. Back pressure drapes
        the slab over the specimen; the depth then counts from the plane of the unloaded clear face.

    Returns
    -------
    PressedElastomer
        The result on the solver's cells and on the relief's nodes.

    Raises
    ------
    PressError
        The specimen reaches over the slab, the press needs more than the slab's thickness or than
        the specimen's height, or touches no solver cell.
    SolverError
        The contact did not converge.

    Notes
    -----
    Linear, frictionless, exact for the flat slab. At a given depth and without back pressure the
    shape does not depend on the modulus, which only scales pressure and force.
    """
    shape, slab = shape_of(specimen), _slab(elastomer, load)
    _check_outline(shape, elastomer)
    modulus_kpa = young_modulus(elastomer).best_kpa
    back = load.back_pressure_kpa / modulus_kpa
    height = shape.height_above_lowest(slab.x_mm, slab.y_mm)
    sag = slab.deflect_opposite(np.full_like(height, back)) if back else np.zeros_like(height)
    control = _control(slab, height - sag, load, modulus_kpa)
    contact = solve_contact(slab.deflect, height - sag, control)
    _check_depth(contact.depth_mm, slab.thickness_mm, load)
    face_x, face_y = _nodes(slab.length_x_mm, load), _nodes(slab.length_y_mm, load)
    face_z = slab.opposite_at_nodes(contact.pressure, face_y.size - 1, face_x.size - 1, back)
    return PressedElastomer(
        x_mm=slab.x_mm,
        y_mm=slab.y_mm,
        pressure_kpa=contact.pressure * modulus_kpa,
        contact=contact.pressure > 0,
        touched_face_mm=contact.deflection_mm - sag - slab.thickness_mm,
        # kPa mm^2 = 1e-3 N
        force_n=float(contact.pressure.sum()) * slab.cell_area_mm2 * modulus_kpa * 1e-3,
        depth_mm=contact.depth_mm,
        young_modulus_kpa=modulus_kpa,
        face_x_mm=face_x,
        face_y_mm=face_y,
        face_z_mm=face_z,
        validity=_validity(shape, slab, height, contact, float(np.abs(face_z).max())),
        iterations=contact.iterations,
        converged=True,
    )


def _slab(elastomer: Elastomer, load: Press) -> FreeSlab:
    cols, rows = (
        fft.next_fast_len(int(np.ceil(length / load.solver_pitch_mm - 1e-9)), real=True)
        for length in (elastomer.length_x_mm, elastomer.length_y_mm)
    )
    return FreeSlab(
        rows=rows,
        cols=cols,
        length_x_mm=elastomer.length_x_mm,
        length_y_mm=elastomer.length_y_mm,
        thickness_mm=elastomer.thickness_mm,
        poisson_ratio=elastomer.poisson_ratio,
    )


def _nodes(length_mm: float, load: Press) -> FloatArray:
    intervals = fft.next_fast_len(int(np.ceil(length_mm / load.relief_pitch_mm - 1e-9)), real=True)
    return np.linspace(-length_mm / 2, length_mm / 2, intervals + 1)


def _control(slab: FreeSlab, height: FloatArray, load: Press, modulus_kpa: float) -> Control:
    if load.control == "force":
        assert load.force_n is not None  # the model's own validator
        return ForceControl(load.force_n / (modulus_kpa * 1e-3), slab.cell_area_mm2)
    assert load.depth_mm is not None
    _check_depth(load.depth_mm, slab.thickness_mm, load)
    if not (height < load.depth_mm).any():
        raise PressError(
            f"press.depth_mm: {load.depth_mm:g} mm touches no cell of the solver's grid; "
            f"use a finer press.solver_pitch_mm than {load.solver_pitch_mm:g}"
        )
    return DepthControl(load.depth_mm)


def _check_outline(shape: Shape, elastomer: Elastomer) -> None:
    x_low, x_high, y_low, y_high = shape.bounds_mm()
    for axis, low, high, length in (
        ("x", x_low, x_high, elastomer.length_x_mm),
        ("y", y_low, y_high, elastomer.length_y_mm),
    ):
        if max(-low, high) > length / 2:
            raise PressError(
                f"specimen: reaches from {low:.4g} to {high:.4g} mm along {axis}, the slab's free "
                f"span is {-length / 2:.4g} to {length / 2:.4g} mm; "
                f"move the specimen or enlarge elastomer.length_{axis}_mm"
            )


def _check_depth(depth_mm: float, thickness_mm: float, load: Press) -> None:
    if depth_mm < thickness_mm:
        return
    asked = (
        f"press.depth_mm: {depth_mm:g} mm"
        if load.control == "depth"
        else f"press.force_n: {load.force_n:g} N needs a depth of {depth_mm:.3g} mm, which"
    )
    raise PressError(
        f"{asked} is not less than the slab's thickness of {thickness_mm:g} mm; "
        "press less or use a thicker slab"
    )


def _validity(
    shape: Shape, slab: FreeSlab, height: FloatArray, contact: Contact, peak_mm: float
) -> Validity:
    touching, pitch = contact.pressure > 0, float(np.sqrt(slab.cell_area_mm2))
    slope = max_slope_deg(height, touching, pitch)
    if slope >= 90:
        raise PressError(
            f"press: at {contact.depth_mm:.3g} mm the contact reaches the specimen's widest "
            "outline, where a height field ends; press less"
        )
    return assess(
        depth_mm=contact.depth_mm,
        thickness_mm=slab.thickness_mm,
        radius_mm=min((ball.radius_mm for ball in shape.spheres()), default=None),
        deflection_mm=peak_mm,
        slope_deg=slope,
        margin_to_rim_mm=margin_mm(touching, slab.x_mm, slab.y_mm, pitch),
        cells_across=float(np.sqrt(4 / np.pi * touching.sum() / max(1, len(shape.spheres())))),
    )
