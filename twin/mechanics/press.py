"""Press a rigid specimen into the elastomer and return both faces, pressure and force.

World frame, mm: the undeformed coated face is z = 0, slab and specimen are centred on the origin
and the specimen is pressed from below. The specimen touches the clear face at z = -thickness
(opposite-face layout) or the coat (contact-face layout). Arrays are (row, col) with row along y and
col along x, both ascending.

The model is linear, frictionless and exact for the flat slab. At a given depth, without preload and
film, the shape does not depend on the modulus, which only scales pressure and force.
"""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from reconstruction.arrays import BoolArray, FloatArray
from reconstruction.errors import counted
from twin.config.models import Elastomer, Press, Specimen
from twin.mechanics.contact import Contact, solve_on_layer
from twin.mechanics.control import Control, DepthControl, ForceControl
from twin.mechanics.errors import PressError
from twin.mechanics.hardness import young_modulus
from twin.mechanics.layer import BondedLayer
from twin.mechanics.layouts import (
    AnyLayer,
    Preload,
    build_layer,
    face_nodes,
    grid_lengths_mm,
    preload_of,
    touched_at_nodes,
    wrapped,
)
from twin.mechanics.size import check_face_nodes, check_slab_cells
from twin.mechanics.validity import Validity, assess, margin_mm, max_slope_deg
from twin.shape import Shape
from twin.specimens import shape_of
from twin.specimens.closed_form import SphereCluster

if TYPE_CHECKING:
    import xarray

    from reconstruction.drawing import Drawing


@dataclass(frozen=True)
class SheetFields:
    """Fields that only the sheet model computes, at the coated face's nodes, (row, col)."""

    #: local thickness: distance of the touched face from the coated one, along its normal
    thickness_mm: FloatArray
    #: (row, col, 2) principal stretches, larger first
    stretch: FloatArray
    #: position on the mounted, unloaded sheet of the material point at this node
    material_x_mm: FloatArray
    material_y_mm: FloatArray


def fields_at(sheet: SheetFields, nodes: Any) -> SheetFields:
    """Return the fields of a sheet at some nodes; `nodes` is a NumPy index into (row, col)."""
    return SheetFields(**{name: values[nodes] for name, values in vars(sheet).items()})


@dataclass(frozen=True)
class ShearFields:
    """Fields of a contact with friction after a slide, on the solver's cells, (row, col)."""

    #: tangential force of the specimen on the touched face over area, along world x and y
    traction_x_kpa: FloatArray
    traction_y_kpa: FloatArray
    #: travel of the specimen over the face since the press; 0 where it sticks or does not touch
    slip_x_mm: FloatArray
    slip_y_mm: FloatArray
    #: cells that stick at the end of the slide
    sticking: BoolArray
    #: tangential force of the specimen on the elastomer
    force_x_n: float
    force_y_n: float

    @property
    def force_n(self) -> float:
        """Magnitude of the tangential force."""
        return float(np.hypot(self.force_x_n, self.force_y_n))


