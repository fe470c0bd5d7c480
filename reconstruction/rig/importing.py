"""Convert a calibration of another program to a calibration of this package.

`reconstruction.rig.importers` reads the file formats. The numbers are identified by their names, in
the same way for all programs. Needed are the camera matrix, distortion and image size of both
devices, and the motion from the camera's frame to the projector's frame.

| program | file |
|---|---|
| OpenCV's stereo_calib | intrinsics.yml (M1, D1, M2, D2) and extrinsics.yml (R, T) |
| scan3d-capture (Moreno and Taubin, 3DIMPVT 2012) | calibration.yml (cam_K, cam_kc, proj_K, ...) |
| others through cv2.FileStorage | YAML or XML with usual names; R as matrix or rotation vector |
| Camera Calibration Toolbox for MATLAB (Bouguet) | Calib_Results_stereo.mat (fc_left, om, ...) |
| MATLAB's stereo calibrator | s = toStruct(stereoParams); save("x.mat", "-struct", "s", "-v7") |

The centre of the first pixel is (0, 0) in all of these files except those of MATLAB's stereo
calibrator. There it is (1, 1), and matrices multiply row vectors from the right.

Names with left, first or 1 are of the camera, names with right, second or 2 of the projector. The
origin of the world frame is the point of the camera's optical axis nearest to the projector's axis.
World x points to the right in the camera image, y up in the image, z to the camera.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from scipy.optimize import least_squares

from reconstruction.arrays import FloatArray
from reconstruction.errors import CaptureError, InputError, few
from reconstruction.rig.calibration import Calibration
from reconstruction.rig.importers import importer_of
from reconstruction.rig.pinhole import Pinhole
from reconstruction.rig.plausibility import BASELINES_MM, Check, require_plausible, rig_checks

MOST_REFIT_PX = 0.05
"""Largest allowed error, px, of the fit of a lens model by k1, k2, p1, p2, k3 without skew."""

# Names in lower case without separators. A name in a file is that of the device and that of the
# quantity, in either order, or both separated by "/".
_FIRST = ("camera", "cam", "left", "l", "1", "c")
_SECOND = ("projector", "proj", "prj", "right", "r", "2", "p", "dlp")
_MATRIX = ("cameramatrix", "intrinsicmatrix", "intrinsics", "int", "matrix", "kk", "k", "m", "a")
_DISTORTION = ("distortioncoefficients", "distcoeffs", "distortion", "dist", "kc", "d")
_WIDTHS, _HEIGHTS = ("imagewidth", "width", "w", "nx"), ("imageheight", "height", "h", "ny")
_SIZES = ("imagesize", "size", "resolution", "imgshape")
_ROTATION = ("r", "rotation", "rotationmatrix", "rmat", "rvec", "om", "rstereo", "stereor")
_TRANSLATION = ("t", "translation", "translationvector", "tvec", "tstereo", "stereot")
_COEFFICIENTS = (4, 5, 8, 12, 14)
_TO_MM = {"mm": 1.0, "cm": 10.0, "m": 1000.0}
# Grid of points (columns, rows) of the lens fit, and least sine of the angle between the two axes.
_GRID = (41, 31)
_LEAST_SINE = 0.02


@dataclass(frozen=True)
class Importing:
    """Options that give the values which a calibration file may lack.

    Attributes
    ----------
    camera_size, projector_size : image size (width, height), px; None: it is in the file
    unit : unit of length in the file: mm, cm or m
    projector_first : whether the first device of the file is the projector, and the motion in the
        file therefore leads from the projector's to the camera's frame
    standoff_mm : distance from the camera to the world's origin on its axis; None: distance to the
        point of the axis nearest to the projector's axis
    """

    camera_size: tuple[int, int] | None = None
    projector_size: tuple[int, int] | None = None
    unit: str = "mm"
    projector_first: bool = False
    standoff_mm: float | None = None


@dataclass(frozen=True, eq=False)
class Imported:
    """A converted calibration, and the numbers in the files from which it was made.

    Attributes
    ----------
    calibration : converted calibration
    used : name in the files of each required quantity
    refit_px : largest deviation, px, of the fitted lens from that in the file, of the camera and of
        the projector; 0: the lens was used unchanged
    """

    calibration: Calibration
    used: Mapping[str, str]
    refit_px: tuple[float, float]


def import_calibration(
    paths: Sequence[Path],
    options: Importing = Importing(),
) -> Imported:
    """Read a calibration of another program from one or several files.

    Raises
    ------
    CaptureError : a file is missing, damaged or of no known format; a required number is missing or
        has another shape; a lens cannot be fitted; or the rig is implausible
    """
    numbers: dict[str, FloatArray] = {}
    for path in paths:
        numbers |= numbers_of(path)
    where = ", ".join(path.name for path in paths)
    try:
        return _assembled(_Names(numbers), options)
    except InputError as error:
        raise CaptureError(f"{where}: {error}") from error


def numbers_of(path: Path) -> dict[str, FloatArray]:
    """Return every number and matrix of a calibration file by its path in the file.

    Raises
    ------
    CaptureError : the file is missing, damaged or of no known format
    """
    return importer_of(path).read(path)


def _plain(name: str) -> str:
    return "".join(sign for sign in name.lower() if sign.isalnum() or sign == "/")


class _Names:
    """Numbers and matrices of the files, searched by all names that programs use for a quantity."""

    def __init__(self, numbers: Mapping[str, FloatArray]) -> None:
        self.numbers = numbers
        self.used: dict[str, str] = {}
        self._by_name = {_plain(name): name for name in numbers}

    def of_device(
        self, device: Sequence[str], names: Sequence[str], sizes: Collection[int]
    ) -> FloatArray | None:
        """Return the first array with a name made of a device's and a quantity's name, or None.

        The number of elements must be one of `sizes`, because K1 is a matrix in one program and a
        coefficient in another.

        Parameters
        ----------
        device : possible names of the device
        names : possible names of the quantity, before or after that of the device
        """
        forms = [
            form
            for name in names
            for prefix in device
            for form in (
                prefix + name,
                name + prefix,
                f"{prefix}/{name}",
                f"cameraparameters{prefix}/{name}",
            )
        ]
        return self._first(f"{device[0]} {names[0]}", forms, sizes)

    def of_any_device(self, names: Sequence[str], sizes: Collection[int]) -> FloatArray | None:
        """Return the first array with one of these names and numbers of elements, or None."""
        return self._first(names[0], names, sizes)

    def _first(self, key: str, forms: Sequence[str], sizes: Collection[int]) -> FloatArray | None:
        for form in forms:
            name = self._by_name.get(form)
            if name is not None and self.numbers[name].size in sizes:
                self.used[key] = name
                return self.numbers[name]
        return None

    def missing(self, quantity: str) -> InputError:
        """Return the error to raise if a quantity is found under none of its names."""
        return InputError(
            f"no {quantity} is found; the file holds {few(sorted(self.numbers)) or '-'}"
        )


def _assembled(names: _Names, options: Importing) -> Imported:
    first, second = _device(names, _FIRST), _device(names, _SECOND)
    sizes = [options.camera_size, options.projector_size]
    T_second_from_first = _motion(names, _TO_MM[options.unit])
    if options.projector_first:
        first, second = second, first
        T_second_from_first = inverse(T_second_from_first)
    pinholes, deviations = zip(
        *(
            lens.pinhole(name, size)
            for name, lens, size in zip(
                ("camera", "projector"), (first, second), sizes, strict=True
            )
        ),
        strict=True,
    )
    T_world_from_cam = _world(T_second_from_first, options.standoff_mm)
    T_world_from_proj = T_world_from_cam @ inverse(T_second_from_first)
    calibration = Calibration(pinholes[0], pinholes[1], T_world_from_cam, T_world_from_proj)
    length_mm = float(np.linalg.norm(T_second_from_first[:3, 3]))
    require_plausible(
        (Check("baseline_mm", length_mm, *BASELINES_MM), *rig_checks(calibration)),
        "check --unit, the image sizes, and which device is the first (--projector-first)",
    )
    return Imported(calibration, names.used, (deviations[0], deviations[1]))


@dataclass(frozen=True, eq=False)
class _Lens:
    """Lens of a device as in the file: camera matrix with skew, any number of coefficients.

    Parameters
    ----------
    matrix : (3, 3) camera matrix, px
    distortion : (n,) coefficients in OpenCV's order, n = 4, 5, 8, 12 or 14
    size : image size (width, height), px; None: it is not in the file
    """

    matrix: FloatArray
    distortion: FloatArray
    size: tuple[int, int] | None

    def pinhole(self, name: str, size: tuple[int, int] | None) -> tuple[Pinhole, float]:
        """Return a pinhole with five coefficients without skew, and its largest deviation, px.

        If the lens has another model, the pinhole is fitted to the lens.
        """
        size = size or self.size
        if size is None:
            raise InputError(f"the {name}'s image size is not in the file; give --{name}-size")
        k = self.matrix
        ideal = Pinhole(size[0], size[1], k[0, 0], k[1, 1], k[0, 2], k[1, 2])
        if k[0, 1] == 0.0 and self.distortion.size <= 5:
            five = np.zeros(5)
            five[: self.distortion.size] = self.distortion
            return replace(ideal, distortion=_five(five)), 0.0
        return _refitted(name, ideal, self)


def _five(values: FloatArray) -> tuple[float, float, float, float, float]:
    k1, k2, p1, p2, k3 = (float(value) for value in values)
    return (k1, k2, p1, p2, k3)


def _refitted(name: str, start: Pinhole, lens: _Lens) -> tuple[Pinhole, float]:
    """Fit a pinhole with five coefficients to a lens; return it and its largest deviation, px.

    The fit minimises the distances, px, on a grid of points over the image.
    """
    u, v = np.meshgrid(
        *(
            np.linspace(0, n - 1, m)
            for n, m in zip((start.width_px, start.height_px), _GRID, strict=True)
        )
    )
    pixels = np.stack((u.ravel(), v.ravel()), axis=-1)
    k = lens.matrix
    y = (pixels[:, 1] - k[1, 2]) / k[1, 1]
    x = (pixels[:, 0] - k[0, 2] - k[0, 1] * y) / k[0, 0]
    eye = np.eye(3)
    enough = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-12)
    places = np.stack((x, y), axis=-1)[:, np.newaxis]
    rays = cv2.undistortPoints(places, eye, lens.distortion, None, eye, eye, enough)[:, 0]
    points = np.column_stack((rays, np.ones(len(rays))))

    def pinhole(values: FloatArray) -> Pinhole:
        fx, fy, cx, cy = (float(value) for value in values[:4])
        changed = replace(start, fx_px=fx, fy_px=fy, cx_px=cx, cy_px=cy)
        return replace(changed, distortion=_five(values[4:]))

    def residual_px(values: FloatArray) -> FloatArray:
        missed: FloatArray = (pinhole(values).project(points) - pixels).ravel()
        return missed

    begin = np.array([start.fx_px, start.fy_px, start.cx_px, start.cy_px, 0.0, 0.0, 0.0, 0.0, 0.0])
    solved: Any = least_squares(residual_px, begin, x_scale="jac", xtol=1e-14, ftol=1e-14)
    largest = float(np.abs(residual_px(solved.x)).max())
    if not largest <= MOST_REFIT_PX:
        raise InputError(
            f"the {name}'s lens ({lens.distortion.size} coefficients, skew {k[0, 1]:g}) differs by "
            f"{largest:.2g} px from the best fit of k1, k2, p1, p2, k3 without skew; allowed "
            f"{MOST_REFIT_PX:g}; calibrate with these five"
        )
    return pinhole(solved.x), largest


def _device(names: _Names, device: Sequence[str]) -> _Lens:
    stored = names.of_device(device, _MATRIX, {9})
    first_px = 0.0
    if stored is not None:
        stored = stored.reshape(3, 3)
        # In files of MATLAB's calibrator the centre of the first pixel is (1, 1), and the matrix
        # multiplies row vectors from the right.
        first_px = (
            1.0 if "cameraparameters" in _plain(names.used[f"{device[0]} {_MATRIX[0]}"]) else 0.0
        )
        matrix = stored.T if stored[2, 0] != 0.0 else stored
    else:
        matrix = _of_toolbox(names, device)
    if not np.allclose(matrix[[1, 2, 2, 2], [0, 0, 1, 2]], (0.0, 0.0, 0.0, 1.0)):
        raise InputError(f"the camera matrix of the {device[0]} is {matrix.tolist()}")
    matrix = matrix - np.array([[0, 0, first_px], [0, 0, first_px], [0, 0, 0]])
    return _Lens(matrix, _distortion(names, device), _size(names, device))


def _of_toolbox(names: _Names, device: Sequence[str]) -> FloatArray:
    focal = names.of_device(device, ("fc",), {2})
    centre = names.of_device(device, ("cc",), {2})
    if focal is None or centre is None:
        raise names.missing(f"camera matrix of the {device[0]}")
    (fx, fy), (cx, cy) = focal.ravel(), centre.ravel()
    skew = names.of_device(device, ("alphac",), {1})
    return np.array([[fx, 0.0 if skew is None else float(skew) * fx, cx], [0, fy, cy], [0, 0, 1]])


def _distortion(names: _Names, device: Sequence[str]) -> FloatArray:
    coefficients = names.of_device(device, _DISTORTION, _COEFFICIENTS)
    if coefficients is not None:
        return coefficients.ravel()
    radial = names.of_device(device, ("radialdistortion",), {2, 3})
    tangential = names.of_device(device, ("tangentialdistortion",), {2})
    if radial is None:
        counts = ", ".join(map(str, _COEFFICIENTS))
        raise names.missing(f"distortion of the {device[0]} ({counts} coefficients)")
    bent = np.zeros(2) if tangential is None else tangential.ravel()
    return np.concatenate((radial.ravel()[:2], bent, radial.ravel()[2:]))


def _size(names: _Names, device: Sequence[str]) -> tuple[int, int] | None:
    width = names.of_device(device, _WIDTHS, {1})
    height = names.of_device(device, _HEIGHTS, {1})
    if width is not None and height is not None:
        return int(width.item()), int(height.item())
    both = names.of_device(device, _SIZES, {2})
    if both is None:
        return None
    first, second = (int(value) for value in both.ravel())
    name = _plain(names.used[f"{device[0]} {_SIZES[0]}"])
    rows_first = "cameraparameters" in name or name.endswith("shape")
    return (second, first) if rows_first else (first, second)


def _motion(names: _Names, to_mm: float) -> FloatArray:
    """Return the motion from the first device's frame to the second's, (4, 4), translation in mm.

    `to_mm` is the length of the file's unit in mm.
    """
    rotation, translation = (
        names.of_any_device(_ROTATION, {3, 9}),
        names.of_any_device(_TRANSLATION, {3}),
    )
    of_rows = names.of_any_device(("rotationofcamera2",), {9})
    if rotation is None and of_rows is not None:
        rotation = of_rows.reshape(3, 3).T
        translation = names.of_any_device(("translationofcamera2",), {3})
    if rotation is None or translation is None:
        raise names.missing("rotation R and translation T from the first device to the second")
    if rotation.size == 3:
        rotation = np.asarray(cv2.Rodrigues(rotation.reshape(3, 1))[0], np.float64)
    motion = np.eye(4)
    motion[:3, :3] = nearest_rotation(rotation.reshape(3, 3))
    motion[:3, 3] = to_mm * translation.ravel()
    return motion


def inverse(motion: FloatArray) -> FloatArray:
    """Return the inverse of a rigid motion (4, 4)."""
    return np.asarray(np.linalg.inv(motion), np.float64)


def nearest_rotation(matrix: FloatArray) -> FloatArray:
    """Return the rotation nearest to a matrix that was printed with few digits.

    Raises
    ------
    InputError : the matrix differs from a rotation by more than 1e-3
    """
    left, stretch, right = np.linalg.svd(matrix)
    if np.abs(stretch - 1).max() > 1e-3 or np.linalg.det(matrix) < 0:
        raise InputError(f"R is no rotation: its singular values are {stretch.tolist()}")
    return np.asarray(left @ right)


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
    if sine_square < _LEAST_SINE**2:
        raise InputError("the axes are parallel and have no nearest point; give --standoff-mm")
    # The shortest connection of the axes z e_z and c + s a is perpendicular to both directions.
    along = (centre[2] - axis[2] * float(axis @ centre)) / sine_square
    if along <= 0:
        raise InputError("the axes are nearest to each other behind the camera; give --standoff-mm")
    return float(along)
