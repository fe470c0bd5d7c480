"""An experiment is printed in at most 20 lines: the values that differ from the defaults."""

import pytest

from twin.assets import list_assets
from twin.config import load_experiment, vary
from twin.config.base import ConfigError
from twin.config.overview import MOST_LINES, WIDTH

EVERY_TABLE = {
    "links": {"press.depth_mm": "elastomer.thickness_mm"},
    "stage.albedo": 0.2,
    "mechanics.tetrahedra": 5000,
    "optics.angle_deg": 25.0,
    "render.samples": 9,
    "decode.use": "both",
    "sigma.thickness_mm": 0.01,
    "measurand": [{"name": "radius", "quantity": "radius"}],
    "layers.window": {"bottom_mm": 20.0, "thickness_mm": 2.0, "ior": 1.5},
    "photometric.gamma": 2.0,
}
"""A value of each table that `examples/slab_ball` leaves at its default."""


def paragraph(text: str, table: str) -> str:
    """Return the values of a table, its lines joined."""
    lines = text.splitlines()
    start = next(i for i, line in enumerate(lines) if line.startswith(f"{table} "))
    rest = next((i for i in range(start + 1, len(lines)) if lines[i][0] != " "), len(lines))
    return " ".join(" ".join(lines[start:rest]).split()).removeprefix(f"{table} ")


def test_changed_values_come_first_and_defaults_are_left_out():
    changes = {"camera.binning": 2, "specimen.kind": "rod", "coating.base_albedo": 0.25}
    text = str(vary(load_experiment("examples/slab_ball"), changes))
    assert text.splitlines()[0] == "experiment ball (contact_fpp): 8 mm steel ball"
    assert paragraph(text, "camera").startswith("binning=2, ")
    assert paragraph(text, "coating").startswith("flakes, base_albedo=0.25, ")
    assert paragraph(text, "specimen").startswith("rod, ")
    assert paragraph(text, "patterns") == "period_px=18, steps=18"
    for default in ("noise_model", "decode", "edge_radius_mm", "gamma", "photometric", "stage"):
        assert default not in text


def test_a_default_that_is_set_is_not_shown():
    experiment = load_experiment("examples/slab_ball")
    assert str(vary(experiment, {"decode.use": "column"})) == str(experiment)
    assert paragraph(str(vary(experiment, {"decode.use": "row"})), "decode") == "use=row"


@pytest.mark.parametrize("name", ["examples/slab_ball", "examples/gauges", "paper/two_balls"])
def test_at_most_twenty_lines(name):
    experiment = load_experiment(name)
    for key, value in EVERY_TABLE.items():
        try:
            experiment = vary(experiment, {key: value})
        except ConfigError:
            assert key == "layers.window"  # direct FPP has no layers
    lines = repr(experiment).splitlines()
    assert 15 < len(lines) <= MOST_LINES
    assert max(map(len, lines)) <= WIDTH


def test_every_shipped_experiment_fits():
    for name in list_assets("scenes"):
        if name.startswith("examples/"):
            assert len(str(load_experiment(name)).splitlines()) <= MOST_LINES
