"""The fields that a computation reads of an experiment are recorded while it runs."""

import copy
import json

import pytest

from reconstruction.errors import InputError
from twin.config import digest, vary
from twin.config.models import Film
from twin.pipeline.memory import Memo, Reads, values_at, watched


def reads_of(experiment, look):
    reads = Reads()
    look(watched(experiment, reads))
    return reads


def test_only_what_is_read_counts(base):
    reads = reads_of(base, lambda proxy: proxy.camera.pose.polar_deg + proxy.seed)
    assert reads.paths == (
        ("camera",),
        ("camera", "pose"),
        ("camera", "pose", "polar_deg"),
        ("seed",),
    )
    assert reads.hold_for(vary(base, {"camera.read_noise_e": 9.0}))
    assert not reads.hold_for(vary(base, {"camera.pose.polar_deg": 1.0}))
    assert not reads.hold_for(vary(base, {"seed": 5}))


@pytest.mark.parametrize(
    "look",
    [
        lambda proxy: proxy.model_dump(),
        lambda proxy: proxy.elastomer.model_copy(update={"layout": "contact_face"}).model_dump(),
        lambda proxy: proxy.elastomer == 3,
        lambda proxy: hash(proxy.elastomer),
        lambda proxy: repr(proxy.elastomer),
        lambda proxy: copy.copy(proxy.elastomer),
        lambda proxy: vars(proxy.elastomer) if hasattr(proxy.elastomer, "__dict__") else 0,
        digest,
    ],
)
def test_anything_but_a_field_reads_all(base, look):
    reads = reads_of(base, look)
    assert not reads.hold_for(vary(base, {"elastomer.shore_a": 12.0}))


def test_reads_of_several_stages_on_paper(base):
    """Expected: together, and read again from JSON, they hold where each of them does."""
    parts = [
        reads_of(base, lambda proxy: proxy.camera.pose.polar_deg),
        reads_of(base, lambda proxy: (proxy.seed, proxy.camera.model_dump())),
        reads_of(base, lambda proxy: proxy.camera.binning),
    ]
    for some in (parts, parts[::-1]):
        again = Reads.from_json(json.loads(json.dumps(Reads.union(some).as_json())))
        assert again.paths == Reads.union(some).paths
        assert again.hold_for(vary(base, {"elastomer.shore_a": 12.0}))
        for changes in ({"camera.read_noise_e": 9.0}, {"seed": 5}, {"camera.pose.polar_deg": 1.0}):
            assert not again.hold_for(vary(base, changes))


def test_what_a_copy_replaces_is_not_read(base):
    """A copy of a table in a copy of the whole: the rest is read where it is looked at."""

    def look(proxy):
        camera = proxy.camera.model_copy(update={"exposure_ms": 2.0 * proxy.camera.pose.polar_deg})
        changed = proxy.model_copy(update={"seed": 5, "camera": camera})
        return changed.seed, changed.camera.exposure_ms, changed.press.depth_mm

    reads = reads_of(base, look)
    for same in ({"seed": 9}, {"camera.exposure_ms": 3.0}, {"press.solver_pitch_mm": 0.2}):
        assert reads.hold_for(vary(base, same))
    for changes in ({"press.depth_mm": 0.6}, {"camera.pose.polar_deg": 1.0}):
        assert not reads.hold_for(vary(base, changes))


def test_properties_and_types_are_looked_through(base):
    reads = reads_of(base, lambda proxy: (proxy.elastomer.touched_plane_mm, proxy.bounces))
    assert ("elastomer", "thickness_mm") in reads.paths
    assert ("render", "bounces") in reads.paths
    assert ("elastomer", "shore_a") not in reads.paths
    assert isinstance(watched(base, Reads()).coating, type(base.coating))


def test_tables_that_may_be_absent(base):
    """The presence of a table counts even if no field in it was read."""
    reads = reads_of(base, lambda proxy: proxy.elastomer.film is None)
    film = Film(thickness_mm=0.1, young_modulus_kpa=100.0)
    assert reads.hold_for(base)
    assert not reads.hold_for(vary(base, {"elastomer.film": film.model_dump()}))


def test_tables_of_several_kinds_are_read_whole(base):
    reads = reads_of(base, lambda proxy: proxy.specimen.kind)
    assert reads.paths == (("specimen",),)
    assert not reads.hold_for(vary(base, {"specimen.separation_mm": 8.5}))


def test_files_count_by_their_content(base, tmp_path):
    mesh = tmp_path / "part.stl"
    mesh.write_bytes(b"first")
    experiment = vary(base, {"specimen": {"kind": "mesh", "file": str(mesh)}})
    reads = reads_of(experiment, lambda proxy: proxy.specimen)
    assert reads.hold_for(experiment)
    mesh.write_bytes(b"second")
    assert not reads.hold_for(experiment)


def test_values_of_another_experiment(base):
    paths = reads_of(base, lambda proxy: proxy.camera.pose.polar_deg).paths
    noisy = vary(base, {"camera.read_noise_e": 9.0})
    assert values_at(noisy, paths) == values_at(base, paths)
    assert values_at(vary(base, {"camera.pose.polar_deg": 1.0}), paths) != values_at(base, paths)


def test_memo_forgets_the_oldest_and_keeps_refusals(base):
    calls = []

    def albedo(proxy):
        calls.append(proxy.coating.base_albedo)
        if calls[-1] == 0.9:
            raise InputError("too bright")
        return calls[-1]

    memo, cases = Memo("albedo", 2), [vary(base, {"coating.base_albedo": a}) for a in (0.1, 0.2)]
    assert [memo.recall(case, (), albedo).value for case in cases * 2] == [0.1, 0.2] * 2
    assert calls == [0.1, 0.2]
    for _ in range(2):
        with pytest.raises(InputError, match="too bright"):
            memo.recall(vary(base, {"coating.base_albedo": 0.9}), (), albedo)
    assert calls == [0.1, 0.2, 0.9]
    memo.recall(cases[0], (), albedo)
    assert calls[-1] == 0.1
    assert (
        memo.recall(cases[0], "other input", albedo).token
        != memo.recall(cases[0], (), albedo).token
    )
