"""Results of sweeps and comparisons in a notebook: one line, a table with a picture, arrays."""

import numpy as np
import pytest

from reconstruction.drawing import Drawing
from reconstruction.errors import InputError
from tests.study import synthetic
from twin.config import load_experiment
from twin.config.study import Study
from twin.pipeline.comparison import Comparison, Outcome
from twin.results.rows import draw_rows, rows_as_arrays
from twin.study.outcome import SweepOutcome
from twin.study.record import StudyRecord
from twin.study.sweep import sweep
from twin.study.workers import local_workers

ROWS = [
    {"kind": "a", "x_mm": 1, "z_um": 0.5, "feasible": True, "note": None},
    {"kind": "b", "x_mm": 2, "z_um": None, "feasible": False, "note": "failed"},
]


def test_columns_are_figures_or_texts():
    """Yes and no is neither; an absent figure is NaN, an absent text is empty."""
    data = rows_as_arrays(ROWS, ["kind", "x_mm", "z_um", "feasible", "note", "absent"]).to_xarray()
    assert set(data.data_vars) == {"kind", "x_mm", "z_um", "note"}
    np.testing.assert_array_equal(data["z_um"], [0.5, np.nan])
    assert data["note"].values.tolist() == ["", "failed"]


def test_only_columns_of_figures_are_drawn():
    panels = draw_rows(ROWS, "kind", ["note", "z_um", "x_mm"], by="kind").axes
    assert [axes.get_ylabel() for axes in panels] == ["z_um", "x_mm", ""]
    assert [line.get_xdata().tolist() for line in panels[1].lines] == [["a"], ["b"]]


@pytest.fixture(scope="module")
def swept(tmp_path_factory) -> SweepOutcome:
    albedo = {"path": "coating.base_albedo", "values": (0.1, 0.2, 0.5)}
    study = Study(name="test", base="examples/slab_balls", axis=(albedo,))
    record = StudyRecord(study, load_experiment("examples/slab_balls"))
    folder = tmp_path_factory.mktemp("sweep") / "store"
    return sweep(record, folder, local_workers(1), make_measurer=synthetic.Fake)


def test_a_sweep_in_a_notebook(swept):
    assert repr(swept).startswith("<SweepOutcome: cases with a result 3, done 3, run time ")
    data = swept.to_xarray()
    assert dict(data.sizes) == {"case": 3}
    np.testing.assert_allclose(data["coating.base_albedo"], [0.1, 0.2, 0.5])
    values = [row["value"] for row in swept.table.rows]
    np.testing.assert_allclose(data["value"], values)
    drawing = swept.plot()
    assert isinstance(drawing, Drawing)
    (axes,) = (one for one in drawing.axes if one.get_ylabel() == "value")
    assert axes.get_xlabel() == "coating.base_albedo"
    np.testing.assert_allclose(axes.lines[0].get_xydata()[:, 1], values)
    assert "data:image/png;base64," in swept._repr_html_()


def test_an_outcome_without_a_store_has_no_table(swept):
    with pytest.raises(InputError, match="no store"):
        SweepOutcome.together([swept]).plot()


def test_a_comparison_in_a_notebook():
    found = Comparison(
        (
            Outcome("nut", "", "contact_fpp", "1", {"z_rmse_um": 2.0, "completeness": 0.97}),
            Outcome("nut", "", "direct_fpp", failure="no <material>"),
        )
    )
    assert len(found) == 2
    assert [one.method for one in found] == ["contact_fpp", "direct_fpp"]
    assert repr(found) == (
        "<Comparison: nut, contact_fpp: error of z 2 um RMS, points on 97.0 %; "
        "nut, direct_fpp: no <material>>"
    )
    data = found.to_xarray()
    np.testing.assert_array_equal(data["z_rmse_um"], [2.0, np.nan])
    assert data["failure"].values.tolist() == ["", "no <material>"]
    panels = found.plot().axes
    assert [axes.get_ylabel() for axes in panels] == ["z_rmse_um", "completeness", ""]
    shown = found._repr_html_()
    assert "no &lt;material&gt;" in shown
    assert "data:image/png;base64," in shown
