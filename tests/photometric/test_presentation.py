"""A height map in one line, as a table with a picture, as labelled arrays."""

import numpy as np
import pytest

from reconstruction.drawing import Drawing
from reconstruction.errors import InputError
from reconstruction.photometric import HeightMap, PhotometricReason


@pytest.fixture
def ramp():
    """Heights that increase along the columns by 0.1 mm per mm; the first row is invalid."""
    col = np.arange(6) * 0.5
    height = np.tile(0.1 * col, (4, 1)).astype(np.float32)
    slopes = np.stack([np.zeros((4, 6)), np.full((4, 6), 0.1)]).astype(np.float32)
    reason = np.zeros((4, 6), np.uint8)
    reason[0] = next(code for code in PhotometricReason if code != PhotometricReason.VALID)
    return HeightMap(height, slopes, reason, 0.5)


def test_one_line(ramp):
    assert repr(ramp) == (
        "<HeightMap: 4 x 6 pixels of 0.5 mm, points 75.0 % of all pixels, heights 0 to 0.25 mm>"
    )


def test_labelled_arrays(ramp):
    data = ramp.to_xarray()
    assert data["height_mm"].dims == ("row", "col")
    assert data["height_mm"].attrs["units"] == data["x"].attrs["units"] == "mm"
    np.testing.assert_array_equal(data["x"], [-1.25, -0.75, -0.25, 0.25, 0.75, 1.25])
    np.testing.assert_array_equal(data["y"], [0.75, 0.25, -0.25, -0.75])
    valid = data["mask_reason"].values == 0
    points = np.stack(np.broadcast_arrays(data["x"].values, data["y"].values[:, None]), -1)[valid]
    np.testing.assert_allclose(points, ramp.points_mm()[:, :2])


def test_the_figure_is_over_x_and_y(ramp):
    drawing = ramp.plot()
    assert isinstance(drawing, Drawing)
    assert [axes.get_xlabel() for axes in drawing.axes[:3]] == ["x (mm)"] * 3
    assert [axes.get_ylabel() for axes in drawing.axes[3:]] == ["z (mm)", "slope (deg)"]
    (section,) = drawing.axes[2].lines
    x_mm, z_mm = section.get_xydata().T
    np.testing.assert_allclose(np.diff(z_mm) / np.diff(x_mm), 0.1, rtol=1e-5)
    assert "data:image/png;base64," in ramp._repr_html_()


def test_a_map_without_a_measurement_has_no_figure(ramp):
    empty = HeightMap(ramp.height_mm, ramp.slopes, np.ones((4, 6), np.uint8), 0.5)
    assert repr(empty).endswith("points 0.0 % of all pixels>")
    with pytest.raises(InputError, match="no valid pixel"):
        empty.plot()
