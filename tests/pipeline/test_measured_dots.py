"""Printed dots through the whole twin: rendered, masked, tracked, compared with the mechanics."""

import numpy as np
import pytest
import xarray

from twin.config import load_experiment
from twin.pipeline import measure
from twin.report.photometric import sections, sentences
from twin.results.folder import read_measurement, write_measurement

DOTS = {
    "photometric.markers": {
        "pitch_x_mm": 2.2, "pitch_y_mm": 2.0, "radius_mm": 0.45, "relative_albedo": 0.2,
    },
    "photometric.presses.count": 4,
    "photometric.presses.smallest_diameter_mm": 5.5,
    "photometric.width_px": 160,
    "photometric.height_px": 120,
}  # fmt: skip


@pytest.fixture(scope="module")
def done(mi):
    return measure(load_experiment("examples/gelsight_ball", DOTS))


def test_dots_are_tracked_to_their_uncertainty(done):
    """Setup: a ball of 6.31 mm, 0.7 mm deep; displacements of 27 um RMS by the model.

    Expected: at most two of the dots in the image lost, none assigned wrongly; the error is below
    a third of the displacement, and 0.5 to 2 standard uncertainties; the error of the field
    between the dots is 0.5 to 1.5 of them.
    """
    figures = done.figures
    assert figures["dots_in_image"] >= 60
    assert figures["dots_tracked"] >= figures["dots_in_image"] - 2
    assert figures["dots_assigned_wrongly"] == 0
    assert 20.0 < figures["dots_true_displacement_rms_um"] < 35.0
    error_um = figures["dots_displacement_error_rms_um"]
    assert error_um < figures["dots_true_displacement_rms_um"] / 3.0
    assert 0.5 < figures["dots_error_over_sigma"] < 2.0
    assert 0.5 < figures["dots_field_error_over_sigma"] < 1.5
    assert done.warnings == tuple(line for line in done.warnings if "markers" not in line)


def test_the_folder_holds_the_displacements(done, tmp_path):
    """Expected: displacements with sigma and a picture; the same figures when it is read again."""
    write_measurement(tmp_path, "measure", done)
    with xarray.open_dataset(tmp_path / "markers.nc", engine="h5netcdf") as data:
        moved = np.stack([data.moved_x_mm.values, data.moved_y_mm.values], axis=-1)
        assert {"sigma_x_mm", "field_sigma_y_mm", "status"} <= set(data.variables)
    np.testing.assert_array_equal(moved, done.colours.dots.motion.moved_mm)
    assert (tmp_path / "markers.png").stat().st_size > 10_000
    again = read_measurement(tmp_path)
    assert again.colours.dots.figures == done.colours.dots.figures


def test_the_report_shows_them(done):
    titles = [section.title for section in sections(done)]
    assert "Printed dots" in titles
    assert any(line.startswith("printed dots: ") for line in sentences(done))
