"""Convert a calibration of another program to a calibration of this package.

`reconstruction.rig.importers` reads the file formats, one module per format. The numbers are
identified by their names, in the same way for all programs (`named_numbers`). Needed are the camera
matrix, distortion and image size of both devices, and the motion from the camera's frame to the
projector's frame (`pose_conventions`).

The centre of the first pixel is (0, 0). Importers of programs with another convention subtract the
difference. Names with left, first or 1 are of the camera, names with right, second or 2 of the
projector. If two files each describe one device by the same names, the file whose name contains
camera, left, ... is of the camera, otherwise the first file.

The origin of the world frame is the point of the camera's optical axis nearest to the projector's
axis. World x points to the right in the camera image, y up in the image, z to the camera.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.errors import CaptureError, InputError
from reconstruction.rig.calibration import Calibration
from reconstruction.rig.imported_lens import read_lens
from reconstruction.rig.importers import importer_of
from reconstruction.rig.named_numbers import DEVICE_NAMES, DEVICES, MATRIX, NamedNumbers, plain
from reconstruction.rig.plausibility import BASELINES_MM, Check, require_plausible, rig_checks
from reconstruction.rig.pose_conventions import (
    LEAST_SINE,
    Pose,
    ReadPose,
    inverse,
    pose_in_file,
    stored_motion,
)

TO_MM = {"mm": 1.0, "cm": 10.0, "m": 1000.0}
"""Length of each unit in mm."""


@dataclass(frozen=True)
class Importing:
    """Options that give the values which a calibration file may lack.

    Attributes
    ----------
    camera_size, projector_size : image size (width, height), px; None: it is in the file
    unit : unit of length in the file: mm, cm or m; None: that of the format, otherwise mm
    projector_first : whether the first device of the file is the projector, and the motion in the
        file therefore leads from the projector's to the camera's frame
    standoff_mm : distance from the camera to the world's origin on its axis; None: distance to the
        point of the axis nearest to the projector's axis
    keys : name in the files by quantity, for names that are not known, see `QUANTITIES`
    pose : convention of R and T; None: forward, or another one that a capture confirms
    baseline_mm : distance between camera and projector, for files without a scale; None: by `unit`
    """

    camera_size: tuple[int, int] | None = None
    projector_size: tuple[int, int] | None = None
    unit: str | None = None
    projector_first: bool = False
    standoff_mm: float | None = None
    keys: Mapping[str, str] = field(default_factory=dict)
    pose: Pose | None = None
    baseline_mm: float | None = None


@dataclass(frozen=True, eq=False)
class Imported:
    """A converted calibration, and the numbers in the files from which it was made.

    Attributes
    ----------
    calibration : converted calibration
    used : name in the files of each required quantity
    refit_px : largest deviation, px, of the fitted lens from that in the file, of the camera and of
        the projector; 0: the lens was used unchanged
    pose : pose with the convention of R and T in the file
    formats : names of the formats of the files
    """

    calibration: Calibration
    used: Mapping[str, str]
    refit_px: tuple[float, float]
    pose: ReadPose
    formats: tuple[str, ...]

    def summary(self) -> Iterator[str]:
        """Yield lines of text: formats, name of each quantity, convention of R and T."""
        yield f"format: {', '.join(self.formats)}"
        for quantity, name in self.used.items():
            yield f"{quantity}: {name}"
        reason = self.pose.reason or "not checked by a capture; see --check"
        yield f"R and T: {self.pose.convention} ({reason})"


def import_calibration(
    paths: Sequence[Path],
    options: Importing = Importing(),
    measured_px: FloatArray | None = None,
) -> Imported:
    """Read a calibration of another program from one or several files.

    Parameters
    ----------
    measured_px : (n, 4) decoded points of a capture of the rig, camera x, y, projector column, row,
        which confirm the convention of R and T; None: it is judged by plausibility

    Raises
    ------
    CaptureError : a file is missing, damaged or of no known format; a required number is missing or
        has another shape; a lens cannot be fitted; or the rig is implausible
    """
    files = [_read(path) for path in paths]
    where = ", ".join(path.name for path in paths)
    try:
        keys = {quantity: name for file in files for quantity, name in file.keys.items()}
        names = NamedNumbers(dict(_merged(files)), {**keys, **options.keys})
        units = [file.unit for file in files if file.unit] or ["mm"]
        to_mm = TO_MM[options.unit or units[0]]
        formats = tuple(dict.fromkeys(file.format for file in files))
        return _assembled(names, options, to_mm, measured_px, formats)
    except InputError as error:
        raise CaptureError(f"{where}: {error}") from error


@dataclass(frozen=True, eq=False)
class _File:
    path: Path
    format: str
    unit: str | None
    keys: Mapping[str, str]
    numbers: Mapping[str, FloatArray]

    @property
    def is_of_one_device(self) -> bool:
        """Whether the file has a camera matrix whose name contains no device."""
        sizes = {plain(name): values.size for name, values in self.numbers.items()}
        return any(sizes.get(name) == 9 for name in MATRIX)

    @property
    def device(self) -> str | None:
        """Device that the file's name contains; None if it contains none."""
        words = {word for word in re.split(r"[\W_]+|(?<=\D)(?=\d)", self.path.stem.lower()) if word}
        named = [device for device in DEVICES if words & set(DEVICE_NAMES[device])]
        # "camera2" contains the word camera, but names the second device.
        return named[-1] if named else None


