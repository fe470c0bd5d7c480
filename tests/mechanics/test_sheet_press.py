"""The sheet model through the experiment's interface: poses, loads, limits, results."""

import re
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator

from tests.mechanics.sheets import build_sheet, pressed
from twin.config.models import Elastomer, Mechanics, Press, Texture
from twin.mechanics import PressedElastomer, PressError, read_press, write_press
from twin.mechanics.errors import SolverError
from twin.mechanics.press import SheetFields
from twin.mechanics.sheet import press
from twin.mechanics.sheet.energy import SheetState
from twin.mechanics.sheet.linear_solver import Banded, NestedDissection, Pardiso, has_pardiso
from twin.mechanics.sheet.path import Loads
from twin.mechanics.texture import textured
from twin.specimens.kinds.ball import Ball
from twin.specimens.kinds.bar import Bar
from twin.specimens.kinds.grating import Grating
from twin.specimens.kinds.group import Group

SMALL = {"length_x_mm": 10.0, "length_y_mm": 10.0}
TINY = {"length_x_mm": 6.0, "length_y_mm": 6.0}
MARBLE = Ball(diameter_mm=4.0)


@pytest.fixture(scope="module")
def wrapped() -> PressedElastomer:
    """A ball of R 4 in a small sheet under 1 kPa."""
    return pressed(Ball(), build_sheet(**SMALL), depth_mm=0.8, back_pressure_kpa=1.0)


def arrays_of(pressed: PressedElastomer | SheetFields) -> dict[str, np.ndarray]:
    values = {field.name: getattr(pressed, field.name) for field in fields(pressed)}
    return {name: value for name, value in values.items() if isinstance(value, np.ndarray)}


def test_a_stretched_sheet_lies_at_zero_and_is_touched_at_once() -> None:
    """Its mounted thickness is h / s^2: z = 0 and travel 0 count from there."""
    done = pressed(MARBLE, build_sheet(**TINY, pre_stretch=1.2), depth_mm=0.02)
    assert np.abs(done.face_z_mm[[0, -1]]).max() < 1e-5
    assert 0.005 < done.face_z_mm.max() < 0.02
    assert done.force_n > 1e-4


def test_where_it_wraps_the_lower_face_is_the_ball(wrapped: PressedElastomer) -> None:
    """And the coat is one local thickness above it."""
    x, y = np.meshgrid(wrapped.x_mm, wrapped.y_mm)
    near = np.hypot(x, y) < 1.2
    assert wrapped.contact[near].all()
    centre = wrapped.depth_mm - 0.3 - 4.0
    radius = np.sqrt(x**2 + y**2 + (wrapped.touched_face_mm - centre) ** 2)[near]
    np.testing.assert_allclose(radius, 4.0, atol=3e-3)
    at_x, at_y = np.meshgrid(wrapped.face_x_mm, wrapped.face_y_mm)
    over = np.sqrt(at_x**2 + at_y**2 + (wrapped.face_z_mm - centre) ** 2)
    middle = np.hypot(at_x, at_y) < 1.2
    sheet = wrapped.sheet
    assert sheet is not None
    np.testing.assert_allclose(over[middle], 4.0 + sheet.thickness_mm[middle], atol=4e-3)
    # Incompressible: the thickness is 1 over the product of the stretches.
    product = sheet.thickness_mm * sheet.stretch.prod(axis=-1)
    np.testing.assert_allclose(product, 0.3, rtol=2e-5)


def force_of_pressure_n(pressed: PressedElastomer) -> float:
    """Return the integral of the pressure over the touched face in plan."""
    cell_mm2 = float(np.diff(pressed.x_mm)[0] * np.diff(pressed.y_mm)[0])
    return 1e-3 * float(pressed.pressure_kpa.sum()) * cell_mm2


def test_the_pressure_on_the_touched_face_is_the_force(wrapped: PressedElastomer) -> None:
    """And on the ball it is even, because air and tension press uniformly on it."""
    assert force_of_pressure_n(wrapped) == pytest.approx(wrapped.force_n, rel=1e-3)
    x, y = np.meshgrid(wrapped.x_mm, wrapped.y_mm)
    inner = wrapped.pressure_kpa[np.hypot(x, y) < 1.0]
    assert inner.std() < 0.1 * inner.mean()


def test_pressure_along_an_edge_is_no_less_than_the_force() -> None:
    """On a sharp bar lines of contact, narrower than a solver's cell, carry most of it."""
    bar = Bar(width_mm=1.5, height_mm=1.5, length_mm=3.0, edge_radius_mm=0.05)
    done = pressed(
        bar, build_sheet(thickness_mm=0.15, **TINY), depth_mm=0.4, cell_mm=0.2, solver_pitch_mm=0.2
    )
    assert force_of_pressure_n(done) == pytest.approx(done.force_n, rel=0.01)


