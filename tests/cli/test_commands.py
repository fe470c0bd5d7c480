"""The command line: output, rejected input, and no incomplete files after an error."""

import json
import os
import shutil
import subprocess
import sys
from importlib import metadata
from pathlib import Path

import h5netcdf
import numpy as np
import pytest
import trimesh

from tests.pictures import count_of, is_drawn
from twin.cli import run
from twin.cli.app import print_metrics
from twin.config import digest, load_experiment
from twin.optics.backend import find_backend
from twin.report.canvas import MEASURED

SMALL = ["-s", "camera.binning=4", "-s", "camera.width_px=968", "-s", "camera.height_px=732"]


@pytest.fixture(scope="module")
def measured(mi, tmp_path_factory):
    out = tmp_path_factory.mktemp("cli") / "measured"
    assert run(["measure", "examples/slab_balls", "-o", str(out), *SMALL]) == 0
    return out


def files_of(folder: Path) -> dict[str, bytes]:
    return {
        str(file.relative_to(folder)): file.read_bytes()
        for file in folder.rglob("*")
        if file.is_file()
    }


def error_of(capsys) -> str:
    return capsys.readouterr().err.strip().splitlines()[-1]


def test_measure_writes_its_contract(measured):
    assert {
        "result.json",
        "experiment.toml",
        "press.nc",
        "coated_face.ply",
        "truth.nc",
        "white.exr",
        "reconstruction.nc",
        "points.ply",
        "report.html",
    } <= {file.name for file in measured.iterdir()}
    result = json.loads((measured / "result.json").read_text())
    experiment = load_experiment(measured / "experiment.toml")
    assert result["digest"] == digest(experiment)
    assert result["metrics"]["wrong_order_pixels"] == 0
    assert {"mitsuba", "drjit", "numpy"} <= set(result["versions"])


def test_files_open_in_standard_tools(measured):
    points = trimesh.load(measured / "points.ply")
    result = json.loads((measured / "result.json").read_text())
    assert len(points.vertices) == result["metrics"]["points"]
    assert len(trimesh.load(measured / "coated_face.ply").faces) > 1e5
    for name in ("press.nc", "truth.nc", "reconstruction.nc", "capture/stack.nc"):
        with h5netcdf.File(measured / name) as file:
            assert file.variables


def test_same_experiment_same_bytes(measured, tmp_path):
    out = tmp_path / "again"
    line = ["measure", str(measured / "experiment.toml"), "-o", str(out), "--no-report"]
    assert run(line) == 0
    first, second = files_of(measured), files_of(out)
    assert first.pop("report.html")
    # The manifest has the digests of the times and of the report.
    for clocked in ("timings.json", "twin-manifest.txt"):
        assert first.pop(clocked)
        assert second.pop(clocked)
    pictures = {name for name in first if name.startswith("figures/")}
    assert pictures
    assert first.keys() - pictures == second.keys()
    first = {name: first[name] for name in second}
    assert [name for name in first if first[name] != second[name]] == []


