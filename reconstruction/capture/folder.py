"""A capture: everything needed to reconstruct, as a folder that any rig can write.

| file | content |
|---|---|
| capture.toml | file names, image size, bit depth, [patterns], [sensor] |
| stack.nc | netCDF-4: `stack` (frame, row, col) uint8, uint16 or float32, DN; `frame_name` |
| calibration.yaml | OpenCV YAML, see `rig.calibration` |

The stack is not compressed: xarray, MATLAB and HDFView read it as it is.

Or, from a real camera, one image per frame and another kind of capture.toml: see `description`.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from reconstruction.arrays import FloatImage, Stack
from reconstruction.capture.description import (
    DESCRIPTION_FILE,
    Description,
    read_description,
    write_description,
)
from reconstruction.capture.frame_order import check_order
from reconstruction.capture.frame_set import is_frame_set
from reconstruction.capture.image_files import find_frames, read_frames, read_image_set
from reconstruction.errors import CaptureError, InputError, few, one_line, require_integer
from reconstruction.netcdf import LabelledArrays, pixel_coordinates, read_arrays, write_arrays
from reconstruction.patterns import PatternSet
from reconstruction.reading import is_regular
from reconstruction.rig.calibration import Calibration, read_calibration, write_calibration
from reconstruction.rig.projected_light import ProjectorResponse
from reconstruction.rig.sensor import SensorNoise

if TYPE_CHECKING:
    import xarray

    from reconstruction.drawing import Drawing

STACK_FILE = "stack.nc"
CALIBRATION_FILE = "calibration.yaml"
SUBFOLDER = "capture"
DIMENSIONS = ("frame", "row", "col")
STACK = "stack"
NAMES = "frame_name"
# Digital numbers of a sensor, or the expected values of a noise-free rendering.
TYPES = ("uint8", "uint16", "float32")


@dataclass(frozen=True, eq=False)
class Capture:
    """Frames and what is known about them.

    Parameters
    ----------
    stack : (frame, row, col) uint8 or uint16, DN, in the order of `patterns.frames`; float32 holds
        the expected values of a noise-free rendering, or corrected frames
    sensor : camera noise
    calibration : camera and projector; the camera has the image size of the stack
    bit_depth : bits per pixel value, 8 to 16
    scale : (row, col) float32, by which merged exposures were multiplied, see `merge_exposures`
    response : of the projector, as far as it is known; None: it is taken for linear

    Raises
    ------
    CaptureError : the parts do not fit each other
    """

    stack: Stack
    patterns: PatternSet
    sensor: SensorNoise
    calibration: Calibration
    bit_depth: int
    scale: FloatImage | None = None
    response: ProjectorResponse | None = None

    def __post_init__(self) -> None:
        require_integer("bit_depth", self.bit_depth, 8, 16)
        camera = self.calibration.camera
        expected = (len(self.patterns.frames), camera.height_px, camera.width_px)
        if self.stack.dtype.name not in TYPES or self.stack.shape != expected:
            raise CaptureError(
                f"stack is {self.stack.dtype} {self.stack.shape}; patterns and calibrated camera "
                f"need {' or '.join(TYPES)} {expected} (frame, row, col)"
            )
        # This way round a NaN of a float stack is refused as well.
        largest = 2**self.bit_depth * (1.0 if self.scale is None else float(self.scale.max()))
        if not self.stack.max() < largest:
            raise CaptureError(
                f"stack holds the value {self.stack.max()}; {self.bit_depth} bits end at "
                f"{2**self.bit_depth - 1}: correct bit_depth or the stack"
            )

    def __repr__(self) -> str:
        frames, rows, cols = self.stack.shape
        shown = ", ".join(f"{name} {value}" for name, value in self._in_short().items())
        return f"<Capture: {frames} frames of {rows} x {cols} pixels, {shown}>"

    def _repr_html_(self) -> str:
        from reconstruction.drawing import as_html

        return as_html("capture", self._in_short(), self.plot())

    def _in_short(self) -> dict[str, str]:
        """Return depth and pattern sequence as texts, by name."""
        shown = self.patterns
        return {
            "values": f"{self.stack.dtype}, {self.bit_depth} bits",
            "pattern code": f"{shown.code}, {shown.steps} steps of period {shown.period_px:g} px",
            "projector": f"{shown.height_px} x {shown.width_px} pixels",
        }

    def plot(self) -> "Drawing":
        """Draw the first frame, and the mean and the greatest value of each pixel in all frames.

        Returns
        -------
        A Matplotlib figure over camera columns and rows, grey values in DN
        """
        from reconstruction.drawing import Drawing, draw_image

        drawing = Drawing(3)
        panels = drawing.subplots(1, 3)
        images = {
            f"frame {self.patterns.frames[0].name}": self.stack[0],
            "mean of all frames": self.stack.mean(axis=0),
            "greatest of all frames": self.stack.max(axis=0),
        }
        for axes, (title, image) in zip(panels, images.items(), strict=True):
            draw_image(axes, image, title, "grey value (DN)", 2**self.bit_depth - 1)
        return drawing

    def to_xarray(self) -> "xarray.Dataset":
        """Return the stack (frame, row, col), DN, with the names of its frames."""
        found = stack_arrays(self.stack, self.patterns).to_xarray().set_coords(NAMES)
        places = pixel_coordinates(*self.stack.shape[1:])
        return found.assign_coords(places).assign_attrs(bit_depth=self.bit_depth)


def write_capture(folder: Path | str, capture: Capture) -> None:
    """Write the three files into an existing empty folder.

    Raises
    ------
    CaptureError : the folder is missing or holds something; exposures were merged
    """
    folder = Path(folder)
    if capture.scale is not None:
        raise CaptureError(f"{folder}: merged exposures are no capture; keep their image files")
    if not folder.is_dir() or any(folder.iterdir()):
        raise CaptureError(f"{folder}: write a capture into an existing empty folder")
    _, rows, cols = capture.stack.shape
    description = Description(
        capture.patterns,
        capture.sensor,
        cols,
        rows,
        capture.bit_depth,
        STACK_FILE,
        CALIBRATION_FILE,
        capture.response,
    )
    write_stack(folder / STACK_FILE, capture.stack, capture.patterns)
    write_calibration(folder / CALIBRATION_FILE, capture.calibration)
    write_description(folder / DESCRIPTION_FILE, description)


def read_capture(folder: Path | str) -> Capture:
    """Read a capture from its folder, or from a folder that holds it as `capture/`.

    The order of the frames is checked; image files of several exposures are merged.

    Raises
    ------
    CaptureError : a file is missing, damaged or does not fit the others, or the frames are clearly
        in another order
    """
    folder = find_capture(folder)
    if is_frame_set(folder / DESCRIPTION_FILE):
        return _read_images(folder)
    description = read_description(folder / DESCRIPTION_FILE)
    calibration = read_calibration(folder / description.calibration_file)
    shape = (description.height_px, description.width_px)
    stack = read_stack(folder / description.stack_file, description.patterns, shape)
    parts = (description.patterns, description.sensor, calibration)
    try:
        capture = Capture(stack, *parts, description.bit_depth, response=description.response)
        check_order(stack, *parts)
    except InputError as error:
        raise CaptureError(f"{folder}: {error}") from error
    return capture


def _read_images(folder: Path) -> Capture:
    description = read_image_set(folder / DESCRIPTION_FILE)
    found = find_frames(folder, description)
    calibration = read_calibration(folder / description.calibration_file)
    frames = read_frames(folder, description, found, calibration)
    parts = (found.patterns, description.sensor, calibration)
    try:
        return Capture(
            frames.stack, *parts, description.bit_depth, frames.scale, description.response
        )
    except CaptureError as error:
        raise CaptureError(f"{folder}: {error}") from error


@dataclass(frozen=True, eq=False)
class UncalibratedCapture:
    """Frames that need no calibration to give projector coordinates; fields as of `Capture`."""

    stack: Stack
    patterns: PatternSet
    sensor: SensorNoise
    scale: FloatImage | None = None
    response: ProjectorResponse | None = None


def read_uncalibrated(folder: Path | str) -> UncalibratedCapture:
    """Read a capture whose calibration file need not exist.

    Raises
    ------
    CaptureError : a file is missing, damaged or does not fit the others, or the frames are clearly
        in another order
    """
    folder = find_capture(folder)
    if is_frame_set(folder / DESCRIPTION_FILE):
        listed = read_image_set(folder / DESCRIPTION_FILE)
        found = find_frames(folder, listed)
        frames = read_frames(folder, listed, found)
        return UncalibratedCapture(
            frames.stack, found.patterns, listed.sensor, frames.scale, listed.response
        )
    description = read_description(folder / DESCRIPTION_FILE)
    shape = (description.height_px, description.width_px)
    stack = read_stack(folder / description.stack_file, description.patterns, shape)
    try:
        check_order(stack, description.patterns, description.sensor)
    except InputError as error:
        raise CaptureError(f"{folder}: {error}") from error
    return UncalibratedCapture(
        stack, description.patterns, description.sensor, response=description.response
    )


def described(folder: Path) -> Path | None:
    """Return the folder, here or below, that capture.toml describes; None where there is none."""
    for candidate in (folder, folder / SUBFOLDER):
        if is_regular(candidate / DESCRIPTION_FILE):
            return candidate
    return None


def find_capture(folder: Path | str) -> Path:
    """Return the folder, here or below, that capture.toml describes, or raise CaptureError."""
    found = described(Path(folder))
    if found is None:
        raise CaptureError(
            f"{folder}: no {DESCRIPTION_FILE} here or in {SUBFOLDER}/; give the folder of a capture"
        )
    return found


def write_stack(path: Path, stack: Stack, patterns: PatternSet) -> None:
    """Write a (frame, row, col) uint8, uint16 or float32 stack and the names of its frames."""
    write_arrays(path, stack_arrays(stack, patterns))


def stack_arrays(stack: Stack, patterns: PatternSet) -> LabelledArrays:
    """Return a (frame, row, col) stack, DN, and the names of its frames."""
    attributes = {"units": "DN", "long_name": "camera frames"}
    names = np.array([frame.name for frame in patterns.frames], dtype=object)
    return LabelledArrays({STACK: (DIMENSIONS, stack, attributes), NAMES: ("frame", names, {})})


def read_stack(path: Path, patterns: PatternSet, shape: tuple[int, int]) -> Stack:
    """Read the stack that `patterns` and the image `shape` (rows, cols) announce.

    Raises
    ------
    CaptureError : missing, truncated or damaged file, wrong variable, type, size or frames
    """
    if not is_regular(path):
        raise CaptureError(f"{path}: the stack of frames is missing")
    try:
        file = read_arrays(path)
    except OSError as error:
        raise CaptureError(
            f"{path}: is no complete netCDF-4 file ({one_line(error)}); copy or record it again"
        ) from error
    _check(path, file, patterns, shape)
    return file[STACK]


def _check(path: Path, file: LabelledArrays, patterns: PatternSet, shape: tuple[int, int]) -> None:
    if STACK not in file or NAMES not in file:
        raise CaptureError(f"{path}: needs the variables {STACK} and {NAMES}")
    dims, stack, _ = file.variables[STACK]
    if dims != DIMENSIONS or str(stack.dtype) not in TYPES:
        raise CaptureError(
            f"{path}: stack is {stack.dtype} {dims}; it must be {' or '.join(TYPES)} {DIMENSIONS}"
        )
    _check_frames(path, [_text(name) for name in file[NAMES]], patterns)
    expected = (len(patterns.frames), *shape)
    if stack.shape != expected:
        raise CaptureError(
            f"{path}: stack has shape {stack.shape}; capture.toml announces {expected}"
        )


def _check_frames(path: Path, found: list[str], patterns: PatternSet) -> None:
    expected = [frame.name for frame in patterns.frames]
    if found == expected:
        return
    missing = [name for name in expected if name not in found]
    extra = [name for name in found if name not in expected]
    raise CaptureError(
        f"{path}: holds {len(found)} frames, the pattern set has {len(expected)}; "
        f"missing: {few(missing)}; not expected: {few(extra)}; "
        "frames must be in the order of the pattern set"
    )


def _text(name: Any) -> str:
    return name.decode("utf-8") if isinstance(name, bytes) else str(name)
