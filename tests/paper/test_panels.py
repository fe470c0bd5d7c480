"""Panels of one measurement: they equal the measured data, gaps included, with small files."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest

from reconstruction.errors import InputError


def test_panels_of_fringes_are_the_measured_points(rod, measured_rod):
    from twin.paper.panels import read_panel_data

    data = read_panel_data(rod / "panels")
    measured = measured_rod.fringes.reconstruction.point_map
    np.testing.assert_array_equal(data.points_mm, measured.points_world_mm)
    np.testing.assert_array_equal(data.valid, measured.valid)
    figures = json.loads((rod / "result.json").read_text())["metrics"]
    assert data.numbers.completeness == figures["completeness"]
    rms_um = float(np.sqrt(np.ma.mean(data.error_um**2)))
    assert rms_um == pytest.approx(figures["z_rmse_um"], rel=1e-3)


def test_the_width_of_a_rod_is_that_of_its_section(rod):
    """The panel's arrow ends where the profile crosses 50 % of its height."""
    from twin.paper.panels import read_panel_data

    data = read_panel_data(rod / "panels")
    width = data.numbers.width
    assert width is not None
    assert width.nominal_mm == 7.23
    assert width.right_mm - width.left_mm == pytest.approx(width.width_mm)
    ends = np.interp([width.left_mm, width.right_mm], *data.section.T)
    assert ends[0] == pytest.approx(ends[1], abs=1e-4)


@pytest.mark.parametrize("name", ["bars_a", "rods_a"])
def test_fig_7_has_a_section_of_round_and_of_rectangular_rods(name):
    """Setup: points of a trapezoid between valleys, 2 mm wide at half height, as of rod A.

    Expected: a section with its width, and the reference; bars had "not measured" there.
    """
    from twin.config import load_experiment
    from twin.paper.panels import _section, _width

    experiment = load_experiment(f"paper/{name}")
    grid = np.meshgrid(np.arange(-4, 4.01, 0.025), np.arange(-1, 1, 0.1))
    x, y = (axis.ravel() for axis in grid)
    z = np.clip(2.0 * (1.25 - np.abs(x)), 0.0, 1.0)
    width = _width(experiment, _section(experiment, np.column_stack([x, y, z])))
    assert width is not None
    assert width.width_mm == pytest.approx(2.0, abs=0.02)
    assert width.nominal_mm == 1.99


def test_a_missing_point_is_a_hole(rod, mi):
    """Setup: points of a block of pixels are taken away. Expected: white there, and only there."""
    from twin.paper.panels import read_panel_data
    from twin.paper.relief_views import draw_relief, stage_for

    data = read_panel_data(rod / "panels")
    stage = stage_for(data)
    valid = data.valid.copy()
    valid[52:68, 70:90] = False
    whole = draw_relief(data, stage, 120, 90)
    holed = draw_relief(replace(data, valid=valid), stage, 120, 90)
    white = (holed == 255).all(axis=-1) & (whole < 250).any(axis=-1)
    assert 40 < white.sum() < 0.1 * white.size
    changed = (holed.astype(int) != whole).any(axis=-1)
    # The hole takes the nearest height, so that the shading of its border changes.
    assert changed.sum() < 3 * white.sum()


def test_colours_are_the_height_not_the_light(rod, mi):
    """Setup: a level surface at either end of the scale. Expected: purple and yellow of viridis."""
    from twin.paper.panels import read_panel_data
    from twin.paper.relief_views import draw_relief, stage_for

    data = read_panel_data(rod / "panels")
    stage = stage_for(data)
    low, high = stage.scale_mm
    flat = replace(data, points_mm=np.where([False, False, True], low, data.points_mm).astype("f4"))
    top = replace(data, points_mm=np.where([False, False, True], high, data.points_mm).astype("f4"))
    middle = [draw_relief(one, stage, 120, 90)[45, 60].astype(int) for one in (flat, top)]
    assert middle[1][1] > middle[0][1] + 80  # yellow over purple


def test_reliefs_that_are_compared_share_scale_and_size(rod, ball):
    from twin.paper.panels import read_panel_data
    from twin.paper.relief_views import stage_for

    folders = rod / "panels", ball / "panels"
    scales = [data.numbers.scale_mm for data in map(read_panel_data, folders)]
    stage = stage_for(*map(read_panel_data, folders))
    assert stage.scale_mm[0] == min(low for low, _ in scales)
    assert stage.scale_mm[1] == max(high for _, high in scales)


def test_a_perfect_cap_has_no_residual(ball):
    """Setup: heights on an exact sphere. Expected: its radius, residuals of float32 rounding."""
    from twin.paper.panels import read_panel_data

    data = read_panel_data(ball / "panels")
    (fit,) = data.numbers.balls
    assert fit.radius_mm == pytest.approx(4.0, abs=1e-4)
    points = data.ball(1)
    assert np.hypot(points[:, 0], points[:, 1]).max() <= 1.5  # score.roi_radius_mm of the rig
    assert np.sqrt(np.mean(points[:, 2].astype(float) ** 2)) == pytest.approx(fit.rmse_mm, rel=1e-3)
    assert fit.rmse_mm < 1e-6


def test_photometric_points_without_measurement_are_gaps(ball):
    from twin.paper.panels import read_panel_data

    data = read_panel_data(ball / "panels")
    assert not data.valid[:10].any()
    assert data.valid[10:].all()


def test_the_same_result_gives_the_same_bytes(rod, measured_rod, tmp_path):
    from twin.paper.panels import panel_data_of, write_panel_data

    write_panel_data(tmp_path / "again", panel_data_of(measured_rod))
    assert {path.name for path in (tmp_path / "again").iterdir()} == {"panels.npz", "panels.json"}
    for path in sorted((rod / "panels").iterdir()):
        assert path.read_bytes() == (tmp_path / "again" / path.name).read_bytes(), path.name


def test_a_case_has_the_figures_of_twin_measure_and_small_files(rod, measured_rod, tmp_path):
    from twin.results.folder import write_measurement

    write_measurement(tmp_path, "measure", measured_rod)
    whole = json.loads((tmp_path / "result.json").read_text())
    stored = json.loads((rod / "result.json").read_text())
    assert {**whole, "command": "paper"} == stored
    assert sum(path.stat().st_size for path in rod.rglob("*") if path.is_file()) < 5e6


def test_damaged_panels_are_an_error_of_one_line(rod, tmp_path):
    from twin.paper.panels import read_panel_data

    folder = tmp_path / "panels"
    shutil.copytree(rod / "panels", folder)
    (folder / "panels.npz").write_bytes(b"no archive")
    with pytest.raises(InputError, match="panels cannot be read") as caught:
        read_panel_data(folder)
    assert "\n" not in str(caught.value)