def test_a_centred_ball_gives_a_symmetric_sheet(wrapped: PressedElastomer) -> None:
    # Near the rim the face is steep, and the triangles between its samples are not symmetric.
    face = wrapped.face_z_mm[30:-30, 30:-30]
    for mirrored in (face[::-1], face[:, ::-1], face.T):
        np.testing.assert_allclose(face, mirrored, atol=5e-4)
    sheet = wrapped.sheet
    assert sheet is not None
    at_x, at_y = (
        positions[30:-30, 30:-30] for positions in (sheet.material_x_mm, sheet.material_y_mm)
    )
    np.testing.assert_allclose(at_x, -at_x[:, ::-1], atol=1e-4)
    np.testing.assert_allclose(at_x, at_y.T, atol=1e-4)


def test_a_turned_specimen_gives_the_turned_face() -> None:
    """A bar off the middle; a turn by 90 deg about z moves the point (x, y) to (-y, x)."""
    size = {"width_mm": 2.0, "length_mm": 4.0, "edge_radius_mm": 0.3}
    straight, turned = (
        pressed(
            Bar(x_mm=x, y_mm=y, yaw_deg=yaw, **size), build_sheet(**SMALL), depth_mm=0.4
        ).face_z_mm[1:-1, 1:-1]
        for x, y, yaw in ((1.0, 0.5, 0.0), (-0.5, 1.0, 90.0))
    )
    np.testing.assert_allclose(turned, straight[::-1].T, atol=5e-4)
    assert np.abs(straight - straight[:, ::-1]).max() > 0.05


def test_the_modulus_only_scales_the_force() -> None:
    soft, hard = (
        pressed(MARBLE, build_sheet(young_modulus_kpa=modulus, **TINY), depth_mm=0.3)
        for modulus in (100.0, 1000.0)
    )
    assert hard.force_n == pytest.approx(10 * soft.force_n, rel=1e-4)
    np.testing.assert_allclose(hard.face_z_mm, soft.face_z_mm, atol=2e-5)


def test_a_force_finds_its_travel() -> None:
    elastomer = build_sheet(**TINY)
    deep = pressed(MARBLE, elastomer, depth_mm=0.35)
    result = pressed(MARBLE, elastomer, force_n=deep.force_n)
    assert result.depth_mm == pytest.approx(0.35, rel=2e-3)
    assert result.force_n == pytest.approx(deep.force_n, rel=1e-3)


def test_a_clamp_holds_the_slope_at_the_rim() -> None:
    clamped, simple = (
        pressed(MARBLE, build_sheet(**TINY), support, depth_mm=0.3)
        for support in ("clamped", "simple")
    )
    rise = [press.face_z_mm[60, 1] - press.face_z_mm[60, 0] for press in (clamped, simple)]
    assert 0 < rise[0] < 0.5 * rise[1]
    assert clamped.force_n > simple.force_n


def test_above_the_limit_pressure_the_largest_stable_pressure_is_named() -> None:
    elastomer = build_sheet(young_modulus_kpa=30.0, **TINY)
    with pytest.raises(PressError, match=r"^press\.back_pressure_kpa: the sheet is ") as caught:
        pressed(MARBLE, elastomer, depth_mm=0.4, back_pressure_kpa=25.0)
    assert "\n" not in str(caught.value)
    stable_kpa = float(re.findall(r"stable up to ([0-9.]+) kPa", str(caught.value))[0])
    assert 0 < stable_kpa < 25
    result = pressed(MARBLE, elastomer, depth_mm=0.4, back_pressure_kpa=stable_kpa)
    assert result.face_z_mm.max() < 0.4


@pytest.mark.parametrize(("holding_kpa", "named_kpa"), [(0.3, 0.25), (0.2, 0.1), (0.05, 0.0)])
def test_low_pressures_are_tried_if_no_load_step_is_stable(
    monkeypatch: pytest.MonkeyPatch, holding_kpa: float, named_kpa: float
) -> None:
    """Setup: a sheet that is too thin above a pressure below the first load step of 0.5 kPa."""
    load = Press(control="depth", depth_mm=0.4, back_pressure_kpa=2.0)
    path = press._path(MARBLE, build_sheet(), load, Mechanics(model="sheet"))

    def check(_sheet: object, state: SheetState, _least: float = 0.2) -> None:
        if state.pressure_kpa > holding_kpa:
            raise SolverError("thins")

    monkeypatch.setattr(press, "check_thickness", check)
    assert press._held_kpa(path, [], Loads(0.4, 2.0)) == named_kpa


