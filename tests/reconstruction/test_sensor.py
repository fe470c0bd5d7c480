import numpy as np
import pytest

from reconstruction.errors import InputError
from reconstruction.sensor import SensorNoise


def test_variance_is_the_photon_transfer_line():
    sensor = SensorNoise(0.5, 4.0, 100.0, 4095.0)
    variance = sensor.variance_dn2(np.array([0.0, 100.0, 1100.0]))
    np.testing.assert_allclose(variance, 4.0 + 1.0 / 12.0 + np.array([0.0, 0.0, 500.0]))


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ((-1.0, 1.0, 0.0, 255.0), "gain_dn_per_e"),
        ((1.0, float("nan"), 0.0, 255.0), "read_noise_e"),
        ((1.0, 1.0, -1.0, 255.0), "black_level_dn"),
        ((1.0, 1.0, 20.0, 20.0), "saturation_dn"),
    ],
)
def test_bad_values_are_named(values, message):
    with pytest.raises(InputError, match=message):
        SensorNoise(*values)
