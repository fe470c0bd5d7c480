"""Influence of the region of a sphere fit: from the apex up to the ball's footprint."""

import numpy as np
import pytest

from reconstruction.evaluate.fit import fit_sphere
from twin.report.spheres import draw_regions, region_curves
from twin.results.folder import read_measurement


def test_a_curve_is_the_fits_over_growing_regions(finished):
    measured = read_measurement(finished)
    curves = region_curves(measured)
    names = [f"ball {number}, {name}" for number in (1, 2) for name in ("measured", "true face")]
    assert [curve.label for curve in curves] == names
    ball = measured.score.spheres[0].nominal
    curve = curves[0]
    assert curve.region_mm[-1] == ball.radius_mm == 4.0
    assert len(curve.region_mm) == 8
    points = measured.points.world_mm[measured.points.valid & measured.truth.lit]
    for place in (2, 7):
        away = np.hypot(points[:, 0] - ball.x_mm, points[:, 1] - ball.y_mm)
        fit = fit_sphere(points[away <= curve.region_mm[place]])
        assert curve.radius_mm[place] == pytest.approx(fit.radius_mm, rel=1e-3)
        assert curve.rmse_um[place] == pytest.approx(1e3 * fit.stats.rmse_mm, rel=0.02)


def test_beyond_the_contact_the_true_face_is_no_sphere(finished):
    """A slab between its balls: 79 um off any sphere at the footprint."""
    truth = region_curves(read_measurement(finished))[1]
    assert truth.rmse_um[0] < 1.0
    assert truth.rmse_um[-1] > 50.0
    assert np.all(np.diff(truth.rmse_um) > 0)


def test_the_picture_is_written(finished, tmp_path):
    draw_regions(tmp_path / "regions.png", read_measurement(finished))
    assert (tmp_path / "regions.png").stat().st_size > 10_000
