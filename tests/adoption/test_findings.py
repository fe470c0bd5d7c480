"""The rig file: every field has value, range and source, also the assumed ones."""

import pytest

from reconstruction.characterise import UncertainValue
from twin.adoption.adopt import Given
from twin.adoption.fields import joint
from twin.adoption.findings import ModelRig, RigField, rig_tables, rows_of, validated, write_rig
from twin.config import load_experiment
from twin.config.base import ConfigError

EXPERIMENT = """name = "mine"
use = "./rig.toml"
[specimen]
kind = "ball"
diameter_mm = 6.0
[press]
use = "scenes/presses/draped_slab"
"""


def measured_field(path, value, uncertainty=None, source="measured: here"):
    return {path: RigField(path, value, uncertainty, source)}


def test_a_rig_file_is_taken_by_an_experiment(tmp_path):
    """Expected: measured values with their interval as range; all other fields as assumed."""
    gamma = RigField.measured("projector.gamma", UncertainValue(1.8, 0.02), "a fit")
    fields = (
        {gamma.path: gamma}
        | measured_field("camera.width_px", 400)
        | measured_field("camera.height_px", 300)
    )
    tables = rig_tables(ModelRig.read("rigs/slab"), fields)
    write_rig(tmp_path / "rig.toml", "bench", tables)
    (tmp_path / "mine.toml").write_text(EXPERIMENT)
    experiment = load_experiment(tmp_path / "mine.toml")
    assert experiment.projector.gamma == 1.8
    assert experiment.provenance["projector.gamma"].range == (1.76, 1.84)
    assert experiment.provenance["projector.gamma"].source == "measured: a fit"
    assert experiment.camera.width_px == 400
    flakes = experiment.provenance["coating.flake_fraction"]
    assert flakes.source.startswith("assumed: as in rigs/slab")
    assert "several angles" in flakes.source
    assert experiment.provenance["elastomer.thickness_mm"].source.endswith("twin identify")


def test_every_field_of_the_rooms_has_a_source():
    tables = rig_tables(ModelRig.read("rigs/slab"), {})
    sources = {path: source for path, _, _, source in rows_of(tables)}
    for room, count in (("camera", 12), ("projector", 9), ("coating", 5), ("elastomer", 3)):
        of_room = [source for path, source in sources.items() if path.startswith(f"{room}.")]
        assert len(of_room) > count
        assert all(source.startswith("assumed") for source in of_room)


def test_an_unusable_rig_is_rejected():
    tables = rig_tables(ModelRig.read("rigs/slab"), measured_field("projector.gamma", 9.0))
    with pytest.raises(ConfigError, match=r"projector\.gamma"):
        validated(tables)


def test_joint_uncertainty_grows_with_disagreement():
    """Equal weights: 1.0 and 1.2 of 0.1 each, chi-square 2; 1.0 and 2.0: 50, 0.1 sqrt(50 / 2)."""
    near = joint([UncertainValue(1.0, 0.1), UncertainValue(1.2, 0.1)])
    assert (near.value, near.uncertainty) == (pytest.approx(1.1), pytest.approx(0.1))
    far = joint([UncertainValue(1.0, 0.1), UncertainValue(2.0, 0.1)])
    assert far.uncertainty == pytest.approx(0.5)
    single = joint([UncertainValue(3.0, 0.2)])
    assert (single.value, single.uncertainty) == (3.0, pytest.approx(0.2))
    # Three that agree, with 0.1 each, are not averaged below 0.1.
    assert joint([UncertainValue(1.0, 0.1)] * 3).uncertainty == pytest.approx(0.1)


def test_options_are_given_together(tmp_path):
    with pytest.raises(ValueError, match="no capture"):
        Given(())
    with pytest.raises(ValueError, match="go together"):
        Given((tmp_path,), reference=tmp_path)
