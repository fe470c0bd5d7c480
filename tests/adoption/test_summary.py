"""The summary of an adopted rig has at most nine lines, whatever was estimated."""

from types import SimpleNamespace

from twin.adoption.findings import NEEDS
from twin.adoption.summary import MOST_LINES, summary_of


def quantity(value, source, limits=None):
    return {"value": value, "source": source} | ({"range": limits} if limits else {})


def adopted(estimates, notes):
    measured = {
        f"pose_{number}_mm": quantity(1.5, "measured: here", [1.0, 2.0])
        for number in range(estimates)
    }
    assumed = {
        "f_number": quantity(8.0, f"assumed: as in rigs/slab{NEEDS}a calibrated light source"),
        "prnu_percent": quantity(0.5, f"assumed: as in rigs/slab{NEEDS}flat frames (--flat)"),
        "flux_mw": quantity(
            1.0, f"assumed: as in rigs/slab{NEEDS}a calibrated light source: it shows"
        ),
        "gap_mm": quantity(1.0, "assumed: as in rigs/slab"),
    }
    tables = {"camera": measured | assumed, "render": {"x": quantity(1.0, "assumed: y")}}
    return SimpleNamespace(tables=tables, notes=tuple(f"remark {n}" for n in range(notes)))


def test_few_estimates_are_all_printed():
    lines = summary_of(adopted(2, 1))
    assert lines == [
        "camera.pose_0_mm = 1.5 (95 %: 1 to 2)",
        "camera.pose_1_mm = 1.5 (95 %: 1 to 2)",
        "2 fields determined (2 measured), 4 assumed",
        "to determine more: a calibrated light source (2 fields); flat frames (--flat) (1 field)",
        "note: remark 0",
    ]


def test_many_estimates_and_remarks_are_counted():
    lines = summary_of(adopted(40, 12))
    assert len(lines) == MOST_LINES
    assert "37 more estimates in rig.toml" in lines
    assert lines[-1] == "10 more notes in result.json"
    assert sum(line.startswith("camera.pose") for line in lines) == 3
