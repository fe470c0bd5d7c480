import dataclasses

import numpy as np
import pytest
from scipy.integrate import trapezoid

from reconstruction.arrays import Reason
from reconstruction.capture.folder import read_capture
from reconstruction.errors import InputError
from tests.pictures import is_drawn, kept_figures
from twin.config import vary
from twin.pipeline.press import press_specimen
from twin.report import press as press_report
from twin.report.camera_images import block_mean, draw_decoding, draw_frames, reason_shares
from twin.report.canvas import (
    axes_at,
    contour_levels,
    drawing,
    height_scale,
    plain_log,
    round_up,
    symmetric_limit,
)
from twin.report.pixel_panels import REASON_COLOURS
from twin.report.press import draw_press
from twin.report.relief import average_on_grid, masked
from twin.report.section import (
    face_profile,
    slab_span,
    specimen_profile,
    touched_profile,
    trace_through_apexes,
)
from twin.report.surfaces import (
    draw_height_map,
    draw_relief_view,
    predicted_density,
)
from twin.report.words import in_words, phrase, split_unit
from twin.results.folder import read_measurement
from twin.results.record import Fringes

PNG = b"\x89PNG\r\n\x1a\n"


@pytest.mark.parametrize(
    ("value", "rounded"), [(1.01, 1.2), (1.0, 1.0), (0.3, 0.3), (41, 50), (9e-4, 1e-3), (0, 1)]
)
def test_scales_end_at_round_numbers(value, rounded):
    assert round_up(value) == rounded


def test_contours_are_round_and_below_the_peak():
    assert contour_levels(0.0, 1.01) == [0.15, 0.3, 0.45, 0.6, 0.75, 0.9]
    assert contour_levels(-0.5, 0.5) == [-0.45, -0.3, -0.15, 0.0, 0.15, 0.3, 0.45]


def test_height_scale_reaches_below_zero_only_where_the_face_sinks():
    assert height_scale(np.array([-0.01, 1.01])) == (0.0, 1.2)
    assert height_scale(np.array([-0.9, 1.01])) == (-1.0, 1.2)
    assert height_scale(np.array([-0.9, -0.1])) == (-1.0, 0.0)


def test_symmetric_limit_survives_no_values():
    assert symmetric_limit(np.array([])) == 1.0


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("standoff_mm", ("standoff", "mm")),
        ("dark_current_e_per_s", ("dark_current", "e⁻/s")),
        ("full_well_e", ("full_well", "e⁻")),
        ("force_n", ("force", "N")),
        ("seed", ("seed", "")),
        ("patterns.steps", ("patterns.steps", "")),
    ],
)
def test_units_come_from_the_suffix(name, expected):
    assert split_unit(name) == expected


def test_phrases_read_as_people_write():
    assert phrase({"thickness_mm": 2.0, "shore_a": 10.0}) == "thickness 2 mm, Shore A 10"
    assert in_words([0.0, 1.5]) == "0, 1.5"
    assert in_words(True) == "yes"


def test_block_mean_keeps_the_mean_and_drops_the_rest():
    image = np.arange(7 * 9, dtype=np.uint16).reshape(7, 9)
    small = block_mean(image, 2)
    assert small.shape == (3, 4)
    assert small[0, 0] == np.mean([0, 1, 9, 10])


def test_world_grid_averages_a_plane_exactly():
    """Setup: points of z = x on a pixel grid. Expected: every full cell holds its mean x."""
    x, y = np.meshgrid(np.arange(40) * 0.1, np.arange(30) * 0.1)
    points = np.stack([x, y, x], axis=-1).reshape(-1, 3)
    cells = average_on_grid(points, points[:, 2], pixel_mm=0.1, most_cells=1000)
    assert cells.pitch_mm == pytest.approx(0.2)
    assert cells.valid.all()
    np.testing.assert_allclose(masked(cells)[5], cells.x_mm - 0.05, atol=1e-9)


def test_predicted_density_integrates_to_one():
    error = np.linspace(-20, 20, 4001)
    density = predicted_density(error, np.array([0.5, 1.0, 2.0]))
    assert trapezoid(density, error) == pytest.approx(1.0, abs=1e-6)


def test_reasons_are_all_coloured_and_add_up():
    assert set(REASON_COLOURS) == set(Reason)
    shares = reason_shares(np.array([[0, 0], [3, 6]], np.uint8))
    assert shares == {Reason.VALID: 0.5, Reason.SATURATED: 0.25, Reason.EDGE: 0.25}


def test_pixel_of_the_rig(finished, experiment):
    pixel_mm = read_measurement(finished).pixel_mm
    field_mm = pixel_mm * experiment.camera.width_px / experiment.camera.binning
    assert 25 < field_mm < 32  # rig_facts.md: 28.6 mm


def test_section_shows_the_specimen_against_the_clear_face(experiment, pressed):
    """In the contact both profiles coincide; elsewhere the specimen is below the face."""
    trace = trace_through_apexes(experiment)
    low, high = slab_span(experiment, trace)
    s_mm = np.linspace(low, high, 2001)
    gap = touched_profile(experiment, pressed, trace, s_mm) - specimen_profile(
        experiment, pressed, trace, s_mm
    )
    assert np.min(gap) > -0.01
    assert np.min(gap) < 0.01
    assert np.max(face_profile(pressed, trace, s_mm)) == pytest.approx(
        pressed.face_z_mm.max(), rel=0.02
    )


