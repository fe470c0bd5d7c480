"""`twin sweep`: output, rejected input, and continuation of an earlier run."""

import csv
import io
import json
from pathlib import Path

import pytest
from markupsafe import escape

from reconstruction.errors import InputError
from tests.browser import assert_readable
from tests.study import synthetic
from twin.cli import run
from twin.results.bound import is_bound_name
from twin.study import pictures

STUDY = """
name = "small"
base = "examples/slab_balls"
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
    """`twin measure` on a case's experiment writes the same result.json, and also the bounds."""
    digest = table_of(capsys, swept)[2]["case"]
    case = swept / "out" / "cases" / digest
    assert {file.name for file in case.iterdir()} == {
        "result.json", "experiment.toml", "timings.json", "twin-manifest.txt"
    }  # fmt: skip
    assert run(["measure", str(case / "experiment.toml"), "-o", str(tmp_path / "one")]) == 0
    own_file, swept_one = (folder / "experiment.toml" for folder in (tmp_path / "one", case))
    assert own_file.read_bytes() == swept_one.read_bytes()
    alone, of_case = (
        json.loads((folder / "result.json").read_text()) for folder in (tmp_path / "one", case)
    )
    figures = alone["metrics"].items()
    alone["metrics"] = {name: value for name, value in figures if not is_bound_name(name)}
    assert alone == of_case
    assert json.loads((case / "result.json").read_text())["digest"] == digest


def test_a_second_run_continues(swept, capsys):
    first = table_of(capsys, swept)
    out = str(swept / "out")
    assert run(["sweep", str(swept / "small.toml"), "-o", out, "-j", "1"]) == 0
    said = capsys.readouterr()
    assert "nothing to do" in said.out
    assert "4 of them in the store" in said.err
    assert table_of(capsys, swept) == first


def test_dry_run_only_reports(swept, capsys, tmp_path):
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
    ("change", "message"),
    [
        (("base_albedo", "base_albdo"), "unknown key 'base_albdo' in [coating]; did you mean"),
        (("[0.3, 0.5]", "[0.3, 1.5]"), "coating.base_albedo: found 1.5, should be less than 1"),
        (("[8.0, 12.0]", "[8.0, 400.0]"), "elastomer.shore_a: found 400"),
        (("values", "valeus"), "unknown key 'valeus' in [axis.0]; did you mean 'values'?"),
        (("at_most = 0.3", ""), "constraint.0: found {'value': 'force_n'}, needs at_least"),
        (('"examples/slab_balls"', '"examples/slab_bals"'), "did you mean examples/slab_balls"),
        (('value = "force_n"\nat_most = 0.3', 'value = "press.depth_mm"\nat_most = 0.1'),
         "constraints exclude all 4"),
    ],
)  # fmt: skip
def test_bad_studies_give_an_error_of_one_line(change, message, tmp_path, capsys):
    file = tmp_path / "bad.toml"
    file.write_text(STUDY.replace(*change))
    assert run(["sweep", str(file), "-o", str(tmp_path / "out")]) == 2
    assert message in capsys.readouterr().err
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


@pytest.fixture
def faked(monkeypatch):
    """Sweeps with cases that are computed without a renderer."""
    from functools import partial

    from twin.study import sweep as module

    def use(measurer):
        monkeypatch.setattr(module, "sweep", partial(module.sweep, make_measurer=measurer))

    return use


def study_file(folder, *lines):
    file = folder / "study.toml"
    file.write_text("\n".join(['name = "test"', 'base = "examples/slab_balls"', *lines, ""]))
    return str(file)


ALBEDOS = ("[[axis]]", 'path = "coating.base_albedo"', "values = [0.2, 0.3]")


DEEP = 'source = "assumed: deeper than the slab"'


def test_a_sweep_reports_reasons_of_failures(tmp_path, capsys, faked):
    """Both cases fail: each reason with a file, exit code 1, also if a second run has no cases."""
    faked(synthetic.Failing)
    out = tmp_path / "out"
    command = ["sweep", study_file(tmp_path, *ALBEDOS), "-o", str(out), "-j", "1"]
    for _ in range(2):
        assert run(command) == 1
        said = capsys.readouterr().err
        assert "1 failed: coating.base_albedo: found 0.2, which this test refuses (see" in said
        assert "1 failed: ZeroDivisionError: broken (see" in said
        file = said.split("(see ")[1].split(")")[0]
        assert "failure" in json.loads(Path(file).read_text())


