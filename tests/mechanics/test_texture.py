"""The coat's texture: covariance exactly, statistics over seeds, and its position on the sheet."""

from dataclasses import fields, replace
from math import exp

import numpy as np
import pytest

from twin.config import ConfigError, digest, load_experiment, vary
from twin.config.models import Press, Texture
from twin.mechanics import (
    face_mesh,
    in_plane_displacement,
    press,
    press_with,
    read_press,
    texture,
    texture_field,
    texture_figures,
    textured,
    write_press,
)
from twin.mechanics.texture import johnson_of
from twin.optics.height_grid import height_grid, shades_itself
from twin.pipeline import press_specimen
from twin.pipeline.press import press_smooth
from twin.results.parts import press_metrics
from twin.specimens.kinds.ball import Ball

NORMAL = Texture(rms_um=12, correlation_mm=0.2)
TAILED = Texture(rms_um=12, correlation_mm=0.2, skewness=0.5, excess_kurtosis=2.0)
LOAD = Press(control="depth", depth_mm=0.6, solver_pitch_mm=0.2, relief_pitch_mm=0.05)
FIELD_MM = (-4.0, 4.0, -3.0, 3.0)


def sampled(of, seed, pitch_mm=0.05):
    """Return the heights on a grid over FIELD_MM, um."""
    x, y = np.arange(-80, 81) * 0.05, np.arange(-60, 61) * 0.05
    every = round(pitch_mm / 0.05)
    X, Y = np.meshgrid(x[::every], y[::every])
    return 1e3 * texture_field(of, seed, FIELD_MM).height_mm(X, Y)


@pytest.fixture
def spot(monkeypatch):
    """The field of one unit of noise at the lattice's origin: the kernel of all fields, mm."""
    origin = lambda _, rows, cols: np.outer(rows == 0, cols == 0).astype(float)  # noqa: E731
    monkeypatch.setattr("twin.mechanics.texture._white_noise", origin)
    texture._blurred_noise.cache_clear()
    yield texture_field(NORMAL, 0, FIELD_MM)
    texture._blurred_noise.cache_clear()


def test_covariance_is_the_same_everywhere(spot):
    """Covariance of white noise through a kernel K: sum of K(P - lattice) K(Q - lattice), exact.

    Expected: rms^2 exp(-(lag / L)^2) for pairs anywhere in a lattice cell, in any direction; the
    kernel's last part is a B-spline, no Gaussian: 5e-4 of the variance, 1e-3 of the correlation.
    """
    steps = np.arange(-20, 21) * spot.pitch_mm
    lattice_X, lattice_Y = np.meshgrid(steps, steps)
    for at in np.random.default_rng(1).uniform(0.0, spot.pitch_mm, (5, 2)):
        here = spot.height_mm(at[0] - lattice_X, at[1] - lattice_Y)
        assert np.sum(here**2) == pytest.approx((12e-3) ** 2, rel=5e-4)
        for lag_x, lag_y in [(0.1, 0.0), (0.0, 0.2), (-0.12, 0.16), (0.3, 0.2)]:
            there = spot.height_mm(at[0] + lag_x - lattice_X, at[1] + lag_y - lattice_Y)
            expected = exp(-(lag_x**2 + lag_y**2) / 0.2**2)
            assert np.sum(here * there) / (12e-3) ** 2 == pytest.approx(expected, abs=1e-3)


@pytest.mark.parametrize("of", [NORMAL, TAILED])
def test_statistics_over_seeds(of):
    """Mean over 60 coats within 4 standard errors, which come from the scatter of the coats.

    Expected: RMS, skewness and kurtosis as specified; the correlation 1/e at the length along both
    axes; the mean size of a height that of its distribution.
    """
    coats = np.array([sampled(of, seed) for seed in range(60)]) / of.rms_um
    axis = 2
    at_length = [
        np.mean(coats[..., 4:] * coats[..., :-4], axis=(1, 2)),
        np.mean(coats[:, 4:] * coats[:, :-4], axis=(1, 2)),
    ]
    power = [np.mean(coats**n, axis=(1, axis)) for n in (1, 2, 3, 4)]
    expected_figures = [0.0, 1.0, of.skewness, 3 + of.excess_kurtosis, exp(-1), exp(-1)]
    for figure, expected in zip([*power, *at_length], expected_figures, strict=True):
        error = figure.std() / np.sqrt(figure.size)
        assert abs(figure.mean() - expected) < 4 * error
        assert error < 0.04 * max(1.0, abs(expected))
    z = np.linspace(-8, 8, 16001)
    density = np.exp(-(z**2) / 2) * 1e-3 / np.sqrt(2 * np.pi)
    mae = density @ np.abs(johnson_of(of.skewness, of.excess_kurtosis).of_normal(z))
    assert np.mean(np.abs(coats)) == pytest.approx(mae, abs=0.006)


