"""Level, contrast and sigma in closed form; a bound from information, by hand."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from reconstruction.arrays import Reason
from reconstruction.decoding.decode import DecodeOptions, decode
from reconstruction.evaluate.estimates import FittedDimension, ball_radius_of_all, step_between
from twin.camera import full_well_e, gain_dn_per_e, noise_model
from twin.config import load_experiment, vary
from twin.optics.contrast import FringeLight, extent_variance_px2, outline, transfer
from twin.optics.light import OVERSAMPLING, light_tables, pattern_set
from twin.optics.stack import TraceMaps
from twin.results.bound import _of_spheres
from twin.results.fringe_levels import FringeNumbers, axis_levels, clipping, steps_of

SHAPE = (12, 16)


@pytest.fixture(scope="module")
def plain():
    """An experiment whose projector has no gamma, and which sets its exposure."""
    return load_experiment("examples/slab_balls", {"camera.binning": 4, "camera.exposure_ms": 20.0})


def maps_of_light(experiment, share, column=400.0):
    """All pixels under so much light that white fills a share of the well."""
    numbers = FringeNumbers.of(experiment, experiment.camera.exposure_ms)
    weight = share * full_well_e(experiment.camera) / numbers.electrons_per_radiance
    one = np.ones(SHAPE)
    places = column + np.arange(SHAPE[1]) * 0.4 * one
    return TraceMaps(
        weight=weight * one, column_px=places, row_px=300.0 * one, axial_mm=200.0 * one,
        column_range_px=0.0 * one, row_range_px=0.0 * one, lit=one > 0, samples=4,
    )  # fmt: skip


@pytest.mark.parametrize("gamma", [1.0, 2.2])
@pytest.mark.parametrize("period_px", [9.0, 18.0])
def test_contrast_is_that_of_the_projectors_tables(plain, gamma, period_px):
    """Mean and first Fourier coefficient of the 18 frames at any place, to the 8 bits of levels."""
    changed = {"projector.gamma": gamma, "patterns.period_px": period_px}
    experiment = vary(plain, changed)
    patterns = pattern_set(experiment.projector, experiment.patterns)
    table = light_tables(experiment.projector, patterns)["column"]
    nodes = slice(16 * 300, 16 * 340)
    frames = table.profiles[nodes, : patterns.steps].astype(np.float64)
    shift = 2j * np.pi * np.arange(patterns.steps) / patterns.steps
    found = 2.0 * np.abs(frames @ np.exp(-shift)) / patterns.steps
    light = FringeLight.of(experiment.projector, experiment.patterns)
    kept = transfer(period_px, experiment.projector.blur_px**2)
    assert light.mean == pytest.approx(frames.mean(), abs=1e-3)
    assert light.amplitude * kept == pytest.approx(found.mean(), rel=4e-3)


def test_blurs_add_as_variances():
    """A box of one pixel, a Gaussian and the samples of a camera pixel, each by its own formula."""
    assert transfer(2.0, 0.0) == pytest.approx(2.0 / np.pi)
    assert transfer(1e9, 0.7) == pytest.approx(1.0)
    assert transfer(10.0, 0.5) / transfer(10.0, 0.0) == pytest.approx(np.exp(-(np.pi**2) / 100))
    for side in (2, 3, 8):
        places = (np.arange(side) + 0.5) / side
        spread = places.max() - places.min()
        assert extent_variance_px2(spread, side**2) == pytest.approx(np.var(places))
    assert extent_variance_px2(1.0, 1) == 0.0


def test_outline_is_half_at_the_border():
    assert outline(-0.5, 800, 0.5) == pytest.approx(0.5)
    assert outline(400.0, 800, 0.5) == pytest.approx(1.0)
    assert outline(803.0, 800, 0.5) == pytest.approx(0.0, abs=1e-9)


def test_sigma_is_surrels(plain):
    """Half a full well of light: sigma = period / 2 pi sqrt(2 / N) sigma_I / B, by hand."""
    maps = maps_of_light(plain, 0.5)
    numbers = FringeNumbers.of(plain, 20.0)
    found = axis_levels(maps, numbers, steps_of(plain, "column"), "column", maps.weight)
    camera, light = plain.camera, FringeLight.of(plain.projector, plain.patterns)
    gain, well = gain_dn_per_e(camera), full_well_e(camera)
    dark = numbers.dark_e * gain
    np.testing.assert_allclose(found.light_dn, 0.5 * well * gain * light.mean + dark)
    modulation = 0.5 * well * gain * light.amplitude * transfer(18.0, numbers.blur_px**2)
    np.testing.assert_allclose(found.modulation_dn, modulation)
    noise = np.sqrt(noise_model(camera).variance_dn2(found.light_dn + camera.black_level_dn))
    steps = plain.patterns.steps
    expected = plain.patterns.period_px / (2 * np.pi) * np.sqrt(2 / steps) * noise / modulation
    np.testing.assert_allclose(found.sigma_px, expected, rtol=1e-12)


def test_a_complex_step_is_the_derivative(plain):
    """Sigma by exposure, period and blur, against central differences."""
    maps = maps_of_light(plain, 0.5)
    for name in ("electrons_per_radiance", "period_px", "blur_px"):
        numbers = FringeNumbers.of(plain, 20.0)
        zero = dict.fromkeys(vars(numbers), 0.0)
        along = FringeNumbers(**(zero | {name: 1.0}))

        def sigma(step, numbers=numbers, along=along):
            moved = numbers.moved(along, step)
            found = axis_levels(maps, moved, steps_of(plain, "column"), "column", maps.weight)
            return found.sigma_px

        step = 1e-5 * getattr(numbers, name)
        differences = (sigma(step) - sigma(-step)) / (2 * step)
        derivative = np.imag(sigma(1e-20j)) / 1e-20
        np.testing.assert_allclose(derivative, differences, rtol=1e-6)


def test_several_periods_are_fused(plain):
    """Three periods: 1 / sigma^2 adds up over the sets of fringes."""
    several = vary(
        plain, {"patterns.code": "hierarchical", "patterns.further_periods_px": [90.0, 2048.0]}
    )
    steps = steps_of(several, "column")
    assert steps.ratios == pytest.approx((1.0, 5.0, 2048 / 18))
    maps, numbers = maps_of_light(plain, 0.5), FringeNumbers.of(plain, 20.0)

    def sigma(steps):
        return axis_levels(maps, numbers, steps, "column", maps.weight).sigma_px

    parts = [sigma(type(steps)((ratio,), steps.count)) for ratio in steps.ratios]
    np.testing.assert_allclose(sigma(steps), sum(1 / part**2 for part in parts) ** -0.5)


def test_information_of_a_mean_and_of_weights():
    """One free height over n points: sigma / sqrt(n); unequal ones weighted by 1 / sigma^2."""
    used = np.ones(100, bool)
    fit = FittedDimension(
        0.0, np.full(100, 0.01), np.zeros(100), used, np.ones((100, 1)), np.ones(1)
    )
    assert fit.bound_mm(np.full(100, 2.0)) == pytest.approx(0.2)
    assert fit.bound_mm(np.full(100, 2.0), points_each=4.0) == pytest.approx(0.1)
    sigma = np.where(np.arange(100) < 50, 1.0, 1e6)
    assert fit.bound_mm(sigma) == pytest.approx(1 / np.sqrt(50))
    # No weighted fit is better than the bound, and the equal one is worse.
    assert np.sqrt(np.sum((fit.slope * sigma) ** 2)) > fit.bound_mm(sigma)


def test_bounds_are_the_spread_of_weighted_fits():
    """2000 draws of a ball's cap and of a step, with sigma that differs by three over the points.

    Expected: weighted least squares attains the bound, 4 % by the number of draws.
    """
    rng = np.random.default_rng(11)
    x, y = rng.uniform(-1.5, 1.5, (2, 400))
    sigma = 1e-3 * (1.0 + 2.0 * (x > 0))
    ball = np.column_stack([x, y, np.sqrt(16.0 - x**2 - y**2)])
    fit = ball_radius_of_all(ball)
    upper = x > 0.3
    step = step_between(np.column_stack([x, y]), 0.5 * upper, upper, ~upper)
    for one in (fit, step):
        weighted = one.design / sigma[:, None]
        back = np.linalg.pinv(weighted) / sigma
        draws = (sigma * rng.standard_normal((2000, 400))) @ back.T @ one.gradient
        assert one.bound_mm(sigma) == pytest.approx(draws.std(), rel=0.06)


@pytest.mark.parametrize("share", [0.9, 1.1, 1.6, 60.0])
def test_clipped_frames_cost_what_the_decoder_says(plain, share):
    """Pixels at whole projector columns under 0.9 to 60 full wells, decoded from exact frames.

    Expected: sigma of the single pixel, grown by the frames that clip, and the mask, as decoded.
    """
    experiment = plain
    patterns = pattern_set(experiment.projector, experiment.patterns)
    columns, rows = 400 + np.arange(40), 300 + np.arange(8)
    maps = maps_of_light(experiment, share)
    one = np.ones((8, 40))
    maps = replace(maps, weight=maps.weight[0, 0] * one, column_px=columns * one)
    maps = replace(maps, row_px=rows[:, None] * one, axial_mm=one)
    maps = replace(maps, column_range_px=0 * one, row_range_px=0 * one)
    numbers, camera = FringeNumbers.of(experiment, 20.0), experiment.camera
    electrons = maps.weight * numbers.electrons_per_radiance
    tables, stack = light_tables(experiment.projector, patterns), []
    for number, frame in enumerate(patterns.frames):
        table, at = tables[frame.axis or "column"], rows if frame.axis == "row" else columns
        nodes = np.rint((at - table.first_px) * OVERSAMPLING).astype(int)
        shown = table.profiles[nodes, table.frames.index(number)]
        shown = shown[:, None] if frame.axis == "row" else shown
        well = np.minimum(electrons * shown + numbers.dark_e, full_well_e(camera))
        stack.append(well * numbers.gain_dn_per_e + camera.black_level_dn)
    options = DecodeOptions(filter_taps=0)
    decoded = decode(np.array(stack, np.float32), patterns, noise_model(camera), options)
    steps = steps_of(experiment, "column")
    levels = axis_levels(maps, numbers, steps, "column", maps.weight)
    reason = np.zeros((8, 40), np.uint8)
    growth = clipping(experiment, levels, maps.column_px, "column", reason)
    sigma = levels.sigma_px * growth
    both = decoded.valid & (reason == 0)
    if share > 10:
        assert np.all(reason == Reason.SATURATED)
        assert np.all(decoded.mask_reason == Reason.SATURATED)
        return
    assert np.all(reason == 0)
    assert both.any()
    assert np.all(growth > 1.05) == (share > 1.2)
    np.testing.assert_allclose(sigma[both], decoded.column.sigma_px[both], rtol=0.01)


@pytest.mark.parametrize(("sigma_mm", "is_known"), [(1e-3, True), (1e3, False)])
def test_a_bound_wider_than_its_points_is_absent_with_the_reason(sigma_mm, is_known):
    """A cap of 3 mm, radius 4: noise of 1 um leaves it open by some um, 1 m by more than a metre.

    Such a bound was a figure of 1e12 um, which studies ranked.
    """
    experiment = load_experiment("examples/slab_ball")
    x, y = np.meshgrid(np.linspace(-1.5, 1.5, 31), np.linspace(-1.5, 1.5, 31))
    world = np.stack((x, y, np.sqrt(16.0 - x**2 - y**2)), axis=-1)
    sigma, valid = np.full(x.shape, sigma_mm), np.ones(x.shape, bool)
    prediction = SimpleNamespace(
        points=SimpleNamespace(points_world_mm=world),
        valid=valid,
        reason=np.zeros(x.shape, np.uint8),
        single_mm=sigma,
        filtered_mm=sigma,
        noise_mm=lambda slope: float(np.sqrt(((slope * sigma) ** 2).sum())),
    )
    found = dict(_of_spheres(experiment, prediction))
    names = "sphere_1_radius_crb_um", "sphere_1_radius_spread_um"
    assert [found[name] is not None for name in names] == [is_known] * 2
    why = found.get("sphere_1_radius_bound_why", "")
    assert why.startswith("" if is_known else "radius: not determined, noise leaves it open by ")
    assert bool(why) != is_known
