"""The object behind the coat in studies: requested by name, computed with the nominal sheet."""

import pytest

from twin.config import load_experiment, vary
from twin.config.sensor_layer import sensor_layer_of
from twin.config.study import Study
from twin.propagation.trials import record_of
from twin.results.names import compensated_names
from twin.study.cases import cases_of
from twin.study.measuring import CaseMeasurer, Conditions

SMALL = {"camera.binning": 4, "press.cell_mm": 0.3}
THICKNESS = {
    "group": "elastomer",
    "key": "elastomer.thickness_mm",
    "distribution": "normal",
    "spread": 0.01,
    "source": "a gauge",
}


@pytest.fixture(scope="module")
def wrapped():
    return load_experiment("examples/wrapped_balls", SMALL)


def test_trials_take_the_nominal_sheet_for_all(wrapped):
    """A trial's own thickness is unknown to its user; a slab gives no object."""
    cases = record_of(wrapped, {"thickness": THICKNESS}, 3, budget=True).cases().run
    thicknesses = {case.experiment.elastomer.thickness_mm for case in cases}
    assert len(thicknesses) > 4
    assert {case.conditions.layer.elastomer.thickness_mm for case in cases} == {0.2}
    slab = load_experiment("examples/slab_balls")
    cases = record_of(slab, {"thickness": THICKNESS}, 3, budget=False).cases().run
    assert {case.conditions.layer for case in cases} == {None}


def test_a_study_that_names_the_object_has_it(wrapped):
    """With each case's own sheet: a study compares designs, which are known."""
    axis = {"path": "elastomer.thickness_mm", "values": [0.15, 0.2]}
    given = {"name": "thin", "base": "examples/wrapped_balls", "axis": [axis]}
    named = Study.model_validate(given | {"metrics": ["compensated_sphere_1_radius_mm"]})
    layers = [case.conditions.layer for case in cases_of(named, wrapped).run]
    assert [layer.elastomer.thickness_mm for layer in layers] == [0.15, 0.2]
    plain = Study.model_validate(given | {"metrics": ["sphere_1_radius_mm"]})
    assert {case.conditions.layer for case in cases_of(plain, wrapped).run} == {None}


def test_a_wrong_thickness_changes_the_object(mi, wrapped):
    """Sheet of 0.2 mm, taken as 0.2 and 0.21: the second ball is smaller by about 0.01 mm."""
    measurer, radii = CaseMeasurer(), []
    for thickness_mm in (0.2, 0.21):
        assumed = vary(wrapped, {"elastomer.thickness_mm": thickness_mm})
        figures = measurer(wrapped, Conditions(layer=sensor_layer_of(assumed))).figures
        assert compensated_names(wrapped) <= set(figures)
        radii.append(figures["compensated_sphere_1_radius_mm"])
    assert radii[0] == pytest.approx(4.0, abs=0.03)
    assert radii[0] - radii[1] == pytest.approx(0.0094, abs=0.0015)
