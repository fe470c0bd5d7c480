"""Scenes for the optics tests: analytic faces instead of pressed ones."""

from collections.abc import Callable

import numpy as np
import pytest
import trimesh

from twin.specimens.solids import grid_facets


@pytest.fixture(scope="session")
def grid_face() -> Callable[..., trimesh.Trimesh]:
    """Return a builder of z(x, y) faces with exact normals from the given gradient."""

    def build(height, slope, half_x_mm=16.0, half_y_mm=12.5, pitch_mm=0.04):
        x = np.arange(-half_x_mm, half_x_mm + pitch_mm / 2, pitch_mm)
        y = np.arange(-half_y_mm, half_y_mm + pitch_mm / 2, pitch_mm)
        x_mm, y_mm = np.meshgrid(x, y)
        vertices = np.stack([x_mm, y_mm, height(x_mm, y_mm)], axis=-1)
        slope_x, slope_y = slope(x_mm, y_mm)
        normals = np.stack([-slope_x, -slope_y, np.ones_like(x_mm)], axis=-1)
        normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
        return trimesh.Trimesh(
            vertices.reshape(-1, 3),
            grid_facets(*x_mm.shape),
            vertex_normals=normals.reshape(-1, 3),
            process=False,
        )

    return build


@pytest.fixture(scope="session")
def plane(grid_face):
    """Return the undeformed face, coarse."""
    return grid_face(lambda x, _: 0.0 * x, lambda x, _: (0.0 * x, 0.0 * x), pitch_mm=0.5)


@pytest.fixture(scope="session")
def bump(grid_face):
    """Return a smooth 0.8 mm bump with 25 degree flanks."""

    def height(x, y):
        return 0.8 * np.exp(-(x**2 + y**2) / 4.0)

    return grid_face(
        height, lambda x, y: (-x / 2 * height(x, y), -y / 2 * height(x, y)), pitch_mm=0.05
    )
