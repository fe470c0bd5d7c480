"""The map of least stretching energy: closed forms, conservation, derivatives, convergence."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from reconstruction.arrays import FloatArray
from reconstruction.compensation.membrane import MaterialMap, SurfaceMetric, _Elements, material_map

Heights = Callable[[FloatArray, FloatArray], FloatArray]


def metric_of(height: Heights, cells: int, length_mm: float = 10.0) -> SurfaceMetric:
    """Return a surface's metric, averaged over each element's 4 x 4 places."""
    nodes = np.linspace(-length_mm / 2, length_mm / 2, cells + 1)
    fine = (np.arange(4 * cells) + 0.5) * length_mm / (4 * cells) - length_mm / 2
    x, y = np.meshgrid(fine, fine)
    small = 1e-5
    slope_x = (height(x + small, y) - height(x - small, y)) / (2 * small)
    slope_y = (height(x, y + small) - height(x, y - small)) / (2 * small)

    def mean(values: FloatArray) -> FloatArray:
        return values.reshape(cells, 4, cells, 4).mean(axis=(1, 3))

    held = np.ones((cells + 1, cells + 1), bool)
    held[1:-1, 1:-1] = False
    parts = (mean(1 + slope_x**2), mean(slope_x * slope_y), mean(1 + slope_y**2))
    return SurfaceMetric(nodes, nodes, *parts, np.zeros((cells, cells)), held)


def bump(x: FloatArray, y: FloatArray) -> FloatArray:
    return 1.5 * np.exp(-((x - 0.5) ** 2 + 1.4 * y**2) / 4)


@pytest.mark.parametrize("pre_stretch", [1.0, 1.2])
def test_flat_sheet_keeps_its_mounted_stretch(pre_stretch: float) -> None:
    """Equal biaxial stretch s: thickness s^-2, tension over mu h 1 - s^-6, and 0 across."""
    sheet = material_map(metric_of(lambda x, y: 0 * x, 10), pre_stretch)
    assert sheet.thinning == pytest.approx(pre_stretch**-2, rel=1e-12)
    assert sheet.tension[..., 0] == pytest.approx(1 - pre_stretch**-6, abs=1e-12)
    assert sheet.tension[..., 2] == pytest.approx(1 - pre_stretch**-6, abs=1e-12)
    assert np.abs(sheet.tension[..., 1]).max() < 1e-12


def test_slope_across_one_axis_is_plane_strain() -> None:
    """A plane of slope m, held all round, stretches along x only: l = sqrt(1 + m^2)."""
    slope = 0.8
    sheet = material_map(metric_of(lambda x, y: slope * x, 8))
    stretch = np.sqrt(1 + slope**2)
    assert sheet.thinning == pytest.approx(1 / stretch, rel=1e-9)
    # Tension over mu h along x: (l^2 - 1 / l^2) / l; in the components of x that is over l^2.
    along = (stretch**2 - stretch**-2) / stretch
    assert sheet.tension[..., 0] == pytest.approx(along / stretch**2, rel=1e-9)


def test_sheet_keeps_its_volume() -> None:
    """Thickness times area over the surface is that of the flat sheet."""
    surface = metric_of(bump, 24)
    sheet = material_map(surface)
    cell = 10.0**2 / 24**2
    volume = float(np.sum(sheet.thinning * np.sqrt(surface.determinant))) * cell
    assert volume == pytest.approx(100.0, rel=2e-4)  # det B at the middle, not its mean


@pytest.mark.parametrize("gives", [False, True])
def test_gradient_and_tangent_are_the_energys_derivatives(gives: bool) -> None:
    surface = replace(metric_of(bump, 5), squeeze=np.linspace(0, 0.3, 25).reshape(5, 5))
    elements = _Elements.on(surface)
    random = np.random.default_rng(1)
    x, y = np.meshgrid(surface.x_mm, surface.y_mm)
    if gives:
        springs = np.where(surface.held, random.uniform(1, 3, x.shape), 0.0)
        elements = elements.on_springs(surface, springs, np.stack((x, y), -1) / 1.1, 1.1)
    place = np.stack((x, y), -1) + random.normal(scale=0.1, size=(*x.shape, 2))
    direction = random.normal(size=place.shape)
    step = 1e-5
    _, gradient, b = elements.energy(place)
    ahead, back = (elements.energy(place + sign * step * direction) for sign in (1, -1))
    assert gradient @ direction.ravel() == pytest.approx(
        (ahead[0] - back[0]) / (2 * step), rel=1e-7
    )
    bent = elements.tangent(b, whole=True) @ direction.ravel()
    assert bent == pytest.approx((ahead[1] - back[1]) / (2 * step), rel=1e-5, abs=1e-4)


@pytest.mark.parametrize("pre_stretch", [1.0, 1.2])
def test_a_flat_sheet_is_at_rest_on_its_rims_springs(pre_stretch: float) -> None:
    surface = metric_of(lambda x, y: 0 * x, 10)
    soft = replace(surface, springs=np.where(surface.held, 0.5, 0.0))
    sheet = material_map(soft, pre_stretch)
    np.testing.assert_allclose(sheet.thinning, pre_stretch**-2, rtol=1e-6)
    bent = replace(metric_of(bump, 10), springs=soft.springs)
    assert (
        material_map(bent).thinning.min() > material_map(replace(bent, springs=None)).thinning.min()
    )


def test_thinning_converges_with_second_order() -> None:
    def at_top(cells: int) -> float:
        sheet: MaterialMap = material_map(metric_of(bump, cells))
        middle = cells // 2
        return float(sheet.thinning[middle - 1 : middle + 1, middle - 1 : middle + 1].mean())

    values = [at_top(cells) for cells in (16, 32, 64)]
    order = np.log2((values[1] - values[0]) / (values[2] - values[1]))
    assert 1.5 < order < 2.5


def test_squeezed_sheet_is_thinner_there() -> None:
    """Pressure on the middle of a flat sheet drives material out of it, and keeps the volume."""
    surface = metric_of(lambda x, y: 0 * x, 20)
    squeeze = np.zeros((20, 20))
    squeeze[6:14, 6:14] = 0.2
    sheet = material_map(replace(surface, squeeze=squeeze))
    assert sheet.thinning[10, 10] < 0.99
    assert sheet.thinning[0, 0] > 1.0
    assert sheet.thinning.mean() == pytest.approx(1.0, rel=1e-3)
