"""The benchmarks of stack and sweep publish the comparison under equal conditions first."""

from types import SimpleNamespace

import pytest

from benchmarks import stack, sweep
from benchmarks.regression.registry import CASES

FIRST = {"stack": "stack_with_shadow_rays_over_one_frame", "sweep": "sweep_over_one_process"}


def test_a_stack_is_compared_with_shadow_rays_and_without(mi, monkeypatch):
    """Setup: 6 s with shadow rays, 4.5 s without, 5 s a stock frame."""
    from twin.optics import stock

    times = {"with": 6.0, "without": 4.5, "stock": 5.0}
    monkeypatch.setattr(stock, "render_frame", lambda *_: "stock")
    monkeypatch.setattr("benchmarks._harness.seconds", lambda call: times[call()])
    speed_ratios = stack.against_one_frame(
        SimpleNamespace(
            frames=54,
            stock_scene=lambda: None,
            trace=lambda: "without",
            with_shadow_rays=lambda: SimpleNamespace(trace=lambda: "with"),
        )
    )
    assert speed_ratios == {
        "stack_with_shadow_rays_over_one_frame": 1.2,
        "stack_without_shadow_rays_over_one_frame": 0.9,
        "stack_with_shadow_rays_s": 6.0,
        "stack_s": 4.5,
        "stock_frame_s": 5.0,
        "frames_per_s": 12.0,
    }


def test_shadow_rays_are_traced_when_asked_for(mi):
    case = stack.StackCase.of_film(4)
    assert not case.rig.shadows
    assert case.with_shadow_rays().rig.shadows


def test_a_sweep_leads_with_one_process():
    speed_ratios = sweep.gains(per_point_s=0.5, in_process_s=1.7, alone_s=18.5)
    assert list(speed_ratios.items()) == [
        ("over_one_process", 3.4),
        ("over_one_by_one", 37.0),
        ("points_per_hour", 7200),
    ]


@pytest.mark.parametrize("name", FIRST)
def test_the_table_leads_with_like_for_like(name):
    case = next(case for case in CASES if case.name == name)
    assert case.figures[0].name == FIRST[name]
