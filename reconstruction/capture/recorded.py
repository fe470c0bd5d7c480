"""Describe recorded frames on disk: the files with the frames of a capture, and their exposures.

There are three formats of capture.toml. The method `recorded` of each class returns the frames as a
`RecordedFrames`:

| format | class | images |
|---|---|---|
| fringe-capture | `description.Description` | one netCDF-4 stack |
| fringe-frames with `files` | `frame_set.FrameSet` | files with names or numbers, and a manifest |
| fringe-frames with [[frames]] | `frame_list.ListedSet` | files, described group by group |

`guess_file` writes a capture.toml of the last format.
"""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

from reconstruction.errors import InputError, require_integer
from reconstruction.motion.positions import StageMotion
from reconstruction.patterns import PatternSet
from reconstruction.rig.projected_light import ProjectorResponse
from reconstruction.rig.sensor import SensorNoise

FRAMES_FORMAT, FRAMES_VERSION = "fringe-frames", 1
Channel = Literal["", "red", "green", "blue"]
CHANNELS: tuple[Channel, ...] = get_args(Channel)
_LONGEST_SHOWN = 200


@dataclass(frozen=True)
class RecordedFrames:
    """Files with the frames of a capture, and all that is needed to read and decode them.

    Parameters
    ----------
    folder : folder of capture.toml
    patterns : pattern set that the frames show
    sensor : camera noise
    bit_depth : bits per pixel value, 8 to 16
    calibration_file : path of the calibration, which need not exist
    response : response of the projector; None: unknown
    stage : motion of the specimen during the capture; None: at rest
    stack_file : file with all frames; None: they are in `files`
    shape : (rows, cols) of the frames in `stack_file`
    files : for each exposure the image of each frame, in the order of `patterns.frames`
    exposures_ms : exposure time of each element of `files`; (): there is one exposure
    dark_file : image without light; None: none was recorded
    channel : channel of colour images to read; "": the images are grey
    """

    folder: Path
    patterns: PatternSet
    sensor: SensorNoise
    bit_depth: int
    calibration_file: Path
    response: ProjectorResponse | None = None
    stage: StageMotion | None = None
    stack_file: Path | None = None
    shape: tuple[int, int] = (0, 0)
    files: tuple[tuple[Path, ...], ...] = ()
    exposures_ms: tuple[float, ...] = ()
    dark_file: Path | None = None
    channel: Channel = ""


@dataclass(frozen=True, kw_only=True)
class ImageSet:
    """Keys of every capture.toml with one image file per frame; `frame_set` explains the keys."""

    sensor: SensorNoise
    bit_depth: int
    calibration_file: str = "calibration.yaml"
    dark_file: str = ""
    channel: Channel = ""
    response: ProjectorResponse | None = None
    stage: StageMotion | None = None

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
        """Raise InputError unless the value of each of these keys is a text.

        An empty text is allowed only if `allow_empty` is True.
        """
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
        """Return the frames on disk in a folder, with the values of the keys of this object."""
        return RecordedFrames(
            folder,
            patterns,
            self.sensor,
            self.bit_depth,
            folder / self.calibration_file,
            self.response,
            self.stage,
            files=tuple(map(tuple, files)),
            exposures_ms=exposures_ms,
            dark_file=folder / self.dark_file if self.dark_file else None,
            channel=self.channel,
        )


def require_one_of(key: str, value: object, allowed: tuple[str, ...]) -> None:
    """Raise InputError unless the value of a key is one of the allowed texts.

    The message names `key`.
    """
    if value not in allowed:
        texts = ", ".join(repr(text) for text in allowed)
        raise InputError(f"{key} is {value!r}; allowed are {texts}")


def require_below(key: str, files: str) -> None:
    """Raise InputError if `files` may name files outside the folder, or searches all subfolders."""
    parts = files.split("/")
    if parts[0] in ("", "~") or ".." in parts or "**" in files or "\0" in files:
        raise InputError(
            f"{key} is {files[:_LONGEST_SHOWN]!r}; give names in the folder of capture.toml or in "
            "a named folder below it, without .. or **"
        )


def natural_key(path: Path) -> list[tuple[int, str]]:
    """Return the sort key of a path in natural order, with frame_2 before frame_10."""
    parts = re.split(r"(\d+)", path.as_posix())
    return [(int(part), "") if part.isdigit() else (-1, part) for part in parts]