def test_reconstruct_needs_no_renderer(measured, tmp_path):
    """A meta path hook refuses mitsuba and drjit in the child process."""
    program = """
        import sys
        class Refuse:
            def find_spec(self, name, path=None, target=None):
                if name.split(".")[0] in ("mitsuba", "drjit"):
                    raise ImportError(f"{name} is not here")
        sys.meta_path.insert(0, Refuse())
        from twin.cli import run
        sys.exit(run(sys.argv[1:]))
    """
    import textwrap

    out = tmp_path / "points"
    command = [sys.executable, "-c", textwrap.dedent(program), "reconstruct", str(measured)]
    done = subprocess.run([*command, "-o", str(out)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert files_of(measured)["reconstruction.nc"] == files_of(out)["reconstruction.nc"]
    # Its points have no colour, which is the deviation from a truth that a real capture lacks.
    first, second = (trimesh.load(folder / "points.ply") for folder in (measured, out))
    np.testing.assert_array_equal(first.vertices, second.vertices)


def test_render_then_reconstruct_is_measure(measured, tmp_path):
    out = tmp_path / "rendered"
    assert run(["render", str(measured / "experiment.toml"), "-o", str(out)]) == 0
    first, second = files_of(measured), files_of(out)
    for name in ("capture/stack.nc", "capture/calibration.yaml", "truth.nc", "press.nc"):
        assert first[name] == second[name]


def test_render_writes_frames_for_other_decoders(measured, tmp_path):
    """16-bit PNG hold the stack's digital numbers, EXR the linear radiance; truth is complete."""
    import imageio.v3 as imageio
    import OpenEXR

    out = tmp_path / "frames"
    few = ["-s", "patterns.steps=3", "--frames", "png", "--frames", "exr"]
    assert run(["render", str(measured / "experiment.toml"), "-o", str(out), *few]) == 0
    with h5netcdf.File(out / "capture" / "stack.nc") as file:
        names = [name.decode() for name in file["frame_name"][...]]
        stack = file["stack"][...]
    pngs = sorted((out / "frames_png").iterdir())
    assert [file.stem[3:] for file in pngs] == names
    for frame, file in zip(stack, pngs, strict=True):
        np.testing.assert_array_equal(imageio.imread(file), frame)
    white = out / "frames_exr" / f"{len(names) - 2:02d}_white.exr"
    assert OpenEXR.File(str(white)).channels()["Y"].pixels.shape == stack.shape[1:]
    with h5netcdf.File(out / "truth.nc") as file:
        length = sum(file[f"normal_{axis}"][...] ** 2 for axis in "xyz")
        hit = file["depth_mm"][...] > 0
        np.testing.assert_allclose(length[hit], 1.0, atol=1e-5)
        np.testing.assert_allclose(
            file["depth_mm"][...][hit], 214.0 - file["z_mm"][...][hit], atol=1e-3
        )


def test_press_by_force(tmp_path):
    out = tmp_path / "pressed"
    file = tmp_path / "e.toml"
    file.write_text(
        'name = "f"\nuse = "scenes/rigs/slab"\n[specimen]\nkind = "ball"\n'
        '[press]\ncontrol = "force"\nforce_n = 0.1\n',
        encoding="utf-8",
    )
    assert run(["press", str(file), "-o", str(out)]) == 0
    metrics = json.loads((out / "result.json").read_text())["metrics"]
    assert metrics["force_n"] == pytest.approx(0.1, rel=1e-4)
    assert is_drawn(out / "press.png", 10.0, 8.6)
    assert count_of(out / "press.png", MEASURED) > 300  # the coated face, in two sections


def test_press_reports_the_contact_transfer(tmp_path):
    """The relief is 50 % at a pitch of 2.40 thicknesses, 10 % at 1.32."""
    out = tmp_path / "pressed"
    coarse = ["-s", "press.relief_pitch_mm=0.05"]
    line = ["press", "examples/slab_balls", "--transfer", "--solid", "-o", str(out), *coarse]
    assert run(line) == 0
    metrics = json.loads((out / "result.json").read_text())["metrics"]
    thickness_mm = load_experiment(out / "experiment.toml").elastomer.thickness_mm
    assert metrics["half_contrast_pitch_mm"] == pytest.approx(2.40 * thickness_mm, rel=2e-3)
    assert metrics["tenth_contrast_pitch_mm"] == pytest.approx(1.32 * thickness_mm, rel=5e-3)
    assert metrics["transfer_computed_minus_closed_form"] < 1e-3
    assert (out / "transfer.csv").read_text().startswith("pitch_mm,closed_form,computed\n")
    assert is_drawn(out / "transfer.png", 7.0, 3.6)
    assert metrics["mechanics_model"] == "spectral"
    assert trimesh.load(out / "slab.stl").is_watertight
    with h5netcdf.File(out / "in_plane.nc") as file, h5netcdf.File(out / "press.nc") as press:
        assert file["u_x_mm"].shape == press["face_z_mm"].shape


THIN = [
    "-s", 'specimen={kind = "ball", diameter_mm = 4.0}',
    "-s", 'elastomer.length_x_mm={value = 9.0, source = "test"}',
    "-s", 'elastomer.length_y_mm={value = 8.0, source = "test"}',
    "-s", "elastomer.thickness_mm=0.3", "-s", "press.depth_mm=0.6",
    "-s", "press.cell_mm=0.25", "-s", "press.relief_pitch_mm=0.05",
]  # fmt: skip


def test_press_of_a_thin_sheet(tmp_path):
    """The solid has the sheet's volume; the pressure gives the relief of a ridge in the coat."""
    import imageio.v3 as imageio

    out = tmp_path / "pressed"
    line = ["press", "examples/wrapped_balls", "--transfer", "--solid", "-o", str(out), *THIN]
    assert run(line) == 0
    metrics = json.loads((out / "result.json").read_text())["metrics"]
    assert metrics["mechanics_model"] == "sheet"
    assert 0.2 < metrics["thinnest_mm"] < 0.3
    assert 1.05 < metrics["largest_stretch"] < 1.5
    assert 20 < metrics["steepest_deg"] < 90
    assert metrics["contact_pressure_kpa"] == 3.0
    assert metrics["ridge_mm"] == 0.07
    assert 1.0 < metrics["tenth_contrast_pitch_mm"] / 0.3 < metrics["half_contrast_pitch_mm"] / 0.3
    body = trimesh.load(out / "slab.stl")
    assert body.is_watertight
    assert body.volume == pytest.approx(0.3 * 9.0 * 8.0, rel=0.01)
    assert not (out / "in_plane.nc").exists()
    # Relief, pressure, two sections, and below them the sheet's own maps.
    assert imageio.imread(out / "press.png").shape[0] == 1508


@pytest.mark.parametrize("name", ["examples/gel_on_window", "examples/group_on_pad"])
def test_press_of_a_gel_on_a_window(tmp_path, name):
    out = tmp_path / "pressed"
    assert run(["press", name, "-o", str(out)]) == 0
    metrics = json.loads((out / "result.json").read_text())["metrics"]
    assert metrics["force_n"] > 0
    assert metrics["relief_peak_mm"] == pytest.approx(metrics["depth_mm"], abs=2e-3)


ON_WINDOW = ["-s", "elastomer.layout=contact_face", "-s", "press.back_pressure_kpa=0"]
REFUSED = [
    (["measure", "nowhere.toml"], "nowhere.toml: not found"),
    (["measure", "examples/slab_balls", "-s", "elastomer.thicknes_mm=2"], "did you mean"),
    (["measure", "examples/slab_balls", "-s", "press.depth_mm"], "write KEY=VALUE"),
    (["measure", "examples/slab_balls", "-s", "press.depth_mm=30"], "press.depth_mm"),
    (["press", "examples/slab_balls", "-s", "specimen.x_mm=8.0"], "free span"),
    (["reconstruct", "nowhere"], "no capture.toml"),
    (["measure", "examples/slab_balls", *ON_WINDOW], "add [layers.gel]"),
]


@pytest.mark.parametrize(("arguments", "message"), REFUSED)
def test_bad_input_gives_one_line_and_no_files(tmp_path, capsys, arguments, message):
    out = tmp_path / "out"
    assert run([*arguments, "-o", str(out)]) == 2
    assert message in error_of(capsys)
    assert list(tmp_path.iterdir()) == []


def test_a_truncated_stack_is_refused_and_keeps_the_earlier_result(measured, tmp_path, capsys):
    capture = tmp_path / "capture"
    shutil.copytree(measured / "capture", capture)
    out = tmp_path / "points"
    assert run(["reconstruct", str(capture), "-o", str(out)]) == 0
    before = files_of(out)
    stack = capture / "stack.nc"
    stack.write_bytes(stack.read_bytes()[:-1000])
    assert run(["reconstruct", str(capture), "-o", str(out)]) == 2
    assert "stack.nc" in error_of(capsys)
    assert files_of(out) == before
    assert sorted(file.name for file in tmp_path.iterdir()) == ["capture", "points"]


def test_output_over_something_else_is_refused(measured, tmp_path, capsys):
    (tmp_path / "precious.txt").write_text("mine")
    for out in (tmp_path, tmp_path / "precious.txt", tmp_path / "precious.txt" / "below"):
        assert run(["reconstruct", str(measured), "-o", str(out)]) == 2
        assert "choose another -o DIR" in error_of(capsys)
    assert (tmp_path / "precious.txt").read_text() == "mine"


def test_a_report_drawn_later_is_the_one_drawn_at_once(mi, measured, tmp_path):
    """Expected: the same page of a measurement, the same pictures of a press and a rendering."""
    out = tmp_path / "measured"
    shutil.copytree(measured, out)
    (out / "report.html").unlink()
    shutil.rmtree(out / "figures")
    assert run(["report", str(out)]) == 0
    assert (out / "report.html").read_bytes() == (measured / "report.html").read_bytes()
    for command, picture in (("press", "press.png"), ("render", "frames.png")):
        at_once, later = tmp_path / f"{command}_1", tmp_path / f"{command}_2"
        line = [command, "examples/slab_balls", *SMALL, "-s", "press.relief_pitch_mm=0.05"]
        assert run([*line, "-o", str(at_once)]) == 0
        shutil.copytree(at_once, later)
        (later / picture).unlink()
        assert run(["report", str(later)]) == 0
        assert (later / picture).read_bytes() == (at_once / picture).read_bytes()


def test_report_of_something_else_is_refused(tmp_path, capsys):
    assert run(["report", str(tmp_path)]) == 2
    assert str(tmp_path) in error_of(capsys)


def test_init_writes_a_valid_experiment_once(tmp_path, capsys):
    file = tmp_path / "mine.toml"
    assert run(["init", str(file)]) == 0
    assert load_experiment(file).specimen.kind == "step"
    assert run(["init", str(file)]) == 2
    assert "exists already" in error_of(capsys)


def test_doctor_and_keys_answer(mi, capsys):
    assert run(["doctor"]) == 0
    assert find_backend().variant in capsys.readouterr().out
    assert run(["keys"]) == 0
    assert "coating(flakes).base_albedo" in capsys.readouterr().out


def test_unknown_command_is_one_line(capsys):
    assert run(["mesure"]) == 2
    assert "Did you mean" in error_of(capsys)


def test_missing_backend_is_exit_code_three(tmp_path):
    environment = os.environ | {
        "DRJIT_LIBLLVM_PATH": str(tmp_path / "absent.so"),
        "TWIN_BACKEND": "llvm",
        "XDG_CACHE_HOME": str(tmp_path / "cache"),
    }
    done = subprocess.run(
        [sys.executable, "-c", "from twin.cli import main; main()", "render", "examples/slab_balls",
         "-o", str(tmp_path / "out"), *SMALL],
        capture_output=True, text=True, check=False, env=environment,
    )  # fmt: skip
    assert done.returncode == 3
    assert "absent.so does not work" in done.stderr.splitlines()[-1]
    assert not (tmp_path / "out").exists()


def test_an_overexposed_measurement_reports_why_instead_of_failing(mi, tmp_path, capsys):
    """Everything saturated: no point, no fit, still a result and a report."""
    out = tmp_path / "bright"
    settings = [*SMALL, "-s", "camera.exposure_ms=5000.0"]
    assert run(["measure", "examples/slab_balls", "-o", str(out), *settings]) == 0
    metrics = json.loads((out / "result.json").read_text())["metrics"]
    assert metrics["points"] == 0
    assert metrics["saturated_share"] > 0.3
    assert [line.split(":")[0] for line in metrics["unfitted_balls"]] == ["ball 1", "ball 2"]
    assert "ball 1: " in capsys.readouterr().out
    assert "ball 1: " in (out / "report.html").read_text()


def test_version_is_that_of_the_package(capsys):
    run(["--version"])
    assert capsys.readouterr().out.strip() == metadata.version("fringe-twin")


def test_tables_print_names_as_they_are(capsys):
    print_metrics({"[/red]": "[bold]x", "absent_um": None})
    printed = capsys.readouterr().out
    assert "[/red]" in printed
    assert "[bold]x" in printed
    assert "None" not in printed
