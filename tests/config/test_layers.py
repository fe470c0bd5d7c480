"""Layers as data: order, gaps of air, and one-line errors."""

import pytest

from twin.config import load_experiment, to_toml, validate_experiment
from twin.config.base import ConfigError
from twin.config.layers import Layer, holding_layer, media_of


def layer(bottom_mm, thickness_mm, ior=1.5):
    return Layer(bottom_mm=bottom_mm, thickness_mm=thickness_mm, ior=ior)


def seen_through(layers):
    return [(medium.top_mm, medium.ior) for medium in media_of(layers)]


def test_order_follows_from_the_heights():
    layers = {"window": layer(4.0, 3.0, 1.52), "gel": layer(0.0, 4.0, 1.41)}
    assert seen_through(layers) == [(7.0, 1.52), (4.0, 1.41)]
    assert holding_layer(layers) is layers["gel"]


def test_gaps_are_air():
    layers = {"window": layer(2.0, 3.0), "filter": layer(8.0, 1.0, 1.6)}
    assert seen_through(layers) == [(9.0, 1.6), (8.0, 1.0), (5.0, 1.5), (2.0, 1.0)]
    assert holding_layer(layers) is None


def test_a_layer_that_starts_below_the_coat_contains_it():
    layers = {"gel": layer(-1.0, 5.0)}
    assert seen_through(layers) == [(4.0, 1.5)]
    assert holding_layer(layers) is layers["gel"]


def test_rounded_heights_touch():
    """0.1 + 0.2 is not 0.3 in binary: no air gap of 5e-17 mm, and no overlap either."""
    layers = {"gel": layer(0.0, 0.3), "window": layer(0.1 + 0.2, 1.0)}
    assert [medium.ior for medium in media_of(layers)] == [1.5, 1.5]


def test_an_experiment_with_layers_loads_back(tmp_path):
    experiment = load_experiment("examples/gel_on_window")
    file = tmp_path / "experiment.toml"
    file.write_text(to_toml(experiment))
    assert load_experiment(file) == experiment
    assert validate_experiment(experiment.model_dump()) == experiment


REFUSED = [
    ({"layers.window.bottom_mm": 3.5}, "gel ends at 4 mm, window starts below that, at 3.5 mm"),
    ({"layers.gel.bottom_mm": -5.0}, "below the opaque coat"),
    ({"layers.gel.thickness_mm": 3.0}, "thickness_mm = 4 as elastomer.thickness_mm"),
    (
        {"layers.gel.bottom_mm": 0.5, "layers.gel.thickness_mm": 3.5},
        "found no layer round the coat",
    ),
    (
        {
            "layers.window.thickness_mm": 9.0,
            "camera.pose.standoff_mm": 12.0,
            "camera.focal_length_mm": 6.0,
        },
        "allowed below the cam",
    ),
    ({"layers.gel.ior": 0.9}, "layers.gel.ior: found 0.9"),
    ({"layers.gel.iro": 1.4}, "did you mean 'ior'"),
    ({"render.bounces": 2}, "set render.bounces = 0"),
    ({"render.engine": "stock"}, "set render.engine = 'one_trace'"),
    ({"modality": "direct_fpp"}, "remove the layers"),
]


@pytest.mark.parametrize(("changes", "message"), REFUSED)
def test_contradictions_are_rejected_in_one_line(changes, message):
    # otherwise the ranges of the data files cause the error
    values = {
        key: {"value": v, "source": "test"} if "mm" in key else v for key, v in changes.items()
    }
    with pytest.raises(ConfigError) as caught:
        load_experiment("examples/gel_on_window", values)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)
