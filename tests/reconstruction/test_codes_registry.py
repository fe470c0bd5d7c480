"""Pattern codes from outside, and own functions that number fringes."""

import os
import sys
from pathlib import Path

import numpy as np
import pytest

from reconstruction.capture.folder import Capture
from reconstruction.capture.frame_arrangement import Arrangement, ListedFrame, ProjectorSize
from reconstruction.codes import CODES
from reconstruction.decoding.decode import DecodeOptions, decode
from reconstruction.errors import InputError
from reconstruction.patterns import AXES, PatternSet
from reconstruction.pipeline import ReconstructOptions, reconstruct
from reconstruction.registry import PLUGINS_VARIABLE, load_plugin
from reconstruction.rig.sensor import SensorNoise

PLUGIN = Path(__file__).parents[2] / "docs/extend/residue_code.py"
UNFILTERED = DecodeOptions(filter_taps=0)
QUIET = SensorNoise(0.0, 0.0, 0.0, 255.0)
HIERARCHICAL = {"code": "hierarchical", "further_periods_px": (600.0, 90.0)}


@pytest.fixture
def residue(monkeypatch):
    """The code of residue_code.py, until the test ends."""
    monkeypatch.setenv(PLUGINS_VARIABLE, os.environ.get(PLUGINS_VARIABLE, ""))
    CODES.names()
    before = set(sys.modules)
    load_plugin(PLUGIN)
    yield "residue"
    del CODES._kinds["residue"]
    for name in set(sys.modules) - before:
        if name.startswith("fringe_twin_plugin_"):
            del sys.modules[name]


def ramps(patterns, rows=40, cols=301):
    x = np.linspace(-0.45, patterns.width_px - 0.55, cols)
    y = np.linspace(-0.45, patterns.height_px - 0.55, rows)
    return np.meshgrid(x, y)


def test_plug_in_is_short():
    assert len(PLUGIN.read_text(encoding="utf-8").splitlines()) <= 60


def test_plug_in_code_decodes_exactly(residue, synthesise):
    patterns = PatternSet(
        500, 300, steps=4, period_px=21.0, code=residue, further_periods_px=(26.0,)
    )
    assert len(patterns.frames) == 2 * 2 * 4 + 2
    column, row = ramps(patterns)
    stack = synthesise(patterns, column, row).astype(np.float32)
    decoded = decode(stack, patterns, QUIET, UNFILTERED)
    assert decoded.valid.mean() > 0.999
    error_px = (decoded.column.coordinate_px - column)[decoded.valid]
    assert np.max(np.abs(error_px)) < 1e-3
    assert np.array_equal(decoded.row.order[decoded.valid], np.floor(row / 21.0)[decoded.valid])


def test_order_risk_of_a_plug_in_masks_uncertain_pixels(residue, synthesise):
    """Oracle: of the kept pixels fewer are a period off; sigma is that of the phase."""
    patterns = PatternSet(
        500, 300, steps=4, period_px=21.0, code=residue, further_periods_px=(26.0,)
    )
    column, row = ramps(patterns, 120, 600)
    rng = np.random.default_rng(2)
    noise_dn = 5.0
    stack = synthesise(patterns, column, row) + rng.normal(0.0, noise_dn, (18, 120, 600))
    sensor = SensorNoise(1e-6, noise_dn * 1e6, 0.0, 400.0)
    strict, loose = (
        decode(stack.astype(np.float32), patterns, sensor, DecodeOptions(0, max_order_error=most))
        for most in (0.01, 1.0)
    )
    wrong = np.abs(loose.column.coordinate_px - column) > 10.0
    assert wrong[loose.valid].mean() > 10.0 * max(wrong[strict.valid].mean(), 1e-4)
    right = loose.valid & ~wrong
    ratio = (loose.column.coordinate_px - column)[right] / loose.column.sigma_px[right]
    assert np.median(np.abs(ratio)) == pytest.approx(0.6745, abs=0.03)


def test_plug_in_code_is_found_in_an_experiment(residue):
    from twin.config.models import Patterns
    from twin.config.schema import list_keys, validated

    table = {"period_px": 21.0, "steps": 4, "code": residue, "further_periods_px": [26.0]}
    assert validated(Patterns, table).code == residue
    assert residue in Patterns.model_json_schema()["properties"]["code"]["enum"]
    key = next(key for key in list_keys(Patterns) if key.path == "code")
    assert "'residue'" in key.allowed
    assert "without common divisor" in key.meaning


def test_a_list_of_frames_states_a_code_from_outside(residue):
    """Two periods are those of the heterodyne code, of which these number too few pixels."""
    frames = [
        ListedFrame(f"{period_px}_{n}.png", "phase", "column", period_px, 90.0 * n)
        for period_px in (21.0, 26.0)
        for n in range(4)
    ]
    size = ProjectorSize(500, 300)
    result = Arrangement(frames, size, "reflected", residue)
    assert result.patterns == PatternSet(
        500, 300, 21.0, 4, code=residue, further_periods_px=(26.0,), axes=("column",), uniform=False
    )
    assert result.files == [frame.file for frame in frames]
    with pytest.raises(InputError, match="unambiguous over"):
        Arrangement(frames, size, "reflected")
    with pytest.raises(InputError, match="allowed are"):
        Arrangement(frames, size, "reflected", "residual")


