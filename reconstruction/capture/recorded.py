"""Recorded frames: the files that contain the frames of a capture, and their exposures.

Each kind of capture.toml is read as one `RecordedFrames`, by its function `recorded`:

| format | class | images |
|---|---|---|
| fringe-capture | `description.Description` | one netCDF-4 stack |
| fringe-frames with `files` | `frame_set.FrameSet` | named or numbered, with a manifest |
| fringe-frames with [[frames]] | `frame_list.ListedSet` | described one group at a time |

A capture.toml that `guess` writes is of the last kind.
"""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

from reconstruction.errors import InputError, require_integer
from reconstruction.patterns import PatternSet
from reconstruction.rig.projected_light import ProjectorResponse
from reconstruction.rig.sensor import SensorNoise

FRAMES_FORMAT, FRAMES_VERSION = "fringe-frames", 1
Channel = Literal["", "red", "green", "blue"]
CHANNELS: tuple[Channel, ...] = get_args(Channel)
_LONGEST_SHOWN = 200


@dataclass(frozen=True)
class RecordedFrames:
    """Frames on disk, in the order of `patterns.frames`, before any image is read.

    Parameters
    ----------
    folder : of capture.toml
    calibration_file : need not exist
    response : of the projector, if it is known
    stack_file : contains all frames; None: they are in `files`
    shape : (rows, cols) of the stack
    files : image of every frame, one list for each exposure
    exposures_ms : one for each list of `files`; () where there is one exposure
    dark_file : image without light; None: none was recorded
    channel : channel of colour images to read; "": images are grey
    """

    folder: Path
    patterns: PatternSet
    sensor: SensorNoise
    bit_depth: int
    calibration_file: Path
    response: ProjectorResponse | None = None
    stack_file: Path | None = None
    shape: tuple[int, int] = (0, 0)
    files: tuple[tuple[Path, ...], ...] = ()
    exposures_ms: tuple[float, ...] = ()
    dark_file: Path | None = None
    channel: Channel = ""


@dataclass(frozen=True, kw_only=True)
class ImageSet:
    """Keys that every capture.toml of single images has; see `frame_set`."""

    sensor: SensorNoise
    bit_depth: int
    calibration_file: str = "calibration.yaml"
    dark_file: str = ""
    channel: Channel = ""
    response: ProjectorResponse | None = None

    def __post_init__(self) -> None:
        require_integer("bit_depth", self.bit_depth, 8, 16)
        require_one_of("channel", self.channel, CHANNELS)
        self.require_names("calibration_file", "dark_file")
        largest = 2**self.bit_depth - 1
        if self.sensor.saturation_dn > largest:
            raise InputError(
                f"sensor saturation_dn is {self.sensor.saturation_dn:g}; {self.bit_depth} bits end "
                f"at {largest}, give at most that"
            )

    def require_names(self, *keys: str, allow_empty: bool = True) -> None:
        """Raise InputError unless the values of these keys are texts."""
        for key in keys:
            value = getattr(self, key)
            if not isinstance(value, str) or not (value or allow_empty):
                raise InputError(f"{key} is {value!r}; give the name of a file")

    def recorded_as(
        self,
        folder: Path,
        patterns: PatternSet,
        files: list[list[Path]],
        exposures_ms: tuple[float, ...],
    ) -> RecordedFrames:
        """Return the images of a folder as recorded frames."""
        return RecordedFrames(
            folder,
            patterns,
            self.sensor,
            self.bit_depth,
            folder / self.calibration_file,
            self.response,
            files=tuple(map(tuple, files)),
            exposures_ms=exposures_ms,
            dark_file=folder / self.dark_file if self.dark_file else None,
            channel=self.channel,
        )


def require_one_of(key: str, value: object, allowed: tuple[str, ...]) -> None:
    """Raise InputError unless the value of a key is one of the allowed texts."""
    if value not in allowed:
        texts = ", ".join(repr(text) for text in allowed)
        raise InputError(f"{key} is {value!r}; allowed are {texts}")


def require_below(key: str, files: str) -> None:
    """Raise InputError for names outside the folder, and patterns that search all folders in it."""
    parts = files.split("/")
    if parts[0] in ("", "~") or ".." in parts or "**" in files or "\0" in files:
        raise InputError(
            f"{key} is {files[:_LONGEST_SHOWN]!r}; give names in the folder of capture.toml or in "
            "a named folder below it, without .. or **"
        )


def natural_key(path: Path) -> list[tuple[int, str]]:
    """Sort key that places frame_2 before frame_10."""
    parts = re.split(r"(\d+)", path.as_posix())
    return [(int(part), "") if part.isdigit() else (-1, part) for part in parts]
