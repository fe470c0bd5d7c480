"""Sheets as cast: a thickness field against closed forms, limits and its plain sheet."""

import json
from dataclasses import replace
from pathlib import Path

import imageio.v3 as imageio
import numpy as np
import pytest
from scipy.optimize import brentq

from reconstruction.errors import InputError
from reconstruction.netcdf import LabelledArrays, write_arrays
from tests.mechanics.sheets import EXACT, NOTHING, ball, build_sheet, laws, line, pressed, strip
from twin import vary
from twin.config import digest, load_experiment
from twin.config.models import Elastomer, Mechanics, Press
from twin.config.sensor_layer import SensorLayer, sensor_layer_of
from twin.mechanics.errors import PressError
from twin.mechanics.models import MODELS, PressInput
from twin.mechanics.press import PressedElastomer
from twin.mechanics.sheet.energy import Sheet
from twin.mechanics.sheet.equilibrium import settle
from twin.mechanics.sheet.faces import sample
from twin.mechanics.sheet.grid import Frame, sheet_grid
from twin.mechanics.sheet.neighbour import Neighbourhood
from twin.mechanics.sheet.path import mounted
from twin.mechanics.sheet.press import SettledSheet, settled_sheet
from twin.mechanics.sheet.rim import rim_springs
from twin.mechanics.sheet.thickness import SheetThickness, sheet_thickness
from twin.specimens.kinds.ball import Ball
from twin.specimens.kinds.flat import Flat

SMALL = {"length_x_mm": 10.0, "length_y_mm": 10.0}


def wedge(slope: float = 0.0, more_mm: float = 0.0) -> SheetThickness:
    """Return a field that increases along X, and is larger by `more_mm` everywhere."""
    return SheetThickness(None, (slope, 0.0), None, -more_mm)


# ---- the field -------------------------------------------------------------------------------


def sampled_um(half_mm: float = 5.0, **table: object) -> np.ndarray:
    """Return the deviation on a grid over a sheet of SMALL, um; rows along y."""
    field = sheet_thickness(build_sheet(thickness_field=table, **SMALL))
    X, Y = np.meshgrid(*2 * [np.linspace(-half_mm, half_mm, 201)])
    return 1e3 * field.deviation_mm(X, Y)


def test_waves_have_their_rms_and_no_mean_on_each_sheet() -> None:
    first, second = (sampled_um(rms_um=3.0, correlation_mm=1.0, seed=n) for n in (1, 2))
    for waves in (first, second):
        assert waves.std() == pytest.approx(3.0, rel=0.01)
        assert abs(waves.mean()) < 0.03
    assert abs(np.corrcoef(first.ravel(), second.ravel())[0, 1]) < 0.5
    np.testing.assert_array_equal(first, sampled_um(rms_um=3.0, correlation_mm=1.0, seed=1))
    np.testing.assert_allclose(
        2 * first, sampled_um(rms_um=6.0, correlation_mm=1.0, seed=1), atol=1e-9
    )


def test_waves_have_their_correlation_length() -> None:
    table = {"rms_um": 1.0, "correlation_mm": 0.5}
    sheet = build_sheet(length_x_mm=60.0, length_y_mm=60.0, thickness_field=table)
    X, Y = np.meshgrid(*2 * [np.arange(-29.0, 29.0, 0.25)])
    waves = sheet_thickness(sheet).deviation_mm(X, Y)
    lagged = (waves[:, :-2] * waves[:, 2:]).mean() / waves.var()
    # 116^2 areas of one length: the standard deviation of the correlation is below 0.01.
    assert lagged == pytest.approx(np.exp(-1), abs=0.03)


def test_a_wedge_gets_thicker_in_its_direction() -> None:
    along = sampled_um(slope_um_per_mm=2.0, slope_deg=90.0)
    np.testing.assert_allclose(along[:, 0], np.linspace(-10, 10, 201), atol=1e-9)
    np.testing.assert_allclose(along, along[:, :1].repeat(201, axis=1), atol=1e-9)


@pytest.mark.parametrize("kind", ["npy", "png", "nc"])
def test_a_measured_map_comes_back(kind: str, tmp_path: Path) -> None:
    x, y = (np.arange(n) * 0.1 - 5.0 for n in (101, 101))
    levels = np.round(1e4 * (0.3 + 2e-3 * x + 1e-3 * y[::-1, None])).astype(np.uint16)
    file, table = str(tmp_path / f"map.{kind}"), {"unit_mm": 1e-4}
    if kind == "npy":
        np.save(file, levels)
    elif kind == "png":
        imageio.imwrite(file, levels)
    else:
        arrays = {"h": (("y", "x"), levels * 0.1, {"units": "um"})}
        write_arrays(Path(file), LabelledArrays(arrays, {}))
        table = {"unit_mm": 1e-3, "variable": "h"}
    read = sampled_um(file=file, pixel_mm=0.1, **table)
    place = np.linspace(-5.0, 5.0, 201)
    # Rounded to 0.1 um, with its mean removed.
    np.testing.assert_allclose(read, 2 * place + place[:, None], atol=0.11)