def test_section_follows_a_turned_specimen(experiment):
    turned = vary(
        experiment, {"specimen.yaw_deg": 90.0, "specimen.x_mm": 1.0, "press.depth_mm": 0.3}
    )
    trace = trace_through_apexes(turned)
    np.testing.assert_allclose(np.abs(trace.direction), [0, 1], atol=1e-9)
    assert trace.offset(1.0, 5.0) == pytest.approx(0.0, abs=1e-9)
    assert slab_span(turned, trace)[1] == pytest.approx(turned.elastomer.length_y_mm / 2)


def test_frames_are_drawn_without_any_result(finished, tmp_path):
    capture = read_capture(finished / "capture")
    draw_frames(tmp_path / "frames.png", capture)
    content = (tmp_path / "frames.png").read_bytes()
    assert content.startswith(PNG)
    assert b"Software" not in content
    with pytest.raises(InputError, match="cannot be written"):
        draw_frames(tmp_path / "absent" / "frames.png", capture)


def test_one_moved_ball_is_drawn_where_it_is(experiment, tmp_path, monkeypatch):
    """Ball at (2, -1): maps in world mm with the peak where it is, a section through the ball."""
    ball = experiment.model_dump(exclude={"specimen", "provenance"}) | {
        "specimen": {"kind": "ball", "x_mm": 2.0, "y_mm": -1.0},
    }
    single = type(experiment).model_validate(ball)
    figures, pressed = kept_figures(monkeypatch, press_report), press_specimen(single)
    draw_press(tmp_path / "press.png", single, pressed)
    assert is_drawn(tmp_path / "press.png", 10.0, 8.6)
    relief, pressure, to_scale, enlarged = figures["press.png"].axes[:4]
    maps = (
        (relief, pressed.face_x_mm, pressed.face_y_mm, pressed.face_z_mm),
        (pressure, pressed.x_mm, pressed.y_mm, pressed.pressure_kpa),
    )
    for axes, x_mm, y_mm, values in maps:
        (shown,) = axes.images
        errors = np.asarray(np.ma.filled(shown.get_array(), 0.0))
        np.testing.assert_allclose(errors.max(), values.max(), rtol=1e-6)
        left, right, bottom, top = shown.get_extent()
        assert shown.origin == "lower"
        row, col = np.unravel_index(np.argmax(errors), errors.shape)
        x = left + (right - left) * (col + 0.5) / errors.shape[1]
        y = bottom + (top - bottom) * (row + 0.5) / errors.shape[0]
        own = np.unravel_index(np.argmax(values), values.shape)
        assert (x, y) == pytest.approx((x_mm[own[1]], y_mm[own[0]]), abs=x_mm[1] - x_mm[0])
    for axes in (to_scale, enlarged):
        low, high = slab_span(single, trace_through_apexes(single))
        assert axes.get_xlim() == pytest.approx((low, high))
        coated = {line.get_label(): line for line in axes.lines}["coated face"]
        assert coated.get_xdata()[np.argmax(coated.get_ydata())] == pytest.approx(2.0, abs=0.2)
        assert coated.get_ydata().max() == pytest.approx(pressed.face_z_mm.max(), rel=5e-3)


def test_maps_survive_many_masked_pixels(finished, tmp_path):
    """Every reason at once, and holes in the relief."""
    measured = read_measurement(finished)
    point_map = measured.fringes.reconstruction.point_map
    reason = point_map.mask_reason.copy()
    for code in Reason:
        reason[10 * code : 10 * code + 10, 40:90] = code
    holed = dataclasses.replace(point_map, mask_reason=reason)
    reconstruction = dataclasses.replace(measured.fringes.reconstruction, point_map=holed)
    draw_decoding(tmp_path / "decoding.png", reconstruction, measured.fringes.capture.patterns)
    pixel_mm = measured.pixel_mm
    points = Fringes(measured.fringes.capture, reconstruction).points
    draw_relief_view(tmp_path / "relief.png", points, pixel_mm)
    draw_height_map(tmp_path / "height.png", points, pixel_mm)
    assert len(list(tmp_path.glob("*.png"))) == 3


def test_labels_are_no_formulas(tmp_path):
    """An unfinished formula is drawn as it is, and decades need none."""
    with drawing(tmp_path / "drawn.png", 3.0, 2.0) as figure:
        axes = axes_at(figure, 0.5, 0.2, 2.0, 1.5)
        axes.plot([0.01, 1.0, 100.0], [0.0, 1.0, 2.0], label="$\\bad{$")
        axes.set_xscale("log")
        plain_log(axes.xaxis)
        axes.set_title("$\\bad{$")
        axes.legend()
        figure.canvas.draw()
        labels = [label.get_text() for label in axes.get_xticklabels()]
    assert {"1", "10", "100"} <= set(labels)
    assert not any("$" in label for label in labels)
    assert (tmp_path / "drawn.png").is_file()