def _read(path: Path) -> _File:
    importer = importer_of(path)
    return _File(path, importer.name, importer.unit, importer.keys, importer.read(path))


def _merged(files: Sequence[_File]) -> Iterator[tuple[str, FloatArray]]:
    """Yield the numbers of all files; those of one device have its name as the first part.

    Raises
    ------
    InputError : more than two files describe one device each
    """
    single = [file for file in files if file.is_of_one_device]
    if len(single) > 2:
        raise InputError(
            f"found {len(single)} files with a camera matrix, allowed one of the camera and one of "
            "the projector"
        )
    devices = [file.device for file in single]
    if len(single) == 2 and sorted(map(str, devices)) != sorted(DEVICES):
        devices = list(DEVICES)
    before = {
        file.path: f"{device}/" for file, device in zip(single, devices, strict=True) if device
    }
    for file in files:
        for name, values in file.numbers.items():
            yield before.get(file.path, "") + name, values


def numbers_of(path: Path) -> dict[str, FloatArray]:
    """Return every number and matrix of a calibration file by its path in the file.

    Raises
    ------
    CaptureError : the file is missing, damaged or of no known format
    """
    return importer_of(path).read(path)


def _assembled(
    names: NamedNumbers,
    options: Importing,
    to_mm: float,
    measured_px: FloatArray | None,
    formats: tuple[str, ...],
) -> Imported:
    order = DEVICES[::-1] if options.projector_first else DEVICES
    lenses = {device: read_lens(names, place) for device, place in zip(order, DEVICES, strict=True)}
    sizes = {"camera": options.camera_size, "projector": options.projector_size}
    (camera, camera_px), (projector, projector_px) = (
        lenses[device].pinhole(device, sizes[device]) for device in DEVICES
    )
    pose = pose_in_file(
        (camera, projector),
        _in_mm(stored_motion(names), options, to_mm),
        options.pose,
        measured_px,
        is_trusted=options.standoff_mm is not None,
    )
    T_world_from_cam = _world(pose.T_proj_from_cam, options.standoff_mm)
    T_world_from_proj = T_world_from_cam @ inverse(pose.T_proj_from_cam)
    calibration = Calibration(camera, projector, T_world_from_cam, T_world_from_proj)
    require_plausible(
        rig_checks(calibration),
        "check --unit, the image sizes, and which device is the first (--projector-first)",
    )
    return Imported(calibration, names.used, (camera_px, projector_px), pose, formats)


def _in_mm(motion: FloatArray, options: Importing, to_mm: float) -> FloatArray:
    """Return the motion from the camera's to the projector's frame with its translation in mm.

    Raises
    ------
    InputError : the baseline is implausible; the message has the units that make it plausible
    """
    stored = float(np.linalg.norm(motion[:3, 3]))
    if options.baseline_mm is not None and stored > 0:
        to_mm = options.baseline_mm / stored
    plausible = [
        f"{factor * stored:.4g} mm with --unit {unit}"
        for unit, factor in TO_MM.items()
        if BASELINES_MM[0] <= factor * stored <= BASELINES_MM[1]
    ]
    require_plausible(
        [Check("baseline_mm", to_mm * stored, *BASELINES_MM)],
        f"it is {' or '.join(plausible) or 'implausible in mm, cm and m'}; else --baseline-mm",
    )
    scaled = motion.copy()
    scaled[:3, 3] *= to_mm
    return inverse(scaled) if options.projector_first else scaled


def _world(T_proj_from_cam: FloatArray, standoff_mm: float | None) -> FloatArray:
    """Return T_world_from_cam, (4, 4), with the world's origin on the camera's optical axis.

    `standoff_mm` None: the origin is the point of the axis nearest to the projector's axis.
    """
    if standoff_mm is None:
        standoff_mm = _nearest_on_axis_mm(inverse(T_proj_from_cam))
    T_world_from_cam = np.diag([1.0, -1.0, -1.0, 1.0])
    T_world_from_cam[2, 3] = standoff_mm
    return T_world_from_cam


def _nearest_on_axis_mm(T_cam_from_proj: FloatArray) -> float:
    """Return the distance, mm, from the camera to the point of its axis nearest the other axis."""
    axis, centre = T_cam_from_proj[:3, 2], T_cam_from_proj[:3, 3]
    sine_square = 1.0 - axis[2] ** 2
    if sine_square < LEAST_SINE**2:
        raise InputError("the axes are parallel and have no nearest point; give --standoff-mm")
    # The shortest connection of the axes z e_z and c + s a is perpendicular to both directions.
    along = (centre[2] - axis[2] * float(axis @ centre)) / sine_square
    if along <= 0:
        raise InputError("the axes are nearest to each other behind the camera; give --standoff-mm")
    return float(along)
