"""The whole press: invariants, orientation, grids, back pressure and refusals."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray
from pydantic import ValidationError

from twin.config.models import Elastomer, Press, Specimen
from twin.mechanics import PressedElastomer, PressError, press
from twin.specimens import height_above_lowest
from twin.specimens.kinds.ball import Ball
from twin.specimens.kinds.group import Group
from twin.specimens.kinds.mesh import MeshFile
from twin.specimens.kinds.rod import Rod
from twin.specimens.kinds.two_balls import TwoBalls

SlabBuilder = Callable[..., Elastomer]

# Coarse: the invariants hold on any grid.
COARSE = {"solver_pitch_mm": 0.25, "relief_pitch_mm": 0.05}


def to_depth(depth_mm: float, **pitches: float) -> Press:
    return Press.model_validate({"control": "depth", "depth_mm": depth_mm} | pitches)


def with_force(force_n: float, **pitches: float) -> Press:
    return Press.model_validate({"control": "force", "force_n": force_n} | pitches)


def gap_mm(pressed: PressedElastomer, specimen: Specimen, slab: Elastomer) -> NDArray[np.float64]:
    height = height_above_lowest(specimen, pressed.x_mm, pressed.y_mm)
    return pressed.touched_face_mm + slab.thickness_mm + height - pressed.depth_mm


@pytest.mark.parametrize("load", [to_depth(0.1, **COARSE), with_force(2.0, **COARSE)])
def test_a_specimen_between_the_cells_is_one_line(slab: SlabBuilder, load: Press) -> None:
    with pytest.raises(PressError, match="touches no cell of the solver's grid; are its sizes in"):
        press(Ball(diameter_mm=0.006), slab(), load)


def test_two_balls_press_symmetrically(slab: SlabBuilder) -> None:
    pressed = press(TwoBalls(), slab(length_x_mm=24), to_depth(0.8))
    for field in (pressed.pressure_kpa, pressed.face_z_mm):
        np.testing.assert_allclose(field, field[:, ::-1], atol=1e-5 * field.max())
        np.testing.assert_allclose(field, field[::-1], atol=1e-5 * field.max())


@pytest.mark.parametrize(("x_mm", "y_mm"), [(4.0, 0.0), (0.0, 4.0), (-4.0, 3.0)])
def test_the_bulge_lies_where_the_ball_is(slab: SlabBuilder, x_mm: float, y_mm: float) -> None:
    elastomer = slab(length_x_mm=24, thickness_mm=2)
    pressed = press(Ball(x_mm=x_mm, y_mm=y_mm), elastomer, to_depth(0.8, **COARSE))
    weight = pressed.pressure_kpa / pressed.pressure_kpa.sum()
    centre = (weight.sum(axis=0) @ pressed.x_mm, weight.sum(axis=1) @ pressed.y_mm)
    # The bent slab leans away from the middle and touches the ball on its outer side.
    assert centre == pytest.approx((x_mm, y_mm), abs=0.3)
    row, col = np.unravel_index(pressed.face_z_mm.argmax(), pressed.face_z_mm.shape)
    # The bent slab leans its summit towards the middle of the span.
    assert pressed.face_x_mm[col] == pytest.approx(x_mm, abs=1.0)
    assert pressed.face_y_mm[row] == pytest.approx(y_mm, abs=1.0)
    assert pressed.face_z_mm.max() > 0


def test_mirrored_specimens_give_mirrored_faces(slab: SlabBuilder) -> None:
    first, mirrored = (
        press(TwoBalls(yaw_deg=yaw, tilt_deg=tilt), slab(), to_depth(0.8, **COARSE))
        for yaw, tilt in ((30.0, 3.0), (150.0, 3.0))
    )
    np.testing.assert_allclose(first.face_z_mm, mirrored.face_z_mm[:, ::-1], atol=1e-5)


def test_the_lifted_ball_presses_harder(slab: SlabBuilder) -> None:
    pressed = press(TwoBalls(tilt_deg=2.0), slab(), to_depth(0.8, **COARSE))
    right = pressed.pressure_kpa[:, pressed.x_mm > 0].sum()
    assert right > 1.5 * pressed.pressure_kpa[:, pressed.x_mm < 0].sum()


def test_shape_does_not_depend_on_the_modulus_and_force_is_proportional(
    slab: SlabBuilder,
) -> None:
    soft, hard = (
        press(Ball(), slab(young_modulus_kpa=kpa), to_depth(0.6, **COARSE)) for kpa in (100, 250)
    )
    np.testing.assert_array_equal(soft.face_z_mm, hard.face_z_mm)
    assert hard.force_n == pytest.approx(2.5 * soft.force_n, rel=1e-12)


def test_force_grows_with_depth_and_softness_deepens_a_press_by_force(slab: SlabBuilder) -> None:
    forces = [press(Ball(), slab(), to_depth(d, **COARSE)).force_n for d in (0.3, 0.6, 0.9)]
    assert forces == sorted(forces)
    depths = [
        press(Ball(), slab(young_modulus_kpa=kpa), with_force(0.3, **COARSE)).depth_mm
        for kpa in (1000, 600)
    ]
    assert depths[0] < depths[1]


def test_hardness_sets_the_modulus_when_none_is_measured(slab: SlabBuilder) -> None:
    pressed = press(Ball(), slab(young_modulus_kpa=None), to_depth(0.5, **COARSE))
    assert pressed.young_modulus_kpa == pytest.approx(413, abs=1)  # Shore 10 A by Gent


def test_halving_the_solver_pitch_moves_the_face_by_less_than_a_micrometre(
    slab: SlabBuilder, reference_press: PressedElastomer
) -> None:
    fine = press(Ball(), slab(), to_depth(1.0, solver_pitch_mm=0.04))
    assert np.abs(fine.face_z_mm - reference_press.face_z_mm).max() < 1e-3
    assert fine.force_n == pytest.approx(reference_press.force_n, rel=1e-3)


def test_relief_grid_covers_the_slab_to_its_rim(reference_press: PressedElastomer) -> None:
    pressed = reference_press
    assert pressed.face_z_mm.shape == (pressed.face_y_mm.size, pressed.face_x_mm.size)
    assert (pressed.face_x_mm[0], pressed.face_x_mm[-1]) == (-10, 10)
    assert np.diff(pressed.face_x_mm).max() <= 0.04 + 1e-12
    for rim in (pressed.face_z_mm[0], pressed.face_z_mm[:, -1]):
        assert not rim.any()
    assert pressed.pressure_kpa.shape == (pressed.y_mm.size, pressed.x_mm.size)
    assert np.diff(pressed.x_mm).max() <= 0.08 + 1e-12


def test_back_pressure_drapes_the_sheet_between_two_balls(slab: SlabBuilder) -> None:
    elastomer = slab(thickness_mm=2, length_x_mm=24)
    plain, draped = (
        press(TwoBalls(), elastomer, to_depth(0.8, back_pressure_kpa=kpa, **COARSE))
        for kpa in (0.0, 30.0)
    )
    middle, apex = (
        [np.interp(x, p.face_x_mm, p.face_z_mm[p.face_y_mm.size // 2]) for p in (plain, draped)]
        for x in (0.0, 4.0)
    )
    assert middle[0] > apex[0]  # without it the slab bends into one hump
    assert middle[1] < apex[1] - 0.2
    gap = gap_mm(draped, TwoBalls(), elastomer)
    assert gap.min() >= -1e-4
    assert draped.force_n > plain.force_n


def test_a_free_slab_sags_under_its_weight(slab: SlabBuilder) -> None:
    """Square plate on supports: 0.00406 rho g h a^4 / D; h 2, E 50 kPa: 0.31 mm."""
    elastomer = slab(thickness_mm=1, young_modulus_kpa=200.0, density_kg_m3=1070.0)
    weight_kpa, bending = 1070 * 9.80665 * 1e-6, 200.0 / (12 * (1 - 0.49**2))
    expected = 0.00406 * weight_kpa * 20**4 / bending
    for angle, sign in ((0.0, -1.0), (180.0, 1.0), (60.0, -0.5)):
        load = to_depth(0.01, gravity_deg=angle, solver_pitch_mm=0.1, relief_pitch_mm=0.05)
        # A small ball in the corner, where it hardly moves the middle.
        far = press(Ball(diameter_mm=1, x_mm=9.4, y_mm=9.4), elastomer, load)
        middle = far.face_z_mm[far.face_y_mm.size // 2, far.face_x_mm.size // 2]
        assert middle == pytest.approx(sign * expected, rel=0.02)


def test_a_sagging_slab_meets_the_ball_earlier(slab: SlabBuilder) -> None:
    elastomer = slab(thickness_mm=2, young_modulus_kpa=50.0, density_kg_m3=1070.0)
    forces = [
        press(Ball(diameter_mm=2), elastomer, to_depth(0.4, gravity_deg=angle)).force_n
        for angle in (0.0, 90.0, 180.0)
    ]
    assert forces[0] > forces[1] > forces[2] > 0
    plain = press(Ball(diameter_mm=2), elastomer, to_depth(0.4))
    assert forces[1] == pytest.approx(plain.force_n, rel=1e-6)


def test_validity_of_the_reference_press_has_no_warning(
    reference_press: PressedElastomer,
) -> None:
    validity = reference_press.validity
    assert validity.warnings == ()
    assert validity.depth_over_thickness == validity.depth_over_radius == 0.25
    # Neo-Hookean reference: the face's peak errs by 17 to 20 um.
    assert validity.height_error_mm == pytest.approx(0.02, abs=0.005)
    assert 8 < validity.margin_mm < 9.5


def test_a_harsh_press_is_flagged(slab: SlabBuilder) -> None:
    elastomer = slab(thickness_mm=2.0)
    pressed = press(Ball(x_mm=7, diameter_mm=4), elastomer, to_depth(1.2, **COARSE))
    said = " ".join(pressed.validity.warnings)
    for part in ("of the thickness", "of the ball's radius", "rim", "cells wide"):
        assert part in said
    assert pressed.validity.height_error_mm > 0.04


def test_a_mesh_wider_than_the_slab_is_refused_in_one_line(
    slab: SlabBuilder, tmp_path: Path
) -> None:
    path = tmp_path / "plate.stl"
    trimesh.creation.box((30, 5, 2)).export(path)
    with pytest.raises(PressError, match="reaches from -15 to 15 mm along x") as caught:
        press(MeshFile(file=str(path)), slab(), to_depth(0.5))
    assert "\n" not in str(caught.value)
    narrow = press(MeshFile(file=str(path), scale=0.4), slab(), to_depth(0.3, **COARSE))
    assert narrow.force_n > 0


@pytest.mark.parametrize("nu", [0.5, 0.6])
def test_an_incompressible_slab_is_refused(slab: SlabBuilder, nu: float) -> None:
    with pytest.raises(ValidationError, match=r"less than 0\.5"):
        slab(poisson_ratio=nu)


@pytest.mark.parametrize(
    ("specimen", "changes", "load", "message"),
    [
        (TwoBalls(), {"length_x_mm": 14.0}, to_depth(0.5), "length_x_mm"),
        (Ball(y_mm=7.0), {}, to_depth(0.5), "length_y_mm"),
        (Ball(y_mm=70.0), {}, to_depth(0.5), "move the specimen"),
        (Ball(), {"thickness_mm": 1.0}, to_depth(1.0), "thickness of 1 mm"),
        (Ball(), {}, with_force(50.0, **COARSE), "50 N needs a depth of"),
        (Ball(), {}, to_depth(1e-5), "solver_pitch_mm"),
        (Ball(diameter_mm=0.1), {}, with_force(0.01, **COARSE), "touches no cell .* than 0.25"),
        (Ball(), {"thickness_mm": 0.02}, to_depth(0.01), "300 times the thickness"),
        (Ball(), {}, to_depth(0.5, gravity_deg=0.0), "density_kg_m3: missing"),
        (
            Ball(),
            {"layout": "contact_face"},
            to_depth(0.5, back_pressure_kpa=1.0),
            "layout = 'opposite_face'",
        ),
        # The air bulges the slab down on the ball: it once "travelled" by minus some millimetres.
        (
            Ball(),
            {"thickness_mm": 1.5},
            with_force(1e-3, back_pressure_kpa=3.0, **COARSE),
            r"press\.force_n: 0\.001 N is reached .* mm before .* lower press\.back_pressure_kpa",
        ),
        (
            Ball(),
            {"length_x_mm": 1000.0, "length_y_mm": 1000.0},
            to_depth(0.5),
            r"press\.relief_pitch_mm: found 0\.025 on 1000 x 1000 mm, .* a pitch of 0\.22 or more",
        ),
        (
            Ball(),
            {"length_x_mm": 100.0, "length_y_mm": 100.0},
            to_depth(0.5, solver_pitch_mm=0.01, relief_pitch_mm=0.05),
            r"press\.solver_pitch_mm: found 0\.01 on 100 x 100 mm, .* allowed up to 2e\+07",
        ),
        (Rod(length_mm=21), {}, to_depth(0.5), "move the specimen"),
        (Group(parts={"far": Ball(x_mm=12)}), {}, to_depth(0.5), "length_x_mm"),
        (
            Ball(diameter_mm=2),
            {"thickness_mm": 8},
            to_depth(3.0, **COARSE),
            "widest outline",
        ),
    ],
)
def test_impossible_presses_are_refused_in_one_line(
    slab: SlabBuilder, specimen: Specimen, changes: dict[str, float], load: Press, message: str
) -> None:
    with pytest.raises(PressError, match=message) as caught:
        press(specimen, slab(**changes), load)
    assert "\n" not in str(caught.value)
