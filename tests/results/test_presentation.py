"""Results as a person meets them: in one line, as a table with a picture, as labelled arrays."""

import io
import re

import matplotlib.image
import numpy as np
import pytest

from reconstruction.cells import SquareCells
from reconstruction.drawing import Drawing, gridded
from reconstruction.errors import InputError
from twin.config import load_experiment
from twin.pipeline import measure

SMALL = {"camera.binning": 4, "camera.width_px": 968, "camera.height_px": 732}


@pytest.fixture(scope="module")
def measured(mi):
    return measure(load_experiment("examples/slab_balls", SMALL))


def test_a_measurement_is_one_line(measured):
    text = repr(measured)
    assert re.fullmatch(r"<Measurement two_balls: contact_fpp, 183 x 242 pixels, .*>", text)
    assert "um RMS" in text
    assert len(text) < 200


def test_a_press_is_one_line(measured):
    text = repr(measured.pressed)
    assert re.fullmatch(
        r"<PressedElastomer: spectral, .* N at .* mm, coat from .* nodes, .*>", text
    )
    assert len(text) < 200


def test_a_reconstruction_is_one_line(measured):
    text = repr(measured.fringes.reconstruction)
    assert re.fullmatch(
        r"<Reconstruction: 183 x 242 pixels, points .*, median sigma of z .*>", text
    )


def test_figures_are_a_list(measured):
    lines = repr(measured.figures).splitlines()
    assert len(lines) == len(measured.figures)
    shown = dict(line.split() for line in lines)
    assert float(shown["z_rmse_um"]) == pytest.approx(measured.figures["z_rmse_um"], rel=1e-5)


@pytest.mark.parametrize("part", ["measured", "pressed", "reconstruction"])
def test_plots_have_mm_axes_and_are_pictures(measured, part):
    """Each has three panels in mm; a notebook gets the picture without being asked."""
    results = {
        "measured": measured,
        "pressed": measured.pressed,
        "reconstruction": measured.fringes.reconstruction,
    }
    drawing = results[part].plot()
    assert isinstance(drawing, Drawing)
    panels = drawing.axes[:3]
    assert {axes.get_xlabel() for axes in panels} == {"x (mm)"}
    picture = matplotlib.image.imread(io.BytesIO(drawing._repr_png_()))
    assert picture.shape[1] > 1000
    assert picture[..., :3].std() > 0.05
    shown = results[part]._repr_html_()
    assert "data:image/png;base64," in shown
    assert "<script" not in shown


def test_a_section_is_the_measured_face(measured):
    """The curve of the third panel is z along y = 0: of the truth within a few sigmas."""
    curves = {line.get_label(): line.get_xydata() for line in measured.plot().axes[2].lines}
    found, true = curves["measured"], curves["true"]
    inner = np.abs(found[:, 0]) < 8.0
    z_true = np.interp(found[inner, 0], true[:, 0], true[:, 1])
    # Cells of some 0.1 mm on slopes of up to 0.3: their means differ by where the points lie.
    assert np.abs(found[inner, 1] - z_true).max() < 0.02


def test_a_measurement_as_labelled_arrays(measured):
    data = measured.to_xarray()
    assert dict(data.sizes) == {"row": 183, "col": 242}
    assert data["z"].attrs["units"] == data["x"].attrs["units"] == "mm"
    assert data["deviation"].attrs["units"] == "um"
    valid = measured.points.valid
    np.testing.assert_array_equal(np.isfinite(data["z"]), valid)
    np.testing.assert_array_equal(data["mask_reason"] == 0, valid)
    error_um = data["deviation"].values[measured.points.valid & measured.truth.measured]
    assert np.sqrt(np.mean(error_um**2)) == pytest.approx(measured.figures["z_rmse_um"], rel=0.2)
    row, col = 90, 120
    point = data.sel(row=row, col=col)
    found = [float(point[name]) for name in "xyz"]
    np.testing.assert_allclose(found, measured.points.world_mm[row, col])


