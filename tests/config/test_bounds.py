"""Physical ranges: every number of every document has two limits with a reason."""

import pytest

from twin.config import ConfigError, load_experiment
from twin.config.axis import Axis
from twin.config.board import BoardFile
from twin.config.inputs import Input
from twin.config.lamps import Lamp
from twin.config.problem import Free, SensorProblem
from twin.config.rows import Limit, Row
from twin.config.schema import experiment_keys, limits_at, list_keys
from twin.config.sensor_layer import SensorLayer
from twin.config.study import Constraint, Study

DOCUMENTS = (SensorLayer, Study, Axis, Constraint, SensorProblem, Free, Row, Limit)
OTHERS = (Input, Lamp, BoardFile)


def test_every_number_has_both_ends() -> None:
    """No number may be 1e300, for which the models were never tested."""
    keys = [*experiment_keys()]
    for document in (*DOCUMENTS, *OTHERS):
        keys += list_keys(document)
    numbers = [key for key in keys if key.allowed.startswith(("number,", "number", "integer"))]
    numbers = [key for key in numbers if not key.allowed.startswith("numbers")]
    assert len(numbers) > 250
    open_ended = [key.path for key in numbers if not {">", "<"} <= set(key.allowed)]
    assert not open_ended
    assert [key.path for key in keys if "Undefined" in key.allowed + key.default] == []


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("press.depth_mm", 1e9, "allowed >= 1e-06, <= 100 (1 nm, a few atoms, to 100 mm"),
        ("press.depth_mm", 5e-324, "allowed >= 1e-06, <= 100 (1 nm, a few atoms"),
        ("press.back_pressure_kpa", 1e9, "<= 1000 (1000 kPa is a workshop's compressed air"),
        ("elastomer.young_modulus_kpa", 1e300, "allowed >= 1, <= 1e+07 (1 kPa, jelly"),
        ("press.back_pressure_kpa", 5e-324, "allowed 0 or at least 0.0001"),
        ("elastomer.tack_j_m2", 1e-300, "allowed 0 or at least 1e-06"),
        ("elastomer.rim_compliance_mm2_per_n", 1e-9, "allowed 0 or at least 0.001"),
        ("camera.exposure_ms", 1e16, "allowed >= 0.0001, <= 1e+06 (100 ns"),
        ("camera.black_level_dn", 4095, "allowed less than 4095, the largest code of bit_depth"),
        ("camera.focal_length_mm", 300, "allowed more than focal_length_mm, 300: a lens forms"),
        ("camera.distortion", [1e300, 0, 0, 0, 0], "allowed >= -1e+06, <= 1e+06"),
        ("projector.flux_mw", 1e-300, "allowed >= 1e-12, <= 1e+06 (1 fW"),
        ("render.photons", 10**9, "allowed >= 1000, <= 1e+08 (each takes 50 bytes of memory"),
        ("specimen.x_mm", 1e9, "allowed >= -1000, <= 1000 (within 1 m"),
    ],
)
def test_a_number_out_of_physics_is_one_line_with_the_reason(
    key: str, value: object, message: str
) -> None:
    stated = {"value": value, "source": "test"}
    with pytest.raises(ConfigError) as caught:
        load_experiment("examples/wrapped_balls", {key: stated})
    text = str(caught.value)
    assert key.rpartition(".")[2] in text
    assert message in text
    assert "\n" not in text


def test_the_reason_is_in_the_list_of_keys() -> None:
    (depth,) = (key for key in experiment_keys() if key.path == "press.depth_mm")
    assert depth.meaning.endswith(
        "range: 1 nm, a few atoms, to 100 mm, the height of the largest specimen"
    )
    assert limits_at("press.depth_mm") == (1e-6, 100.0)
    assert limits_at("camera.exposure_ms") == (1e-4, 1e6)


def test_hints_are_only_for_the_keys_that_are_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    """A hint compares a key with every known key: 100 000 typos took minutes."""
    looked_up: list[str] = []
    monkeypatch.setattr("twin.config.schema._closest", lambda key, *_: looked_up.append(key))
    with pytest.raises(ConfigError) as caught:
        load_experiment("examples/slab_ball", {f"typo_{n}": 1 for n in range(500)})
    assert len(str(caught.value).splitlines()) == 21
    assert len(looked_up) == 20
