"""Compute the result of a press from a sheet in equilibrium: faces, contact, force, validity."""

import numpy as np

from reconstruction.arrays import FloatArray
from twin.config.models import Elastomer, Press
from twin.mechanics.hardness import young_modulus
from twin.mechanics.layouts import face_nodes
from twin.mechanics.press import PressedElastomer, SheetFields
from twin.mechanics.sheet.case import SheetCase
from twin.mechanics.sheet.energy import Sheet, SheetState
from twin.mechanics.sheet.faces import height_map, sample
from twin.mechanics.sheet.grid import normal_of
from twin.mechanics.sheet.kernel import curvature_squared
from twin.mechanics.sheet.pressure import pressure_on_cells
from twin.mechanics.validity import assess_sheet, margin_mm

_HALF = 0.5


def contact_force_n(sheet: Sheet, state: SheetState) -> float:
    """Return the upward force of specimen and plate on the sheet, N.

    It is computed from the balance of forces: air pressure, weight and reaction of the rim.
    """
    sheet.evaluate(state.control_mm, state, tangent=False)
    held = float(sheet.reactions().sum())
    surface = sheet.surface(state.control_mm)
    plan = np.cross(surface[..., 1, :], surface[..., 2, :])[..., 2]
    pressed = state.pressure_kpa * float((plan * sheet.grid.rest.area_mm2).sum())
    weighed_mm2 = sheet.thickness_ratio * sheet.grid.rest.area_mm2
    weight = sheet.laws.weight_kpa * float(weighed_mm2.sum())
    # kPa mm^2 = mN
    return 1e-3 * (pressed + weight - held)


def pressed_of(
    case: SheetCase,
    elastomer: Elastomer,
    load: Press,
    sheet: Sheet,
    state: SheetState,
) -> PressedElastomer:
    """Return the result of a press, in the world frame, from the equilibrium of its sheet."""
    mounted_mm, modulus_kpa = elastomer.mounted_thickness_mm, young_modulus(elastomer).best_kpa
    half_mm, stretch = mounted_mm / 2, elastomer.pre_stretch
    nodes_x, nodes_y = (
        face_nodes(length, load) for length in (elastomer.length_x_mm, elastomer.length_y_mm)
    )
    sampled = sample(sheet, state, load.relief_pitch_mm)
    carried = np.concatenate(
        (sampled.thickness_mm[..., None], sampled.stretch, sampled.material_mm), axis=2
    )
    flat = np.array([half_mm, mounted_mm, stretch, stretch, 0.0, 0.0])
    face_z, fields = height_map(sampled.upper_mm, carried, nodes_x, nodes_y, flat)
    x, y = _centres(elastomer.length_x_mm, load), _centres(elastomer.length_y_mm, load)
    touch = _touching(sheet, state, sampled.middle_mm, sampled.thickness_mm)
    touched_z, on_cells = height_map(sampled.lower_mm, touch, x, y, np.array([-half_mm, 0.0]))
    contact = on_cells[..., 0] > _HALF
    frame_mm = elastomer.length_x_mm / 2, elastomer.length_y_mm / 2
    pitch = float(np.sqrt((x[1] - x[0]) * (y[1] - y[0])))
    across_mm = float(np.sqrt(4 / np.pi * contact.sum())) * pitch
    return PressedElastomer(
        x_mm=x,
        y_mm=y,
        pressure_kpa=pressure_on_cells(sheet, state, x, y),
        contact=contact,
        touched_face_mm=touched_z - half_mm,
        force_n=contact_force_n(sheet, state),
        depth_mm=state.travel_mm,
        young_modulus_kpa=modulus_kpa,
        face_x_mm=nodes_x,
        face_y_mm=nodes_y,
        face_z_mm=face_z - half_mm,
        validity=assess_sheet(
            depth_mm=state.travel_mm,
            thickness_mm=elastomer.thickness_mm,
            radius_mm=min((ball.radius_mm for ball in case.shape.spheres()), default=None),
            deflection_mm=float(np.abs(face_z - half_mm).max()),
            bend_1_mm=_contact_bend(sheet, state),
            slope_deg=_steepest_deg(sheet, state),
            margin_to_rim_mm=margin_mm(contact, x, y, frame_mm),
            cells_across=across_mm / sheet.cell_mm,
            ridge_pitch_mm=case.ridge_pitch_mm,
        ),
        iterations=state.steps,
        converged=True,
        model="sheet",
        sheet=_fields(fields),
    )


def _fields(carried: FloatArray) -> SheetFields:
    """Return the fields at the coated face's nodes from an array (row, col, 5) of their values."""
    return SheetFields(
        thickness_mm=carried[..., 0],
        stretch=carried[..., 1:3],
        material_x_mm=carried[..., 3],
        material_y_mm=carried[..., 4],
    )


def _touching(
    sheet: Sheet, state: SheetState, middle_mm: FloatArray, thickness_mm: FloatArray
) -> FloatArray:
    """Return 1 where specimen or plate touches the sheet, else 0, as float (row, col, 1).

    A sheet with tack touches up to the middle of the cohesive range, where its pull is largest.
    """
    lift = np.array([0.0, 0.0, sheet.touched_z_mm + state.travel_mm])
    points = (middle_mm - lift).reshape(-1, 3)
    nearest = np.full(thickness_mm.size, np.inf)
    for body in sheet.bodies.moving:
        distance_mm = body.evaluate(points, sheet.reach_mm)[0]
        nearest = np.minimum(nearest, distance_mm - thickness_mm.ravel() / 2)
    reach = sheet.laws.tack_range_mm / 2 if sheet.laws.tack > 0 else 0.0
    return np.asarray((nearest < reach).reshape(*thickness_mm.shape, 1), np.float64)


def _contact_bend(sheet: Sheet, state: SheetState) -> float:
    """Return the RMS curvature, 1/mm, of the sheet where specimen or plate touches; 0: nowhere."""
    surface = sheet.surface(state.control_mm)
    touch = sheet.touch(surface[..., 0, :], state.travel_mm)
    touching = (sheet.gap_mm(surface, touch) < 0).any(axis=0)
    if not touching.any():
        return 0.0
    square = curvature_squared(state.control_mm, sheet.grid.rest)[touching]
    weight = sheet.grid.rest.area_mm2[touching]
    return float(np.sqrt((square * weight).sum() / weight.sum()))


def _steepest_deg(sheet: Sheet, state: SheetState) -> float:
    upright = normal_of(sheet.surface(state.control_mm))[..., 2]
    return float(np.rad2deg(np.arccos(np.clip(upright.min(), -1.0, 1.0))))


def _centres(length_mm: float, load: Press) -> FloatArray:
    count = int(np.ceil(length_mm / load.solver_pitch_mm - 1e-9))
    centres = (np.arange(count) + 0.5) * (length_mm / count) - length_mm / 2
    return np.asarray(centres, dtype=np.float64)
