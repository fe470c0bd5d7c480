"""Read and write capture.toml of a real rig with one image file per frame.

| key | content |
|---|---|
| format, version | "fringe-frames", 1 |
| files | pattern of the file names, see below |
| bit_depth | bits per pixel value, 8 to 16 |
| patterns_file | manifest, patterns.toml, of the projected images |
| calibration_file | OpenCV YAML, see `rig.calibration` |
| dark_file | optional: an image without light, preferably a mean of many |
| exposures_ms | optional: exposure time of each set, if all frames were recorded several times |
| channel | optional: channel of colour images to read, "red", "green" or "blue" |
| [sensor] | camera noise, see `SensorNoise` |
| [response] | optional: response of the projector, see `ProjectorResponse` |
| [stage] | optional: motion of the specimen, see `motion.positions.StageMotion` |

The pattern of the file names has fields, as in "{index:03d}_{name}.png". {index} is the number of
the frame from 0, {number} its number from 1, and {name} its name. {set} is the number of its set
from 0. Numbers are at most 99 digits wide. Or the pattern has * and ?; then the frames are the
matching files in natural order of their names (frame_2 before frame_10).

Paths are relative to the folder of capture.toml. For images that other programs wrote, [[frames]]
replaces files and patterns_file, see `frame_list`.
"""

import re
import string
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from reconstruction import reading
from reconstruction.arrays import Stack
from reconstruction.capture.description import (
    DESCRIPTION_FILE,
    MANIFEST_FILE,
    file_names,
    read_manifest,
    read_parts,
    write_manifest,
    write_toml,
)
from reconstruction.capture.recorded import (
    FRAMES_FORMAT,
    FRAMES_VERSION,
    ImageSet,
    RecordedFrames,
    natural_key,
    require_below,
)
from reconstruction.errors import CaptureError, InputError, few, require_integer, require_number
from reconstruction.patterns import PatternSet
from reconstruction.rig.sensor import SensorNoise
from reconstruction.writing import write_png

FIELDS = ("index", "number", "name", "set")
_FILES = "{index:03d}_{name}.png"
_LONGEST_SHOWN = 200


@dataclass(frozen=True, kw_only=True)
class FrameSet(ImageSet):
    """Content of a capture.toml with the key `files`; the module's text explains the keys."""

    files: str
    patterns_file: str = "patterns.toml"
    exposures_ms: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        self.require_names("files", "patterns_file", "calibration_file", allow_empty=False)
        object.__setattr__(self, "exposures_ms", _exposures(self.exposures_ms))
        require_below("files", self.files)
        _check_fields(self.files, self.sets)

    @property
    def sets(self) -> int:
        """Number of sets of frames: how often the pattern sequence was recorded."""
        return max(1, len(self.exposures_ms))

    def recorded(self, folder: Path) -> RecordedFrames:
        """Return the frames on disk in a folder, in the order of its manifest.

        Raises
        ------
        CaptureError : the manifest or images are missing, or there are too many images
        """
        patterns = read_manifest(folder / self.patterns_file)
        files = frame_files(folder, self, patterns)
        return self.recorded_as(folder, patterns, files, self.exposures_ms)


def read_frame_set(path: Path) -> FrameSet:
    """Read a capture.toml with the key `files`.

    Raises
    ------
    CaptureError : no TOML, wrong format or version, unknown or missing key, value out of range
    """
    return read_parts(path, (FRAMES_FORMAT, FRAMES_VERSION), FrameSet, {"sensor": SensorNoise})


def frame_files(folder: Path, description: FrameSet, patterns: PatternSet) -> list[list[Path]]:
    """Return a list for each set with the image file of each frame, ordered as `patterns.frames`.

    Raises
    ------
    CaptureError : images are missing, or there are too many
    """
    find = _sorted_files if _is_glob(description.files) else _named_files
    return [find(folder, description, patterns, number) for number in range(description.sets)]


def _named_files(
    folder: Path, description: FrameSet, patterns: PatternSet, number: int
) -> list[Path]:
    files = [
        folder / description.files.format(index=i, number=i + 1, name=frame.name, set=number)
        for i, frame in enumerate(patterns.frames)
    ]
    missing = [
        path.relative_to(folder).as_posix() for path in files if not reading.is_regular(path)
    ]
    if missing:
        raise CaptureError(
            f"{folder}: {len(missing)} of {len(files)} frames are missing: {few(missing)}; "
            "record them, or correct files in capture.toml"
        )
    return files


