"""Projector blur that increases with the distance from the focal plane."""

import numpy as np
import pytest

from reconstruction.errors import InputError
from reconstruction.rig.projected_light import blurred
from twin.config import load_experiment
from twin.optics.export import inexpressible
from twin.optics.light import (
    LEVELS_PER_OCTAVE,
    OVERSAMPLING,
    BlurLevels,
    Defocus,
    light_tables,
    pattern_set,
    response,
)
from twin.optics.rig import projector_pinhole
from twin.pipeline import render

APERTURE_MM = 24.0
NEAR_MM, FAR_MM = 215.0, 290.0


def stated(value):
    return {"value": value, "source": "test"}


def paper(changes):
    few = {"projector.width_px": 320, "patterns.steps": 3}
    return load_experiment("examples/slab_balls", few | changes)


@pytest.fixture(scope="module")
def experiment():
    return paper({"projector.aperture_mm": stated(APERTURE_MM), "projector.focus_mm": 250.0})


@pytest.fixture(scope="module")
def patterns(experiment):
    return pattern_set(experiment.projector, experiment.patterns)


def column_levels(patterns, table):
    return np.stack([patterns.profile(patterns.frames[k]) for k in table.frames], axis=1)


def blur_at(mi, tables, column_px, axial_mm):
    """Light of the column frames (point, frame) in the middle row, as the kernel looks it up."""
    from twin.optics.connection import Connection, FrameLight

    ones = np.ones_like(column_px)
    place = mi.Float(column_px), mi.Float(360.0 * ones), mi.Float(ones), mi.Bool(ones > 0)
    path = Connection(*place, mi.Float(axial_mm))
    frames = len(tables["column"].frames)
    return np.stack([np.array(v) for v in FrameLight(tables).values(path)[:frames]], axis=1)


def test_a_constant_blur_needs_no_levels(patterns):
    tables = light_tables(paper({}).projector, patterns)
    assert all(table.levels is None and table.defocused is None for table in tables.values())


def test_an_aperture_needs_distances(experiment, patterns):
    with pytest.raises(ValueError, match="axial distances"):
        light_tables(experiment.projector, patterns)


def test_light_between_two_blur_levels_is_the_light_of_that_blur(mi, experiment, patterns):
    """Any frame, any distance: 1e-3 of the directly blurred pattern (nodes and levels together)."""
    tables = light_tables(experiment.projector, patterns, (NEAR_MM, FAR_MM))
    rng = np.random.default_rng(4)
    column_px = rng.uniform(-3.0, 323.0, 400)
    axial_mm = rng.uniform(NEAR_MM, FAR_MM, 400)
    interpolated = blur_at(mi, tables, column_px, axial_mm)
    light = response(column_levels(patterns, tables["column"]), experiment.projector)
    variance_px2 = Defocus.of(experiment.projector).variance_px2(axial_mm)
    wanted = [
        blurred(light, np.array([x]), sigma)[0]
        for x, sigma in zip(column_px, np.sqrt(variance_px2), strict=True)
    ]
    np.testing.assert_allclose(interpolated, wanted, atol=1e-3)
    assert np.ptp(variance_px2) > 2.0  # the test includes strong defocus


def test_the_levels_hold_every_blur_of_the_range(experiment):
    defocus = Defocus.of(experiment.projector)
    levels = BlurLevels.between(defocus, NEAR_MM, FAR_MM)
    blurs = np.array(levels.blurs_px())
    actual = np.sqrt(defocus.variance_px2(np.linspace(NEAR_MM, FAR_MM, 1001)))
    assert blurs[0] == pytest.approx(actual.min(), rel=1e-6)
    assert blurs[-2] < actual.max() <= blurs[-1]
    np.testing.assert_allclose(blurs[LEVELS_PER_OCTAVE:] ** 2, 2 * blurs[:-LEVELS_PER_OCTAVE] ** 2)


