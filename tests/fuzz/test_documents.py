"""Documents drawn from the config models are valid, or rejected with a message in lines."""

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from reconstruction.errors import InputError
from tests.fuzz.trees import damaged, documents
from twin.config.loading import load_experiment, to_toml, validate_experiment
from twin.config.models import Camera, Elastomer, Experiment, Press, Projector
from twin.config.problem import SensorProblem
from twin.config.schema import validated
from twin.config.study import Study
from twin.optics.coatings.flakes import Flakes

# The same cases in every run, and no time limit: the speed of the machine is not tested.
FUZZED = settings(
    max_examples=60,
    derandomize=True,
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
)
PART = settings(FUZZED, max_examples=40)
MOST_LINES, LONGEST_LINE = 300, 2000


def _refused_in_lines(error: InputError) -> None:
    lines = str(error).split("\n")
    assert 0 < len(lines) <= MOST_LINES
    assert max(map(len, lines)) <= LONGEST_LINE
    assert all(line.strip() for line in lines)


@FUZZED
@given(tree=documents(Experiment))
def test_an_experiment_is_valid_or_refused_in_lines(tree):
    try:
        result = validate_experiment(tree)
    except InputError as error:
        _refused_in_lines(error)
    else:
        assert validate_experiment(result.model_dump(mode="json")) == result
        assert to_toml(result)


@pytest.mark.parametrize(
    "name", ["examples/wrapped_group", "examples/gelsight_ball", "paper/bear", "examples/gauges"]
)
@PART
@given(data=st.data())
def test_a_shipped_experiment_with_faults_is_valid_or_refused_in_lines(name, data):
    tree = load_experiment(name).model_dump(mode="json")
    try:
        result = validate_experiment(data.draw(damaged(tree)))
    except InputError as error:
        _refused_in_lines(error)
    else:
        assert validate_experiment(result.model_dump(mode="json")) == result


@pytest.mark.parametrize(
    "model", [Camera, Projector, Elastomer, Flakes, Press, Study, SensorProblem]
)
@PART
@given(data=st.data())
def test_a_part_is_valid_or_refused_in_lines(model, data):
    try:
        result = validated(model, data.draw(documents(model)))
    except InputError as error:
        _refused_in_lines(error)
    else:
        assert isinstance(result, model)


@pytest.mark.parametrize("text", ["1.2.3 mm", ". mm", "1e5e5 mm", "--1 mm"])
def test_what_is_no_number_with_a_unit_is_refused_in_lines(text):
    with pytest.raises(InputError, match="thickness_mm"):
        load_experiment("examples/wrapped_nut", {"elastomer.thickness_mm": text})


def test_a_source_that_is_no_text_is_refused_in_a_line():
    with pytest.raises(InputError, match=r"thickness_mm\.source: found 3, allowed a text"):
        load_experiment(
            "examples/wrapped_nut", {"elastomer.thickness_mm": {"value": 1, "source": 3}}
        )
