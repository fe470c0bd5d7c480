"""Coverage of the object's lengths: its counts, with measurements of known errors."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from benchmarks import object_coverage
from reconstruction.errors import InputError


def test_a_failed_sensor_is_counted_and_the_others_of_its_press_are_measured(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Setup: of three sensors the first fails, one is off by 1 u, one by 3 u; two presses."""

    def measure(experiment: Any, *, trial: int, **_: Any) -> Any:
        if trial == 1:
            raise InputError("no points")
        errors_um = {2: 4.0, 3: -12.0}
        length = SimpleNamespace(error=errors_um[trial], uncertainty=SimpleNamespace(standard=4.0))
        return SimpleNamespace(object=SimpleNamespace(quantity=lambda name: length))

    monkeypatch.setattr(object_coverage, "measure", measure)
    figures = object_coverage.coverage("radius", (2, 3), true_rig=True)
    assert figures == {
        "radius_coverage": 0.5,
        "radius_error_over_u": pytest.approx(np.sqrt(5.0)),
        "radius_error_um": pytest.approx(np.sqrt(80.0)),
        "radius_measured": pytest.approx(2 / 3),
    }
    printed = capsys.readouterr().out
    assert printed.count("sensor 1: no points") == 2
    assert "radius, press 2: errors (um) [  4. -12.]" in printed
    assert "press 0" not in printed
