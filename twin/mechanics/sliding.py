"""Slide a pressed specimen over a bonded layer: a path of equilibria with Coulomb friction.

The press is frictionless; friction acts from the beginning of the slide. Fields are in the frame
that moves with the specimen: a bonded layer is the same at each place, so that the pressure moves
with the specimen. Each increment of the travel is solved for traction (`friction`) and pressure in
turns until both agree: the traction deflects the face against the press in front of the specimen
and along it behind, the pressure displaces the face in its plane. The slip also carries material
through the frame; its effect on displacements is of the order of the strain, and is neglected.

Arrays are (row, col) on the layer's cells; pressure and traction are divided by Young's modulus.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from reconstruction.arrays import BoolArray, FloatArray
from twin.config.models import Elastomer, Press
from twin.mechanics.contact import Contact, solve_on_layer
from twin.mechanics.control import Control, inner
from twin.mechanics.errors import PressError, SolverError
from twin.mechanics.friction import limited, solve_friction
from twin.mechanics.layer import BondedLayer
from twin.mechanics.layouts import Preload, build_layer
from twin.mechanics.patch import Span
from twin.mechanics.press import PressedElastomer, ShearFields, coated_face, press_control
from twin.mechanics.shear import InPlane, ShearedLayer
from twin.shape import Shape

# Increments of a straight slide. With 4 times as many, shear force and stick area change by less
# than 1 % (tests).
INCREMENTS = 4
LARGEST_SHEAR_STRAIN = 0.5
"""Largest traction over shear modulus without a warning (assumed: half of a simple shear of 1)."""
_MOST_TURNS = 30
# Change of the pressure in the last turn over the pressure, both summed over the cells.
_TOLERANCE = 1e-4
# A cell sticks if its traction is smaller than the bound of friction by more than this share.
_AT_BOUND = 1e-3


@dataclass(frozen=True, eq=False)
class SlidEquilibrium:
    """Equilibrium at one point of the path of a slide."""

    #: pressure, and displacement along the press with the part that the traction causes
    contact: Contact
    traction: InPlane
    #: slip of the specimen over the face since the press, mm; 0 outside the contact
    slip_mm: InPlane
    #: displacement of the face in its plane by pressure and traction, mm
    displacement_mm: InPlane
    #: cells that stick in the last increment
    sticking: BoolArray
    #: friction's energy since the press over modulus, and work of the specimen's travel along the
    #: face over modulus, mm^3
    dissipated_mm3: float = 0.0
    work_mm3: float = 0.0

    def force_mm2(self, cell_area_mm2: float) -> tuple[float, float]:
        """Return the force on the layer along x and y over modulus, mm^2."""
        x, y = (float(part.sum()) * cell_area_mm2 for part in self.traction)
        return x, y


def slide(
    layer: BondedLayer,
    height_mm: FloatArray,
    pressed: tuple[Contact, Control],
    friction_coefficient: float,
    travels_mm: Sequence[tuple[float, float]],
) -> Iterator[SlidEquilibrium]:
    """Slide a pressed specimen along a path; return the equilibrium at each of its points.

    Parameters
    ----------
    layer : a bonded layer without film
    height_mm : (row, col) float, mm; the specimen's height behind its foremost point, inf where
        absent
    pressed : the frictionless contact from which the slide starts, and the control of the press
    friction_coefficient : mu, more than 0
    travels_mm : points of the path, (x, y) since the press, mm

    Raises
    ------
    SolverError : traction or pressure did not converge
    """
    contact, control = pressed
    still, sheared = InPlane(*np.zeros((2, layer.rows, layer.cols))), ShearedLayer(layer)
    at_rest = InPlane(*layer.in_plane(contact.pressure))
    state = SlidEquilibrium(contact, still, still, at_rest, contact.pressure > 0)
    increment = _Increment(sheared, height_mm, control, friction_coefficient)
    before = (0.0, 0.0)
    for travel in travels_mm:
        state = increment.after(state, (travel[0] - before[0], travel[1] - before[1]))
        before = travel
        yield state


@dataclass(frozen=True, eq=False)
class _Increment:
    """Solution of one increment of the travel."""

    sheared: ShearedLayer
    height_mm: FloatArray
    control: Control
    mu: float

    def after(self, start: SlidEquilibrium, moved_mm: tuple[float, float]) -> SlidEquilibrium:
        """Return the equilibrium after the specimen has moved by `moved_mm` along x and y."""
        layer, contact, traction = self.sheared.layer, start.contact, start.traction
        for _ in range(_MOST_TURNS):
            traction = self._traction(contact, start, moved_mm, traction)
            deflection = self.sheared.deflect(traction)
            solved = solve_on_layer(layer, self.height_mm + deflection, self.control)
            change = float(np.abs(solved.pressure - contact.pressure).sum())
            contact = replace(solved, deflection_mm=solved.deflection_mm + deflection)
            traction = limited(traction, self.mu * contact.pressure)
            if change <= _TOLERANCE * float(contact.pressure.sum()):
                return self._state(start, contact, traction, moved_mm)
        raise SolverError(
            f"press: pressure and friction do not agree within {_MOST_TURNS} turns; use a smaller "
            "elastomer.friction_coefficient or slide"
        )

    def _traction(
        self,
        contact: Contact,
        start: SlidEquilibrium,
        moved_mm: tuple[float, float],
        guess: InPlane,
    ) -> InPlane:
        layer = self.sheared.layer
        spans = map(Span.around, np.nonzero(contact.pressure > 0), contact.pressure.shape)
        patch = self.sheared.patch(*spans)
        pressed = layer.in_plane(contact.pressure)
        target = InPlane(
            *(
                (start.displacement_mm[axis] - pressed[axis])[patch.cells] + moved_mm[axis]
                for axis in (0, 1)
            )
        )
        bound = self.mu * contact.pressure[patch.cells]
        near = InPlane(*(part[patch.cells] for part in guess))
        within = solve_friction(patch, bound, target, near)
        whole = InPlane(*np.zeros((2, layer.rows, layer.cols)))
        for axis in (0, 1):
            whole[axis][patch.cells] = within[axis]
        return whole

    def _state(
        self,
        start: SlidEquilibrium,
        contact: Contact,
        traction: InPlane,
        moved_mm: tuple[float, float],
    ) -> SlidEquilibrium:
        layer = self.sheared.layer
        touching = contact.pressure > 0
        by_pressure, by_traction = layer.in_plane(contact.pressure), self.sheared.displace(traction)
        displaced = InPlane(*(by_pressure[axis] + by_traction[axis] for axis in (0, 1)))
        # Slip on cells that touch; the rounding of sticking cells is of the friction's tolerance.
        bound = self.mu * contact.pressure
        sticking = touching & (np.hypot(*traction) < (1 - _AT_BOUND) * bound)
        slipping = touching & ~sticking
        slips = [
            np.where(slipping, moved_mm[axis] - displaced[axis] + start.displacement_mm[axis], 0.0)
            for axis in (0, 1)
        ]
        area = layer.cell_area_mm2
        dissipated = sum(inner(traction[axis], slips[axis]) for axis in (0, 1)) * area
        mean = [(traction[axis] + start.traction[axis]).sum() / 2 for axis in (0, 1)]
        work = float(np.dot(mean, moved_mm)) * area
        return SlidEquilibrium(
            contact,
            traction,
            InPlane(
                *(np.where(touching, start.slip_mm[axis] + slips[axis], 0.0) for axis in (0, 1))
            ),
            displaced,
            sticking,
            start.dissipated_mm3 + dissipated,
            start.work_mm3 + work,
        )


def slid_press(
    pressed: PressedElastomer, pressed_from: tuple[Shape, Elastomer, Press]
) -> PressedElastomer:
    """Slide a press of the spectral model, and return it at the end of the slide.

    Parameters
    ----------
    pressed : the frictionless press, at the specimen's pose at the end of the slide
    pressed_from : shape of the specimen, elastomer and load of the press

    Raises
    ------
    SolverError : as `slide`
    """
    shape, elastomer, load = pressed_from
    modulus_kpa, mu = pressed.young_modulus_kpa, elastomer.friction_coefficient
    layer = build_layer(elastomer, load, shape, modulus_kpa)
    assert isinstance(layer, BondedLayer)  # `check_slide`
    assert mu is not None
    height = shape.height_above_lowest(layer.x_mm, layer.y_mm)
    flat_mm = pressed.touched_face_mm - elastomer.touched_plane_mm
    start = Contact(pressed.pressure_kpa / modulus_kpa, flat_mm, pressed.depth_mm, 0)
    control = press_control(layer, height, load, modulus_kpa)
    *_, end = slide(layer, height, (start, control), mu, straight(load))
    contact, nodes = end.contact, (pressed.face_y_mm, pressed.face_x_mm)
    slid = replace(
        pressed,
        pressure_kpa=contact.pressure * modulus_kpa,
        contact=contact.pressure > 0,
        touched_face_mm=contact.deflection_mm + elastomer.touched_plane_mm,
        force_n=float(contact.pressure.sum()) * layer.cell_area_mm2 * 1e-3 * modulus_kpa,
        depth_mm=contact.depth_mm,
        face_z_mm=coated_face(layer, contact, Preload(), shape, nodes),
        iterations=pressed.iterations + contact.iterations,
        shear=_shear_fields(end, layer, modulus_kpa),
    )
    return _with_strain_warning(slid, elastomer)


def _shear_fields(end: SlidEquilibrium, layer: BondedLayer, modulus_kpa: float) -> ShearFields:
    # kPa mm^2 = 1e-3 N; the modulus last, as in `press`.
    force_x, force_y = (force * 1e-3 * modulus_kpa for force in end.force_mm2(layer.cell_area_mm2))
    return ShearFields(
        traction_x_kpa=end.traction.x * modulus_kpa,
        traction_y_kpa=end.traction.y * modulus_kpa,
        slip_x_mm=end.slip_mm.x,
        slip_y_mm=end.slip_mm.y,
        sticking=end.sticking,
        force_x_n=force_x,
        force_y_n=force_y,
    )


def _with_strain_warning(slid: PressedElastomer, elastomer: Elastomer) -> PressedElastomer:
    shear = slid.shear
    assert shear is not None
    shear_modulus_kpa = slid.young_modulus_kpa / (2 * (1 + elastomer.poisson_ratio))
    traction_kpa = float(np.hypot(shear.traction_x_kpa, shear.traction_y_kpa).max())
    strain = traction_kpa / shear_modulus_kpa
    if strain <= LARGEST_SHEAR_STRAIN:
        return slid
    warning = (
        f"the friction shears the gel by up to {strain:.2g}, above {LARGEST_SHEAR_STRAIN:g}: the "
        "linear model neglects large strain"
    )
    validity = replace(slid.validity, warnings=(*slid.validity.warnings, warning))
    return replace(slid, validity=validity)


def straight(load: Press, increments: int = INCREMENTS) -> list[tuple[float, float]]:
    """Return the points of the straight slide of a press, (x, y) since the press, mm."""
    shares = (np.arange(increments) + 1) / increments
    return [(share * load.slide_x_mm, share * load.slide_y_mm) for share in shares.tolist()]


def check_slide(shape: Shape, elastomer: Elastomer, load: Press) -> None:
    """Raise an error if the specimen cannot slide on the elastomer, without solving it.

    Raises
    ------
    PressError : the layout is not `contact_face`, the elastomer has a film or no friction, or the
        specimen is beyond the pad at the start of the slide
    """
    key = "slide_x_mm" if load.slide_x_mm else "slide_y_mm"
    slid = f"press.{key}: found {getattr(load, key):g} mm"
    if elastomer.layout != "contact_face":
        raise PressError(
            f"{slid} with elastomer.layout = 'opposite_face', allowed with 'contact_face' only: a "
            "gel bonded to a window; change the layout or remove the slide"
        )
    if elastomer.film is not None:
        raise PressError(f"{slid} with elastomer.film, which a slide does not model; remove one")
    if not elastomer.friction_coefficient:
        raise PressError(
            f"{slid} without friction: give elastomer.friction_coefficient, more than 0"
        )
    x_low, x_high, y_low, y_high = shape.bounds_mm()
    for axis, low, high, length, travel in (
        ("x", x_low, x_high, elastomer.length_x_mm, load.slide_x_mm),
        ("y", y_low, y_high, elastomer.length_y_mm, load.slide_y_mm),
    ):
        if max(-(low - travel), high - travel) > length / 2:
            raise PressError(
                f"press.slide_{axis}_mm: found {travel:g}, with which the slide starts beyond the "
                f"pad: the specimen reaches from {low - travel:.4g} to {high - travel:.4g} mm, "
                f"allowed {-length / 2:.4g} to {length / 2:.4g}; slide less"
            )
