"""Read and write captures: folders with all data that a reconstruction needs.

| file | content |
|---|---|
| capture.toml | file names, image size, bit depth, [patterns], [sensor] |
| stack.nc | netCDF-4: `stack` (frame, row, col) uint8, uint16 or float32, DN; `frame_name` |
| calibration.yaml | OpenCV YAML, see `rig.calibration` |

The capture of a real camera may have one image file per frame instead of stack.nc, and another kind
of capture.toml, see `recorded`.
"""

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from reconstruction.arrays import LATER, FloatImage, Stack
from reconstruction.capture.description import (
    DESCRIPTION_FILE,
    Description,
    read_description,
    read_toml,
    write_description,
)
from reconstruction.capture.frame_list import read_listed
from reconstruction.capture.frame_order import check_order
from reconstruction.capture.frame_set import read_frame_set
from reconstruction.capture.image_files import (
    check_exposures,
    merge_exposures,
    read_exposures,
    with_file_names,
)
from reconstruction.capture.recorded import FRAMES_FORMAT, RecordedFrames
from reconstruction.capture.stack_file import NAMES, TYPES, read_stack, stack_arrays, write_stack
from reconstruction.errors import CaptureError, InputError, require_integer
from reconstruction.motion.positions import StageMotion
from reconstruction.netcdf import pixel_coordinates
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


@dataclass(frozen=True, eq=False)
class Capture:
    """Recorded frames with their patterns, camera noise and calibration: input of `reconstruct`.

    Parameters
    ----------
    stack : (frame, row, col) uint8 or uint16, DN, in the order of `patterns.frames`; float32:
        expected values of a noise-free rendering, or corrected frames
    patterns : projected patterns
    sensor : camera noise
    calibration : geometry of the rig; its camera has the image size of the stack
    bit_depth : bits per pixel value, 8 to 16
    scale : (row, col) float32, factor by which each pixel's DN above the black level was
        multiplied, see `merge_exposures`; None: a single exposure
    response : response of the projector; None: it is unknown and assumed linear
    stage : motion of the specimen during the capture, by which `reconstruct` corrects the frames;
        None: it was at rest

    Raises
    ------
    CaptureError : the parts are inconsistent
    """

    stack: Stack
    patterns: PatternSet
    sensor: SensorNoise
    calibration: Calibration
    bit_depth: int
    scale: FloatImage | None = None
    response: ProjectorResponse | None = None
    stage: StageMotion | None = field(default=None, metadata=LATER)

    def __post_init__(self) -> None:
        require_integer("bit_depth", self.bit_depth, 8, 16)
        camera = self.calibration.camera
        expected = (len(self.patterns.frames), camera.height_px, camera.width_px)
        if self.stack.dtype.name not in TYPES or self.stack.shape != expected:
            raise CaptureError(
                f"stack is {self.stack.dtype} {self.stack.shape}; patterns and calibrated camera "
                f"need {' or '.join(TYPES)} {expected} (frame, row, col)"
            )
        # Written as "not below", so that a NaN of a float stack is an error as well.
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
        """Return short texts on data type and bit depth, pattern code and projector, by name."""
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
        """Return the stack (frame, row, col), DN, and the names of its frames as a dataset."""
        dataset = stack_arrays(self.stack, self.patterns).to_xarray().set_coords(NAMES)
        places = pixel_coordinates(*self.stack.shape[1:])
        return dataset.assign_coords(places).assign_attrs(bit_depth=self.bit_depth)


