import dataclasses
import tracemalloc

import numpy as np
import pytest

from reconstruction import compiling
from reconstruction.compact import Half, Orders, RaySpread, Turns, stored_value
from reconstruction.decoding._rows import BIAS, pack_row, unpack_row
from reconstruction.decoding.decode import AxisDecode, DecodeOptions, decode
from reconstruction.decoding.plan import CHANCE_UNIT, SIGMA_UNIT_PX, units_of
from reconstruction.patterns import PatternSet
from reconstruction.rig.calibration import Calibration, Pinhole
from reconstruction.rig.sensor import SensorNoise
from reconstruction.triangulation import triangulate

SENSOR = SensorNoise(0.17, 6.2, 64.0, 4095.0)


def packed(values, unit):
    line = np.asarray(values, np.float32)
    out = np.zeros(line.size, np.uint16)
    pack_row(line, np.float32(BIAS / unit), np.zeros_like(line), out)
    return out


@pytest.mark.parametrize("unit", [2.0**-15, 2.0**-3, 1.0, 2.0**10])
def test_compiled_half_precision_is_that_of_numpy(unit):
    """Setup: 18 decades, also below the smallest full exponent. Expected: the same 16 bits.

    Except exactly between two values, which random ones never are.
    """
    rng = np.random.default_rng(4)
    values = (10.0 ** rng.uniform(-9.0, 4.8, 5000) * unit).astype(np.float32)
    bits = packed(values, unit)
    np.testing.assert_array_equal(bits, (values / unit).astype(np.float16).view(np.uint16))
    np.testing.assert_array_equal(bits, Half.of(values, unit).bits)
    back = np.zeros_like(values)
    unpack_row(bits, np.float32(unit / BIAS), back)
    np.testing.assert_array_equal(back, Half(bits, unit).expand())
    full = values > 6.2e-5 * unit
    np.testing.assert_allclose(back[full], values[full], rtol=2.0**-11)
    assert 0.3 < full.mean() < 0.9


def test_half_precision_ends_at_its_largest_value():
    """Expected: no infinity, and NaN does not pass as a small value."""
    assert packed([0.0, 65504.0, 1e6, np.inf, np.nan], 1.0).view(np.float16).tolist() == [
        0.0, 65504.0, 65504.0, 65504.0, 65504.0,
    ]  # fmt: skip
    assert Half.of(np.array([1e6, np.inf]), 1.0).expand().tolist() == [65504.0, 65504.0]


@pytest.mark.parametrize("saturation_dn", [1.0, 255.0, 4095.0, 65535.0, 3e8])
def test_levels_fit_their_unit(saturation_dn):
    """Expected: thrice the largest level of the longest exposure still fits."""
    sensor = SensorNoise(0.0, 0.0, 0.0, saturation_dn)
    for scale in (1.0, 12.5):
        unit_dn = units_of(sensor, np.array([[1.0, scale]], np.float32))[0]
        assert 3.0 * saturation_dn * scale < 65504.0 * unit_dn
        assert saturation_dn * scale >= 2.0**13 * unit_dn


def test_order_is_the_coordinate_without_its_phase():
    """Setup: coordinates also at borders of periods and left of the first pixel's centre."""
    period_px = 18.3
    order = np.arange(-1, 60)[:, np.newaxis]
    turns = np.array([0.0, 1e-4, 0.3, 0.999, 0.999999])
    x = (period_px * (order + turns)).astype(np.float32)
    steps = np.rint(turns * 65536).astype(np.int64) % 65536
    phases = Turns(np.broadcast_to(steps, x.shape).astype(np.uint16))
    result = Orders(x, phases, period_px).expand()
    # 0.999999 turns are stored as a whole turn, 0 of the next period.
    expected = order + (turns > 0.9999)
    np.testing.assert_array_equal(result, np.where(x == 0.0, 0, expected))
    again = period_px * (result + phases.expand().astype(float) / (2.0 * np.pi))
    # Half a step of the phase, and of single precision at 1100 px.
    assert np.max(np.abs(again - x)) < 0.5 * period_px / 65536 + 6.2e-5
    assert result.dtype == np.int16


def test_spread_follows_the_ray():
    """Setup: sigma_d along rays of an oblique camera. Expected: |R (x, y, 1)| sigma_d, 0.05 %."""
    rng = np.random.default_rng(2)
    rotation = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation, (70.0, 90.0, 180.0)
    ray = np.concatenate([rng.uniform(-0.3, 0.3, (5, 6, 2)), np.ones((5, 6, 1))], axis=-1)
    points = (214.0 * ray @ rotation.T + T[:3, 3]).astype(np.float32)
    sigma_mm = rng.uniform(1e-4, 2e-3, (5, 6)).astype(np.float32)
    sigma_mm[0, 0] = 0.0
    spread = RaySpread(points, Half.of(sigma_mm, 2.0**-10), T)
    expected = np.abs(ray @ rotation.T) * sigma_mm[..., np.newaxis]
    np.testing.assert_allclose(spread.expand(), expected, rtol=1e-3)
    np.testing.assert_array_equal(spread.component(2), spread.expand()[..., 2])