@pytest.mark.parametrize(
    ("friction", "tack", "sticks"),
    [("auto", 0.0, False), ("auto", 0.2, True), ("none", 0.2, False), ("stick", 0.0, True)],
)
def test_auto_friction_sticks_where_there_is_tack(friction: str, tack: float, sticks: bool) -> None:
    assert build_sheet(friction=friction, tack_j_m2=tack).sticks is sticks


def test_tack_widens_the_contact() -> None:
    elastomer = build_sheet(thickness_mm=0.15, **TINY)
    dry, tacky = (
        pressed(MARBLE, elastomer.model_copy(update=keys), depth_mm=0.6, cell_mm=0.15)
        for keys in ({}, {"tack_j_m2": 0.2})
    )

    def covered(press: PressedElastomer) -> float:
        x, y = np.meshgrid(press.x_mm, press.y_mm)
        centre = press.depth_mm - 0.15 - 2.0
        return float(np.mean(np.sqrt(x**2 + y**2 + (press.touched_face_mm - centre) ** 2) < 2.02))

    assert covered(tacky) > 1.3 * covered(dry)
    # Its rim is pulled, and the part that sticks carries a share along the face.
    assert tacky.pressure_kpa.min() < 0
    assert force_of_pressure_n(tacky) == pytest.approx(tacky.force_n, rel=0.01)


@pytest.mark.parametrize("friction", ["none", "stick"])
def test_the_same_press_gives_the_same_bytes(friction: str) -> None:
    elastomer = build_sheet(friction=friction, length_x_mm=6.0, length_y_mm=7.0)
    first, second = (
        pressed(Ball(diameter_mm=4.0, x_mm=0.7), elastomer, depth_mm=0.4) for _ in range(2)
    )
    for name, value in arrays_of(first).items():
        assert value.tobytes() == getattr(second, name).tobytes(), name
    assert first.sheet is not None
    for name, value in arrays_of(first.sheet).items():
        assert value.tobytes() == getattr(second.sheet, name).tobytes(), name
    assert first.force_n == second.force_n


def test_a_sheet_comes_back_whole(wrapped: PressedElastomer, tmp_path: Path) -> None:
    write_press(tmp_path / "press.nc", wrapped)
    back = read_press(tmp_path / "press.nc")
    assert (back.model, back.validity, back.force_n) == ("sheet", wrapped.validity, wrapped.force_n)
    assert wrapped.sheet is not None
    for name, value in (arrays_of(wrapped) | arrays_of(wrapped.sheet)).items():
        result = getattr(back if hasattr(back, name) else back.sheet, name)
        np.testing.assert_array_equal(result, value, strict=True)


def test_texture_moves_with_the_sheet(wrapped: PressedElastomer) -> None:
    """The coat's height at a node is that of the flat coat at the material point there."""
    elastomer, load = build_sheet(**SMALL), Press(control="depth", depth_mm=0.8)
    texture = Texture(rms_um=10.0, correlation_mm=0.4)
    assert wrapped.sheet is not None
    X, Y = np.meshgrid(wrapped.face_x_mm, wrapped.face_y_mm)
    here = replace(wrapped.sheet, material_x_mm=X, material_y_mm=Y)
    flat = replace(wrapped, face_z_mm=np.zeros_like(X), sheet=here)
    added = [textured(press, elastomer, load, texture, 7).texture_mm for press in (flat, wrapped)]
    places = np.stack((wrapped.sheet.material_y_mm, wrapped.sheet.material_x_mm), axis=-1)
    table = RegularGridInterpolator(
        (wrapped.face_y_mm, wrapped.face_x_mm), added[0], "cubic", bounds_error=False
    )
    carried = table(places)
    level = np.hypot(X, Y) < 0.5  # elsewhere the slope counts too
    np.testing.assert_allclose(added[1][level], carried[level], rtol=0.03, atol=2e-4)
    moved = np.hypot(places[..., 1] - X, places[..., 0] - Y)
    assert moved.max() > 0.05