@pytest.mark.parametrize(
    ("table", "expected"),
    [
        ({"rms_um": 100.0}, "0.15 to 0.45 mm, 0.5 to 1.5 x thickness_mm"),
        ({"slope_um_per_mm": 40.0}, "is 0.1 to 0.5 mm thick"),
        ({"file": "none.npy", "pixel_mm": 0.1}, "thickness_field.file: none.npy: found no file"),
    ],
)
def test_a_sheet_that_cannot_be_is_refused(table: dict, expected: str) -> None:
    with pytest.raises(InputError, match=expected):
        sheet_thickness(build_sheet(thickness_field=table, **SMALL))


def test_a_map_smaller_than_the_sheet_is_refused(tmp_path: Path) -> None:
    np.save(tmp_path / "map.npy", np.full((80, 100), 0.3))
    table = {"file": str(tmp_path / "map.npy"), "pixel_mm": 0.1}
    with pytest.raises(PressError, match=r"covers 10 x 8 mm, needed 10 x 10 mm"):
        sheet_thickness(build_sheet(thickness_field=table, **SMALL))
    cut = build_sheet(thickness_field=table, pre_stretch=1.25, **SMALL)
    assert sheet_thickness(cut) is not None


def test_every_pixel_of_a_map_counts(tmp_path: Path) -> None:
    """Setup: pixels of 0.02 mm, finer than other samples; a map of two pixels per side.

    Expected: one pixel of 0.02 mm is an error; stripes of 50 um have the mean 0 on the sheet.
    """

    def read_um(map_mm: np.ndarray, pixel_mm: float) -> np.ndarray:
        np.save(tmp_path / "map.npy", map_mm)
        return sampled_um(file=str(tmp_path / "map.npy"), pixel_mm=pixel_mm)

    stripes = 0.3 + 0.05 * np.cos(2 * np.pi * np.arange(501) / (500 / 128)) * np.ones((501, 1))
    # 1 % of the amplitude: samples on both edges of the sheet count as whole ones.
    assert abs(read_um(stripes, 0.02).mean()) < 0.5
    assert np.ptp(read_um(np.array([[0.3, 0.32], [0.3, 0.32]]), 20.0)) == pytest.approx(10.0)
    stripes[231, 262] = 0.02
    with pytest.raises(PressError, match=r"the sheet is 0\.0199 to"):
        read_um(stripes, 0.02)


@pytest.mark.parametrize("model", ["spectral", "neo_hookean", "fem"])
def test_models_of_a_slab_refuse_a_field(model: str) -> None:
    mechanics, load = Mechanics(model=model), Press(control="depth", depth_mm=0.1)
    case = PressInput(mechanics, Ball(), build_sheet(thickness_field={"rms_um": 1.0}), load)
    with pytest.raises(PressError, match=rf"\[elastomer.thickness_field\], which the {model}"):
        MODELS[model].check(case)


def test_a_pad_from_cad_refuses_the_field_but_no_other_key_of_a_sheet() -> None:
    sheet = build_sheet(thickness_field={"rms_um": 1.0}, friction="stick")
    case = PressInput(Mechanics(model="fem"), Ball(), sheet, Press(control="depth", depth_mm=0.1))
    with pytest.raises(PressError, match=r"^elastomer\.thickness_field: found the table"):
        MODELS["fem"].check(case)


def test_only_experiments_with_a_field_have_another_digest() -> None:
    plain = load_experiment("examples/wrapped_balls")
    cast = vary(plain, {"elastomer.thickness_field.rms_um": 2.0})
    assert "thickness_field" not in json.dumps(plain.model_dump(mode="json"))
    assert cast.elastomer.thickness_field.rms_um == 2.0
    assert digest(cast) != digest(plain)


# ---- the solver ------------------------------------------------------------------------------