@pytest.fixture(scope="module")
def capture(synthesise):
    """Return 53 frames of 12 bits, 200 x 300 px, and the devices."""
    patterns = PatternSet(1280, 720)
    row, col = np.mgrid[0:200, 0:300].astype(float)
    clean = synthesise(
        patterns, 300.0 + 0.9 * col, 200.0 + 0.9 * row, mean_dn=1900.0, amplitude_dn=1500.0
    )
    noise = np.random.default_rng(3).normal(0.0, 18.0, (200, 300))
    stack = np.rint(clean + np.stack([np.roll(noise, 7 * i, 1) for i in range(53)]))
    T = np.eye(4)
    T[0, 3] = 100.0
    device = Pinhole(300, 200, 2000.0, 2000.0, 149.5, 99.5, (-0.05, 0.1, 1e-4, 0.0, 0.0))
    return stack.astype(np.uint16), patterns, Calibration(device, device, np.eye(4), T)


def test_decoder_keeps_sixteen_bits_and_gives_single_precision(capture):
    stack, patterns, _ = capture
    axis = decode(stack, patterns, SENSOR, DecodeOptions(filter_taps=0)).column
    units = {"mean_dn": 2.0**-2, "sigma_px": SIGMA_UNIT_PX, "order_error": CHANCE_UNIT}
    for name, unit in units.items():
        stored = stored_value(axis, name)
        assert isinstance(stored, Half)
        assert stored.unit == unit
        assert getattr(axis, name).dtype == np.float32
    phase = stack[:18].astype(float)
    np.testing.assert_allclose(axis.mean_dn, phase.mean(axis=0), rtol=2.0**-11)
    turns = np.exp(-2j * np.pi * np.arange(18) / 18)
    z = np.tensordot(turns, phase, axes=1)
    np.testing.assert_allclose(axis.modulation_dn, np.abs(z) / 9.0, rtol=2.0**-10)
    error_rad = np.angle(np.exp(1j * axis.phase_rad) * np.conj(z))
    assert np.max(np.abs(error_rad)) < 0.6 * 2.0 * np.pi / 65536
    rest = np.sum(phase**2, 0) - 18 * phase.mean(0) ** 2 - 2.0 * np.abs(z) ** 2 / 18.0
    np.testing.assert_allclose(axis.residual_dn, np.sqrt(rest / 15.0), rtol=0.02)
    period_px = patterns.period_px
    x_px = period_px * (axis.order + axis.phase_rad.astype(float) / (2.0 * np.pi))
    assert np.max(np.abs(x_px - axis.coordinate_px)) < 0.5 * period_px / 65536 + 6e-5


def test_plain_arrays_are_kept_as_they_are():
    images = [np.full((2, 3), float(i), np.float32) for i in range(9)]
    axis = AxisDecode(*images)
    assert axis.mean_dn is images[3]
    assert axis.order_error is images[7]
    replaced = dataclasses.replace(axis, mean_dn=Half.of(images[2], 1.0))
    assert np.all(replaced.mean_dn == 2.0)
    assert replaced.order_error is images[7]
    with pytest.raises(dataclasses.FrozenInstanceError):
        axis.mean_dn = images[0]


def test_result_needs_less_than_half_of_the_memory_of_the_stack(monkeypatch, capture):
    """Expected: all that decoding and triangulating allocate at once, below half of 16-bit frames.

    Setup: a dark capture of full size, so that lines and patches of two threads are small.
    Why: with the stack itself that is the promised 1.5, which the benchmark measures.
    """
    monkeypatch.setattr(compiling, "threads", lambda: 2)
    _, patterns, calibration = capture
    stack = np.zeros((len(patterns.frames), 1464, 1936), np.uint16)
    camera = dataclasses.replace(calibration.camera, width_px=1936, height_px=1464)
    calibration = dataclasses.replace(calibration, camera=camera)
    triangulate(decode(stack, patterns, SENSOR), calibration)  # loads the kernels
    tracemalloc.start()
    points = triangulate(decode(stack, patterns, SENSOR), calibration)
    peak_bytes = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert points.mask_reason.shape == stack.shape[1:]
    assert 0.4 * stack.nbytes < peak_bytes < 0.48 * stack.nbytes