def test_a_sweep_with_some_failures_reports_them(tmp_path, capsys, faked):
    faked(synthetic.Failing)
    lines = [line.replace("0.3", "0.6, 0.7") for line in ALBEDOS]
    command = ["sweep", study_file(tmp_path, *lines), "-o", str(tmp_path / "out"), "-j", "1"]
    assert run(command) == 0
    said = capsys.readouterr()
    assert "2 done, 1 failed" in said.out
    assert "1 failed: coating.base_albedo: found 0.2" in said.err


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (["set.elastomer.layout = \"contact_face\"", "set.press.back_pressure_kpa = 0.0"],
         "layers: found none, elastomer.layout = 'contact_face' is seen through its gel"),
        (['set.press.depth_mm = { value = 9.0, source = "assumed: too deep" }'],
         "is not less than the slab's thickness"),
        (['set.elastomer.length_x_mm = { value = 5.0, source = "assumed: short" }'],
         "specimen: reaches from"),
        (['modalities = ["direct_fpp"]', 'set.specimen = { kind = "ball", diameter_mm = 8.0 }'],
         "specimen.material: found none for"),
        (['set.render.engine = "stock"', "set.camera.distortion = [0.1, 0.0, 0.0, 0.0, 0.0]"],
         "camera.distortion: stock Mitsuba cannot express it"),
        (["set.camera.depth_of_field = true", "set.render.samples = 1"], "render.samples: found 1"),
        (['set.mechanics.model = "neo_hookean"', "set.press.back_pressure_kpa = 1.0"],
         "has neither film"),
    ],
)  # fmt: skip
def test_dry_run_finds_unmeasurable_cases(tmp_path, capsys, lines, message):
    """The same words as the run's own, before anything is pressed; no case is left: exit code 2."""
    file = study_file(tmp_path, *lines, *ALBEDOS)
    assert run(["sweep", file, "-o", str(tmp_path / "out"), "--dry-run"]) == 2
    said = capsys.readouterr().err
    assert "2 of 2 cases cannot be measured" in said
    assert message in said
    assert not (tmp_path / "out").exists()


def test_dry_run_names_the_cases_that_cannot(tmp_path, capsys):
    lines = ["[[axis]]", 'path = "press.depth_mm"', "values = [0.3, 8.0]", DEEP, *ALBEDOS]
    assert run(["sweep", study_file(tmp_path, *lines), "-o", str(tmp_path), "--dry-run"]) == 0
    said = capsys.readouterr().err
    assert "2 of 4 cases cannot be measured: press.depth_mm: 8 mm is not less than" in said
    assert "(at press.depth_mm = 8.0, coating.base_albedo = 0.2)" in said


def test_dry_run_of_a_search_looks_along_its_axes(tmp_path, capsys):
    lines = [
        'sampling.method = "optimise"',
        'optimise = { trials = 9, objectives = [{ metric = "z_rmse_um" }] }',
        *("[[axis]]", 'path = "press.depth_mm"', "low = 0.3", "high = 8.0", DEEP),
    ]
    assert run(["sweep", study_file(tmp_path, *lines), "-o", str(tmp_path), "--dry-run"]) == 0
    assert "cases tried along the axes cannot be measured" in capsys.readouterr().err


def test_dry_run_checks_equal_fields_once(base, study_of, monkeypatch):
    """200 noise draws and codes of one press and one coat: one check."""
    from twin.study import measurable as module
    from twin.study.cases import cases_of

    checked = []
    check = module.check_measurable
    monkeypatch.setattr(module, "check_measurable", lambda e: (checked.append(e), check(e)))
    period = {"path": "patterns.period_px", "low": 10, "high": 28, "count": 10}
    cases = cases_of(study_of(period, repeats=20), base).run
    assert module.unmeasurable(cases) == {}
    assert (len(cases), len(checked)) == (200, 1)


def no_picture(*_):
    raise InputError("no renderer in this test")


@pytest.mark.parametrize("name", ["[/red]", "[bold]", "$\\bad{$", ":smile:", "<b>&"])
def test_any_name_is_printed_and_drawn(tmp_path, capsys, faked, monkeypatch, name):
    """Markup of Rich, Matplotlib and HTML in a name is printed unchanged."""
    faked(synthetic.Bowl)
    monkeypatch.setattr(pictures, "take_picture", no_picture)
    axis = ["[[axis]]", f"name = '{name}'", *ALBEDOS[1:]]
    choices = ["[[axis]]", 'name = "coat"', f"[axis.choices.'{name}']", "coating.flake_ior = 0.9"]
    file, out = study_file(tmp_path, *axis, *choices), str(tmp_path / "out")
    assert run(["sweep", file, "-o", out, "-j", "1"]) == 0
    assert run(["sweep", "best", out, "-b", "bowl"]) == 0
    printed, _, verdict = capsys.readouterr().out.rpartition("Build this: ")
    assert printed.count(name) == 2
    assert name in verdict
    assert run(["sweep", "report", out, "-b", "bowl", "-b", "slope"]) == 0
    assert escape(name) in (tmp_path / "out" / "report.html").read_text()
    if name == "<b>&":
        assert_readable(tmp_path / "out" / "report.html", tmp_path)


def test_no_name_is_a_formula_in_the_csv(tmp_path, capsys, faked):
    faked(synthetic.Bowl)
    label = "=cmd|' /C calc'!A0"
    choices = ["[[axis]]", 'name = "@coat"', f'[axis.choices."{label}"]', "coating.flake_ior = 0.9"]
    file, out = study_file(tmp_path, *choices), str(tmp_path / "out")
    assert run(["sweep", file, "-o", out, "-j", "1"]) == 0
    capsys.readouterr()
    assert run(["sweep", "table", out]) == 0
    head, *rows = csv.reader(io.StringIO(capsys.readouterr().out))
    assert head[0] == "'@coat"
    assert [row[0] for row in rows] == [f"'{label}"]