@dataclass(frozen=True)
class PressedElastomer:
    """Result of a press: both faces of the elastomer, pressure and force; mm, world frame."""

    #: (col,) and (row,) solver cell centres
    x_mm: FloatArray
    y_mm: FloatArray
    #: (row, col) pressure on the touched face: vertical force over area in plan; its sum over the
    #: cells is the force
    pressure_kpa: FloatArray
    #: (row, col) cells that touch the specimen
    contact: BoolArray
    #: (row, col) world z of the touched face at the cell centres
    touched_face_mm: FloatArray
    force_n: float
    #: travel of the specimen after first touch
    depth_mm: float
    young_modulus_kpa: float
    #: (col,) and (row,) nodes of the coated face, both ends included
    face_x_mm: FloatArray
    face_y_mm: FloatArray
    #: (row, col) world z of the coated face at the nodes
    face_z_mm: FloatArray
    validity: Validity
    #: passes of the contact solver, and whether it converged
    iterations: int
    converged: bool
    #: name of the model, see `twin.mechanics.models`
    model: str = "spectral"
    #: (row, col) height of the coat's texture, included in face_z_mm; None: the coat is smooth
    texture_mm: FloatArray | None = None
    #: further fields of the sheet model; None for other models
    sheet: SheetFields | None = None
    #: friction after a slide; None: the specimen has not slid
    shear: ShearFields | None = None
    #: of a relaxing elastomer: force at the end of the press, and largest change of the coated
    #: face's heights since then; None: it does not relax
    initial_force_n: float | None = None
    relief_change_um: float | None = None

    @property
    def stick_area_share(self) -> float:
        """Share of the contact area that sticks at the end of a slide; 1 without a slide."""
        if self.shear is None:
            return 1.0
        return float(self.shear.sticking.sum() / max(1, int(self.contact.sum())))

    def __repr__(self) -> str:
        rows, cols = self.face_z_mm.shape
        low, high = float(self.face_z_mm.min()), float(self.face_z_mm.max())
        return (
            f"<PressedElastomer: {self.model}, {self.force_n:.3g} N at {self.depth_mm:.3g} mm, "
            f"coat from {low:.3g} to {high:.3g} mm on {rows} x {cols} nodes, "
            f"{counted(len(self.validity.warnings), 'warning')}>"
        )

    def _repr_html_(self) -> str:
        from reconstruction.drawing import as_html

        rows = {
            "force": f"{self.force_n:.4g} N",
            "travel": f"{self.depth_mm:.4g} mm",
            "Young's modulus": f"{self.young_modulus_kpa:.4g} kPa",
            "highest pressure": f"{self.pressure_kpa.max():.4g} kPa",
        }
        return as_html(f"pressed elastomer ({self.model})", rows, self.plot())

    def plot(self) -> "Drawing":
        """Draw the coated face, the pressure, and a section: a Matplotlib figure."""
        from twin.mechanics.drawing import press_drawing

        return press_drawing(self)

    def to_xarray(self) -> "xarray.Dataset":
        """Return all fields with coordinates (mm), units and long names, as in press.nc."""
        from twin.mechanics.arrays import press_arrays

        return press_arrays(self).to_xarray()


def press(
    specimen: Specimen, elastomer: Elastomer, load: Press, *, any_depth: bool = False
) -> PressedElastomer:
    """Press `specimen` into `elastomer` by `load` with the spectral model, and return the result.

    Parameters
    ----------
    elastomer : flat slab on a simply supported rim, or gel bonded to a window
    load : depth or force, back pressure, gravity, and the pitches of solver and relief. Back
        pressure presses the slab onto the specimen, and under its weight the slab sags. The depth
        then counts from the plane of the unloaded touched face.
    any_depth : True: raise no error if the travel of a free slab reaches its thickness; other
        models use such a result as their first guess

    Returns
    -------
    Fields at the solver's cells and at the relief's nodes; in the contact-face layout the cells
    cover a window larger than the pad

    Raises
    ------
    PressError : the specimen extends beyond the slab or touches no solver cell; the depth reaches
        the slab's thickness or a ball's widest outline; or the force is below that with which back
        pressure or weight presses the slab on the specimen
    SolverError : the contact did not converge
    """
    shape = shape_of(specimen)
    check_load(shape, elastomer, load, any_depth=any_depth)
    modulus_kpa = young_modulus(elastomer).best_kpa
    layer = build_layer(elastomer, load, shape, modulus_kpa)
    preload = preload_of(elastomer, load, modulus_kpa)
    sag, height = preload.deflection(layer), shape.height_above_lowest(layer.x_mm, layer.y_mm)
    _check_cells(height, shape, load)
    contact = solve_on_layer(
        layer, height + sag, press_control(layer, height + sag, load, modulus_kpa)
    )
    if not (any_depth and elastomer.layout == "opposite_face"):
        _check_depth(contact.depth_mm, elastomer, load)
    _check_reached(contact.depth_mm, load)
    nodes = face_nodes(elastomer.length_y_mm, load), face_nodes(elastomer.length_x_mm, load)
    face_z = coated_face(layer, contact, preload, shape, nodes)
    return PressedElastomer(
        x_mm=layer.x_mm,
        y_mm=layer.y_mm,
        pressure_kpa=contact.pressure * modulus_kpa,
        contact=contact.pressure > 0,
        touched_face_mm=contact.deflection_mm + sag + elastomer.touched_plane_mm,
        # kPa mm^2 = 1e-3 N; the modulus last, so that `unit_press` scales to the same bytes.
        force_n=float(contact.pressure.sum()) * layer.cell_area_mm2 * 1e-3 * modulus_kpa,
        depth_mm=contact.depth_mm,
        young_modulus_kpa=modulus_kpa,
        face_x_mm=nodes[1],
        face_y_mm=nodes[0],
        face_z_mm=face_z,
        validity=_validity((shape, elastomer, layer), height, contact, face_z),
        iterations=contact.iterations,
        converged=True,
    )


