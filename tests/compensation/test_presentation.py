"""`twin.compensate`: the object in one line, as a table with maps, as labelled arrays."""

import re

import numpy as np
import pytest

import twin
from reconstruction.compensation import CompensatedSheet
from reconstruction.drawing import Drawing
from reconstruction.errors import InputError
from tests.compensation.test_command import LAYER, coat_map


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    """A ball of radius 4 under 0.2 mm of silicone, from points and a layer file."""
    file = tmp_path_factory.mktemp("layer") / "layer.toml"
    file.write_text(LAYER)
    return twin.compensate(coat_map(), file)


def test_points_and_a_layer_file_give_the_object(result):
    assert isinstance(result.compensated, CompensatedSheet)
    assert result.figures["part_1_form"] == "ball"
    assert result.figures["part_1_radius_mm"] == pytest.approx(4.0, abs=3e-3)


def test_both_results_have_a_short_text(result):
    force = rf"force {result.compensated.force_n:.3g} N \(standard uncertainty .* N\)"
    shown = rf"contact {result.compensated.area_mm2:.3g} mm\^2, {force}, highest pressure .* kPa"
    assert re.fullmatch(
        rf"<CompensationResult: {shown}, part 1 radius (3\.99|4\.00).. mm>", repr(result)
    )
    assert re.fullmatch(
        rf"<CompensatedSheet: \d+ x \d+ cells of 0\.\d+ mm, {shown}>", repr(result.compensated)
    )


def test_arrays_are_over_x_and_y_in_mm(result):
    for data in (result.to_xarray(), result.compensated.to_xarray()):
        assert data["coat_z_mm"].dims == ("y", "x")
        assert data["x"].attrs["units"] == data["thickness_mm"].attrs["units"] == "mm"
        assert data["pressure_kpa"].attrs["units"] == "kPa"
        assert float(data["thickness_mm"].sel(x=0, y=0, method="nearest")) < 0.2
    touched = data["clear_z_mm"].sel(x=0, y=0, method="nearest")
    coat = data["coat_z_mm"].sel(x=0, y=0, method="nearest")
    assert 0.1 < float(coat - touched) < 0.2


def test_the_figure_has_a_coat_a_pressure_and_a_section(result):
    for shown in (result, result.compensated):
        drawing = shown.plot()
        assert isinstance(drawing, Drawing)
        assert [axes.get_xlabel() for axes in drawing.axes[:3]] == ["x (mm)"] * 3
        assert [axes.get_ylabel() for axes in drawing.axes[3:]] == ["z (mm)", "pressure (kPa)"]
        assert "data:image/png;base64," in shown._repr_html_()
    section = {line.get_label(): line.get_xydata() for line in drawing.axes[2].lines}
    tip_mm = np.nanmax(section["object, in contact"][:, 1])
    assert 0.1 < section["coat"][:, 1].max() - tip_mm < 0.2


def test_missing_input_is_named():
    with pytest.raises(InputError, match="layer: found none"):
        twin.compensate(coat_map())
    with pytest.raises(InputError, match="measured is 3, of type int"):
        twin.compensate(3)