@pytest.mark.parametrize(
    ("changes", "load", "message"),
    [
        ({"thickness_mm": 1.2}, {}, r"elastomer\.thickness_mm: found 1\.2, .* 0\.05 to 1"),
        ({"layout": "contact_face"}, {}, r"elastomer\.layout: "),
        ({"film": {"thickness_mm": 0.1, "young_modulus_kpa": 1e3}}, {}, r"elastomer\.film: "),
        ({"length_x_mm": 6.0}, {}, r"specimen: reaches from -4 to 4 mm along x"),
        ({}, {"gravity_deg": 0.0}, r"elastomer\.density_kg_m3: missing"),
        # 100 kPa of shear modulus, 0.3 mm.
        ({"tack_j_m2": 30.1}, {}, r"elastomer\.tack_j_m2: found 30\.1, allowed up to 30, shear"),
        (
            {"length_x_mm": 1000.0, "length_y_mm": 45.0},
            {},
            r"elastomer\.length_x_mm, length_y_mm: found 1000 and 45, .* allowed up to 40000: ",
        ),
        (
            {"length_x_mm": 1000.0, "length_y_mm": 100.0},
            {"relief_pitch_mm": 0.02},
            r"press\.relief_pitch_mm: found 0\.02 on 1000 x 100 mm, ",
        ),
    ],
)
def test_what_a_sheet_cannot_be_is_one_line(changes: dict, load: dict, message: str) -> None:
    with pytest.raises(PressError, match=f"^{message}") as caught:
        pressed(Ball(), build_sheet(**changes), depth_mm=0.3, **load)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("force_n", "message"),
    [
        # Along a rigid rim no line carries more than 5 mu h: 24 mm x 5 x 0.1 MPa x 0.3 mm, and the
        # air on 36 mm^2.
        (100.0, r"found 100 N, allowed up to 3\.64 N, which tears a sheet of 0\.3 mm"),
        (1e-4, r"0\.0001 N is less than the .* N with which air of 1 kPa presses the sheet on"),
    ],
)
def test_a_force_that_no_travel_gives_is_refused(force_n: float, message: str) -> None:
    """The first was searched for in 40 steps; the second was to be lowered still more."""
    with pytest.raises(PressError, match=rf"^press\.force_n: {message}") as caught:
        pressed(MARBLE, build_sheet(**TINY), force_n=force_n, back_pressure_kpa=1.0)
    assert "\n" not in str(caught.value)


def test_progress_goes_on_from_the_first_load_step_to_the_last() -> None:
    """Also during the search of the travel for a force."""
    shares: list[float] = []
    press.press_sheet(
        MARBLE,
        build_sheet(**TINY),
        Press(control="force", force_n=0.02, relief_pitch_mm=0.05, cell_mm=0.3),
        Mechanics(model="sheet"),
        shares.append,
    )
    assert shares == sorted(shares)
    assert len(set(shares)) > 4
    assert shares[-1] == 1.0


def test_the_press_does_not_depend_on_the_solver(monkeypatch: pytest.MonkeyPatch) -> None:
    result = []
    for kind in (Banded, NestedDissection, *([Pardiso] if has_pardiso() else [])):
        monkeypatch.setattr("twin.mechanics.sheet.energy.linear_solver", kind)
        result.append(pressed(MARBLE, build_sheet(**TINY), depth_mm=0.4))
    for other in result[1:]:
        np.testing.assert_allclose(result[0].face_z_mm, other.face_z_mm, atol=1e-6)


def test_a_round_frame_is_as_wide_all_round() -> None:
    result = pressed(Ball(), build_sheet(outline="round", **SMALL), depth_mm=0.4)
    x, y = np.meshgrid(result.face_x_mm, result.face_y_mm)
    r = np.hypot(x, y)
    ring = (r > 3.975) & (r < 4.025)
    # The slope there is about 0.1: heights differ by the width of the ring.
    expected = np.polynomial.Polynomial.fit(r[ring], result.face_z_mm[ring], 2)(r[ring])
    assert np.abs(result.face_z_mm[ring] - expected).max() < 5e-4
    assert (result.face_z_mm[r > 5.0] == 0).all()


def test_elastomers_round_or_stretched_are_checked() -> None:
    with pytest.raises(ValueError, match="round opening needs length_x_mm = length_y_mm"):
        build_sheet(outline="round", length_x_mm=10.0)
    assert Elastomer.model_fields["pre_stretch"].default == 1.0


@pytest.mark.parametrize(("pitch_mm", "warned"), [(0.9, True), (1.1, False)])
def test_ridges_finer_than_five_thicknesses_are_reported(pitch_mm: float, warned: bool) -> None:
    grating = Grating(pitch_mm=pitch_mm, groove_mm=0.01, length_x_mm=3.0, length_y_mm=3.0)
    group = Group(parts={"ball": Ball(x_mm=5.0), "grating": grating})
    assert group.finest_pitch_mm == pitch_mm
    assert Ball().finest_pitch_mm is None
    result = pressed(grating, build_sheet(thickness_mm=0.2, **TINY), depth_mm=0.1)
    assert any("--transfer" in text for text in result.validity.warnings) is warned
