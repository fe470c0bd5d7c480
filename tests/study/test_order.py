"""Neighbours share their stages; batches hold every case once and cut between stages."""

from itertools import pairwise

from twin.config import vary
from twin.study.cases import Case
from twin.study.order import batches_of, in_sharing_order

READS = (
    (("elastomer", "thickness_mm"),),
    (("coating", "base_albedo"),),
    (("patterns", "period_px"),),
)


def cases(base):
    """3 thicknesses x 4 coats x 5 periods, the thickness changing fastest."""
    return [
        Case(
            {"thickness": thickness, "albedo": albedo, "period": period},
            vary(
                base,
                {
                    "elastomer.thickness_mm": thickness,
                    "coating.base_albedo": albedo,
                    "patterns.period_px": period,
                },
            ),
            f"{thickness}{albedo}{period}",
        )
        for period in (12.0, 14.0, 16.0, 18.0, 20.0)
        for albedo in (0.2, 0.3, 0.4, 0.5)
        for thickness in (2.0, 3.0, 4.0)
    ]


def changes(ordered, name):
    values = [case.settings[name] for case in ordered]
    return sum(a != b for a, b in pairwise(values))


def test_early_stages_change_least(base):
    ordered = [case for _, case in in_sharing_order(cases(base), READS)]
    assert changes(ordered, "thickness") == 2
    assert changes(ordered, "albedo") == 3 * 4 - 1
    assert len({case.digest for case in ordered}) == 60


def test_batches_hold_all_and_share(base):
    """Per worker about six batches; none mixes two presses here, where a press has 20 cases."""
    for workers in (1, 2, 5):
        batches = batches_of(in_sharing_order(cases(base), READS), workers)
        digests = [case.digest for batch in batches for case in batch]
        assert len(digests) == len(set(digests)) == 60
        assert max(map(len, batches)) <= -(-60 // (6 * workers))
        ending = max(map(len, batches[-2 * workers :]))
        assert ending <= -(-60 // (12 * workers))  # workers end at about the same time
        assert all(len({case.settings["thickness"] for case in batch}) == 1 for batch in batches)


def test_order_is_kept_without_known_reads(base):
    given = cases(base)
    assert [case for _, case in in_sharing_order(given, ())] == given
    assert sum(map(len, batches_of(in_sharing_order(given, ()), 2))) == 60


def test_small_groups_of_the_first_stage_stay_together(base):
    """Nine cases under five calibrations, two workers: single cases would split each pair."""
    nine = [
        Case({"seed": n % 5}, vary(base, {"seed": n % 5, "press.depth_mm": 0.3 + 0.1 * n}), str(n))
        for n in range(9)
    ]
    reads = ((("seed",),), (("press", "depth_mm"),))
    batches = batches_of(in_sharing_order(nine, reads), 2)
    assert sorted(case.digest for batch in batches for case in batch) == list("012345678")
    seeds = [case.settings["seed"] for batch in batches for case in batch]
    assert sum(a != b for a, b in pairwise(seeds)) == 4
    homes = [{n for n, batch in enumerate(batches) if seed in seeds_of(batch)} for seed in range(5)]
    assert all(len(home) == 1 for home in homes)
    assert len(batches) >= 4


def seeds_of(batch):
    return {case.settings["seed"] for case in batch}
