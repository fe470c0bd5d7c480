"""`twin sweep`: what it writes, what it refuses, and that it goes on where it was."""

import csv
import io
import json

import pytest

from twin.cli import run

STUDY = """
name = "small"
base = "paper/two_balls"
metrics = ["force_n", "z_rmse_um", "completeness"]
set.camera = { binning = 4, width_px = 640, height_px = 480 }
set.press = { relief_pitch_mm = 0.05, solver_pitch_mm = 0.16, back_pressure_kpa = 0.0 }
set.patterns.steps = 4

[[axis]]
path = "elastomer.shore_a"
values = [8.0, 12.0]

[[axis]]
path = "coating.base_albedo"
name = "albedo"
values = [0.3, 0.5]

[[constraint]]
value = "force_n"
at_most = 0.3
"""


@pytest.fixture(scope="module")
def swept(mi, tmp_path_factory):
    folder = tmp_path_factory.mktemp("sweep")
    (folder / "small.toml").write_text(STUDY)
    assert run(["sweep", str(folder / "small.toml"), "-o", str(folder / "out"), "-j", "1"]) == 0
    return folder


def table_of(capsys, folder):
    assert run(["sweep", "table", str(folder / "out")]) == 0
    return list(csv.DictReader(io.StringIO(capsys.readouterr().out)))


def test_table(swept, capsys):
    rows = table_of(capsys, swept)
    assert [(r["elastomer.shore_a"], r["albedo"]) for r in rows] == [
        ("8.0", "0.3"), ("8.0", "0.5"), ("12.0", "0.3"), ("12.0", "0.5")
    ]  # fmt: skip
    assert list(rows[0]) == [
        "elastomer.shore_a", "albedo", "case", "state", "reason", "feasible",
        "force_n", "z_rmse_um", "completeness",
    ]  # fmt: skip
    assert {row["state"] for row in rows} == {"done"}
    forces = [float(row["force_n"]) for row in rows]
    assert forces[0] == forces[1] < forces[2] == forces[3]
    assert [row["feasible"] for row in rows] == [str(force <= 0.3) for force in forces]


def test_a_case_is_a_measurement(swept, capsys, tmp_path):
    """`twin measure` on a case's experiment writes the very same result.json."""
    digest = table_of(capsys, swept)[2]["case"]
    case = swept / "out" / "cases" / digest
    assert {file.name for file in case.iterdir()} == {
        "result.json", "experiment.toml", "timings.json", "twin-manifest.txt"
    }  # fmt: skip
    assert run(["measure", str(case / "experiment.toml"), "-o", str(tmp_path / "one")]) == 0
    for name in ("result.json", "experiment.toml"):
        assert (tmp_path / "one" / name).read_bytes() == (case / name).read_bytes()
    assert json.loads((case / "result.json").read_text())["digest"] == digest


def test_goes_on_where_it_was(swept, capsys):
    first = table_of(capsys, swept)
    out = str(swept / "out")
    assert run(["sweep", str(swept / "small.toml"), "-o", out, "-j", "1"]) == 0
    said = capsys.readouterr()
    assert "nothing to do" in said.out
    assert "4 of them known" in said.err
    assert table_of(capsys, swept) == first


def test_dry_run_only_tells(swept, capsys, tmp_path):
    out = tmp_path / "none"
    assert run(["sweep", str(swept / "small.toml"), "-o", str(out), "--dry-run"]) == 0
    assert "4 cases, about " in capsys.readouterr().err
    assert not out.exists()


def test_csv_and_parquet(swept, capsys, tmp_path):
    assert run(["sweep", "table", str(swept / "out"), "--csv", str(tmp_path / "t.csv")]) == 0
    assert len((tmp_path / "t.csv").read_text().splitlines()) == 5
    parquet = pytest.importorskip("pyarrow.parquet")
    assert run(["sweep", "table", str(swept / "out"), "--parquet", str(tmp_path / "t.pq")]) == 0
    table = parquet.read_table(tmp_path / "t.pq")
    assert table.num_rows == 4
    assert str(table.schema.field("force_n").type) == "double"


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (("base_albedo", "base_albdo"), "unknown key 'base_albdo' in [coating]; did you mean"),
        (("[0.3, 0.5]", "[0.3, 1.5]"), "coating.base_albedo: found 1.5, should be less than 1"),
        (("[8.0, 12.0]", "[8.0, 40.0]"), "elastomer.shore_a: found 40, allowed 5 to 15"),
        (("values", "valeus"), "unknown key 'valeus' in [axis.0]; did you mean 'values'?"),
        (("at_most = 0.3", ""), "constraint.0: found {'value': 'force_n'}, needs at_least"),
        (('"paper/two_balls"', '"paper/two_bals"'), "did you mean paper/two_balls"),
        (('value = "force_n"\nat_most = 0.3', 'value = "press.depth_mm"\nat_most = 0.1'),
         "constraints exclude all 4"),
    ],
)  # fmt: skip
def test_bad_studies_are_told_in_one_line(change, told, tmp_path, capsys):
    file = tmp_path / "bad.toml"
    file.write_text(STUDY.replace(*change))
    assert run(["sweep", str(file), "-o", str(tmp_path / "out")]) == 2
    assert told in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_bad_folders(swept, tmp_path, capsys):
    (tmp_path / "mine").write_text("")
    assert run(["sweep", str(swept / "small.toml"), "-o", str(tmp_path)]) == 2
    assert "is no earlier run of twin sweep" in capsys.readouterr().err
    assert run(["sweep", "table", str(tmp_path)]) == 2
    assert "is no store of a sweep" in capsys.readouterr().err


def test_a_store_holds_one_version(swept, tmp_path, capsys):
    from shutil import copytree

    copytree(swept / "out", tmp_path / "out")
    mark = tmp_path / "out" / "store.json"
    mark.write_text(mark.read_text().replace('"mitsuba": "', '"mitsuba": "0.'))
    assert run(["sweep", str(swept / "small.toml"), "-o", str(tmp_path / "out")]) == 2
    assert "its cases were computed with mitsuba 0." in capsys.readouterr().err
