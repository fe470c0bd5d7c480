"""The files of a measurement are labelled data sets: dimensions, coordinates, units, long names."""

from pathlib import Path

import numpy as np
import pytest
import xarray

from twin.results.folder import read_measurement
from twin.results.parts import read_truth, write_truth

FILES = ("truth.nc", "reconstruction.nc", "height_map.nc", "press.nc")


@pytest.mark.parametrize("name", FILES)
def test_every_variable_says_what_it_is_and_its_unit(finished, name):
    with xarray.open_dataset(finished / name, engine="h5netcdf") as data:
        assert data.data_vars
        for variable in data.variables.values():
            assert variable.attrs["units"]
            assert len(variable.attrs["long_name"]) > 5
            assert np.isfinite(variable.values).all()


def test_maps_are_looked_up_by_camera_pixel(finished):
    truth = read_measurement(finished).truth
    with xarray.open_dataset(finished / "truth.nc", engine="h5netcdf") as data:
        assert data["z_mm"].dims == ("row", "col")
        found = data["z_mm"].sel(row=17, col=29)
        assert float(found) == truth.points_world_mm[17, 29, 2]


def test_truth_comes_back_and_has_the_same_bytes(finished, tmp_path):
    truth = read_truth(finished / "truth.nc")
    write_truth(tmp_path / "again.nc", truth)
    assert (tmp_path / "again.nc").read_bytes() == (finished / "truth.nc").read_bytes()
    again = read_truth(tmp_path / "again.nc")
    for name in truth.__annotations__:
        np.testing.assert_array_equal(getattr(again, name), getattr(truth, name))


def test_a_full_disk_is_an_ordinary_error(finished):
    """HDF5 is not told: the process lives, and the first failure is raised."""
    truth = read_truth(finished / "truth.nc")
    with pytest.raises(OSError, match="No space left on device"):
        write_truth(Path("/dev/full"), truth)
