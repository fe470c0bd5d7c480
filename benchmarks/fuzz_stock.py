"""Sound inputs of the fuzz: small experiments, captures, calibrations, a result, a store."""

import shutil
import subprocess
from pathlib import Path

import cv2
import imageio.v3 as imageio
import numpy as np
from scipy.io import savemat

from reconstruction.photometric.colour_maps import COLOUR_TERMS, PLACE_TERMS, ColourPolynomial
from reconstruction.photometric.sensor import SensorCalibration, write_sensor_calibration
from reconstruction.writing import write_exr_channels

SMALL = {
    "camera.binning": 4,
    "camera.width_px": 484,
    "camera.height_px": 368,
    "press.solver_pitch_mm": 0.4,
}
_STUDY = """name = "fuzz"
base = "slab.toml"
[[axis]]
path = "coating.base_albedo"
values = [0.3, 0.5]
"""
_LAYER = """[elastomer]
use = "materials/elastomers/thin_silicone_c"
length_x_mm = 24.0
length_y_mm = 20.0
[press]
back_pressure_kpa = 3.0
[sigma]
thickness_mm = 0.004
"""


def make_stock(folder: Path, run: Path) -> None:
    """Make the sound inputs once: small experiments, a capture, a measurement, a store.

    Parameters
    ----------
    folder : new folder
    run : program of the command line
    """
    import trimesh

    from twin.assets import asset_path
    from twin.config import load_experiment
    from twin.config.loading import to_toml

    (folder / "kept" / "deep").mkdir(parents=True)
    for name in ("canary.txt", "deep/canary.json", "result.csv"):
        (folder / "kept" / name).write_text("nobody may change this\n")
    slab = load_experiment("examples/slab_ball", SMALL)
    (folder / "slab.toml").write_text(to_toml(slab))
    sheet = SMALL | {"press.cell_mm": 0.4}
    (folder / "sheet.toml").write_text(to_toml(load_experiment("examples/wrapped_balls", sheet)))
    part = trimesh.creation.box((4.0, 3.0, 2.0))
    for name in ("part.stl", "part.ply", "part.obj"):
        part.export(folder / name)
    mesh = {"specimen": {"kind": "mesh", "file": str(folder / "part.stl")}}
    (folder / "slab_mesh.toml").write_text(
        to_toml(load_experiment("examples/slab_ball", SMALL | mesh))
    )
    (folder / "study.toml").write_text(_STUDY)
    shutil.copy(asset_path("scenes", "boards/paper_dots"), folder / "board.toml")
    shutil.copy(asset_path("scenes", "problems/slab"), folder / "problem.toml")
    shutil.copy(asset_path("scenes", "inputs/handling"), folder / "inputs.toml")
    capture = Path(__file__).parents[1] / "docs" / "example_capture"
    shutil.copytree(capture, folder / "capture")
    shutil.copytree(capture, folder / "capture_pressed")
    (folder / "capture_pressed" / "layer.toml").write_text(_LAYER)
    for kind in ("exr", "tiff"):
        _with_other_images(capture, folder / f"capture_{kind}", kind)
    _without_description(capture, folder / "bare")
    shutil.copytree(folder / "bare", folder / "listed")
    make_colours(folder / "colours")
    _make_stereo(folder)
    for command in (
        ("measure", "slab.toml", "-o", "measured"),
        ("render", "slab.toml", "-o", "rendered"),
        ("sweep", "study.toml", "-o", "swept", "-j", "1"),
        ("sweep", "report", "swept"),
        ("describe", "listed", "--projector", "1280", "720"),
        ("decode", "listed", "-o", "decoded"),
        # Compiles what reads 8-bit images, for which no case has the time.
        ("reconstruct", "capture", "-o", "reconstructed"),
    ):
        subprocess.run([str(run), *command], cwd=folder, check=True, capture_output=True)


def _with_other_images(capture: Path, folder: Path, kind: str) -> None:
    """Copy a capture, its images as TIFF or EXR."""
    shutil.copytree(capture, folder)
    for path in sorted(folder.glob("*.png")):
        image, other = imageio.imread(path), path.with_suffix(f".{kind}")
        if kind == "exr":
            write_exr_channels(other, {"Y": image.astype(np.float32)})
        else:
            imageio.imwrite(other, image)
        path.unlink()
    text = (folder / "capture.toml").read_text()
    (folder / "capture.toml").write_text(text.replace("{name}.png", f"{{name}}.{kind}"))


def _without_description(capture: Path, folder: Path) -> None:
    """Copy a capture's images alone, every second of their pixels."""
    folder.mkdir()
    for path in sorted(capture.glob("*.png")):
        imageio.imwrite(folder / path.name, imageio.imread(path)[::2, ::2])


def _make_stereo(folder: Path) -> None:
    """Make calibrations as other programs write them: YAML, XML, MATLAB."""
    matrix = np.array([[1800.0, 0.0, 320.0], [0.0, 1800.0, 240.0], [0.0, 0.0, 1.0]])
    motion = {"om": np.array([[0.05], [-0.42], [0.02]]), "T": np.array([[98.0], [6.0], [21.0]])}
    found = {f"{one}{name}": value for one in ("M", "D") for name, value in _of(one, matrix)}
    for kind in ("yml", "xml"):
        storage = cv2.FileStorage(str(folder / f"stereo.{kind}"), cv2.FileStorage_WRITE)
        for name, value in (found | motion).items():
            storage.write(name, value)
        storage.release()
    savemat(folder / "stereo.mat", found | motion)


def _of(name: str, matrix: np.ndarray) -> tuple[tuple[int, np.ndarray], ...]:
    value = matrix if name == "M" else np.array([[-0.11, 0.07, 4e-4, -3e-4, 0.02]])
    return (1, value), (2, value)


def make_colours(folder: Path) -> None:
    """Make a photometric press of noise, and the calibration of a sensor that maps it."""
    folder.mkdir()
    rng = np.random.default_rng(0)
    for name in ("press.png", "still.png"):
        imageio.imwrite(folder / name, rng.integers(90, 120, (48, 64, 3), np.uint8))
    colour_map = ColourPolynomial(
        rng.normal(0.0, 0.01, (2, len(COLOUR_TERMS), len(PLACE_TERMS))), -np.ones(3), np.ones(3)
    )
    background = np.full((48, 64, 3), 100.0, np.float32)
    write_sensor_calibration(folder / "sensor.npz", SensorCalibration(colour_map, background, 0.1))
    lines = ('format = "photometric-press"', "version = 1", 'image = "press.png"')
    ends = ('background = ["still.png"]', 'calibration = "sensor.npz"', "")
    (folder / "press.toml").write_text("\n".join((*lines, *ends)))
