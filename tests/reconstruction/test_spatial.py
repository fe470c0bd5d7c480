"""Spatial unwrapping of one period: orders, islands and references with known truth."""

import json
from pathlib import Path

import imageio.v3 as imageio
import numpy as np
import pytest

from reconstruction.arrays import Reason
from reconstruction.capture.folder import Capture
from reconstruction.decoding import PhaseReference
from reconstruction.decoding.decode import DecodeOptions, decode
from reconstruction.errors import InputError
from reconstruction.patterns import AXES, PatternSet
from reconstruction.pipeline import ReconstructOptions, reconstruct
from reconstruction.rig.sensor import SensorNoise
from reconstruction.spatial_unwrapping import unwrap_spatially
from tests.reconstruction.conftest import LIST_HEAD
from twin.cli.captures import decode as decode_command

PATTERNS = PatternSet(400, 300, period_px=18.0, steps=4, code="spatial", uniform=False)
NOISE = SensorNoise(1e-6, 2e6, 0.0, 400.0)
ROWS, COLS = 120, 160
SKULL = Path(__file__).parents[3] / "shared/cases/03_slstudio_skull_2x3"


def scene(step_px=0.0):
    """Return column and row coordinates of a bump, with a rectangle that is `step_px` aside."""
    row, col = np.mgrid[0:ROWS, 0:COLS].astype(float)
    bump = 25.0 * np.exp(-((row - 40.0) ** 2 + (col - 60.0) ** 2) / 400.0)
    aside = step_px * is_raised()
    return 30.0 + 1.9 * col + 0.2 * row + bump + aside, 20.0 + 1.8 * row - 0.1 * col


def is_raised():
    row, col = np.mgrid[0:ROWS, 0:COLS]
    return (row > 70) & (row < 110) & (col > 90) & (col < 150)


def decoded(synthesise, reference, step_px=0.0, noise_dn=2.0, patterns=PATTERNS):
    column, row = scene(step_px)
    stack = synthesise(patterns, column, row)
    stack += np.random.default_rng(1).normal(0.0, noise_dn, stack.shape)
    options = DecodeOptions(filter_taps=0, reference=reference)
    result = decode(stack.astype(np.float32), patterns, NOISE, options)
    return result, result.column.coordinate_px - column, result.row.coordinate_px - row


def marked(x, y, step_px=0.0):
    column, row = scene(step_px)
    return (x, y, column[y, x] + 1.5, row[y, x] - 1.5)


def test_one_pixel_makes_a_continuous_surface_absolute(synthesise):
    """Setup: noise of 2 DN at a modulation of 100. Expected: all orders right, sigma honest."""
    result, column, row = decoded(synthesise, PhaseReference((marked(10, 10),)))
    assert result.valid.all()
    assert result.islands.max() == 1
    for error, axis in ((column, result.column), (row, result.row)):
        assert np.max(np.abs(error)) < 1.0
        assert np.std(error / axis.sigma_px) == pytest.approx(1.0, abs=0.03)


@pytest.mark.parametrize("step_px", [-7.0, 4.5, 11.0, 23.0])
def test_islands_behind_a_jump_are_masked_unless_stated(synthesise, step_px):
    """Setup: a rectangle aside by -0.4 to 1.3 periods. Expected: masked without its own pixel."""
    one = PhaseReference((marked(10, 10, step_px),))
    result, column, _ = decoded(synthesise, one, step_px)
    inside = is_raised()
    assert not result.valid[inside].any()
    assert np.all(result.mask_reason[inside] == Reason.ORDER_UNCERTAIN)
    assert result.valid[~inside].all()
    assert np.max(np.abs(column[~inside])) < 1.0
    assert np.array_equal(np.unique(result.islands[0][inside]), [2])
    both = PhaseReference((marked(10, 10, step_px), marked(100, 90, step_px)))
    result, column, _ = decoded(synthesise, both, step_px)
    assert result.valid.all()
    assert np.max(np.abs(column)) < 1.0


