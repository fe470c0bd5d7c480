"""Axes and samplers: which points a study takes."""

import numpy as np
import pytest

from reconstruction.errors import InputError
from twin.assets import list_assets
from twin.config import ConfigError
from twin.config.axis import Axis
from twin.config.study import Study, load_study
from twin.study.cases import cases_of, point_count, points_of, shares_of
from twin.study.estimate import estimate
from twin.study.record import StudyRecord
from twin.study.remarks import remarks_of
from twin.study.store import Store

LOW_HIGH = {"path": "coating.base_albedo", "low": 0.1, "high": 0.5}
ROUGH = {"path": "coating.flake_roughness", "low": 0.1, "high": 0.9}


def test_levels_of_ranges():
    linear = Axis(path="a", low=1.0, high=3.0, count=3)
    assert [level.label for level in linear.levels()] == [1.0, 2.0, 3.0]
    log = Axis(path="a", low=0.01, high=1.0, count=3, scale="log")
    assert [level.label for level in log.levels()] == [0.01, 0.1, 1.0]
    whole = Axis(path="a", low=3, high=5, count=9, integer=True)
    assert [level.label for level in whole.levels()] == [3, 4, 5]
    assert all(isinstance(level.label, int) for level in whole.levels())


def test_grid_is_every_combination_in_order(study_of):
    study = study_of(LOW_HIGH | {"count": 2}, ROUGH | {"count": 3})
    labels = [tuple(level.label for level in point) for point in points_of(study)]
    assert labels == [(a, r) for a in (0.1, 0.5) for r in (0.1, 0.5, 0.9)]
    assert point_count(study) == 6


@pytest.mark.parametrize("method", ["latin_hypercube", "sobol"])
def test_samplers_fill_the_space(study_of, method):
    """Every 16th of each axis holds exactly one of 16 points, and the same seed the same points."""
    study = study_of(LOW_HIGH, ROUGH, sampling={"method": method, "count": 16, "seed": 3})
    shares = shares_of(study)
    for axis in range(2):
        assert sorted((shares[:, axis] * 16).astype(int)) == list(range(16))
    assert np.array_equal(shares, shares_of(study))
    for point in points_of(study):
        assert 0.1 <= point[0].label <= 0.5


def test_saltelli_changes_one_axis_at_a_time(study_of):
    study = study_of(LOW_HIGH, ROUGH, sampling={"method": "saltelli", "count": 8})
    a, b, ab_0, ab_1 = shares_of(study).reshape(4, 8, 2)
    assert np.array_equal(ab_0[:, 0], b[:, 0])
    assert np.array_equal(ab_0[:, 1], a[:, 1])
    assert np.array_equal(ab_1[:, 1], b[:, 1])
    assert point_count(study) == 32


def test_morris_walks_step_once_along_each_axis(study_of):
    study = study_of(LOW_HIGH, ROUGH, sampling={"method": "morris", "count": 5})
    for walk in shares_of(study).reshape(5, 3, 2):
        steps = np.abs(np.diff(walk, axis=0))
        assert np.allclose(np.sort(steps.sum(axis=0)), 2 / 3)
        assert ((steps > 0).sum(axis=1) == 1).all()


def test_choices_move_several_fields(base, tmp_path):
    """A choice may use a data file, and take a value away that the base has."""
    file = tmp_path / "mix.toml"
    file.write_text(
        """
        name = "mix"
        base = "examples/slab_balls"
        [[axis]]
        name = "mix"
        [axis.choices.A]
        elastomer.use = "materials/elastomers/silicone_a"
        [axis.choices.force]
        press = { control = "force", force_n = "200 mN", depth_mm = "absent" }
        """
    )
    study, loaded = load_study(file)
    by_name = {case.settings["mix"]: case.experiment for case in cases_of(study, loaded).run}
    assert by_name["A"].elastomer.shore_a == 20.0
    assert by_name["A"].press.depth_mm == loaded.press.depth_mm
    assert by_name["force"].press.force_n == 0.2
    assert by_name["force"].press.depth_mm is None


def test_values_outside_a_stated_range_are_warned_of_unless_they_have_a_source(study_of, base):
    """An error follows only where the value is outside the physical range of its key."""
    axis = {"path": "elastomer.shore_a", "values": [10.0, 30.0]}
    cases = cases_of(study_of(axis), base).run
    (remark,) = remarks_of({case.digest: {} for case in cases}, cases)
    assert remark.digests == (cases[1].digest,)
    assert "elastomer.shore_a = 30 is outside 5 to 15, the range of its source (" in remark.text
    sourced = cases_of(study_of(axis | {"source": "assumed: a harder mix"}), base).run
    assert remarks_of({case.digest: {} for case in sourced}, sourced) == ()
    with pytest.raises(ConfigError, match=r"elastomer.shore_a: found 500"):
        cases_of(study_of(axis | {"values": [500.0]}), base)


