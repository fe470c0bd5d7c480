"""Remedies of a thin sheet that touches too little: the smallest value that is sufficient."""

from pathlib import Path
from types import SimpleNamespace

import pytest

from reconstruction.errors import InputError
from twin.cli import forward
from twin.config import load_experiment
from twin.pipeline import contact_remedies as module
from twin.pipeline.contact_remedies import (
    ContactRemedy,
    contact_remedies,
    first_remedy,
    is_measured,
)

TENT = {"press.back_pressure_kpa": 0.0, "press.depth_mm": 0.5}


@pytest.fixture
def sufficient(monkeypatch):
    """Replace the presses: a value is sufficient from a threshold on, and fails above a limit."""
    values: dict[str, tuple[float, float]] = {}
    pressed: list[tuple[str, float]] = []

    def remedy(experiment, key, value):
        pressed.append((key, value))
        least, most = values.get(key, (1e9, 1e9))
        if value > most:
            raise InputError("press.back_pressure_kpa: the sheet is stable up to ...")
        return ContactRemedy(key, value, 0.4, ()) if value >= least else None

    monkeypatch.setattr(module, "_remedy", remedy)
    return values, pressed


@pytest.fixture(scope="module")
def tent():
    return load_experiment("examples/wrapped_balls", TENT)


def test_the_smallest_sufficient_value_of_each_number(sufficient, tent):
    """Expected: typical air of 0.03 /mm x 413 kPa x 0.2 mm = 2.5 kPa, of which half is enough."""
    values, pressed = sufficient
    values["press.back_pressure_kpa"] = (1.0, 2.0)
    values["press.depth_mm"] = (1.2, 9.0)
    done: list[float] = []
    remedies = contact_remedies(tent, done.append)
    assert [(item.key, item.value) for item in remedies] == [
        ("press.back_pressure_kpa", 1.2),
        ("press.depth_mm", 1.5),
    ]
    assert done == pytest.approx([1 / 3, 2 / 3, 1.0])
    assert len(pressed) <= 9


def test_a_value_without_equilibrium_is_no_remedy(sufficient, tent):
    """The typical pressure has no equilibrium; the next number is tried, and no more than that."""
    values, pressed = sufficient
    values["press.back_pressure_kpa"] = (0.0, 0.1)
    values["press.depth_mm"] = (0.0, 9.0)
    assert first_remedy(tent).key == "press.depth_mm"
    assert [key for key, _ in pressed] == ["press.back_pressure_kpa", "press.depth_mm"]
    assert contact_remedies(tent)[0].key == "press.depth_mm"


def test_only_values_above_the_present_one_are_tried(sufficient, tent):
    _, pressed = sufficient
    present = {"press.back_pressure_kpa": 2.6, "elastomer.tack_j_m2": 0.3}
    changed = load_experiment("examples/wrapped_balls", TENT | present)
    assert contact_remedies(changed) == []
    assert first_remedy(changed) is None
    assert all(value > 2.6 for key, value in pressed if key == "press.back_pressure_kpa")
    assert "elastomer.tack_j_m2" not in {key for key, _ in pressed}


def length(error_um, expanded_um, margin_um=None):
    return SimpleNamespace(
        measurand=SimpleNamespace(unit="mm"),
        error=error_um,
        margin=margin_um,
        uncertainty=SimpleNamespace(expanded=expanded_um),
    )


@pytest.mark.parametrize(
    ("lengths", "measured"),
    [
        ([length(-9.0, 12.0)], True),
        ([length(-9.0, 12.0), length(None, 0.0)], False),
        ([length(15.0, 250.0)], False),
        ([length(60.0, 5.0)], False),
        ([length(60.0, 5.0, margin_um=10.0)], True),
        ([length(9.0, 5.0, margin_um=-4.0)], False),
        ([], True),
    ],
)
def test_an_object_is_measured_within_its_limits(lengths, measured):
    score = SimpleNamespace(quantities=lengths, figures={"object_rms_um": 1.0})
    assert is_measured(score, 50.0) is measured


def test_an_object_without_lengths_needs_contact():
    score = SimpleNamespace(quantities=[], figures={"object_rms_um": None})
    assert not is_measured(score, 50.0)


def test_the_printed_command_has_the_settings_of_the_measurement(monkeypatch, capsys, tmp_path):
    monkeypatch.setattr(forward, "_measure", lambda loaded, *_: SimpleNamespace(experiment=loaded))
    monkeypatch.setattr("twin.report.object.is_touched_too_little", lambda _: True)
    deeper = ContactRemedy("press.depth_mm", 1.5, 0.4, ())
    monkeypatch.setattr(module, "first_remedy", lambda _: deeper)
    settings = ["press.depth_mm=0.5", "description=two balls"]
    forward.measure(Path("examples/wrapped_balls"), out=tmp_path, settings=settings)
    command = "measure examples/wrapped_balls -s press.depth_mm=0.5 -s 'description=two balls' -o"
    assert command in capsys.readouterr().out
