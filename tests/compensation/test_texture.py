"""Texture of a coat that a smooth reference hides: its variance from the rest of the relief."""

import numpy as np
import pytest
from scipy import ndimage

from reconstruction.compensation.relief import Relief, SheetOpening, relief_on_frame
from reconstruction.compensation.texture import smoothed_variance

SIDE_MM, PITCH_MM, RMS_MM, SMOOTH_MM = 12.0, 0.05, 5e-3, 0.2


def rough_relief(length_mm: float, seed: int) -> Relief:
    """Return a relief with texture of autocovariance exp(-r^2 / L^2) and some noise."""
    count, random = round(SIDE_MM / PITCH_MM), np.random.default_rng(seed)
    z = ndimage.gaussian_filter(random.normal(size=(count, count)), length_mm / 2 / PITCH_MM)
    z = z / z.std() * RMS_MM + random.normal(scale=3e-4, size=z.shape)
    places = (np.arange(count) + 0.5) * PITCH_MM - SIDE_MM / 2
    x, y = np.meshgrid(places, places)
    points = np.stack((x, y, z), axis=-1).reshape(-1, 3)
    cells = round(SIDE_MM / 0.1)
    frame = SheetOpening(SIDE_MM, SIDE_MM)
    return relief_on_frame(points, np.full(len(points), 3e-4), frame, (cells, cells))


@pytest.mark.parametrize(("length_mm", "tolerance"), [(0.1, 0.03), (0.15, 0.04), (0.25, 0.1)])
def test_smoothed_part_of_a_texture(length_mm: float, tolerance: float) -> None:
    """With the variance of the rest it is the variance of the texture, for three lengths."""
    relief = rough_relief(length_mm, 7)
    hidden = smoothed_variance(relief, relief.measured, SMOOTH_MM)
    # Closed form: the rest has 1 - 4 / a1 + 6 / a2 - 4 / a3 + 1 / a4 of it, aj = 1 + 2 j s^2 / L^2.
    parts = [1 + 2 * power * (SMOOTH_MM / length_mm) ** 2 for power in range(5)]
    rest = sum(sign / part for sign, part in zip((1, -4, 6, -4, 1), parts, strict=True))
    assert np.sqrt(rest * RMS_MM**2 + hidden) == pytest.approx(RMS_MM, rel=tolerance)


def test_noise_and_too_few_cells_hide_no_texture() -> None:
    relief = rough_relief(0.15, 3)
    few = np.zeros_like(relief.measured)
    few[:9, :9] = True
    assert smoothed_variance(relief, few, SMOOTH_MM) == 0.0
    assert smoothed_variance(relief, ~relief.inside, SMOOTH_MM) == 0.0