def test_repeats_and_modalities_multiply(study_of, base):
    study = study_of(LOW_HIGH | {"count": 2}, repeats=3, modalities=("contact_fpp", "direct_fpp"))
    cases = cases_of(study, base).run
    assert len({case.digest for case in cases}) == len(cases) == 12
    assert {case.settings["seed"] for case in cases} == {base.seed + i for i in range(3)}


def test_the_limit_counts_repeats_and_methods(study_of, base):
    albedo = {"path": "coating.base_albedo", "low": 0.1, "high": 0.9, "count": 100}
    hardness = {"path": "elastomer.shore_a", "low": 8, "high": 12, "count": 100}
    study = study_of(albedo, hardness, repeats=10)
    assert len(points_of(study)) == 10_000
    with pytest.raises(InputError, match=r"found 100010 cases .10001 points, 10 repeats, 1 method"):
        points_of(study_of({**albedo, "count": 10_001}, repeats=10))
    both = ("contact_fpp", "direct_fpp")
    with pytest.raises(InputError, match=r"found 200000 cases .*, 2 methods.*allowed up to 100000"):
        points_of(study_of(albedo, hardness, repeats=10, modalities=both))


def test_a_preview_of_a_large_study_is_short_and_has_every_level(study_of, base, tmp_path):
    albedo = {"path": "coating.base_albedo", "low": 0.1, "high": 0.9, "count": 50}
    hardness = {"path": "elastomer.shore_a", "low": 8, "high": 12, "count": 40}
    study = study_of(albedo, hardness, repeats=10)
    result = StudyRecord(study, base).first_look()
    assert 300 < len(result.run) <= 500
    for axis, levels in (("coating.base_albedo", 50), ("elastomer.shore_a", 40)):
        assert len({case.settings[axis] for case in result.run}) > 0.9 * levels
    expected = estimate(StudyRecord(study, base), result, Store(tmp_path / "none"), 1)
    assert expected.cases == pytest.approx(20_000, rel=0.02)
    small = study_of({**albedo, "count": 20})
    assert StudyRecord(small, base).first_look().step == 1


def test_constraints_on_fields_exclude_before_anything_runs(study_of, base):
    bound = {"value": "press.depth_mm", "per": "elastomer.thickness_mm", "at_most": 0.3}
    axis = {"path": "elastomer.thickness_mm", "values": [2.0, 3.0, 4.0]}
    result = cases_of(study_of(axis, constraint=(bound,)), base)
    assert [case.settings["elastomer.thickness_mm"] for case in result.run] == [3.0, 4.0]
    assert result.excluded == 1


@pytest.mark.parametrize(
    ("axis", "message"),
    [
        ({"path": "a.b"}, "takes one of values"),
        ({"path": "a.b", "values": [1], "low": 1.0, "high": 2.0}, "takes one of values"),
        ({"path": "a.b", "low": 2.0, "high": 1.0}, "allowed below high"),
        ({"path": "a.b", "low": 0.0, "high": 1.0, "scale": "log"}, "allowed above 0"),
        ({"path": "a.b", "values": [1, 1]}, "twice"),
        ({"path": "a.b", "values": [{"c": 1}]}, "use choices for tables"),
        ({"values": [1]}, "path: missing"),
        ({"choices": {"A": {}}}, "name: missing"),
        ({"path": "a b", "values": [1]}, "should match pattern"),
    ],
)
def test_bad_axes(axis, message):
    with pytest.raises(ValueError, match=message):
        Axis(**axis)


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"axis": ()}, "found 0, allowed 1 to 16"),
        ({"axis": (LOW_HIGH,)}, "a grid needs count or values"),
        ({"axis": (LOW_HIGH,), "sampling": {"method": "sobol"}}, "count: missing"),
        ({"axis": (LOW_HIGH | {"count": 2},) * 2}, "twice"),
        ({"axis": (LOW_HIGH,), "sampling": {"method": "optimise"}}, "need each other"),
    ],
)
def test_bad_studies(keys, message):
    with pytest.raises(ValueError, match=message):
        Study(name="test", base="examples/slab_balls", **keys)


@pytest.mark.parametrize(
    "name", [name for name in list_assets("scenes") if name.startswith("studies/")]
)
def test_shipped_studies_are_valid(name):
    """Every case of every ready study is a valid experiment; searches are valid at a corner."""
    study, loaded = load_study(name)
    if study.sampling.method in ("optimise", "gradient"):
        corner = tuple(axis.level_at(0.0) for axis in study.axis)
        assert cases_of(study, loaded, [corner]).run
    else:
        result = StudyRecord(study, loaded).cases()
        assert len(result.run) >= 10
        assert result.excluded == 0
