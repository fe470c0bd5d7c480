"""The random relief: its RMS and periodogram are those of its keys, for any seed."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twin.specimens.kinds.random_relief import RandomRelief


def periodogram(relief: RandomRelief) -> tuple[np.ndarray, np.ndarray]:
    """Return wavenumber (1 / mm) and power of every wave of the face."""
    heights = relief.heights_mm()
    per_mm = np.fft.fftfreq(len(heights), relief.length_mm / len(heights))
    power = np.abs(np.fft.fft2(heights)) ** 2
    return np.hypot(per_mm[:, None], per_mm[None, :]).ravel(), power.ravel()


@given(seed=st.integers(0, 2**32 - 1), rms_um=st.floats(0.1, 500.0))
@settings(max_examples=10)
def test_the_rms_is_that_of_the_key(seed: int, rms_um: float) -> None:
    heights = RandomRelief(seed=seed, rms_um=rms_um, shortest_mm=1.0).heights_mm()
    assert np.std(heights) == pytest.approx(1e-3 * rms_um, rel=1e-12)
    assert abs(heights.mean()) < 1e-12


@pytest.mark.parametrize("hurst", [0.0, 0.5, 1.0])
def test_the_spectrum_falls_with_the_exponent_and_ends_at_the_cut_offs(hurst: float) -> None:
    relief = RandomRelief(hurst=hurst, longest_mm=6.0, shortest_mm=0.75)
    wavenumber, power = periodogram(relief)
    inside = (wavenumber >= 1 / 6.0) & (wavenumber <= 1 / 0.75)
    slope = np.polyfit(np.log(wavenumber[inside]), np.log(power[inside]), 1)[0]
    assert slope == pytest.approx(-2 * (1 + hurst), abs=1e-6)
    assert power[~inside].max() < 1e-20 * power.max()


def test_another_seed_gives_another_face_with_the_same_spectrum() -> None:
    one, two = (RandomRelief(seed=seed, shortest_mm=1.0) for seed in (1, 2))
    assert np.corrcoef(one.heights_mm().ravel(), two.heights_mm().ravel())[0, 1] < 0.5
    assert np.allclose(periodogram(one)[1], periodogram(two)[1], atol=1e-12)
    assert np.array_equal(one.heights_mm(), RandomRelief(seed=1, shortest_mm=1.0).heights_mm())


def test_the_body_has_the_volume_of_plate_and_mean_plane() -> None:
    relief = RandomRelief(shortest_mm=1.0)
    mesh = relief.shape().body
    lowest = float(relief.heights_mm().min())
    assert mesh.is_watertight
    # Over a whole period the facets weigh all nodes equally, and the mean of the nodes is 0.
    expected = relief.length_mm**2 * (relief.base_mm - lowest)
    assert mesh.volume == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"shortest_mm": 6.0}, "allowed rising"),
        ({"longest_mm": 20.0}, "up to length_mm"),
        ({"shortest_mm": 0.01}, "1024 nodes"),
        ({"longest_mm": 0.601, "shortest_mm": 0.6, "length_mm": 1.0}, "wider band"),
    ],
)
def test_bands_that_no_wave_fits_are_refused(keys: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        RandomRelief(**keys)