def scaled_stress(pressed: PressedElastomer, factor: float) -> PressedElastomer:
    """Return a press with modulus and all stresses times a factor, and with the same shape."""
    shear = pressed.shear
    if shear is not None:
        stresses = ("traction_x_kpa", "traction_y_kpa", "force_x_n", "force_y_n")
        shear = replace(shear, **{name: getattr(shear, name) * factor for name in stresses})
    return replace(
        pressed,
        pressure_kpa=pressed.pressure_kpa * factor,
        force_n=pressed.force_n * factor,
        young_modulus_kpa=pressed.young_modulus_kpa * factor,
        shear=shear,
    )


def check_load(shape: Shape, elastomer: Elastomer, load: Press, *, any_depth: bool = False) -> None:
    """Raise an error if a press is impossible, without solving it; arguments as for `press`.

    Raises
    ------
    PressError : the specimen extends beyond the slab, the depth is the slab's thickness or more,
        the preload does not fit the layout, or the grids take too much memory
    """
    check_outline(shape, elastomer)
    check_face_nodes(elastomer, load)
    check_slab_cells(grid_lengths_mm(elastomer, shape), load)
    preload_of(elastomer, load, young_modulus(elastomer).best_kpa)
    if load.depth_mm is not None and not (any_depth and elastomer.layout == "opposite_face"):
        _check_depth(load.depth_mm, elastomer, load)


def coated_face(
    layer: AnyLayer,
    contact: Contact,
    preload: Preload,
    shape: Shape,
    nodes_mm: tuple[FloatArray, FloatArray],
) -> FloatArray:
    """Return world z of the coated face at its nodes along y and x, (row, col) mm."""
    y_mm, x_mm = nodes_mm
    if isinstance(layer, BondedLayer):
        indented = contact.depth_mm - shape.height_above_lowest(x_mm, y_mm)
        deflection, cells = wrapped(contact.deflection_mm, (layer.y_mm, layer.x_mm))
        return touched_at_nodes(deflection, cells, nodes_mm, indented)
    loaded = contact.pressure + preload.touched
    return layer.opposite_at_nodes(loaded, y_mm.size - 1, x_mm.size - 1, preload.coated)


def _check_cells(height: FloatArray, shape: Shape, load: Press) -> None:
    if not np.isfinite(height).any():
        x_low, x_high, y_low, y_high = shape.bounds_mm()
        raise PressError(
            f"specimen: {x_high - x_low:.3g} x {y_high - y_low:.3g} mm seen from above, which "
            f"touches no cell of the solver's grid; are its sizes in mm? If so, use a finer "
            f"press.solver_pitch_mm than {load.solver_pitch_mm:g}"
        )


