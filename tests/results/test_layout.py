"""Figures and warnings of the rig's layout, and the duration of a sequence, in closed form."""

from pathlib import Path

import numpy as np
import pytest

from twin.cli.start import layout
from twin.config import load_experiment, vary
from twin.config.rig import shipped_lenses
from twin.optics.rig import true_calibration
from twin.results.layout import KNOWN_BEFORE, layout_figures, layout_warnings
from twin.results.sequence import frame_count, sequence_ms, sequence_warnings

BASE = "examples/slab_balls"
# 4 steps and complementary Gray code of 8 px along one axis of 64 px: 3 + 1 bits, white and black.
SHORT = {
    "projector.width_px": 64,
    "projector.height_px": 64,
    "patterns.period_px": 8.0,
    "patterns.steps": 4,
    "patterns.axes": ["column"],
    "camera.frame_rate_hz": "absent",
}


def example(**keys):
    return load_experiment(BASE, {key.replace("__", "."): value for key, value in keys.items()})


def test_figures_are_those_of_the_lens_and_of_the_triangle():
    figures = layout_figures(example())
    assert set(figures) == KNOWN_BEFORE - {"sequence_ms"}  # which needs an exposure time
    assert figures["magnification"] == pytest.approx(50 / 164)
    assert figures["field_width_mm"] == pytest.approx(1936 * 0.0045 * 164 / 50)
    assert figures["pixel_on_coat_um"] == pytest.approx(4.5 * 164 / 50)
    # 2 N c (1 + m) / m^2, which neglects the fourth power of the aperture.
    depth_mm = 2 * 8.0 * 0.0045 * (1 + 50 / 164) / (50 / 164) ** 2
    assert figures["depth_of_field_mm"] == pytest.approx(depth_mm, rel=1e-4)
    assert figures["diffraction_um"] == pytest.approx(1.22 * 0.525 * 8 * (214 / 164) / (50 / 164))
    sides = 214.0**2 + 250.0**2 - 2 * 214.0 * 250.0 * np.cos(np.deg2rad(25))
    assert figures["baseline_mm"] == pytest.approx(np.sqrt(sides))
    assert figures["triangulation_angle_deg"] == pytest.approx(25.0)


def test_a_telecentric_lens_has_its_own_distance_and_no_baseline():
    data = shipped_lenses()["scenes/lenses/falenses_btl_0_72x"].model_dump()
    figures = layout_figures(example(optics__lens=data))
    assert figures["working_distance_mm"] == 72.0
    nearer = layout_figures(example(optics__lens=data, optics__working_distance_mm=70.5))
    assert nearer["working_distance_mm"] == 70.5  # within the tolerance of the lens
    assert figures["depth_of_field_mm"] == pytest.approx(2 * 9.8 * 0.0045 / 0.72**2, rel=1e-3)
    assert "baseline_mm" not in figures


def test_photometric_stereo_has_no_projector():
    figures = layout_figures(load_experiment("examples/gelsight_ball"))
    assert {"magnification", "depth_of_field_mm"} <= set(figures)
    assert {"baseline_mm", "frames", "lit_field_share"}.isdisjoint(figures)


def test_a_field_larger_than_the_projected_image_is_reported():
    """The projected image is 250 / 1.2 mm wide and 9 / 16 of it high; the field is its square."""
    wide = example(optics__field_mm=[234.0, 176.0], camera__focal_length_mm=20.0)
    share = layout_figures(wide)["lit_field_share"]
    pinhole = true_calibration(wide).camera
    assert pinhole.width_px / pinhole.fx_px * wide.camera.pose.standoff_mm > 230.0
    assert 0.5 < share < 0.8
    assert f"the projector lights {share:.0%} of the camera's field" in layout_warnings(wide)[0]
    assert layout_warnings(vary(wide, {"optics": "absent"})) == []  # as stated by numbers before
    assert layout_warnings(example(optics__field_mm=[20.0, 15.0])) == []


