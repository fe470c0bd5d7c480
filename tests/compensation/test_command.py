"""`twin compensate`: from a folder with measured points and a layer to the object's files."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from reconstruction.arrays import Reason
from reconstruction.decoding.decode import AxisDecode, Decoded
from reconstruction.netcdf import read_arrays
from reconstruction.pipeline import read_reconstruction, write_reconstruction
from reconstruction.triangulation import PointMap
from tests.compensation.sheets import RIM_MM, YOUNG_KPA, pressed_ball
from tests.compensation.slabs import WIDE_MM, coat_points, pressed, slab
from twin.cli import run
from twin.config import load_experiment
from twin.config.sensor_layer import load_sensor_layer
from twin.pipeline.compensation import compensated_figures
from twin.specimens.kinds.ball import Ball
from twin.specimens.kinds.brick import Brick

LAYER = f"""[elastomer]
thickness_mm = 0.2
length_x_mm = {2 * RIM_MM}
length_y_mm = {2 * RIM_MM}
outline = "round"
young_modulus_kpa = {YOUNG_KPA}
poisson_ratio = 0.49
[press]
back_pressure_kpa = 2.0
[sigma]
thickness_mm = 0.004
"""

SLAB = f"""[elastomer]
thickness_mm = 3.0
length_x_mm = {WIDE_MM}
length_y_mm = {WIDE_MM}
young_modulus_kpa = 400.0
poisson_ratio = 0.49
[press]
back_pressure_kpa = 10.0
depth_mm = 0.7
[sigma]
depth_mm = 0.002
[specimen]
kind = "ball"
diameter_mm = 7.0
"""


def coat_map() -> PointMap:
    """Return the coat of a ball as a camera of 240 x 240 pixels above it would measure it."""
    profile = pressed_ball(0.2, 2.0)
    places = np.linspace(-RIM_MM, RIM_MM, 240)
    x, y = np.meshgrid(places, -places)
    inside = np.hypot(x, y) < RIM_MM
    z = CubicSpline(profile.radius_mm, profile.upper_z_mm)(np.minimum(np.hypot(x, y), RIM_MM))
    points = np.where(inside[..., None], np.stack((x, y, z), axis=-1), 0.0).astype(np.float32)
    reason = np.where(inside, Reason.VALID, Reason.DARK).astype(np.uint8)
    sigma = np.where(inside[..., None], np.float32(1e-4), np.float32(0)) * np.ones(3, np.float32)
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[2, 3] = 200.0
    return PointMap(points, sigma, reason, pose)


def slab_map() -> PointMap:
    """Return the coat of a ball under a slab, pressed 0.7 mm under air, 3 um of noise."""
    heights = pressed(Ball(diameter_mm=8.0), slab(span_mm=WIDE_MM), 0.7, air_kpa=10.0).coat_mm
    points, sigma = coat_points(heights, 3e-3, span_mm=WIDE_MM)
    shape = heights.shape
    sigma_xyz = np.broadcast_to(np.float32(sigma[0]), (*shape, 3)).copy()
    reason = np.full(shape, Reason.VALID, np.uint8)
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[2, 3] = 200.0
    return PointMap(points.reshape(*shape, 3).astype(np.float32), sigma_xyz, reason, pose)


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of `twin reconstruct`, with a layer file next to it."""
    folder = tmp_path_factory.mktemp("coat") / "result"
    write_result(folder, coat_map())
    (folder.parent / "layer.toml").write_text(LAYER)
    return folder