def press_control(layer: AnyLayer, height: FloatArray, load: Press, modulus_kpa: float) -> Control:
    """Return the control of a press: its force over modulus, or its travel.

    Raises
    ------
    PressError : at the travel the specimen, at `height` (row, col), mm, touches no cell
    """
    if load.control == "force":
        assert load.force_n is not None  # the model's own validator
        return ForceControl(load.force_n / (modulus_kpa * 1e-3), layer.cell_area_mm2)
    assert load.depth_mm is not None
    if not (height < load.depth_mm).any():
        raise PressError(
            f"press.depth_mm: {load.depth_mm:g} mm touches no cell of the solver's grid; "
            f"press deeper or use a finer press.solver_pitch_mm than {load.solver_pitch_mm:g}"
        )
    return DepthControl(load.depth_mm)


def check_outline(shape: Shape, elastomer: Elastomer) -> None:
    """Raise an error if a specimen extends beyond the pad, or beyond the slab's free span.

    Raises
    ------
    PressError : the message states the axis, the specimen's extent and the allowed extent, mm
    """
    x_low, x_high, y_low, y_high = shape.bounds_mm()
    free = elastomer.layout == "opposite_face"
    span = "the slab's free span" if free else "the pad"
    for axis, low, high, length in (
        ("x", x_low, x_high, elastomer.length_x_mm),
        ("y", y_low, y_high, elastomer.length_y_mm),
    ):
        if max(-low, high) > length / 2:
            raise PressError(
                f"specimen: reaches from {low:.4g} to {high:.4g} mm along {axis}, {span} "
                f"is {-length / 2:.4g} to {length / 2:.4g} mm; "
                f"move the specimen or enlarge elastomer.length_{axis}_mm"
            )


def _check_depth(depth_mm: float, elastomer: Elastomer, load: Press) -> None:
    if depth_mm < elastomer.thickness_mm:
        return
    cause, remedy = f"press.depth_mm: {depth_mm:g} mm", "press less or use a thicker slab"
    if load.control == "force":
        cause = f"press.force_n: {load.force_n:g} N needs a depth of {depth_mm:.3g} mm, which"
        remedy = "lower press.force_n, or use a thicker or harder slab"
        if elastomer.layout == "opposite_face":
            remedy += (
                ", a narrower rim (elastomer.length_x_mm, length_y_mm), or a gel bonded to a "
                "window (elastomer.layout = 'contact_face', with layers)"
            )
    raise PressError(
        f"{cause} is not less than the slab's thickness of {elastomer.thickness_mm:g} mm; {remedy}"
    )


def _check_reached(depth_mm: float, load: Press) -> None:
    """Raise an error if the given force is below that of air or weight on the specimen."""
    if depth_mm < 0.0:
        raise PressError(
            f"press.force_n: {load.force_n:g} N is reached {-depth_mm:.3g} mm before the specimen "
            "is at the plane of the unloaded slab: air or weight already press with more; "
            "raise it, or lower press.back_pressure_kpa"
        )


def _validity(
    pressed: tuple[Shape, Elastomer, AnyLayer],
    height: FloatArray,
    contact: Contact,
    face_z: FloatArray,
) -> Validity:
    shape, elastomer, layer = pressed
    touching, pitch = contact.pressure > 0, float(np.sqrt(layer.cell_area_mm2))
    slope = max_slope_deg(height, touching, pitch)
    if slope >= 90 and isinstance(shape, SphereCluster):
        raise PressError(
            f"press: at {contact.depth_mm:.3g} mm the contact reaches the specimen's widest "
            "outline, where a height field ends; press less"
        )
    half = elastomer.length_x_mm / 2, elastomer.length_y_mm / 2
    return assess(
        layout=elastomer.layout,
        depth_mm=contact.depth_mm,
        thickness_mm=layer.thickness_mm,
        radius_mm=min((ball.radius_mm for ball in shape.spheres()), default=None),
        deflection_mm=float(np.abs(face_z).max()),
        slope_deg=slope,
        margin_to_rim_mm=margin_mm(touching, layer.x_mm, layer.y_mm, half),
        cells_across=float(np.sqrt(4 / np.pi * touching.sum() / max(1, len(shape.spheres())))),
    )
