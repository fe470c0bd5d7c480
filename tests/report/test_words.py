"""Labels and units of everything that a report may show: made from the names, so over all names."""

import importlib
import pkgutil

import pytest
from pydantic import BaseModel

import twin.config
from twin.config import load_experiment
from twin.report.words import in_ascii, label_of, phrase, printed_sentence, split_unit
from twin.results.names import figure_names
from twin.study.derived import DERIVED

UNIT_WORDS = {
    f"{unit}{power}"
    for unit in ("mm", "um", "nm", "px", "deg", "rad", "kpa", "percent", "dn", "mw", "ms", "kg")
    for power in ("", "2", "3")
} | {"m2", "m3"}
"""Words of a name that can only be a unit."""


def fields_of_models(kind=BaseModel):
    for model in kind.__subclasses__():
        if model.__module__.startswith("twin."):
            yield from model.model_fields
        yield from fields_of_models(model)


@pytest.fixture(scope="module")
def names():
    """All keys of all files, and the figures of every kind of experiment."""
    for module in pkgutil.walk_packages(twin.config.__path__, "twin.config."):
        importlib.import_module(module.name)
    field_names = set(fields_of_models()) | set(DERIVED)
    for name in EXPERIMENTS:
        field_names |= figure_names(load_experiment(name))
    return sorted(field_names)


EXPERIMENTS = (
    "examples/gel_on_window", "examples/gelsight_ball", "examples/slab_balls", "examples/slab_rod",
    "examples/wrapped_bars", "examples/wrapped_balls", "examples/wrapped_nut",
)  # fmt: skip
"""One of each kind that has figures of its own."""


def test_no_label_keeps_a_part_of_its_unit(names):
    """Expected: no word of a label is a unit, and none ends in "per"; every unit has a sign."""
    assert len(names) > 300
    for name in names:
        label, unit = label_of(name)
        words = label.split()
        assert not UNIT_WORDS & set(words), (name, label)
        assert words[-1] != "per" or len(words) == 1, (name, label)
        assert not unit or not set("0123456789") & set(unit.removeprefix("1/")), (name, unit)


@pytest.mark.parametrize(
    ("name", "label", "unit"),
    [
        ("rim_compliance_mm2_per_n", "rim compliance", "mm²/N"),
        ("gain_dn_per_e", "gain", "DN/e⁻"),
        ("variance_dn2", "variance", "DN²"),
        ("contact_area_mm2", "contact area", "mm²"),
        ("force_per_depth_n_per_mm", "force per depth", "N/mm"),
        ("fill_mw_per_mm2", "fill", "mW/mm²"),
        ("dark_current_e_per_s", "dark current", "e⁻/s"),
        ("absorption_per_mm", "absorption", "1/mm"),
        ("density_kg_m3", "density", "kg/m³"),
        ("tack_j_m2", "tack", "J/m²"),
        ("standoff_mm", "standoff", "mm"),
        ("force_n", "force", "N"),
        ("sphere_1_radius_mm", "sphere 1 radius", "mm"),
        ("crb_radius_um_by_projector.pose.polar_deg", "crb radius by polar", "µm/°"),
        ("crb_radius_um_by_coating.base_albedo", "crb radius by base albedo", "µm"),
        ("completeness", "completeness", ""),
        ("n", "n", ""),
    ],
)
def test_units_are_written_as_people_write_them(name, label, unit):
    assert label_of(name) == (label, unit)


def test_a_phrase_of_the_sheets_keys():
    assert phrase({"rim_compliance_mm2_per_n": 0.0, "tack_j_m2": 0.05}) == (
        "rim compliance 0 mm²/N, tack 0.05 J/m²"
    )
    assert split_unit("mm") == ("mm", "")


def test_a_sentence_of_the_terminal_keeps_its_abbreviations_on_a_page():
    """A comparison's page contained "180.7 um rms"."""
    line = "object: deviation 180.7 um RMS on the 44 % of it; 3 um +- 2 um (k = 2)"
    assert printed_sentence(line) == (
        "Object: deviation 180.7 µm RMS on the 44 % of it; 3 µm ± 2 µm (k = 2)"
    )


@pytest.mark.parametrize(
    ("text", "plain"),
    [
        ("3.0001\N{NO-BREAK SPACE}mm ± 2.7 µm, −0.3 µm", "3.0001 mm +- 2.7 um, -0.3 um"),
        ("µm/°", "um/ deg"),
        ("0.1–0.2 mm², mm³", "0.1-0.2 mm2, mm3"),
    ],
)
def test_the_terminal_shows_ascii(text, plain):
    assert in_ascii(text) == plain
