"""The files of a measurement are labelled data sets: dimensions, coordinates, units, long names."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import xarray

from reconstruction.errors import InputError
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
        z_mm = data["z_mm"].sel(row=17, col=29)
        assert float(z_mm) == truth.points_world_mm[17, 29, 2]


def test_truth_comes_back_and_has_the_same_bytes(finished, tmp_path):
    truth = read_truth(finished / "truth.nc")
    write_truth(tmp_path / "again.nc", truth)
    assert (tmp_path / "again.nc").read_bytes() == (finished / "truth.nc").read_bytes()
    again = read_truth(tmp_path / "again.nc")
    for name in truth.__annotations__:
        np.testing.assert_array_equal(getattr(again, name), getattr(truth, name))


def test_a_full_disk_is_an_ordinary_error(finished):
    """HDF5 gets no error code: the process continues, and the first failure is raised."""
    truth = read_truth(finished / "truth.nc")
    with pytest.raises(OSError, match="No space left on device"):
        write_truth(Path("/dev/full"), truth)


@pytest.mark.parametrize("value", ["absent", "many", ["none"]])
def test_a_result_without_a_figure_is_refused(finished, tmp_path, value):
    """A word or a missing key is rejected as a figure; null is a figure without a value."""
    folder = tmp_path / "result"
    shutil.copytree(finished, folder)
    result = json.loads((folder / "result.json").read_text())
    result["metrics"]["z_rmse_um"] = None
    (folder / "result.json").write_text(json.dumps(result))
    assert read_measurement(folder).figures["z_rmse_um"] is None
    result["metrics"].pop("z_rmse_um")
    if value != "absent":
        result["metrics"]["z_rmse_um"] = value
    (folder / "result.json").write_text(json.dumps(result))
    with pytest.raises(InputError, match=r"result\.json: no z_rmse_um; measure again"):
        read_measurement(folder)
