"""Reliefs in figures: positions of points, occlusion, and that all drawers accept a grid."""

import numpy as np
import pytest

from twin.optics.view import SceneSurface, SceneView
from twin.report.relief import height_scale_of, relief_picture, shaded

HALF_MM, NODES = 10.0, 41


def surface(z_mm=0.0, values=None, cut=None) -> SceneSurface:
    """A grid of 0.5 mm; z by (x, y), coloured by z or other values."""
    x_mm, y_mm = np.meshgrid(
        np.linspace(-HALF_MM, HALF_MM, NODES), np.linspace(HALF_MM, -HALF_MM, NODES)
    )
    z_mm = z_mm(x_mm, y_mm) if callable(z_mm) else np.full_like(x_mm, z_mm)
    points_mm = np.stack([x_mm, y_mm, z_mm], axis=-1)
    coloured = z_mm if values is None else values(x_mm, y_mm)
    return SceneSurface.of_grid("relief", points_mm, coloured, height_scale_of(0.0, 1.0), cut=cut)


def view(turn_deg: float, lift_deg: float = 35.0) -> SceneView:
    turn, lift = np.deg2rad((turn_deg, lift_deg))
    return SceneView.around((0, 0, 0), 40.0, turn, lift, width_px=160, height_px=120)


def yellow(picture) -> np.ndarray:
    """Pixels of the upper end of the scale in any illumination; (row, col) bool."""
    red, green, blue = np.moveaxis(picture.astype(int), -1, 0)
    return (red > 2 * blue + 40) & (green > 2 * blue + 40)


@pytest.mark.parametrize("turn_deg", [0, 50, 130, 180, 230, 310])
def test_a_point_appears_where_the_view_projects_it(turn_deg):
    """Setup: the level plane, one square of it coloured otherwise. Expected: its projection."""
    scene_view = view(turn_deg)
    marked = surface(values=lambda x, y: ((abs(x - 4) < 1.1) & (abs(y + 3) < 1.1)).astype(float))
    centre_px = np.argwhere(yellow(relief_picture(marked, scene_view)))[:, ::-1].mean(axis=0)
    np.testing.assert_allclose(centre_px, scene_view.project((4.0, -3.0, 0.0)), atol=2.0)


@pytest.mark.parametrize("turn_deg", [0, 50, 130, 180, 230, 310])
def test_a_ridge_hides_what_is_behind_it(turn_deg):
    """Setup: a ring wall of height 4 around a marked floor, seen at 20 deg. Expected: no floor.

    Cells are painted from far to near for every direction of the view.
    """
    wall = surface(
        lambda x, y: np.where(abs(np.hypot(x, y) - 6) < 1, 4.0, 0.0),
        lambda x, y: (np.hypot(x, y) < 2).astype(float),
    )
    floor = surface(values=lambda x, y: (np.hypot(x, y) < 2).astype(float))
    assert yellow(relief_picture(floor, view(turn_deg, 20.0))).sum() > 50
    assert not yellow(relief_picture(wall, view(turn_deg, 20.0))).any()


def test_heights_are_enlarged():
    from dataclasses import replace

    peak = surface(lambda x, y: np.exp(-(x**2 + y**2) / 4))
    plain, enlarged = view(0), replace(view(0), enlarged=5.0)
    tops = [
        np.argwhere(yellow(relief_picture(peak, scene_view)))[:, 0].min()
        for scene_view in (plain, enlarged)
    ]
    assert tops[0] - tops[1] == pytest.approx(4.0 * np.cos(np.deg2rad(35)) * 160 / 40, abs=3.0)


def test_a_jump_is_not_joined():
    """Setup: a step of 8 mm in a grid of 0.5 mm. Expected: only its cells are left out."""
    step = {
        cut_mm: surface(lambda x, y: np.where(x > 0.1, 8.0, 0.0), cut=cut_mm)
        for cut_mm in (5.0, None)
    }
    assert step[None].cells.all()
    assert (~step[5.0].cells).sum() == NODES - 1
    assert len(step[5.0].triangles) == 2 * step[5.0].cells.sum()


def test_holes_stay_white_and_light_only_dims():
    holed = surface(lambda x, y: np.where(np.hypot(x, y) < 3, np.nan, x / 20 + 0.5))
    rgba = shaded(holed, 2.0)
    holes = np.isnan(holed.grid_mm[..., 2])
    assert (rgba[holes] == 1.0).all()
    ratio = rgba[~holes][:, :3] / np.maximum(holed.rgb.reshape(*holes.shape, 3)[~holes], 1e-6)
    np.testing.assert_allclose(ratio, ratio[:, :1].repeat(3, axis=1), atol=1e-6)
    assert (shaded(surface(np.nan), 1.0) == 1.0).all()


def test_the_renderer_draws_a_grid_too(mi):
    """Setup: the grid of a plane in a corner of the view. Expected: the outline of the figure."""
    from twin.optics.picture import picture

    half = surface(lambda x, y: np.where(x > 0.1, np.nan, 0.0))
    scene_view = view(0, 60.0)
    painted, rendered = relief_picture(half, scene_view), picture([half], scene_view, 16)
    differs = (painted < 250).any(axis=-1) != (rendered < 250).any(axis=-1)
    assert (painted < 250).any(axis=-1).sum() > 1000
    assert differs.mean() < 0.02
