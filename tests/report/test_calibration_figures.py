"""Pictures of a calibration show its numbers: arrows, points, a matrix, errors over U."""

from types import SimpleNamespace

import numpy as np
import pytest

from tests.pictures import colour_at, count_of, is_drawn, kept_figures, rgb
from twin.report import calibration as drawn
from twin.report.canvas import FIT, MEASURED, TRUE_FACE, diverging


@pytest.fixture(scope="module")
def done():
    """Two poses of two features, one of four unused; three parameters, the second of them fixed."""
    measured = [np.array([[10.0, 20.0, 300.0, 400.0], [90.0, 70.0, 500.0, 450.0]])] * 2
    residuals = [np.array([[0.3, 0.4, 0.03, 0.04], [0.0, -0.5, 0.05, 0.0]])] * 2
    parameters = [
        SimpleNamespace(name="fx", value=1001.0, sigma=2.0, expanded=4.0),
        SimpleNamespace(name="fixed", value=3.0, sigma=0.0, expanded=0.0),
        SimpleNamespace(name="cx", value=50.0, sigma=0.5, expanded=1.0),
        SimpleNamespace(name="baseline", value=100.0, sigma=0.1, expanded=0.2),
    ]
    adjustment = SimpleNamespace(
        used=[np.array([True, True]), np.array([True, False])],
        measured_px=measured,
        residuals_px=residuals,
        covariance=np.array([[4.0, 0.0, -0.5], [0.0, 0.0, 0.0], [-0.5, 0.0, 0.25]]),
    )
    poses = [
        SimpleNamespace(name="flat", camera_px=0.01, projector_px=0.02, epipolar_px=0.001),
        SimpleNamespace(name="tilted", camera_px=0.04, projector_px=0.03, epipolar_px=0.002),
    ]
    result = SimpleNamespace(adjustment=adjustment, poses=poses, parameters=parameters)
    truth = {"fx": 1000.0, "fixed": 3.0, "cx": 50.5, "baseline": 100.4}
    observations = (SimpleNamespace(camera_size_px=(120, 90)),)
    return SimpleNamespace(result=result, observations=observations, truth=truth)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("calibration")


@pytest.fixture(scope="module")
def figures(done, folder):
    with pytest.MonkeyPatch.context() as patch:
        actual = kept_figures(patch, drawn)
        drawn.draw_calibration(folder, done)
    return actual


def test_every_picture_is_drawn(figures, folder):
    sizes = {
        "residuals.png": (10.2, 4.2),
        "pose_residuals.png": (7.0, 3.4),
        "correlations.png": (7.2, 6.2),
        "parameters.png": (7.6, 1.72),
    }
    assert set(figures) == set(sizes)
    assert all(is_drawn(folder / name, *size) for name, size in sizes.items())


def test_arrows_are_the_residuals_of_used_features(figures, folder):
    """Three are used; the typical camera residual, 0.5 px, is 2 % of the 80 px they span."""
    camera, projector = figures["residuals.png"].axes
    assert (camera.get_xlim(), camera.get_ylim()) == ((-0.5, 119.5), (89.5, -0.5))
    for axes, places, scale in ((camera, slice(0, 2), 1.0), (projector, slice(2, 4), 0.1)):
        (arrows,) = axes.collections
        expected = np.array([[0.3, 0.4], [0.0, -0.5], [0.3, 0.4]]) * scale
        if axes is projector:
            expected[1] = [0.05, 0.0]
        np.testing.assert_allclose(np.column_stack([arrows.U, arrows.V]), expected)
        places_px = np.array([[10.0, 20, 300, 400], [90, 70, 500, 450], [10, 20, 300, 400]])
        np.testing.assert_allclose(arrows.get_offsets(), places_px[:, places])
    assert camera.collections[0].scale == pytest.approx(0.5 / (0.02 * 80.0))
    low, high = projector.get_ylim()
    assert low > high
    assert count_of(folder / "residuals.png", MEASURED) > 20


def test_points_are_the_residuals_of_the_poses(figures, folder):
    (axes,) = figures["pose_residuals.png"].axes
    shown = {line.get_label(): line.get_ydata().tolist() for line in axes.lines}
    assert shown == {
        "camera": [0.01, 0.04], "projector": [0.02, 0.03], "epipolar": [0.001, 0.002]
    }  # fmt: skip
    assert axes.get_yscale() == "log"
    assert [label.get_text() for label in axes.get_xticklabels()] == ["flat", "tilted"]
    for colour, values in ((MEASURED, (0.01, 0.04)), (FIT, (0.02, 0.03)), (TRUE_FACE, (0.001,))):
        for place, value in enumerate(values):
            actual = colour_at(folder / "pose_residuals.png", axes, place, value)
            np.testing.assert_allclose(actual, rgb(colour), atol=10)


def test_the_matrix_is_the_correlation_of_free_parameters(figures, folder):
    """Covariance -0.5 of deviations 2 and 0.5: correlation -0.5; the fixed one is left out."""
    axes = figures["correlations.png"].axes[0]
    np.testing.assert_allclose(axes.images[0].get_array(), [[1.0, -0.5], [-0.5, 1.0]])
    assert axes.images[0].get_clim() == (-1.0, 1.0)
    assert [label.get_text() for label in axes.get_xticklabels()] == ["fx", "cx"]
    for (x, y), value in (((0, 0), 1.0), ((1, 0), -0.5)):
        expected = 255.0 * np.array(diverging()((value + 1.0) / 2.0)[:3])
        actual = colour_at(folder / "correlations.png", axes, x, y)
        np.testing.assert_allclose(actual, expected, atol=4)


def test_errors_are_shown_over_their_expanded_uncertainty(figures, folder):
    """1 of 4, -0.5 of 1, -0.4 of 0.2: 0.25, -0.5 and -2, from the top; the axis ends at 2.2."""
    (axes,) = figures["parameters.png"].axes
    (points,) = (line for line in axes.lines if line.get_marker() == "o")
    np.testing.assert_allclose(points.get_xdata(), [0.25, -0.5, -2.0])
    assert points.get_ydata().tolist() == [2, 1, 0]
    assert axes.get_xlim() == pytest.approx((-2.2, 2.2))
    path = folder / "parameters.png"
    np.testing.assert_allclose(colour_at(path, axes, 0.8, 1.5), rgb("#e8f0f7"), atol=3)
    np.testing.assert_allclose(colour_at(path, axes, 1.5, 1.5), rgb("white"), atol=3)
    np.testing.assert_allclose(colour_at(path, axes, -2.0, 0.0), rgb(MEASURED), atol=10)
