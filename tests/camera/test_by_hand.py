"""Camera figures computed by hand: electrons of a radiance, dark frames, full pixels."""

import numpy as np
import pytest

from twin.camera import electrons_per_ms, expose
from twin.config import load_experiment

SHAPE = (200, 200)


def experiment_with(**changes):
    plain = {"exposure_ms": 10.0, "prnu_percent": 0.0, "dsnu_e": 0.0} | changes
    return load_experiment("examples/slab_balls", {f"camera.{k}": v for k, v in plain.items()})


def known(value):
    return {"value": value, "source": "test"}


def test_electrons_of_a_radiance():
    """A lens of 50 mm at 250 mm magnifies by 50 / 200 = 0.25: f/4 works as f/5.

    Irradiance per mW / (mm^2 sr): pi 0.8 / (4 5^2) = 0.0251327 mW / mm^2, on (2 x 5 um)^2 = 1e-4
    mm^2 for 1 ms: 2.51327e-12 J. A photon of 500 nm has h c / lambda = 3.97289e-19 J, and one of
    two frees an electron: 3.16303e6 electrons.
    """
    camera = experiment_with(
        focal_length_mm=50.0, f_number=4.0, lens_transmission=known(0.8), binning=2,
        pixel_pitch_um=known(5.0), quantum_efficiency=known(0.5), **{"pose.standoff_mm": 250.0},
    ).camera  # fmt: skip
    assert electrons_per_ms(camera, 500.0) == pytest.approx(3.16303e6, rel=2e-6)


def test_dark_frames_at_binning_four():
    """16 pixels as one, 1 s: 10 e-/s make 160 e-, offsets of 15 e- 60, read noise of 6.2 e- 24.8.

    Full well 16 x 1000 e- over 4095 - 100 levels: 0.2496875 DN/e-. Mean 100 + 39.95 DN; offsets
    14.98 DN; temporal sqrt(24.8^2 + 160) = 27.839 e- or 6.951 DN, with 1/12 of rounding 6.957.
    """
    dark = experiment_with(
        binning=4, exposure_ms=1000.0, dark_current_e_per_s=10.0, dsnu_e=15.0, bit_depth=12,
        read_noise_e=known(6.2), full_well_e=known(1000.0), black_level_dn=100.0,
    )  # fmt: skip
    stack = expose(dark, [np.zeros(SHAPE, np.float32)] * 40, 0).stack.astype(float)
    # 40,000 pixels determine a spread to 0.35 %, their mean to 0.075 DN.
    assert stack.mean() == pytest.approx(139.95, abs=0.3)
    assert np.sqrt(stack.var(axis=0, ddof=1).mean()) == pytest.approx(6.957, rel=0.005)
    pattern = stack.mean(axis=0).var(ddof=1) - 6.957**2 / 40
    assert np.sqrt(pattern) == pytest.approx(14.98, rel=0.015)


def test_a_clean_frame_ends_at_the_full_well():
    """Without noise, 24,000 e- over 4095 - 16 levels: half a well 2055.5 DN, three wells 4095."""
    clean = experiment_with(
        noise=False, dark_current_e_per_s=0.0, full_well_e=known(24000.0), black_level_dn=16.0
    )
    rate = 10.0 * electrons_per_ms(clean.camera, clean.projector.wavelength_nm)
    radiance = [np.full((2, 2), e / rate, np.float32) for e in (0.0, 12000.0, 24000.0, 72000.0)]
    stack = expose(clean, radiance, 0).stack
    np.testing.assert_allclose(stack[:, 0, 0], [16.0, 2055.5, 4095.0, 4095.0], rtol=1e-6)


def test_dark_current_fills_the_well_too():
    """900 of 1000 e- are dark, 300 are light: the well is full, with noise and without."""
    settings = {
        "dark_current_e_per_s": known(900.0),
        "full_well_e": known(1000.0),
        "exposure_ms": 1000.0,
    }
    quiet = {"read_noise_e": known(0.0)}
    for noise in (False, True):
        experiment = experiment_with(noise=noise, **settings, **quiet)
        rate = 1000.0 * electrons_per_ms(experiment.camera, experiment.projector.wavelength_nm)
        stack = expose(experiment, [np.full((20, 20), 300.0 / rate, np.float32)], 0).stack
        assert (stack == 4095).all()
