"""Arguments of a wrong type to the public calls: one line that names the allowed type, at once."""

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import twin
from reconstruction.errors import InputError

NAME = "examples/slab_balls"
FOR_EXPERIMENT = "give an experiment, as twin.load_experiment returns it"
FOR_PATH = "give a TOML file, or the name of a shipped one"


@cache
def loaded() -> Any:
    return twin.load_experiment(NAME)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: twin.measure(NAME), f"experiment is '{NAME}', of type str; {FOR_EXPERIMENT}"),
        (lambda: twin.measure(None), f"experiment is of type NoneType; {FOR_EXPERIMENT}"),
        (lambda: twin.press(Path(NAME)), f"Path.*; {FOR_EXPERIMENT}"),
        (lambda: twin.render(NAME, None), FOR_EXPERIMENT),
        (lambda: twin.vary(NAME, {}), FOR_EXPERIMENT),
        (lambda: twin.uncertainty(3), f"experiment is 3, of type int; {FOR_EXPERIMENT}"),
        (lambda: twin.render(loaded(), np.zeros(3)), r"face is of type ndarray; .*face_mesh"),
        (lambda: twin.vary(loaded(), ["a=1"]), "changes is of type list; give values by dotted"),
        (lambda: twin.vary(loaded(), {1: 2}), "path of a change is 1, of type int"),
        (lambda: twin.load_experiment(NAME, "a=1"), "changes is 'a=1', of type str"),
        (lambda: twin.vary(loaded(), {"press.depth_mm": np.ones(2)}), "found array"),
        (lambda: twin.measure(loaded(), memory={}), r"memory is of type dict; give a twin\.Memory"),
        (lambda: twin.measure(loaded(), trial=-1), "trial is -1; give a whole number from 0"),
        (lambda: twin.measure(loaded(), trial=0.5), "trial is 0.5; give a whole number from 0"),
        (lambda: twin.with_compensation(None), "done is of type NoneType"),
        (
            lambda: twin.compensate(None),
            "measured is of type NoneType; give a result of twin.measure",
        ),
        (lambda: twin.calibrate(None), "source is of type NoneType; give an experiment"),
        (lambda: twin.adopt(), "adopt: found no capture; give at least one folder"),
        (lambda: twin.load_experiment(None), f"path is of type NoneType; {FOR_PATH}"),
        (lambda: twin.load_experiment({"name": "x"}), f"path is of type dict; {FOR_PATH}"),
        (lambda: twin.load_study(3), f"path is 3, of type int; {FOR_PATH}"),
        (lambda: twin.load_problem(b"x"), f"path is of type bytes; {FOR_PATH}"),
    ],
)
def test_a_wrong_type_is_one_line(call: Callable[[], Any], message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        call()
    assert "\n" not in str(caught.value)