def test_islands_can_be_joined_over_jumps_below_half_a_period(synthesise):
    joined = PhaseReference((marked(10, 10),), islands="join")
    for step_px, is_right in ((7.0, True), (11.0, False)):
        result, column, _ = decoded(synthesise, joined, step_px)
        assert result.valid.mean() > 0.95
        error_px = np.abs(column[is_raised() & result.valid])
        assert error_px.max() < 1.0 if is_right else error_px.min() > 17.0


def test_noisy_pixels_are_left_out_or_right(synthesise):
    """Setup: phase sigma 0.14 rad, and 10 % of the pixels without light. Expected: none wrong."""
    turns = scene()[0] / 18.0
    rng = np.random.default_rng(3)
    noisy = turns + rng.normal(0.0, 0.022, turns.shape)
    usable = rng.random(turns.shape) > 0.1
    result = unwrap_spatially(noisy - np.floor(noisy), np.full(turns.shape, 0.022), usable)
    main = (result.islands == 1) & result.consistent
    assert main.sum() > 0.99 * usable.sum()
    wrong = np.unique((noisy - np.floor(noisy) + result.orders - noisy)[main].round())
    assert wrong.size == 1


def test_a_vortex_of_the_phase_is_masked_where_two_paths_differ():
    """Setup: the phase is the angle about a point. Expected: one cut from the point outwards."""
    row, col = np.mgrid[0:60, 0:60] - 29.5
    turns = np.arctan2(row, col) / (2.0 * np.pi) % 1.0
    result = unwrap_spatially(turns, np.full(turns.shape, 0.01), np.hypot(row, col) > 4.0)
    assert result.islands.max() == 1
    assert 20 < np.count_nonzero(~result.consistent) < 200


@pytest.mark.parametrize("shape", [(1, 1), (1, 50), (50, 1), (3, 3)])
def test_small_and_dark_images_have_no_island(shape):
    turns = np.random.default_rng(0).random(shape)
    for usable in (np.zeros(shape, np.bool_), turns > 0.5):
        assert not unwrap_spatially(turns, np.full(shape, 0.01), usable).islands.any()


def test_a_reference_that_cannot_be_used_is_one_line(synthesise):
    for reference, message in (
        (None, "reference_pixels, or reference_z_mm"),
        (PhaseReference(z_mm=0.0), "reference_pixels"),
        (PhaseReference(((500.0, 3.0, 8.0, 9.0),)), "160 columns and 120 rows"),
        (PhaseReference((marked(10, 10), (90.0, 20.0, 2.0, 3.0))), "one island differ"),
    ):
        with pytest.raises(InputError, match=message):
            decoded(synthesise, reference)


@pytest.fixture(scope="module")
def capture(calibration, surface, project, synthesise):
    """A bump on a plane, and its points; one period of 40 px."""
    points_mm = surface(calibration)
    seen = project(calibration, points_mm)
    patterns = PatternSet(1280, 720, 40.0, 4, code="spatial", uniform=False)
    stack = synthesise(patterns, seen[..., 0], seen[..., 1]).astype(np.float32)
    return Capture(stack, patterns, SensorNoise(1e-6, 1.0, 0.0, 400.0), calibration, 8), points_mm


@pytest.mark.parametrize("kind", ["plane", "epipolar"])
def test_points_with_a_plane_or_one_known_column(capture, calibration, project, kind):
    """Expected: the true points to 1 um; rows follow from the epipolar line of the columns."""
    taken, points_mm = capture
    column = project(calibration, points_mm)[45, 20, 0]
    references = {
        "plane": PhaseReference(z_mm=0.0),
        "epipolar": PhaseReference(((20.0, 45.0, column),)),
    }
    options = DecodeOptions(filter_taps=0, reference=references[kind])
    result = reconstruct(taken, ReconstructOptions(options, use="both")).point_map
    assert result.valid.mean() > 0.999
    assert np.max(np.abs(result.points_world_mm - points_mm)[result.valid]) < 1e-3


