"""Hole and hexagon of a nut's relief, against reliefs with a known share of a hexagon."""

import numpy as np
import pytest

from twin.config import load_experiment, vary
from twin.results.names import figure_names
from twin.results.nuts import nut_figures
from twin.specimens import shape_of
from twin.specimens.kinds.nut import Nut

FLAT_MM = 5.0
_AZIMUTH = (np.arange(36000) + 0.5) / 36000 * 2 * np.pi
_HEXAGON_MM = FLAT_MM / np.cos(_AZIMUTH % (np.pi / 3) - np.pi / 6)
# Sixth harmonic of the hexagon's radius; corners are at 0.
SIXTH_MM = 2 * float(np.mean(_HEXAGON_MM * np.cos(6 * _AZIMUTH)))


def lying(**specimen):
    return vary(load_experiment("paper/nut"), {"specimen": {"yaw_deg": 0.0} | specimen})


def grid(pitch_mm=0.04):
    x, y = np.meshgrid(np.arange(-11, 11, pitch_mm), np.arange(-10, 10, pitch_mm))
    return x.ravel(), y.ravel()


def tent(share, hole_mm=0.3):
    """A ring with a hole of 2 mm radius; its contours have this share of a hexagon."""
    x, y = grid()
    radius, azimuth = np.hypot(x, y), np.arctan2(y, x)
    edge_mm = 5.3 + share * SIXTH_MM * np.cos(6 * azimuth)
    z = np.where(radius < 2.0, -hole_mm, np.minimum(0.0, 0.7 * (edge_mm - radius)))
    return np.column_stack([x, y, z])


@pytest.mark.parametrize("share", [0.0, 0.25, 0.5, 1.0])
def test_the_share_is_that_of_the_contour(share):
    figures = nut_figures(lying(), tent(share))
    assert figures["nut_hexagon_share"] == pytest.approx(share, abs=0.02)
    assert figures["nut_hole_depth_mm"] == pytest.approx(0.3)


def test_the_nut_itself_is_a_hexagon_but_for_its_walls():
    """The face of the specimen's mesh towards the sheet, turned and moved.

    A mean over 0.1 mm of radius across an upright wall ends the corners early.
    """
    experiment = lying(yaw_deg=20.0, x_mm=0.7, y_mm=-0.4)
    along = np.arange(-8.0, 8.0, 0.04)
    gap = shape_of(experiment.specimen).height_above_lowest(along, along)
    x, y = (grid.ravel() for grid in np.meshgrid(along, along))
    z = np.where(np.isfinite(gap), -gap, -3.0).ravel()
    figures = nut_figures(experiment, np.column_stack([x, y, z]))
    assert figures["nut_hexagon_share"] == pytest.approx(0.87, abs=0.03)


def test_a_nut_without_a_chamfer_is_read_below_its_face():
    figures = nut_figures(lying(chamfer_mm=0.0), tent(0.5))
    assert figures["nut_hexagon_share"] == pytest.approx(0.5, abs=0.02)


def test_noise_does_not_move_its_mean():
    rng = np.random.default_rng(2)
    points = tent(0.0)
    shares = []
    for _ in range(12):
        noisy = points + np.array([0.0, 0.0, 1.0]) * rng.normal(0, 0.014, (len(points), 1))
        shares.append(nut_figures(lying(), noisy)["nut_hexagon_share"])
    assert abs(np.mean(shares)) < 4 * np.std(shares) / np.sqrt(len(shares)) + 0.01


def test_a_relief_too_flat_for_the_contour_shows_no_hexagon():
    points = tent(1.0)
    points[:, 2] *= 0.1
    assert nut_figures(lying(), points)["nut_hexagon_share"] == 0.0


def test_points_that_miss_the_hole_say_nothing_of_it():
    points = tent(0.5)
    figures = nut_figures(lying(), points[np.hypot(points[:, 0], points[:, 1]) > 1.0])
    assert set(figures) == {"nut_hexagon_share"}


def test_only_nuts_have_these_figures():
    assert nut_figures(load_experiment("paper/ball"), tent(1.0)) == {}
    assert not {"nut_hexagon_share"} & figure_names(load_experiment("paper/ball"))
    nut = {f"{of}{n}" for of in ("", "true_face_") for n in nut_figures(lying(), tent(1.0))}
    assert nut <= figure_names(lying())
    assert isinstance(lying().specimen, Nut)