def test_one_seed_one_coat():
    assert sampled(TAILED, 3).tobytes() == sampled(TAILED, 3).tobytes()
    same_place = np.corrcoef(sampled(TAILED, 3).ravel(), sampled(TAILED, 4).ravel())[0, 1]
    assert abs(same_place) < 0.1


def test_a_coarser_mesh_sees_the_same_heights():
    fine, coarse = sampled(TAILED, 3), sampled(TAILED, 3, pitch_mm=0.1)
    assert coarse.tobytes() == fine[::2, ::2].tobytes()


def test_a_larger_sheet_has_the_same_coat_in_its_middle():
    X, Y = np.meshgrid(np.linspace(-1, 1, 9), np.linspace(-1, 1, 7))
    small, large = (
        texture_field(TAILED, 3, extent).height_mm(X, Y)
        for extent in ((-1.0, 1.0, -1.0, 1.0), (-9.0, 7.0, -3.0, 5.0))
    )
    np.testing.assert_allclose(small, large, rtol=1e-9, atol=1e-12)


def test_a_point_outside_is_refused():
    with pytest.raises(ValueError, match="outside the field"):
        texture_field(NORMAL, 0, FIELD_MM).height_mm(np.array([9.0]), np.array([0.0]))


def test_only_the_coated_face_changes(slab):
    smooth = press(Ball(), slab(), LOAD)
    coated = textured(smooth, slab(), LOAD, NORMAL, seed=1)
    changed = {
        field.name
        for field in fields(smooth)
        if not np.array_equal(getattr(smooth, field.name), getattr(coated, field.name))
    }
    assert changed == {"face_z_mm", "texture_mm"}
    np.testing.assert_array_equal(coated.face_z_mm, smooth.face_z_mm + coated.texture_mm)


def test_heights_count_along_the_normal(slab):
    """On a plane of slope 3/4 the coat rises by 5/4 of the height that a flat one has."""
    flat = replace(press(Ball(), slab(), LOAD), model="fem")
    flat = replace(flat, face_z_mm=np.zeros_like(flat.face_z_mm))
    tilted = replace(flat, face_z_mm=flat.face_z_mm + 0.75 * flat.face_x_mm)
    level, steep = (textured(face, slab(), LOAD, NORMAL, seed=1) for face in (flat, tilted))
    np.testing.assert_allclose(steep.texture_mm, 1.25 * level.texture_mm, rtol=1e-9)


def test_a_grain_moves_with_its_material(slab):
    """A material point at X before the press is at X + u after it: its height is that of X."""
    from scipy.interpolate import RegularGridInterpolator

    load = LOAD.model_copy(update={"relief_pitch_mm": 0.025, "depth_mm": 0.9})
    smooth = press(Ball(), slab(), load)
    coated = textured(smooth, slab(), load, NORMAL, seed=1)
    nodes = smooth.face_y_mm, smooth.face_x_mm
    u_x, u_y = (
        RegularGridInterpolator(nodes, u) for u in in_plane_displacement(smooth, slab(), load)
    )
    X = np.random.default_rng(2).uniform(-4, 4, (200, 2))  # rows of y, x
    now = X
    for _ in range(50):
        now = X + np.column_stack((u_y(now), u_x(now)))
    slope = np.gradient(smooth.face_z_mm, *nodes)
    height = coated.texture_mm / np.sqrt(1 + slope[0] ** 2 + slope[1] ** 2)
    result = RegularGridInterpolator(nodes, height, method="cubic")
    before = texture_field(NORMAL, 1, (-5, 5, -5, 5)).height_mm(X[:, 1], X[:, 0])
    assert np.abs(now - X).max() > 0.05
    np.testing.assert_allclose(result(now), before, atol=1e-4)
    assert np.std(result(X) - before) > 2e-3