@pytest.mark.parametrize(
    ("changes", "remedy"),
    [
        ({"decode.use": "row"}, 'set decode.use = "column"'),
        ({"patterns.axes": ["row"]}, 'set patterns.axes = ["column"]'),
        ({"projector.pose.azimuth_deg": 90.0}, 'set decode.use = "row"'),
        ({"decode.use": "both"}, ""),
        ({"projector.pose.azimuth_deg": 90.0, "patterns.axes": ["row"]}, ""),
    ],
)
def test_an_axis_without_depth_is_reported(changes, remedy):
    warnings = layout_warnings(load_experiment(BASE, changes))
    assert [remedy in warning for warning in warnings] == [True] * bool(remedy)


def test_the_command_prints_warnings_without_a_measurement(capsys):
    layout(Path(BASE), settings=["decode.use=row", "camera.exposure_ms=1"])
    warnings = capsys.readouterr().err.splitlines()
    assert len(warnings) == 2
    assert warnings[0].startswith("twin: warning: the depth is computed from projector rows")
    assert warnings[1].startswith("twin: warning: exposure of 1 ms, shorter than the 2.78 ms")
    layout(Path(BASE))
    layout(Path("examples/gelsight_ball"), settings=["decode.use=row", "camera.exposure_ms=1"])
    assert "twin: warning" not in capsys.readouterr().err


@pytest.mark.parametrize(
    ("changes", "exposure_ms", "expected_ms"),
    [
        ({}, 5.0, 10 * 5.0),  # exposure longer than any pattern
        ({}, 1.0, 6 * 1.0 + 4 * 1e3 / 360),
        ({}, 0.0, 6 * 1e3 / 2500 + 4 * 1e3 / 360),
        ({"patterns.low_level": 10}, 0.0, 10 * 1e3 / 360),  # no frame of 0 and 255 only
        ({"projector.pattern_rate_1bit_hz": "absent"}, 0.0, 10 * 1e3 / 360),
        ({"camera.frame_rate_hz": 50.0}, 1.0, 10 * 20.0),
        ({"patterns.inverse": True, "patterns.uniform": False}, 1.0, 8 * 1.0 + 4 * 1e3 / 360),
        (
            {"patterns.code": "gray", "patterns.steps": 0, "patterns.period_px": 8.0},
            0.0,
            5 * 1e3 / 2500,
        ),
    ],
)
def test_a_sequence_takes_the_slowest_of_exposure_camera_and_pattern(
    changes, exposure_ms, expected_ms
):
    experiment = load_experiment(BASE, SHORT | changes)
    assert sequence_ms(experiment, exposure_ms) == pytest.approx(expected_ms, rel=1e-12)
    fixed = vary(experiment, {"camera.exposure_ms": max(exposure_ms, 0.01)})
    figures = layout_figures(fixed)
    assert figures["frames"] == frame_count(experiment)
    assert figures["least_sequence_ms"] <= figures["sequence_ms"]


def test_an_exposure_of_a_part_of_a_pattern_is_reported():
    experiment = load_experiment(BASE, SHORT)
    (warning,) = sequence_warnings(experiment, 2.0)
    assert "a real camera records a part of its levels; dim the projector" in warning
    assert sequence_warnings(experiment, 1e3 / 360) == []
    words = {"patterns.code": "gray", "patterns.steps": 0}
    assert sequence_warnings(vary(experiment, words), 2.0) == []


@pytest.mark.parametrize(("rate_hz", "least_ms"), [(360.0, "2.78"), (1440.0, "0.7"), (200.0, "5")])
def test_the_remedy_of_a_stated_exposure_is_sufficient(rate_hz, least_ms):
    """1 / 1440 Hz = 0.6944 ms: the printed exposure is rounded up."""
    stated = {"projector.pattern_rate_8bit_hz": rate_hz, "camera.exposure_ms": 0.5}
    (warning,) = sequence_warnings(load_experiment(BASE, SHORT | stated), 0.5)
    assert warning.endswith(f"set camera.exposure_ms to at least {least_ms}")
    remedied = load_experiment(BASE, SHORT | stated | {"camera.exposure_ms": float(least_ms)})
    assert sequence_warnings(remedied, float(least_ms)) == []