def write_capture(folder: Path | str, capture: Capture) -> None:
    """Write stack.nc, calibration.yaml and capture.toml into an existing empty folder.

    Raises
    ------
    CaptureError : the folder is missing or not empty, or the capture has merged exposures
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
        capture.stage,
    )
    write_stack(folder / STACK_FILE, capture.stack, capture.patterns)
    write_calibration(folder / CALIBRATION_FILE, capture.calibration)
    write_description(folder / DESCRIPTION_FILE, description)


def read_capture(folder: Path | str) -> Capture:
    """Read a capture from its folder, or from the subfolder `capture/` of `folder`.

    The frames are compared with the order that capture.toml states. Image files of several
    exposures are merged.

    Raises
    ------
    CaptureError : a file is missing, damaged or inconsistent, or the frames are clearly in another
        order than capture.toml states
    """
    recorded = find_recorded(find_capture(folder))
    calibration = read_calibration(recorded.calibration_file)
    stack, scale = read_frames(recorded, calibration)
    parts = (recorded.patterns, recorded.sensor, calibration, recorded.bit_depth)
    try:
        return Capture(stack, *parts, scale, recorded.response, recorded.stage)
    except CaptureError as error:
        raise CaptureError(f"{recorded.folder}: {error}") from error


@dataclass(frozen=True, eq=False)
class UncalibratedCapture:
    """Recorded frames without calibration, for `decode`; the fields are as in `Capture`."""

    stack: Stack
    patterns: PatternSet
    sensor: SensorNoise
    scale: FloatImage | None = None
    response: ProjectorResponse | None = None


def read_uncalibrated(folder: Path | str) -> UncalibratedCapture:
    """Read a capture without its calibration file, which need not exist.

    Raises
    ------
    CaptureError : a file is missing, damaged or inconsistent, or the frames are clearly
        not in the order that capture.toml states, or capture.toml has a table [stage]
    """
    recorded = find_recorded(find_capture(folder))
    if recorded.stage is not None:
        raise CaptureError(
            f"{recorded.folder}: [stage] needs the calibration of the rig; reconstruct the capture,"
            " or remove [stage] to decode the frames as they are"
        )
    stack, scale = read_frames(recorded)
    return UncalibratedCapture(stack, recorded.patterns, recorded.sensor, scale, recorded.response)


def find_recorded(folder: Path) -> RecordedFrames:
    """Return the frames on disk that the capture.toml of a folder describes, of any format.

    Raises
    ------
    CaptureError : capture.toml is damaged, images or patterns.toml are missing, or the listed
        frames cannot be decoded
    """
    path = folder / DESCRIPTION_FILE
    values = read_toml(path)
    if values.get("format") != FRAMES_FORMAT:
        return read_description(path).recorded(folder)
    read = read_listed if "frames" in values else read_frame_set
    return read(path).recorded(folder)


def read_frames(
    recorded: RecordedFrames, calibration: Calibration | None = None
) -> tuple[Stack, FloatImage | None]:
    """Read and check recorded frames, and merge several exposures.

    Parameters
    ----------
    calibration : helps to detect exchanged axes; None: the rig is not calibrated

    Returns
    -------
    stack (frame, row, col), DN, and the scale factor of each pixel (row, col), see
    `merge_exposures`; None instead of the factors for a single exposure

    Raises
    ------
    CaptureError : files are missing or damaged, sizes or types differ, values exceed the bit depth,
        brightness contradicts the exposure times, or frames are clearly in another order
    """
    patterns, sensor = recorded.patterns, recorded.sensor
    if recorded.stack_file is not None:
        stacks = [read_stack(recorded.stack_file, patterns, recorded.shape)]
    else:
        stacks = read_exposures(recorded)
    try:
        for stack in stacks:
            check_order(stack, patterns, sensor, calibration)
        if len(stacks) == 1:
            return stacks[0], None
        check_exposures(stacks, recorded)
        merged = merge_exposures(stacks, recorded.exposures_ms, sensor)
    except InputError as error:
        message = with_file_names(str(error), recorded)
        raise CaptureError(f"{recorded.folder}: {message}") from error
    return merged.stack, merged.scale


def described(folder: Path) -> Path | None:
    """Return `folder` if it has a capture.toml, else its subfolder `capture/`; None: neither."""
    for candidate in (folder, folder / SUBFOLDER):
        if is_regular(candidate / DESCRIPTION_FILE):
            return candidate
    return None


def find_capture(folder: Path | str) -> Path:
    """Return `folder` if it has a capture.toml, else its subfolder `capture/` if that has one.

    Raises
    ------
    CaptureError : neither has a capture.toml
    """
    subfolder = described(Path(folder))
    if subfolder is None:
        raise CaptureError(
            f"{folder}: no {DESCRIPTION_FILE} here or in {SUBFOLDER}/; give the folder of a capture"
        )
    return subfolder
