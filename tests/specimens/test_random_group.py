"""The random group: parts keep their distance, lie on one plane, and have the stated sizes."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from twin.config import load_experiment
from twin.specimens import bodies
from twin.specimens.kinds.random_group import RandomGroup


@given(seed=st.integers(0, 2**32 - 1), count=st.integers(2, 6))
@settings(max_examples=20)
def test_outlines_keep_their_distance_inside_the_field(seed: int, count: int) -> None:
    group = RandomGroup(seed=seed, count=count, gap_mm=0.3)
    assert np.all(np.abs(group.places_mm) <= (group.field_mm - group.sizes_mm[:, None]) / 2)
    apart = np.linalg.norm(group.places_mm[:, None] - group.places_mm[None], axis=-1)
    least = (group.sizes_mm[:, None] + group.sizes_mm[None]) / 2 + 0.3
    np.fill_diagonal(apart, np.inf)
    assert np.all(apart >= least)


def test_parts_stand_on_one_plane_within_their_outline_circles() -> None:
    """Expected: equal lowest points; the highest at 0; no vertex outside the circle of its part."""
    group = RandomGroup(seed=3, count=8, smallest_mm=1.5, largest_mm=4.0)
    parts = bodies(group, 0.0)
    assert len(parts) == 8
    lowest = [float(part.mesh.bounds[0, 2]) for part in parts]
    assert np.ptp(lowest) < 1e-6
    assert max(float(part.mesh.bounds[1, 2]) for part in parts) == pytest.approx(0.0, abs=1e-9)
    for part, centre, size in zip(parts, group.places_mm, group.sizes_mm, strict=True):
        across = np.linalg.norm(part.mesh.vertices[:, :2] - centre, axis=1).max()
        # Balls are polyhedra, edges are rounded: at most the circle, at least the inscribed form.
        assert 0.45 * size < across <= 0.5 * size + 1e-6, part.name
        assert part.mesh.is_watertight


def test_sizes_are_log_uniform_and_forms_equally_frequent() -> None:
    groups = [RandomGroup(seed=seed, count=4, largest_mm=4.0) for seed in range(100)]
    sizes = np.concatenate([group.sizes_mm for group in groups])
    assert stats.kstest(sizes, stats.loguniform(2.0, 4.0).cdf).pvalue > 0.01
    forms = [name.partition("_")[2] for group in groups for name in group.components]
    names, counts = np.unique(forms, return_counts=True)
    assert set(names) == {"ball", "rod", "disc", "block"}
    assert stats.chisquare(counts).pvalue > 0.01


def test_another_seed_gives_another_group_and_the_same_one_the_same() -> None:
    one, two, again = (RandomGroup(seed=seed) for seed in (1, 2, 1))
    assert not np.array_equal(one.places_mm, two.places_mm)
    assert one.components == again.components


def test_the_material_of_the_group_is_that_of_its_parts() -> None:
    keys = {"kind": "random_group", "count": 3, "material": {"kind": "diffuse", "albedo": 0.3}}
    specimen = load_experiment("examples/gauges", {"specimen": keys}).specimen
    assert [part.material.albedo for part in bodies(specimen, 0.0)] == [0.3] * 3


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"smallest_mm": 6.0}, "allowed rising"),
        ({"largest_mm": 20.0}, "up to field_mm = 16"),
        ({"count": 60}, "count: found 60, of which"),
    ],
)
def test_faults(keys: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        RandomGroup(**keys)