@pytest.fixture(scope="module")
def under_slab(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder and layer file for a slab."""
    folder = tmp_path_factory.mktemp("slab") / "result"
    write_result(folder, slab_map())
    (folder.parent / "layer.toml").write_text(SLAB)
    return folder


def write_result(folder: Path, coat: PointMap) -> None:
    folder.mkdir()
    shape = coat.mask_reason.shape
    blank = AxisDecode(
        **{
            name: np.zeros(shape, np.int16 if name == "order" else np.float32)
            for name in AxisDecode.__dataclass_fields__
        }
    )
    decoded = Decoded(blank, blank, coat.mask_reason)
    write_reconstruction(folder / "reconstruction.nc", decoded, coat)


def test_object_is_written_as_points_and_figures(measured: Path, tmp_path: Path) -> None:
    layer, digests = measured.parent / "layer.toml", []
    for out in (tmp_path / "object", tmp_path / "again"):
        arguments = ["compensate", str(measured), "--layer", str(layer), "-o", str(out)]
        assert run(arguments) == 0
        result = json.loads((out / "result.json").read_text())
        digests.append((result["digest"], (out / "contact.nc").read_bytes()))
    assert digests[0] == digests[1]
    assert result["command"] == "compensate"
    figures = result["metrics"]
    assert figures["part_1_form"] == "ball"
    assert figures["part_1_radius_mm"] == pytest.approx(4.0, abs=3e-3)
    assert 2.5 < figures["part_1_radius_sigma_um"] < 6.0  # from 4 um of thickness
    points = read_reconstruction(out / "reconstruction.nc").point_map
    away = np.linalg.norm(points.points_world_mm[points.valid] - [0, 0, 0.6 - 0.2 - 4.0], axis=1)
    assert np.median(np.abs(away - 4.0)) < 2e-3
    contact = read_arrays(out / "contact.nc")
    assert contact.variables["thickness_mm"][2]["units"] == "mm"
    assert float(contact["pressure_kpa"].max()) > 5.0
    made = ("points.ply", "layer.toml", "experiment.toml", "report.html")
    for name in (*made, "figures/compensation.png"):
        assert (out / name).stat().st_size > 0
    assert run(["compensate", str(measured), "--layer", str(out / "layer.toml"), "-o",
                str(tmp_path / "third"), "--no-report"]) == 0  # fmt: skip
    assert not (tmp_path / "third" / "report.html").exists()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("thickness_mm = 0.2", "thickness_mm = 3.0"), "3 mm thick"),
        (("back_pressure_kpa = 2.0", "back_pressure_kpa = -1"), "back_pressure_kpa"),
        (("[sigma]", "[sigmas]"), "sigma"),
        (("thickness_mm = 0.004", "thickness_mm = nan"), "thickness_mm"),
    ],
)
def test_a_wrong_layer_gives_a_single_line(
    measured: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], change: tuple[str, str],
    message: str,
) -> None:  # fmt: skip
    layer = tmp_path / "layer.toml"
    layer.write_text(LAYER.replace(*change))
    out = tmp_path / "out"
    assert run(["compensate", str(measured), "--layer", str(layer), "-o", str(out)]) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert any(line.startswith("twin: ") and message in line for line in lines)
    assert not out.exists()


def test_a_missing_layer_or_points_is_named(
    measured: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["compensate", str(measured), "-o", str(tmp_path / "out")]) == 2
    assert "--layer layer.toml" in capsys.readouterr().err
    empty = tmp_path / "empty"
    empty.mkdir()
    assert run(["compensate", str(empty), "-o", str(tmp_path / "out")]) == 2
    assert "no reconstruction.nc" in capsys.readouterr().err


def test_a_ball_calibrates_the_layer(measured: Path, tmp_path: Path) -> None:
    """The layer is 5 % too thick; the calibrated file has 0.2 mm, and can be read again."""
    given = tmp_path / "believed.toml"
    given.write_text(LAYER.replace("thickness_mm = 0.2\n", "thickness_mm = 0.21\n"))
    arguments = ["compensate", str(measured), "--layer", str(given), "--no-report"]
    out = tmp_path / "calibrated"
    assert run([*arguments, "--ball-diameter-mm", "8", "-o", str(out)]) == 0
    layer = load_sensor_layer(out / "layer.toml")
    assert layer.elastomer.thickness_mm == pytest.approx(0.2, abs=2e-3)
    assert 0 < layer.sigma.thickness_mm < 2e-3
    assert layer.elastomer.young_modulus_kpa == pytest.approx(YOUNG_KPA, rel=0.06)


def test_a_compliant_rim_is_fitted_and_stored(measured: Path, tmp_path: Path) -> None:
    """The true rim is rigid; the modulus is known to 3 kPa, so that the free span is used."""
    given, out = tmp_path / "believed.toml", tmp_path / "calibrated"
    open_rim = "rim_compliance_mm2_per_n = 20.0\nyoung_modulus_kpa = 3.0\n"
    given.write_text(LAYER + open_rim)
    arguments = ["compensate", str(measured), "--layer", str(given), "--no-report"]
    assert run([*arguments, "--ball-diameter-mm", "8", "-o", str(out)]) == 0
    layer = load_sensor_layer(out / "layer.toml")
    sigma = layer.sigma.rim_compliance_mm2_per_n
    assert layer.elastomer.rim_compliance_mm2_per_n < 2 * sigma < 40.0
    figures = json.loads((out / "result.json").read_text())["metrics"]
    assert figures["calibrated_rim_compliance_sigma_mm2_per_n"] == pytest.approx(sigma)


def test_numbers_of_an_object_under_a_slab(under_slab: Path, tmp_path: Path) -> None:
    out, layer = tmp_path / "object", under_slab.parent / "layer.toml"
    arguments = ["compensate", str(under_slab), "--layer", str(layer)]
    assert run([*arguments, "-o", str(out)]) == 0
    figures = json.loads((out / "result.json").read_text())["metrics"]
    u = figures["compensated_diameter_sigma_um"]
    assert figures["compensated_diameter_mm"] == pytest.approx(8.0, abs=0.1)
    assert 100.0 < u < 800.0  # the error from large strain is included
    assert figures["compensated_travel_mm"] == pytest.approx(0.7, abs=4e-3)
    assert figures["compensated_force_n"] > 0.1
    page = (out / "report.html").read_text()
    assert "specimen.diameter_mm" in page
    points = read_reconstruction(out / "reconstruction.nc").point_map
    away = np.linalg.norm(points.points_world_mm[points.valid] - [0, 0, 0.7 - 3.0 - 4.0], axis=1)
    assert np.median(np.abs(away - 4.0)) < 0.02
    calibrated = tmp_path / "calibrated"
    known = ["--ball-diameter-mm", "8", "--no-report", "-o", str(calibrated)]
    assert run([*arguments, *known]) == 0
    calibrated_layer = load_sensor_layer(calibrated / "layer.toml")
    assert calibrated_layer.elastomer.thickness_mm == pytest.approx(3.0, abs=2e-3)
    assert calibrated_layer.elastomer.young_modulus_kpa == pytest.approx(400.0, abs=2.0)
    assert calibrated_layer.specimen is not None  # a layer for later presses


def test_a_slab_without_a_known_form_is_an_error(
    under_slab: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    layer = tmp_path / "layer.toml"
    layer.write_text(SLAB[: SLAB.index("[specimen]")])
    arguments = ["compensate", str(under_slab), "--layer", str(layer), "-o", str(tmp_path / "out")]
    assert run(arguments) == 2
    assert "tell [specimen] in the layer file" in capsys.readouterr().err


def test_incomplete_input_has_no_figures() -> None:
    """They are part of a measurement's figures if the elastomer wraps or the form is fitted."""
    slab_ball = load_experiment("examples/slab_ball")
    brick = slab_ball.model_copy(update={"specimen": Brick()})
    assert compensated_figures(brick, coat_map()) == {}
    sheet = load_experiment("examples/wrapped_balls")
    blind = coat_map()
    blind = replace(blind, mask_reason=np.full_like(blind.mask_reason, Reason.DARK))
    assert "no valid point" in compensated_figures(sheet, blind)["compensation_failure"]