def test_a_constant_deviation_is_a_sheet_of_another_thickness() -> None:
    """Energy, forces, pressure of contact and stick, weight and faces: the same to rounding."""
    changes = {"tack": 0.1, "tack_range_mm": 0.1}
    thick, thin = (laws(h, weight_kpa=-0.1 * h, **changes) for h in (0.32, 0.3))
    grid = sheet_grid(Frame(6.0, 6.0, pre_stretch=1.1), *2 * [line(2.7, 1.0, 0.3)])
    plain = Sheet(grid, thick, ball(), -0.15, sticks=True)
    field = Sheet(grid.with_thickness(wedge(more_mm=0.02)), thin, ball(), -0.15, sticks=True)
    bumps = np.random.default_rng(1).normal(scale=0.01, size=grid.free.shape) * grid.free
    state = replace(mounted(grid), control_mm=grid.mounted_mm + bumps, travel_mm=0.3)
    seen = []
    for sheet in (plain, field):
        gripped = sheet.regripped(state)
        assert gripped.grip.held.sum() > 10
        moved = replace(gripped, control_mm=gripped.control_mm + 0.1 * bumps[::-1])
        energy = sheet.evaluate(moved.control_mm, moved, tangent=True).energy
        seen.append((energy, sheet._forces.copy(), sheet._tangent.copy(), sheet.thickness_ratio))
    assert seen[1][0] == pytest.approx(seen[0][0], rel=1e-12)
    for one, other in zip(seen[0][1:3], seen[1][1:3], strict=True):
        np.testing.assert_allclose(other, one, atol=1e-11 * np.abs(one).max())
    for name in ("upper_mm", "lower_mm", "thickness_mm"):
        faces = [getattr(sample(sheet, state, 0.1), name) for sheet in (plain, field)]
        np.testing.assert_allclose(faces[1], faces[0], atol=1e-12)


def test_a_membrane_of_linear_thickness_is_its_closed_form() -> None:
    """A pre-stretched strip in plane strain: mu h (l - 1 / (l^3 s^2)) is the same at every X."""
    stretch, slope, mean_mm, half_mm = 1.2, 0.012, 0.3, 10.0 / 1.2
    plain = strip(laws(mean_mm), NOTHING, line(half_mm, half_mm, 0.25))
    frame = Frame(20.0, 3600.0, pre_stretch=stretch)
    grid = sheet_grid(frame, plain.grid.x, plain.grid.y).with_thickness(wedge(slope))
    sheet = Sheet(replace(grid, free=plain.grid.free), laws(mean_mm), NOTHING, -mean_mm / 2)
    state = settle(sheet, mounted(sheet.grid), EXACT)

    X, weights = np.polynomial.legendre.leggauss(40)
    X, weights = half_mm * X, half_mm * weights

    def stretch_at(tension: float, X_mm: float) -> float:
        pull = tension / (mean_mm + slope * X_mm)
        return brentq(lambda s: s - 1 / (s**3 * stretch**2) - pull, 0.5, 5.0, xtol=1e-13)

    def length(tension: float) -> float:
        return float(weights @ [stretch_at(tension, at) for at in X])

    tension = brentq(lambda pull: length(pull) - 20.0, 0.01, 0.3, xtol=1e-13)
    places = np.linspace(-half_mm, half_mm, 9)
    solved = sheet.grid.evaluate(state.control_mm, places, np.zeros(1))[0]
    expected = [stretch_at(tension, at) for at in places]
    assert expected[0] - expected[-1] > 0.2
    np.testing.assert_allclose(solved[1:-1, 1, 0], expected[1:-1], rtol=2e-4)
    np.testing.assert_allclose(solved[:, 0, 2], 0.0, atol=1e-9)
    # Reaction of the west edge per length: mu h (l - 1 / (l^3 s^2)), kPa mm.
    sheet.evaluate(state.control_mm, state, tangent=False)
    pulled = -sheet._forces[:, 0, 0].sum() / (3600.0 / stretch)
    assert pulled == pytest.approx(100.0 * tension, rel=1e-4)


def test_over_a_flat_face_the_coat_is_the_local_thickness_out() -> None:
    """Air presses a wedge on a punch: h(X) times thinning, less the contact's compression."""
    air_kpa, slope_um = 4.0, 10.0
    field = {"slope_um_per_mm": slope_um, "slope_deg": 0.0}
    sheet = build_sheet(thickness_field=field, **SMALL)
    over = pressed(Flat(diameter_mm=6.0), sheet, depth_mm=0.3, back_pressure_kpa=air_kpa)
    X, Y = np.meshgrid(over.face_x_mm, over.face_y_mm)
    inner = np.hypot(X, Y) < 1.5
    thinning = 1 / over.sheet.stretch.prod(axis=-1)
    undeformed_mm = 0.3 + 1e-3 * slope_um * over.sheet.material_x_mm
    local_mm = (undeformed_mm * thinning)[inner]
    np.testing.assert_allclose(over.sheet.thickness_mm[inner], local_mm, atol=1e-4)
    # The punch's face is at z = 0: 0.3 mm of travel from the lower face. E* = 400 kPa, see `case`.
    compressed_mm = (air_kpa * undeformed_mm / (4 * 400.0) / thinning)[inner]
    assert np.ptp(local_mm) > 0.015
    np.testing.assert_allclose(over.face_z_mm[inner], local_mm - compressed_mm, atol=3e-4)


