import numpy as np
import pytest

from reconstruction.errors import InputError
from reconstruction.rig.sensor import SensorNoise


def test_variance_is_the_photon_transfer_line():
    sensor = SensorNoise(0.5, 4.0, 100.0, 4095.0)
    variance = sensor.variance_dn2(np.array([0.0, 100.0, 1100.0]))
    np.testing.assert_allclose(variance, 4.0 + 1.0 / 12.0 + np.array([0.0, 0.0, 500.0]))


def test_clipped_values_are_those_within_the_noise_of_a_full_pixel():
    """Six sigmas of read noise 4 and dark offsets 3, gain 0.5, and half a level of rounding."""
    sensor = SensorNoise(0.5, 4.0, 100.0, 4095.0, dsnu_e=3.0)
    assert sensor.clipped_from_dn == pytest.approx(4095.0 - 6.0 * 0.5 * 5.0 - 0.5)


def test_without_noise_only_the_top_code_is_clipped():
    assert 254.0 < SensorNoise(0.1, 0.0, 0.0, 255.0).clipped_from_dn < 255.0


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ((-1.0, 1.0, 0.0, 255.0), "gain_dn_per_e"),
        ((1.0, float("nan"), 0.0, 255.0), "read_noise_e"),
        ((1.0, 1.0, -1.0, 255.0), "black_level_dn"),
        ((1.0, 1.0, 20.0, 20.0), "saturation_dn"),
        ((1.0, 50.0, 0.0, 255.0), "no value between"),
        ((1.0, 1.0, 0.0, 255.0, -1.0), "dsnu_e"),
    ],
)
def test_bad_values_are_named(values, message):
    with pytest.raises(InputError, match=message):
        SensorNoise(*values)
