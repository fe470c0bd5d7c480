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
from twin.cli import run
from twin.config import load_experiment
from twin.config.sensor_layer import load_sensor_layer
from twin.pipeline.compensation import compensated_figures

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


def coat_map() -> PointMap:
    """Return the coat of a ball as a camera of 240 x 240 pixels sees it from above."""
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


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder as `twin reconstruct` leaves it, with a layer file beside it."""
    folder = tmp_path_factory.mktemp("coat") / "result"
    folder.mkdir()
    coat = coat_map()
    shape = coat.mask_reason.shape
    blank = AxisDecode(
        **{
            name: np.zeros(shape, np.int16 if name == "order" else np.float32)
            for name in AxisDecode.__dataclass_fields__
        }
    )
    decoded = Decoded(blank, blank, coat.mask_reason)
    write_reconstruction(folder / "reconstruction.nc", decoded, coat)
    (folder.parent / "layer.toml").write_text(LAYER)
    return folder


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
    found = read_reconstruction(out / "reconstruction.nc").point_map
    away = np.linalg.norm(found.points_world_mm[found.valid] - [0, 0, 0.6 - 0.2 - 4.0], axis=1)
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
    ("change", "told"),
    [
        (("thickness_mm = 0.2", "thickness_mm = 3.0"), "3 mm thick"),
        (("back_pressure_kpa = 2.0", "back_pressure_kpa = -1"), "back_pressure_kpa"),
        (("[sigma]", "[sigmas]"), "sigma"),
        (("thickness_mm = 0.004", "thickness_mm = nan"), "thickness_mm"),
    ],
)
def test_a_wrong_layer_is_one_line(
    measured: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], change: tuple[str, str],
    told: str,
) -> None:  # fmt: skip
    layer = tmp_path / "layer.toml"
    layer.write_text(LAYER.replace(*change))
    out = tmp_path / "out"
    assert run(["compensate", str(measured), "--layer", str(layer), "-o", str(out)]) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert any(line.startswith("twin: ") and told in line for line in lines)
    assert not out.exists()


def test_without_a_layer_or_points_it_says_what_to_give(
    measured: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["compensate", str(measured), "-o", str(tmp_path / "out")]) == 2
    assert "--layer layer.toml" in capsys.readouterr().err
    empty = tmp_path / "empty"
    empty.mkdir()
    assert run(["compensate", str(empty), "-o", str(tmp_path / "out")]) == 2
    assert "no reconstruction.nc" in capsys.readouterr().err


def test_a_ball_calibrates_the_layer(measured: Path, tmp_path: Path) -> None:
    """Believed 5 % too thick; what is written is 0.2 mm, and is read again."""
    believed = tmp_path / "believed.toml"
    believed.write_text(LAYER.replace("thickness_mm = 0.2\n", "thickness_mm = 0.21\n"))
    arguments = ["compensate", str(measured), "--layer", str(believed), "--no-report"]
    out = tmp_path / "calibrated"
    assert run([*arguments, "--ball-diameter-mm", "8", "-o", str(out)]) == 0
    layer = load_sensor_layer(out / "layer.toml")
    assert layer.elastomer.thickness_mm == pytest.approx(0.2, abs=2e-3)
    assert 0 < layer.sigma.thickness_mm < 2e-3
    assert layer.elastomer.young_modulus_kpa == pytest.approx(YOUNG_KPA, rel=0.06)


def test_a_slab_has_no_compensated_figures() -> None:
    """They stand beside a measurement's own only where the elastomer wraps."""
    assert compensated_figures(load_experiment("examples/slab_ball"), coat_map()) == {}
    sheet = load_experiment("examples/wrapped_balls")
    blind = coat_map()
    blind = replace(blind, mask_reason=np.full_like(blind.mask_reason, Reason.DARK))
    assert "no valid point" in compensated_figures(sheet, blind)["compensation_failure"]