def test_a_press_as_labelled_arrays(measured):
    """Coordinates in mm: the face is looked up by place."""
    pressed = measured.pressed
    data = pressed.to_xarray()
    assert {data[name].attrs["units"] for name in ("x", "y", "face_x", "face_y")} == {"mm"}
    middle = data["face_z_mm"].sel(face_x=0.0, face_y=0.0, method="nearest")
    at = np.abs(pressed.face_y_mm).argmin(), np.abs(pressed.face_x_mm).argmin()
    assert float(middle) == pressed.face_z_mm[at]
    force_n = 1e-3 * float(data["pressure_kpa"].integrate(("x", "y")))
    assert force_n == pytest.approx(pressed.force_n, rel=1e-6)


def test_a_reconstruction_as_labelled_arrays(measured):
    data = measured.fringes.reconstruction.to_xarray()
    assert data["z_mm"].dims == ("row", "col")
    assert data["sigma_z_mm"].attrs["units"] == "mm"


def test_cells_hold_means():
    points = np.array([[0.1, 0.1], [0.4, 0.2], [1.2, 0.3], [0.2, 1.9]])
    cells = SquareCells.of(points, 1.0).means(np.array([1.0, 3.0, 5.0, 7.0]))
    np.testing.assert_array_equal(cells.mean, [[7.0, 0.0], [2.0, 5.0]])
    np.testing.assert_array_equal(cells.valid, [[True, False], [True, True]])
    assert cells.extent_mm == (0.0, 2.0, 0.0, 2.0)


def test_cells_that_are_too_small_are_refused():
    with pytest.raises(InputError, match="give more"):
        SquareCells.of(np.array([[0.0, 0.0], [10.0, 10.0]]), 1e-4)
    with pytest.raises(InputError, match="found 0"):
        SquareCells.of(np.array([[0.0, 0.0], [10.0, 10.0]]), 0.0)


def test_any_cloud_has_a_grid_without_many_gaps():
    rng = np.random.default_rng(1)
    points = rng.uniform(0.0, 10.0, (5000, 3))
    assert gridded(points, points[:, 2]).valid.mean() > 0.95


def test_a_capture_in_one_line_and_as_labelled_arrays(measured):
    capture = measured.fringes.capture
    frames = len(capture.patterns.frames)
    text = repr(capture)
    assert text.startswith(f"<Capture: {frames} frames of 183 x 242 pixels, values uint")
    assert f"steps of period {capture.patterns.period_px:g} px" in text
    data = capture.to_xarray()
    assert data["stack"].dims == ("frame", "row", "col")
    assert data["stack"].attrs["units"] == "DN"
    assert [str(name) for name in data["frame_name"].values] == [
        frame.name for frame in capture.patterns.frames
    ]
    np.testing.assert_array_equal(data["stack"].sel(row=90, col=120), capture.stack[:, 90, 120])


def test_a_capture_in_pictures(measured):
    """The mean over all frames shows the object, the greatest value whether a pixel saturates."""
    capture = measured.fringes.capture
    drawing = capture.plot()
    assert [axes.get_xlabel() for axes in drawing.axes[:3]] == ["column (px)"] * 3
    assert [axes.get_ylabel() for axes in drawing.axes[3:]] == ["grey value (DN)"] * 3
    mean, greatest = (axes.images[0].get_array() for axes in drawing.axes[1:3])
    np.testing.assert_allclose(mean, capture.stack.mean(axis=0))
    np.testing.assert_array_equal(greatest, capture.stack.max(axis=0))
    assert mean.mean() > 0.1 * greatest.mean()  # the picture is not black
    assert "data:image/png;base64," in capture._repr_html_()


def test_labels_of_neighbouring_panels_are_apart(measured):
    """All that belongs to a panel, labels included, ends 0.2 inches before the next one begins."""
    drawing = measured.fringes.capture.plot()
    drawing.png()
    boxes = sorted(axes.get_tightbbox().extents[[0, 2]].tolist() for axes in drawing.axes[:3])
    bars = sorted(axes.get_tightbbox().extents[2] for axes in drawing.axes[3:])
    gaps_in = [(box[0] - bar) / drawing.dpi for bar, box in zip(bars[:2], boxes[1:], strict=True)]
    assert min(gaps_in) > 0.2
