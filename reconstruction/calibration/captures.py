"""Captures of a board: like any capture, but the rig is not calibrated yet."""

from dataclasses import dataclass
from pathlib import Path

from reconstruction.arrays import FloatImage, Stack
from reconstruction.capture.description import read_description
from reconstruction.capture.folder import DESCRIPTION_FILE, SUBFOLDER
from reconstruction.capture.frame_order import check_order
from reconstruction.capture.frame_set import is_frame_set, read_frame_set
from reconstruction.capture.image_files import read_frames
from reconstruction.capture.pattern_files import read_manifest
from reconstruction.capture.stack_file import read_stack
from reconstruction.errors import CaptureError, InputError
from reconstruction.patterns import PatternSet
from reconstruction.rig.sensor import SensorNoise

# What a pose was recorded in; a folder of such files is not left out silently.
RECORDED = {".png", ".tif", ".tiff", ".bmp", ".exr", ".nc"}


@dataclass(frozen=True, eq=False)
class BoardCapture:
    """Frames of one board pose, (frame, row, col) DN, and what is known about them.

    scale : (row, col) float32, by which merged exposures were multiplied, see `merge_exposures`
    """

    stack: Stack
    patterns: PatternSet
    sensor: SensorNoise
    scale: FloatImage | None = None


def read_board_capture(folder: Path | str) -> BoardCapture:
    """Read a capture whose calibration file need not exist.

    Raises
    ------
    CaptureError : a file is missing, damaged or does not fit the others, or the frames are clearly
        in another order
    """
    folder = _find(Path(folder))
    if is_frame_set(folder / DESCRIPTION_FILE):
        frame_set = read_frame_set(folder / DESCRIPTION_FILE)
        patterns = read_manifest(folder / frame_set.patterns_file)
        frames = read_frames(folder, frame_set, patterns)
        return BoardCapture(frames.stack, patterns, frame_set.sensor, frames.scale)
    description = read_description(folder / DESCRIPTION_FILE)
    shape = (description.height_px, description.width_px)
    stack = read_stack(folder / description.stack_file, description.patterns, shape)
    try:
        check_order(stack, description.patterns, description.sensor)
    except InputError as error:
        raise CaptureError(f"{folder}: {error}") from error
    return BoardCapture(stack, description.patterns, description.sensor)


def pose_folders(folder: Path | str) -> list[Path]:
    """Return the pose folders inside `folder` in the order of their names.

    Raises
    ------
    CaptureError : there is none, or one holds images that no capture.toml describes
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise CaptureError(f"{folder}: no such folder; give one that holds a folder per board pose")
    inside = sorted(path for path in folder.iterdir() if path.is_dir())
    found = [path for path in inside if _described(path) is not None]
    for path in inside:
        if path not in found and any(item.suffix.lower() in RECORDED for item in path.iterdir()):
            raise CaptureError(
                f"{path}: holds images but no {DESCRIPTION_FILE}; write one (copy that of another "
                "pose), or move the folder away"
            )
    if not found:
        raise CaptureError(
            f"{folder}: no folder with {DESCRIPTION_FILE} in it; give the folder that holds one "
            "capture folder per board pose"
        )
    return found


def _find(folder: Path) -> Path:
    found = _described(folder)
    if found is None:
        raise CaptureError(f"{folder}: no {DESCRIPTION_FILE} here or in {SUBFOLDER}/")
    return found


def _described(folder: Path) -> Path | None:
    for candidate in (folder, folder / SUBFOLDER):
        if (candidate / DESCRIPTION_FILE).is_file():
            return candidate
    return None
