"""Sound inputs of the fuzz: small experiments, captures, calibrations, a result, a store."""

import shutil
import subprocess
from pathlib import Path

import cv2
import imageio.v3 as imageio
import numpy as np
from scipy.io import savemat

from reconstruction.photometric.maps.polynomial import COLOUR_TERMS, PLACE_TERMS, ColourPolynomial
from reconstruction.photometric.sensor import SensorCalibration, write_sensor_calibration
from reconstruction.writing import write_exr_channels

CAPTURE = Path(__file__).parents[1] / "docs" / "example_capture"
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
_PRESS = """format = "photometric-press"
version = 1
image = "press.png"
background = ["still.png"]
calibration = "sensor.npz"
"""
_COMMANDS = (
    "measure slab.toml -o measured",
    "render slab.toml -o rendered",
    "sweep study.toml -o swept -j 1",
    "sweep report swept",
    "describe listed --projector 1280 720",
    "decode listed -o decoded",
    # Compiles the reader of 8-bit images, for which no case has the time.
    "reconstruct capture -o reconstructed",
)


def make_stock(folder: Path, run: Path) -> None:
    """Make the sound inputs once.

    Parameters
    ----------
    folder : new folder
    run : program of the command line
    """
    (folder / "kept" / "deep").mkdir(parents=True)
    for name in ("canary.txt", "deep/canary.json", "result.csv"):
        (folder / "kept" / name).write_text("no command may change this\n")
    _make_documents(folder)
    for name in ("capture", "capture_pressed"):
        shutil.copytree(CAPTURE, folder / name)
    (folder / "capture_pressed" / "layer.toml").write_text(_LAYER)
    for kind in ("exr", "tiff"):
        _with_other_images(folder / f"capture_{kind}", kind)
    # Images without a description, every second of their pixels.
    for name in ("bare", "listed"):
        (folder / name).mkdir()
        for path in sorted(CAPTURE.glob("*.png")):
            imageio.imwrite(folder / name / path.name, imageio.imread(path)[::2, ::2])
    make_colours(folder / "colours")
    _make_stereo(folder)
    for command in _COMMANDS:
        subprocess.run([str(run), *command.split()], cwd=folder, check=True, capture_output=True)


def _make_documents(folder: Path) -> None:
    """Write experiments, meshes, a study, a board, a problem and inputs."""
    import trimesh

    from twin.assets import asset_path
    from twin.config import load_experiment
    from twin.config.loading import to_toml

    part = trimesh.creation.box((4.0, 3.0, 2.0))
    for name in ("part.stl", "part.ply", "part.obj"):
        part.export(folder / name)
    mesh = SMALL | {"specimen": {"kind": "mesh", "file": str(folder / "part.stl")}}
    for name, base, settings in (
        ("slab", "slab_ball", SMALL),
        ("sheet", "wrapped_balls", SMALL | {"press.cell_mm": 0.4}),
        ("slab_mesh", "slab_ball", mesh),
    ):
        (folder / f"{name}.toml").write_text(to_toml(load_experiment(f"examples/{base}", settings)))
    (folder / "study.toml").write_text(_STUDY)
    for name, asset in (
        ("board", "boards/paper_dots"),
        ("problem", "problems/slab"),
        ("inputs", "inputs/handling"),
    ):
        shutil.copy(asset_path("scenes", asset), folder / f"{name}.toml")


def _with_other_images(folder: Path, kind: str) -> None:
    """Copy the capture, its images as TIFF or EXR."""
    shutil.copytree(CAPTURE, folder)
    for path in sorted(folder.glob("*.png")):
        image, other = imageio.imread(path), path.with_suffix(f".{kind}")
        if kind == "exr":
            write_exr_channels(other, {"Y": image.astype(np.float32)})
        else:
            imageio.imwrite(other, image)
        path.unlink()
    text = (folder / "capture.toml").read_text()
    (folder / "capture.toml").write_text(text.replace("{name}.png", f"{{name}}.{kind}"))


def _make_stereo(folder: Path) -> None:
    """Make calibrations in the formats of other programs: YAML, XML, MATLAB."""
    matrix = np.array([[1800.0, 0.0, 320.0], [0.0, 1800.0, 240.0], [0.0, 0.0, 1.0]])
    lens = np.array([[-0.11, 0.07, 4e-4, -3e-4, 0.02]])
    values = {"M1": matrix, "M2": matrix, "D1": lens, "D2": lens}
    values |= {"om": np.array([[0.05], [-0.42], [0.02]]), "T": np.array([[98.0], [6.0], [21.0]])}
    for kind in ("yml", "xml"):
        storage = cv2.FileStorage(str(folder / f"stereo.{kind}"), cv2.FileStorage_WRITE)
        for name, value in values.items():
            storage.write(name, value)
        storage.release()
    savemat(folder / "stereo.mat", values)


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
    (folder / "press.toml").write_text(_PRESS)