def over_ball(rms_um: float) -> PressedElastomer:
    field = {"rms_um": rms_um, "correlation_mm": 2.0}
    sheet = build_sheet(thickness_field=field, **SMALL)
    return pressed(Ball(), sheet, depth_mm=0.5, back_pressure_kpa=4.0)


def test_small_waves_change_face_and_force_in_proportion() -> None:
    plain = pressed(Ball(), build_sheet(**SMALL), depth_mm=0.5, back_pressure_kpa=4.0)
    none, small, double = (over_ball(rms_um) for rms_um in (0.0, 2.0, 4.0))
    np.testing.assert_array_equal(none.face_z_mm, plain.face_z_mm)
    assert none.force_n == plain.force_n
    first, second = (case.face_z_mm - plain.face_z_mm for case in (small, double))
    assert 5e-4 < np.abs(first).max() < 1e-2
    assert np.abs(second - 2 * first).max() < 0.05 * np.abs(second).max()
    by_first, by_second = (case.force_n - plain.force_n for case in (small, double))
    assert by_second == pytest.approx(2 * by_first, rel=0.1)


def test_the_neighbour_of_a_field_is_the_press_with_another_field() -> None:
    def data(rms_um: float) -> tuple:
        sheet = build_sheet(
            thickness_field={"rms_um": rms_um, "correlation_mm": 2.0, "seed": 3}, **SMALL
        )
        load = Press(control="depth", depth_mm=0.5, back_pressure_kpa=4.0, cell_mm=0.4,
                     relief_pitch_mm=0.05)  # fmt: skip
        return Mechanics(model="sheet"), Ball(), sheet, load

    mechanics, specimen, sheet, load = data(4.0)
    rest = settled_sheet(specimen, sheet, load, mechanics)
    rest = replace(rest, state=settle(rest.sheet, rest.state, EXACT))
    near = Neighbourhood(rest).press(*data(4.005))
    there = copy_with_field(rest, data(4.005)[2])
    change = there.face_z_mm - rest.result().face_z_mm
    assert np.abs(change).max() > 1e-5
    assert np.abs(near.face_z_mm - there.face_z_mm).max() < 1e-3 * np.abs(change).max()


def copy_with_field(rest: SettledSheet, elastomer: Elastomer) -> PressedElastomer:
    """Return the press of another field on the same cells, in equilibrium."""
    field = rest.sheet.grid.with_thickness(sheet_thickness(elastomer))
    bodies, cell_mm = rest.sheet.bodies, rest.sheet.cell_mm
    sheet = Sheet(field, rest.sheet.laws, bodies, rest.sheet.touched_z_mm, cell_mm=cell_mm)
    return replace(rest, sheet=sheet, state=settle(sheet, rest.state, EXACT)).result()


def test_a_compliant_rim_is_in_equilibrium_with_the_local_tension() -> None:
    """At X = +-5 mm the mounted sheet pulls with mu (1 - s^-6) h(X) per mounted length."""
    frame = Frame(11.0, 11.0, pre_stretch=1.1, rim_compliance_mm2_per_n=4.0)
    grid = sheet_grid(frame, *2 * [line(5.0, 4.0, 1.0)]).with_thickness(wedge(0.01))
    west, east, *_ = rim_springs(grid, laws(0.3), edges=((1, 0), (1, -1)))
    unit = 100.0 * (1 - 1.1**-6) * 11.0
    assert -west.tension[:, 0].sum() == pytest.approx(0.25 * unit, rel=1e-9)
    assert east.tension[:, 0].sum() == pytest.approx(0.35 * unit, rel=1e-9)


# ---- the compensation ------------------------------------------------------------------------


def test_the_compensation_assumes_a_uniform_sheet() -> None:
    cast = vary(load_experiment("examples/wrapped_balls"), {"elastomer.thickness_field.seed": 2})
    layer = sensor_layer_of(cast)
    assert layer.elastomer.thickness_field is None
    with pytest.raises(ValueError, match="assumes a uniform sheet; remove"):
        SensorLayer(elastomer=cast.elastomer)