def test_figures_tell_rms_and_correlation_length(slab):
    """8 x 8 mm hold some 300 patches: RMS and length come back to 5 and 10 %."""
    smooth = press(Ball(), slab(), LOAD)
    assert texture_figures(smooth) == {}
    result = press_metrics(textured(smooth, slab(), LOAD, TAILED, seed=1))
    assert result["texture_rms_um"] == pytest.approx(12, rel=0.05)
    assert result["texture_correlation_mm"] == pytest.approx(0.2, rel=0.1)


def test_it_is_stored_and_read_back(slab, tmp_path):
    import h5netcdf

    smooth = press(Ball(), slab(), LOAD)
    coated = textured(smooth, slab(), LOAD, NORMAL, seed=1)
    for name, pressed in (("smooth.nc", smooth), ("coated.nc", coated)):
        write_press(tmp_path / name, pressed)
    np.testing.assert_array_equal(read_press(tmp_path / "coated.nc").texture_mm, coated.texture_mm)
    assert read_press(tmp_path / "smooth.nc").texture_mm is None
    with h5netcdf.File(tmp_path / "smooth.nc") as file:
        assert "texture_mm" not in file


SMALL = {"press.solver_pitch_mm": 0.2, "press.relief_pitch_mm": 0.05}


def test_a_smooth_coat_keeps_its_bytes_and_digest():
    experiment = load_experiment("examples/slab_balls", SMALL)
    assert "texture" not in experiment.coating.model_dump()
    rough = vary(experiment, {"coating.texture": NORMAL.model_dump()})
    assert digest(vary(rough, {"coating.texture": None})) == digest(experiment) != digest(rough)
    plain = press_with(
        experiment.mechanics, experiment.specimen, experiment.elastomer, experiment.press
    )
    pressed = press_specimen(experiment)
    assert pressed.face_z_mm.tobytes() == plain.face_z_mm.tobytes()
    assert "texture_rms_um" not in press_metrics(pressed)


@pytest.mark.parametrize("model", ["spectral", "neo_hookean", "fem"])
def test_every_model_gets_it_from_the_experiments_seed(model, monkeypatch):
    """A quick press replaces the slow models: one function adds the texture for all of them."""
    experiment = load_experiment(
        "examples/slab_balls", SMALL | {"coating.texture": NORMAL.model_dump()}
    )
    smooth = replace(press_smooth(experiment), model=model)
    monkeypatch.setattr("twin.pipeline.press.press_with", lambda *_: smooth)
    first, again, second_seed = (
        press_specimen(vary(experiment, {"seed": seed})).face_z_mm for seed in (1, 1, 2)
    )
    assert first.tobytes() == again.tobytes()
    assert 0.8 * 12e-3 * np.sqrt(2) < np.std(first - second_seed) < 1.2 * 12e-3 * np.sqrt(2)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"skewness": 1.0, "excess_kurtosis": 1.0}, "excess_kurtosis: found 1, allowed at least"),
        ({"correlation_mm": 0.08}, "press.relief_pitch_mm: found 0.05, allowed up to 0.04"),
        ({"rms_um": 0.0}, "coating.texture.rms_um: found 0.0, should be greater than 0"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(changes, message):
    with pytest.raises(ConfigError) as caught:
        load_experiment(
            "examples/slab_balls", SMALL | {"coating.texture": NORMAL.model_dump() | changes}
        )
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("rms_um", "shades"), [(12.0, False), (90.0, True)])
def test_a_gentle_texture_is_proven_not_to_shade_itself(slab, rms_um, shades):
    """Slopes of 12 um over 0.2 mm are below 0.1; of 90 um they reach the light's elevation."""
    of = NORMAL.model_copy(update={"rms_um": rms_um})
    coated = textured(press(Ball(), slab(), LOAD), slab(), LOAD, of, seed=1)
    source_mm = np.array([200.0, 0.0, 230.0])
    assert shades_itself(height_grid(face_mesh(coated)), source_mm) == shades
