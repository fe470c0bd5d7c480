"""The page on own data: its blocks run in their order, and each gives the stated result."""

import contextlib
import io
import shlex
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import twin
from reconstruction import read_capture, reconstruct
from reconstruction.writing import write_exr_channels
from tests.docs.documents import DOCS, Block, blocks
from tests.optics.measured_tables import matte_table
from twin.cli import run
from twin.config import load_experiment
from twin.mechanics.storage import read_press
from twin.specimens import height_above_lowest, shape_of

PAGE = "bring_your_own.md"


def block(start: str) -> Block:
    (result,) = (some for some in blocks(DOCS / PAGE) if some.text.startswith(start))
    return result


def run_commands(text: str) -> None:
    for line in text.splitlines():
        assert run(shlex.split(line)[1:]) == 0, line


def executed(start: str, variables: dict[str, Any]) -> str:
    """Run a block of Python and return its output."""
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec(compile(block(start).text, PAGE, "exec"), variables)
    return printed.getvalue()


@pytest.fixture
def folder(tmp_path, monkeypatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_height_map_is_the_same_in_each_format(folder):
    """Expected: four files give one relief, 0.2 mm high, and three presses one coated face."""
    variables = dict[str, Any]()
    executed("import imageio", variables)
    Path("my.toml").write_text(block('name = "my_relief"').text, encoding="utf-8")
    run_commands(block("twin press my.toml").text)
    write_exr_channels("relief.exr", {"Z": variables["z_mm"].astype(np.float32)})
    files = {"npy": {}, "exr": {}, "png": {"unit_mm": 1e-4}, "nc": {"unit_mm": 1e-3}}
    x_mm, y_mm = np.linspace(-2.0, 2.0, 33), np.linspace(-1.5, 1.5, 25)
    heights_mm = [
        height_above_lowest(specimen_from(f"relief.{suffix}", keys), x_mm, y_mm)
        for suffix, keys in files.items()
    ]
    assert np.ptp(heights_mm[0]) == pytest.approx(0.2, abs=2e-3)
    for other in heights_mm[1:]:
        np.testing.assert_allclose(other, heights_mm[0], atol=1.1e-4)
    faces = [read_press(folder / f"from_{name}" / "press.nc") for name in ("npy", "png", "netcdf")]
    assert np.ptp(faces[0].face_z_mm) > 0.1
    for face in faces[1:]:
        np.testing.assert_allclose(face.face_z_mm, faces[0].face_z_mm, atol=2e-4)


def specimen_from(file: str, keys: dict[str, float]) -> Any:
    changes = {f"specimen.{key}": value for key, value in keys.items()}
    return load_experiment("my.toml", {"specimen.file": file} | changes).specimen


def test_another_kind_by_a_dotted_key(folder):
    """Setup: part.stl is the ball of the experiment. Expected: its force is that of the ball."""
    ball = load_experiment("examples/slab_ball", {"press.solver_pitch_mm": 0.2})
    shape_of(ball.specimen).mesh(0.0).export("part.stl")
    run_commands(block("twin press examples/slab_ball").text)
    force_n = twin.press(ball).force_n
    forces_n = {name: read_press(folder / name / "press.nc").force_n for name in ("rod", "part")}
    assert forces_n["part"] == pytest.approx(force_n, rel=0.02)
    assert forces_n["rod"] > 1.2 * force_n
    printed = executed("import twin", {}).splitlines()
    page = (DOCS / PAGE).read_text(encoding="utf-8")
    shown = page.partition("    experiment ball")[2].partition("\n\n")[0].splitlines()
    assert len(printed) <= 20
    for line in shown[1:]:
        start = line.removeprefix("    ").removesuffix("...")
        assert any(some.startswith(start) for some in printed), start


def test_a_measured_coat_of_the_page(mi, folder):
    matte_table(folder / "my_coat.bsdf")
    text = block("[coating]").text
    Path("own.toml").write_text(f'name = "own"\nuse = "scenes/examples/slab_ball"\n{text}')
    coating = load_experiment("own.toml").coating
    assert (coating.kind, coating.wavelength_nm) == ("measured", 525)
    assert coating.bsdf()


def test_own_noise_is_in_the_images(mi, folder):
    """Expected: the coat's radius as without own noise within 5 %, and a warning with its name."""
    variables: dict[str, Any] = {"twin": twin}
    radius_mm = float(executed("def shot_and_row_noise", variables))
    done = variables["done"]
    assert any("shot_and_row_noise" in warning for warning in done.warnings)
    own = twin.measure(variables["ball"]).figures["sphere_1_radius_mm"]
    assert radius_mm != own
    assert radius_mm == pytest.approx(own, rel=0.05)


def test_own_decoder_own_calibration_and_normals(folder):
    """Expected: the points of the built-in decoder, and the imported rig is the capture's."""
    shutil.copytree(DOCS / "example_capture", "example_capture")
    variables = dict[str, Any]()
    assert "points 100.0 %" in executed("import numpy as np\nfrom", variables)
    capture = read_capture("example_capture")
    expected = reconstruct(capture).point_map
    points = variables["result"].point_map
    assert np.array_equal(points.valid, expected.valid)
    np.testing.assert_allclose(points.points_world_mm, expected.points_world_mm, atol=1e-4)
    executed("normals, valid", variables)
    assert 3.0 < variables["tilt_deg"].max() < 20.0
    executed("import cv2", variables)
    run_commands(block("twin import-calibration").text)
    shutil.copy("rig/calibration.yaml", "example_capture/calibration.yaml")
    rig, own = capture.calibration, read_capture("example_capture").calibration
    assert own.camera.fx_px == pytest.approx(rig.camera.fx_px)
    stated, imported = (
        np.linalg.inv(item.T_world_from_proj) @ item.T_world_from_cam for item in (rig, own)
    )
    np.testing.assert_allclose(imported, stated, atol=1e-6)