def test_defocus_is_the_light_of_all_pupil_points(mi, experiment, patterns):
    """Brute force: many pinholes over the pupil, their images made to coincide in the focal plane.

    Expected: fringes differ as the transfer functions 2 J1(x) / x and exp(-x^2 / 8) of disc
    and Gaussian differ, x^4 / 384 with x = pi c / period; Gray edges by less than 3 % of white at a
    circle of 6 px: total kurtosis -0.67 / 24 times max |u^3 - 3 u| phi(u) = 0.55 gives 1.5 %, and a
    stripe has two edges. Without defocus the error would exceed 10 %.
    """
    projector, pinhole = experiment.projector, projector_pinhole(experiment.projector)
    tables = light_tables(projector, patterns, (NEAR_MM, FAR_MM))
    rng = np.random.default_rng(5)
    axial_mm = np.repeat([NEAR_MM, 235.0, 270.0, FAR_MM], 40)
    column_px = rng.uniform(20.0, 300.0, axial_mm.size)
    x_mm = (column_px - pinhole.cx_px) / pinhole.fx_px * axial_mm
    line = (np.arange(40) + 0.5) / 20 - 1.0
    pupil_mm = APERTURE_MM / 2 * np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
    pupil_mm = pupil_mm[np.hypot(*pupil_mm.T) <= APERTURE_MM / 2, 0]
    shift_px = pinhole.fx_px * pupil_mm / projector.focus_mm
    seen_px = pinhole.fx_px * (x_mm[:, None] - pupil_mm) / axial_mm[:, None] + pinhole.cx_px
    light = response(column_levels(patterns, tables["column"]), projector)
    sharp = blurred(light, (seen_px + shift_px).ravel(), projector.blur_px)
    wanted = sharp.reshape(*seen_px.shape, -1).mean(axis=1)
    error = np.abs(blur_at(mi, tables, column_px, axial_mm) - wanted)
    fringes = np.array([patterns.frames[k].kind == "phase" for k in tables["column"].frames])
    circle_px = pinhole.fx_px * APERTURE_MM * np.abs(1 / axial_mm - 1 / projector.focus_mm)
    assert circle_px.max() > 5.0
    x = np.pi * circle_px / experiment.patterns.period_px
    assert np.all(error[:, fringes] < 0.5 * x[:, None] ** 4 / 384 + 4e-4)
    assert error.max() < 3e-2
    in_focus = blurred(light, column_px, projector.blur_px)
    assert np.abs(in_focus - wanted).max() > 0.1


def test_focus_is_at_the_origin_unless_stated():
    """Off-axis projector: the origin's axial distance is shorter than its standoff."""
    projector = paper({"projector.aperture_mm": 5.0}).projector
    pinhole = projector_pinhole(projector)
    centre_y = (pinhole.cy_px - (pinhole.height_px - 1) / 2) / pinhole.fy_px
    expected = projector.pose.standoff_mm / np.hypot(1.0, centre_y)
    assert Defocus.of(projector).focus_mm == pytest.approx(expected)


def test_rendered_modulation_falls_as_the_transfer_function(mi, plane):
    """Fringe modulation of point-like camera pixels, over a field 30 mm deep, in closed form.

    (white - black) / (white + black) sinc(1 / period) exp(-2 pi^2 sigma^2 / period^2).
    """
    from twin.optics.rig import true_calibration

    experiment = load_experiment(
        "examples/slab_balls",
        {
            "projector.aperture_mm": stated(40.0),
            "patterns.steps": 3,
            "patterns.code": "gray",
            "camera.width_px": 48,
            "camera.height_px": 36,
            "camera.pixel_pitch_um": {"value": 180.0, "source": "test"},
            "render.samples": 1,
        },
    )
    patterns = pattern_set(experiment.projector, experiment.patterns)
    stack, period_px = render(experiment, plane), experiment.patterns.period_px
    frames = np.stack(stack.frames[patterns.index("phase", "column")])
    turns = np.exp(-2j * np.pi * np.arange(3) / 3)
    modulation = 2.0 * np.abs(np.tensordot(turns, frames, 1)) / np.sum(frames, axis=0)
    pose = true_calibration(experiment).T_world_from_proj
    axial_mm = (stack.truth.points_world_mm - pose[:3, 3]) @ pose[:3, 2]
    variance_px2 = Defocus.of(experiment.projector).variance_px2(axial_mm)
    contrast = experiment.projector.contrast
    expected = (contrast - 1) / (contrast + 1) * np.sinc(1.0 / period_px)
    expected = expected * np.exp(-2.0 * np.pi**2 * variance_px2 / period_px**2)
    lit = stack.truth.lit
    assert expected[lit].min() < 0.8
    assert expected[lit].max() > 0.9
    # Three steps fold the harmonics of the 8-bit levels onto the fringe: half a level of 255.
    np.testing.assert_allclose(modulation[lit], expected[lit], atol=4e-3)


def test_stock_engine_and_export_say_that_they_cannot(plane):
    changes = {"projector.aperture_mm": 5.0, "render.engine": "stock"}
    experiment = paper(changes)
    with pytest.raises(InputError, match=r"^projector\.aperture_mm: [^\n]*$"):
        render(experiment, plane)
    assert any("projector.aperture_mm" in line for line in inexpressible(experiment))


def test_nodes_are_finer_than_the_least_blur():
    """Blur below 0.1 px is set to 0.1 px: two nodes per standard deviation need 1/16 px."""
    from twin.optics.light import LEAST_VARIANCE_PX2

    assert np.sqrt(LEAST_VARIANCE_PX2) > 1.0 / OVERSAMPLING