def test_a_plane_of_uncertain_depth_masks_all_pixels(capture):
    """Setup: sigma of the depth of 30 mm, more than a period. Expected: no order is trusted."""
    options = DecodeOptions(filter_taps=0, reference=PhaseReference(z_mm=0.0, sigma_mm=30.0))
    result = reconstruct(capture[0], ReconstructOptions(options))
    assert not result.point_map.valid.any()


def test_a_described_capture_is_decoded_by_the_command(tmp_path, synthesise, capsys):
    """Setup: eight images, one period, a rectangle aside. Expected: islands named, one masked."""
    folder = tmp_path / "capture"
    folder.mkdir()
    column, row = scene(7.0)
    frames = np.rint(synthesise(PATTERNS, column, row)).astype(np.uint8)
    for frame, image in zip(PATTERNS.frames, frames, strict=True):
        imageio.imwrite(folder / f"{frame.name}.png", image)
    groups = "".join(
        f'\n[[frames]]\nfiles = "phase_{axis}_*.png"\nkind = "phase"\naxis = "{axis}"\n'
        "period_px = 18.0\nsteps = 4\n"
        for axis in AXES
    )
    head = LIST_HEAD.replace("width_px = 160", "width_px = 400").replace("96", "300")
    text = head.format(top='code = "spatial"') + groups
    (folder / "capture.toml").write_text(text, encoding="utf-8")
    pixel = (10.0, 10.0, float(column[10, 10]), float(row[10, 10]))
    decode_command(folder, out=tmp_path / "out", reference_pixels=(pixel,))
    figures = json.loads((tmp_path / "out" / "result.json").read_text())["metrics"]
    assert figures["column_islands"] == 2
    assert figures["column_islands_masked_share"] == pytest.approx(is_raised().mean(), abs=0.01)
    assert "2 islands separated by jumps" in capsys.readouterr().err


@pytest.mark.skipif(not SKULL.is_dir(), reason="needs ../shared/cases")
def test_orders_of_a_real_skull_are_those_of_temporal_unwrapping():
    """Setup: three steps of 16 fringes, three of one fringe (SLStudio). Expected: 99 % agree."""
    frames = [imageio.imread(SKULL / f"frameSeq_0{n}.png").astype(float) for n in range(6)]
    images = np.stack([frame.mean(axis=-1) if frame.ndim == 3 else frame for frame in frames])
    steps = np.exp(-2j * np.pi * np.arange(3) / 3.0)
    fine, coarse = (np.tensordot(steps, part, axes=1) for part in (images[:3], images[3:]))
    turns, whole = (np.angle(z) / (2.0 * np.pi) % 1.0 for z in (fine, coarse))
    usable = np.minimum(np.abs(fine), np.abs(coarse)) > 12.0
    sigma = 0.3 / np.maximum(np.abs(fine), 1.0)
    result = unwrap_spatially(turns, sigma, usable)
    main = (result.islands == 1) & result.consistent
    assert main.sum() > 0.95 * usable.sum()
    offset = np.rint(16.0 * whole - turns) - result.orders
    assert np.mean(offset[main] == np.median(offset[main])) > 0.99


def test_a_reference_without_effect_is_one_line(synthesise):
    patterns = PatternSet(160, 96, period_px=16, steps=4, code="gray")
    column_px, row_px = np.meshgrid(np.linspace(20, 120, 40), np.linspace(20, 70, 30))
    stack = np.rint(synthesise(patterns, column_px, row_px)).astype(np.uint8)
    options = DecodeOptions(reference=PhaseReference(pixels=((5, 5, 30.0, 30.0),)))
    with pytest.raises(InputError, match="no effect with patterns code 'gray'"):
        decode(stack, patterns, SensorNoise(0.1, 5.0, 4.0, 255.0), options)