def _sorted_files(
    folder: Path, description: FrameSet, patterns: PatternSet, number: int
) -> list[Path]:
    pattern = description.files.format(set=number)
    dark = folder / description.dark_file
    files = sorted((path for path in folder.glob(pattern) if path != dark), key=natural_key)
    if len(files) != len(patterns.frames):
        raise CaptureError(
            f"{folder}: {pattern} finds {len(files)} images, the pattern set has "
            f"{len(patterns.frames)} frames{_gap(files)}; record the sequence again, or correct "
            "files in capture.toml"
        )
    return files


def _gap(files: list[Path]) -> str:
    """Return a text with the first gap in the numbers at the end of the names, or ""."""
    matches = [re.search(r"(\d+)\D*$", path.name) for path in files]
    numbers = [int(match.group(1)) for match in matches if match]
    for before, after in pairwise(numbers):
        if after - before > 1:
            return f" (their numbers jump from {before} to {after})"
    return ""


def _is_glob(files: str) -> bool:
    return any(sign in files for sign in "*?")


def _check_fields(files: str, sets: int) -> None:
    try:
        parts = [part[1:] for part in string.Formatter().parse(files) if part[1] is not None]
    except ValueError:
        parts = [("", "", None)]
    named, allowed = [str(part[0]) for part in parts], ("set",) if _is_glob(files) else FIELDS
    if not all(name in allowed and _is_narrow(name, *form) for name, *form in parts):
        raise InputError(
            f"files is {files[:_LONGEST_SHOWN]!r}; allowed are the fields {', '.join(FIELDS)} in "
            "braces, numbers with up to two digits of width as in {index:03d}, or * and ? with at "
            "most {set}"
        )
    if not (_is_glob(files) or {"index", "number", "name"} & set(named)):
        raise InputError(f"files is {files!r}: the same name for all frames; use {{index}}")
    if (sets > 1) != ("set" in named):
        raise InputError(
            f"files is {files!r} with {sets} sets of frames; {{set}} is the number (from 0)"
            " of each of exposures_ms, use both or neither"
        )


def _is_narrow(name: str | None, form: str | None, conversion: str | None) -> bool:
    """Return True if a field is at most 99 digits wide; a width of ten digits would take GBs."""
    width = r"" if name == "name" else r"0?\d{0,2}d?"
    return conversion is None and re.fullmatch(width, form or "") is not None


def _exposures(values: object) -> tuple[float, ...]:
    if not isinstance(values, (list, tuple)):
        raise InputError(f"exposures_ms is {values!r}; give a list of numbers")
    for value in values:
        require_number("exposures_ms", value, 0.0, open_low=True)
    return tuple(float(value) for value in values)


def write_frame_set(
    folder: Path | str,
    stack: Stack,
    patterns: PatternSet,
    sensor: SensorNoise,
    bit_depth: int,
) -> None:
    """Write image files, manifest and capture.toml into an existing folder.

    A calibration file is not written.

    Parameters
    ----------
    stack : (frame, row, col) uint8 or uint16, DN; the image files have the same type
    patterns : projected patterns, one frame each
    sensor : camera noise
    bit_depth : bits per pixel value, 8 to 16

    Raises
    ------
    CaptureError : the stack does not fit the patterns, or is not uint8 or uint16
    """
    folder = Path(folder)
    require_integer("bit_depth", bit_depth, 8, 16)
    if len(stack) != len(patterns.frames) or stack.dtype not in (np.uint8, np.uint16):
        raise CaptureError(
            f"stack is {stack.dtype} {stack.shape}; images need uint8 or uint16 of "
            f"{len(patterns.frames)} frames"
        )
    for name, frame in zip(file_names(patterns), stack, strict=True):
        write_png(folder / name, frame)
    write_manifest(folder / MANIFEST_FILE, patterns)
    header = {
        "format": FRAMES_FORMAT,
        "version": FRAMES_VERSION,
        "files": _FILES,
        "bit_depth": bit_depth,
        "patterns_file": FrameSet.patterns_file,
        "calibration_file": FrameSet.calibration_file,
    }
    write_toml(folder / DESCRIPTION_FILE, header, {"sensor": asdict(sensor)})
