"""The benchmark of the live view: moves of the sliders, and updates that are not possible."""

from types import SimpleNamespace
from typing import Any

import pytest

from benchmarks import view
from reconstruction.errors import InputError
from twin.viewer.sliders import SliderRange


@pytest.mark.parametrize(
    ("value", "expected"), [(2.0, 2.4), (0.0, 1.0), (4.9, 3.92), (-0.5, -0.4), (5.0, 4.0)]
)
def test_every_slider_moves_within_its_range(value: float, expected: float) -> None:
    slider = SliderRange("press", "press.x_mm", "x, mm", 0.0 if value >= 0.0 else -1.0, 5.0, value)
    assert view.moved(slider, 0.2) == pytest.approx(expected)


def test_an_update_that_fails_has_no_time(capsys: pytest.CaptureFixture[str]) -> None:
    def show(changes: dict[str, float]) -> Any:
        raise InputError("no equilibrium")

    times = [view._spent(SimpleNamespace(show=show), {"press.depth_mm": 9.0}), 0.5, 0.2]
    assert "no equilibrium" in capsys.readouterr().out
    assert view.largest(times) == 0.5
    assert view.largest(times[:1]) is None
