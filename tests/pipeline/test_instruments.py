"""One specimen and one load, carried from the experiment's rig to another sensor."""

import pytest

from reconstruction.errors import InputError
from twin.config import load_experiment, vary
from twin.pipeline.comparison import PhotometricPlan, case_for


@pytest.fixture(scope="module")
def coarse():
    return load_experiment("examples/slab_ball", {"press.solver_pitch_mm": 0.4})


def test_a_load_is_carried_over(coarse):
    """Setup: a ball pressed 0.5 mm into the paper's sheet, then into the other sensor's gel.

    Expected: by force, the force of that depth, to the four digits kept, with its origin stated; by
    depth, the same depth; under force control either way round.
    """
    deep = vary(coarse, {"press.depth_mm": 0.5})
    by_force = case_for(deep, "photometric_stereo", PhotometricPlan())
    assert (by_force.press.control, by_force.press.depth_mm) == ("force", None)
    assert by_force.press.force_n > 0.01
    assert "0.5 mm deep" in by_force.provenance["press.force_n"].source
    assert by_force.press.solver_pitch_mm != deep.press.solver_pitch_mm
    by_depth = case_for(deep, "photometric_stereo", PhotometricPlan(match="depth"))
    assert by_depth.press.depth_mm == 0.5
    load = {"control": "force", "depth_mm": None, "force_n": by_force.press.force_n}
    pushed = vary(deep, {f"press.{name}": value for name, value in load.items()})
    again = case_for(pushed, "photometric_stereo", PhotometricPlan())
    assert again.press == by_force.press
    back = case_for(pushed, "photometric_stereo", PhotometricPlan(match="depth"))
    assert back.press.depth_mm == pytest.approx(0.5, rel=2e-3)


def test_an_experiment_with_lamps_stays_on_its_sensor():
    """The same gel for fringes and lamps: one rig, one press."""
    own = load_experiment("paper/gelsight_two_balls")
    case = case_for(own, "photometric_stereo", PhotometricPlan(rig="rigs/none"))
    assert case.model_dump(exclude={"provenance"}) == own.model_dump(exclude={"provenance"})
    assert case_for(own, "contact_fpp", PhotometricPlan()).elastomer == own.elastomer


def test_a_rig_without_lamps_is_refused(coarse):
    with pytest.raises(InputError, match="allowed 'photometric_stereo'"):
        case_for(coarse, "photometric_stereo", PhotometricPlan(rig="examples/gel_on_window"))
    with pytest.raises(InputError, match="photometric rig: rigs/paper"):
        case_for(coarse, "photometric_stereo", PhotometricPlan(rig="rigs/paper"))
    plan = PhotometricPlan(settings={"camera.binnning": 2})
    with pytest.raises(InputError, match="unknown key 'binnning'"):
        case_for(coarse, "photometric_stereo", plan)
