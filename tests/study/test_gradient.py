"""Gradient search: finds a known minimum within bounds, continues from the store."""

import numpy as np
import pytest

from reconstruction.errors import InputError
from tests.study.synthetic import Fake
from twin.config import ConfigError
from twin.config.schema import validated
from twin.config.study import Study
from twin.study.measuring import CaseResult
from twin.study.needed import bound_needed
from twin.study.record import StudyRecord, read_record
from twin.study.sweep import sweep
from twin.study.table import read_table
from twin.study.workers import local_workers

ALBEDO = {"path": "coating.base_albedo", "name": "albedo", "low": 0.1, "high": 0.9}
PERIOD = {"path": "patterns.period_px", "low": 8.0, "high": 40.0, "scale": "log"}
SEED = {"path": "camera.pose.standoff_mm", "name": "standoff", "low": 190.0, "high": 210.0}


class Valley(Fake):
    """exp of a bowl, lowest at albedo 0.4, period 20, with derivatives; and by the standoff."""

    def __call__(self, experiment, conditions=None):
        albedo, period = experiment.coating.base_albedo, experiment.patterns.period_px
        far = (experiment.camera.pose.standoff_mm - 204.0) / 10.0
        value = np.exp((albedo - 0.4) ** 2 + np.log(period / 20.0) ** 2 + albedo * far**2)
        figures = {
            "crb_radius_um": value,
            "crb_radius_um_by_coating.base_albedo": value * (2 * (albedo - 0.4) + far**2),
            "crb_radius_um_by_patterns.period_px": value * 2 * np.log(period / 20.0) / period,
            "warnings": [],
        }
        return CaseResult(figures)


def study(study_of, *axes, **keys):
    plan = {"objective": {"metric": "crb_radius_um"}} | keys.pop("gradient", {})
    return study_of(*axes, sampling={"method": "gradient"}, gradient=plan, **keys)


def searched(requested, base, folder):
    outcome = sweep(StudyRecord(requested, base), folder, local_workers(1), make_measurer=Valley)
    rows = read_table(folder).rows
    best = min((row for row in rows if row["feasible"]), key=lambda row: row["crb_radius_um"])
    return outcome, best


def test_search_finds_a_known_minimum(study_of, base, tmp_path):
    """Linear and logarithmic axes with derivatives, one by differences: within 40 cases."""
    outcome, best = searched(study(study_of, ALBEDO, PERIOD, SEED), base, tmp_path)
    assert best["albedo"] == pytest.approx(0.4, abs=0.01)
    assert best["patterns.period_px"] == pytest.approx(20.0, rel=0.01)
    assert best["standoff"] == pytest.approx(204.0, abs=0.3)
    assert outcome.states["done"] <= 40
    assert len(read_record(tmp_path).points) == outcome.states["done"]


def test_search_keeps_constraints_on_fields(study_of, base, tmp_path):
    bound = {"value": "coating.base_albedo", "per": "patterns.period_px", "at_least": 0.03}
    outcome, best = searched(study(study_of, ALBEDO, PERIOD, constraint=(bound,)), base, tmp_path)
    ratio = best["albedo"] / best["patterns.period_px"]
    assert 0.03 <= ratio <= 0.03 * (1 + 1e-3)
    rows = read_table(tmp_path).rows
    assert len(rows) == outcome.states["done"]  # those beyond the bound, too, as not feasible
    beyond = [row for row in rows if row["albedo"] / row["patterns.period_px"] < 0.03 * (1 - 1e-9)]
    assert [row["feasible"] for row in beyond] == [False] * len(beyond)


def test_search_continues_from_the_store(study_of, base, tmp_path):
    """A search with 3 cases continues to 40: stored cases are reused, the result is the same."""
    few = study(study_of, ALBEDO, PERIOD, gradient={"evaluations": 3})
    assert searched(few, base, tmp_path / "two")[0].states["done"] == 3
    more = study(study_of, ALBEDO, PERIOD)
    outcome, best = searched(more, base, tmp_path / "two")
    at_once, alike = searched(more, base, tmp_path / "one")
    assert best == alike
    assert outcome.finished == at_once.states["done"] == outcome.states["done"] + 3


def test_an_objective_without_derivatives_is_refused(study_of, base, tmp_path):
    second = study(study_of, ALBEDO, gradient={"objective": {"metric": "z_rmse_um"}})
    with pytest.raises(InputError, match="found no number of z_rmse_um"):
        searched(second, base, tmp_path)


@pytest.mark.parametrize(
    ("axis", "message"),
    [
        (ALBEDO | {"count": 3}, "low and high without count"),
        (ALBEDO | {"integer": True}, "no whole numbers"),
    ],
)
def test_axes_must_be_continuous(axis, message):
    tree = {"name": "x", "base": "examples/slab_balls", "axis": [axis]}
    tree |= {"sampling": {"method": "gradient"}, "gradient": {"objective": {"metric": "crb"}}}
    with pytest.raises(ConfigError, match=message):
        validated(Study, tree, "x: ")


@pytest.mark.parametrize(
    ("metrics", "keys", "needed"),
    [
        (("crb_radius_um", "force_n"), {}, "alone"),
        (("crb_radius_um", "z_rmse_um"), {}, "beside"),
        (("z_rmse_um",), {}, "no"),
        (("crb_radius_um",), {"keep": ("points",)}, "beside"),
        ((), {"objectives": ({"metric": "crb_radius_um"},)}, "beside"),
        (("crb_radius_um",), {"objectives": ({"metric": "object_rms_um"},)}, "beside"),
        (("crb_radius_um",), {"constraint": ({"value": "force_n", "at_most": 1},)}, "alone"),
    ],
)
def test_a_study_needs_the_stages_of_its_figures(study_of, metrics, keys, needed):
    axis = {"path": "coating.base_albedo", "values": [0.2, 0.4]}
    assert bound_needed(study_of(axis, metrics=metrics, **keys)) == needed


def test_a_study_of_bounds_renders_no_frame(study_of, base, tmp_path, monkeypatch):
    """Two coats, two periods: one press, one scene, two traces; no frame, no noise, no decoding."""
    from twin.pipeline import fringes, trace

    def refused(*_, **__):
        raise AssertionError("not needed for a bound")

    for module, name in ((trace, "light"), (trace, "tables_of"), (fringes, "expose_capture"),
                         (fringes, "reconstruct_moving")):  # fmt: skip
        monkeypatch.setattr(module, name, refused)
    counts = {}
    for name in ("patches_of", "load_face", "view_of"):
        plain = getattr(trace, name)

        def counted(*given, name=name, plain=plain):
            counts[name] = counts.get(name, 0) + 1
            return plain(*given)

        monkeypatch.setattr(trace, name, counted)
    albedo = {"path": "coating.base_albedo", "values": [0.2, 0.4]}
    period = {"path": "patterns.period_px", "values": [12.0, 18.0]}
    requested = study_of(albedo, period, metrics=("predicted_sigma_z_um", "force_n"))
    outcome = sweep(StudyRecord(requested, base), tmp_path, local_workers(1))
    assert outcome.states == {"done": 4}
    assert counts == {"load_face": 1, "view_of": 1, "patches_of": 2}
    rows = {
        (r["coating.base_albedo"], r["patterns.period_px"]): r for r in read_table(tmp_path).rows
    }
    assert rows[0.4, 12.0]["predicted_sigma_z_um"] < rows[0.4, 18.0]["predicted_sigma_z_um"]
