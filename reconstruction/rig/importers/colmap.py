"""Importer of COLMAP's cameras.txt with images.txt: two cameras, the second is the projector.

The pose is that between the first images of both cameras (x_camera = R x_world + T). The centre of
the first pixel is (0.5, 0.5). A reconstruction has no scale: give `--baseline-mm`, or `--unit`
after a registration to known lengths.
"""

import re
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from reconstruction.arrays import FloatArray
from reconstruction.errors import CaptureError, InputError, counted
from reconstruction.reading import is_regular, read_text
from reconstruction.rig.importers import IMPORTERS, Importer, head_of

# Places of fx, fy, cx, cy and of the distortion in OpenCV's order among the parameters; None: 0.
_MODELS: dict[str, tuple[tuple[int, int, int, int], tuple[int | None, ...]]] = {
    "SIMPLE_PINHOLE": ((0, 0, 1, 2), (None,) * 5),
    "PINHOLE": ((0, 1, 2, 3), (None,) * 5),
    "SIMPLE_RADIAL": ((0, 0, 1, 2), (3, None, None, None, None)),
    "RADIAL": ((0, 0, 1, 2), (3, 4, None, None, None)),
    "OPENCV": ((0, 1, 2, 3), (4, 5, 6, 7, None)),
    "FULL_OPENCV": ((0, 1, 2, 3), tuple(range(4, 12))),
}
_CAMERAS, _IMAGES = "cameras.txt", "images.txt"
_FIRST_CENTRE_PX = 0.5
_DEVICES = ("camera", "projector")


class Colmap(Importer):
    """Importer of the text files of a sparse model; the other of the two files is read with it."""

    name = "colmap"
    summary = "COLMAP's cameras.txt and images.txt in one folder (two cameras)"

    def recognises(self, path: Path) -> bool:
        """Return True for the names of the two files, or a first line of their comments."""
        mark = re.match(r"# (Camera|Image) list with", head_of(path))
        return path.name in (_CAMERAS, _IMAGES) or mark is not None

    def read(self, path: Path) -> dict[str, FloatArray]:
        """Return matrix, distortion and size of both devices, and R and T between them."""
        cameras = path.with_name(_CAMERAS) if path.name == _IMAGES else path
        rows = [line.split() for line in _lines(cameras) if line.strip()]
        if len(rows) != 2:
            raise CaptureError(
                f"{cameras}: found {counted(len(rows), 'camera')}, allowed 2: camera and "
                "projector; give projector images their own camera in COLMAP"
            )
        images = cameras.with_name(_IMAGES)
        poses = _poses(images) if is_regular(images) else {}
        rows.sort(key=lambda row: _place(row, poses))
        numbers: dict[str, FloatArray] = {}
        for device, row in zip(_DEVICES, rows, strict=True):
            numbers |= _lens(f"{cameras}: camera {row[0]}", device, row)
        first, second = (poses.get(row[0]) for row in rows)
        if first is not None and second is not None:
            motion = second[1] @ np.linalg.inv(first[1])
            numbers |= {"R": motion[:3, :3], "T": motion[:3, 3]}
        return numbers


def _lines(path: Path) -> list[str]:
    try:
        lines = read_text(path).splitlines()
    except InputError as error:
        raise CaptureError(str(error)) from None
    return [line for line in lines if not line.startswith("#")]


def _place(row: list[str], poses: dict[str, tuple[str, FloatArray]]) -> tuple[bool, int]:
    """Return the sorting key of a camera: the one with images of the projector is the second."""
    name = poses[row[0]][0].lower() if row[0] in poses else ""
    return "proj" in name, int(row[0]) if row[0].isdigit() else 0


def _lens(where: str, device: str, row: list[str]) -> dict[str, FloatArray]:
    try:
        model, width, height = row[1], int(row[2]), int(row[3])
        values = [float(text) for text in row[4:]]
        focal, distortion = _MODELS[model]
        fx, fy, cx, cy = (values[place] for place in focal)
        bent = [0.0 if place is None else values[place] for place in distortion]
    except KeyError:
        raise CaptureError(f"{where}: model is {row[1]}, allowed {', '.join(_MODELS)}") from None
    except (IndexError, ValueError):
        raise CaptureError(
            f"{where}: found {' '.join(row)[:80]}; allowed ID MODEL WIDTH HEIGHT PARAMETERS"
        ) from None
    centre = np.array([cx, cy]) - _FIRST_CENTRE_PX
    return {
        f"{device}/matrix": np.array([[fx, 0, centre[0]], [0, fy, centre[1]], [0, 0, 1.0]]),
        f"{device}/distortion": np.array(bent),
        f"{device}/size": np.array([width, height], float),
    }


def _poses(path: Path) -> dict[str, tuple[str, FloatArray]]:
    """Return name and pose (4, 4) of the first image of each camera, by the camera's ID."""
    poses: dict[str, tuple[str, FloatArray]] = {}
    for line in _lines(path)[::2]:  # every second line has the image's points
        words = line.split(maxsplit=9)
        try:
            qw, qx, qy, qz, *shift = map(float, words[1:8])
            motion = np.eye(4)
            motion[:3, :3] = Rotation.from_quat([qx, qy, qz, qw]).as_matrix()
            motion[:3, 3] = shift
            poses.setdefault(str(int(words[8])), (words[9], motion))
        except (IndexError, ValueError):
            raise CaptureError(
                f"{path}: found {line[:80]!r}; allowed ID QW QX QY QZ TX TY TZ CAMERA_ID NAME"
            ) from None
    return poses


IMPORTERS.register(Colmap())