def test_unknown_code_is_one_line_with_the_allowed_names():
    from twin.config.base import ConfigError
    from twin.config.models import Patterns
    from twin.config.schema import validated

    for make in (
        lambda: PatternSet(100, 60, code="grey"),
        lambda: validated(Patterns, {"period_px": 18.0, "steps": 4, "code": "grey"}),
    ):
        with pytest.raises((InputError, ConfigError), match="complementary_gray, ") as caught:
            make()
        assert "\n" not in str(caught.value)
        assert "grey" in str(caught.value)


def hierarchical(wrapped):
    """Number fringes from the coarsest period to the finest."""
    periods_px, x_px = wrapped.fringes.periods_px, None
    for j in sorted(range(len(periods_px)), key=lambda j: -periods_px[j]):
        turns, period_px = wrapped.turns[j], periods_px[j]
        # The coarsest period spans the image, which starts half a pixel before 0.
        coarse = 0.5 * wrapped.fringes.length_px if x_px is None else x_px
        x_px = period_px * (np.rint(coarse / period_px - turns) + turns)
    return x_px


def complementary(wrapped):
    """Number fringes by the half-period word, read away from its edges."""
    turns = wrapped.turns[0] + 0.5 / wrapped.fringes.period_px  # words change at pixels' borders
    over, cell = np.floor(turns), turns % 1.0
    (half,) = wrapped.words
    order = np.where(cell < 0.25, (half + 1) // 2, np.where(cell < 0.75, half // 2, 0))
    order = np.where(cell >= 0.75, (half + 1) // 2 - 1, order)
    return wrapped.coordinate_px(order - over)


@pytest.mark.parametrize(
    ("unwrap", "change"),
    [(hierarchical, HIERARCHICAL), (complementary, {}), (complementary, {"inverse": True})],
)
def test_own_function_gives_the_coordinates_of_the_code(synthesise, unwrap, change):
    patterns = PatternSet(500, 300, steps=5, period_px=17.0, **change)
    column, row = ramps(patterns)
    stack = synthesise(patterns, column, row, blur_px=0.5).astype(np.float32)
    expected = decode(stack, patterns, QUIET, UNFILTERED)
    decoded = decode(stack, patterns, QUIET, UNFILTERED, unwrap=unwrap)
    both = expected.valid & decoded.valid
    assert both.mean() > 0.98
    for axis in AXES:
        own, code = getattr(decoded, axis), getattr(expected, axis)
        assert np.max(np.abs(own.coordinate_px - code.coordinate_px)[both]) < 1e-4
        np.testing.assert_allclose(own.modulation_dn, code.modulation_dn)


def test_unknown_orders_are_masked_and_other_shapes_rejected(synthesise):
    patterns = PatternSet(500, 300, steps=5, period_px=17.0)
    column, row = ramps(patterns)
    stack = synthesise(patterns, column, row).astype(np.float32)
    unknown = decode(
        stack, patterns, QUIET, unwrap=lambda wrapped: np.full(wrapped.usable.shape, np.nan)
    )
    assert not unknown.valid.any()
    assert set(np.unique(unknown.mask_reason)) == {4}
    with pytest.raises(InputError, match="one for each pixel"):
        decode(stack, patterns, QUIET, unwrap=lambda wrapped: np.zeros(3))
    words = PatternSet(64, 48, steps=0, period_px=2.0, code="gray")
    stack = np.zeros((len(words.frames), 4, 5), np.uint8)
    with pytest.raises(InputError, match="no phases"):
        decode(stack, words, QUIET, unwrap=complementary)


def test_reconstruct_takes_an_own_function(calibration, surface, project, synthesise):
    """Expected: the points that the pattern code gives, with the noise of the phase."""
    patterns = PatternSet(1280, 720, steps=4, period_px=18.0)
    seen_px = project(calibration, surface(calibration))
    stack = synthesise(patterns, seen_px[..., 0], seen_px[..., 1]).astype(np.float32)
    sensor = SensorNoise(0.1, 5.0, 0.0, 255.0)
    capture = Capture(stack, patterns, sensor, calibration, 8)
    options = ReconstructOptions(decode=UNFILTERED)
    code = reconstruct(capture, options).point_map
    own = reconstruct(capture, options, unwrap=complementary).point_map
    both = code.valid & own.valid
    assert both.mean() > 0.9
    np.testing.assert_allclose(
        own.points_world_mm[both], code.points_world_mm[both], atol=1e-3, rtol=0.0
    )
    np.testing.assert_allclose(own.sigma_z_mm[both], code.sigma_z_mm[both], rtol=2e-3)
