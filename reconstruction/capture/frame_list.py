"""Read a capture.toml that lists the pattern of each image, for images of other programs.

| key | content |
|---|---|
| format, version | "fringe-frames", 1 |
| bit_depth, calibration_file, dark_file, | |
| channel, [sensor], [response], [stage] | as with the key `files`, see `frame_set` |
| [projector] | width_px, height_px; pixel_ratio, if pixels are not square |
| [[frames]] | one table for each group of images, see `FrameEntry` |

Each group is expanded into `ListedFrame`s, one per image. The frames are sorted into the order of
decoding, independently of their names, and define the `PatternSet`. With the key `files` and a
manifest no list is needed.

A phase frame shows A + B cos(2 pi x / period + sign * shift). A set of N phase frames must have N
equal steps of 360 degrees / N; its first shift is arbitrary. The bits of a reflected code word
without the finest bit number stripes that are wider by a factor of two. Therefore bits that are
finer than the fringes need may be listed, but are not used.
"""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

from reconstruction import reading
from reconstruction.capture.description import DESCRIPTION_FILE, build, read_parts
from reconstruction.capture.frame_arrangement import Arrangement, ListedFrame, ProjectorSize
from reconstruction.capture.recorded import (
    FRAMES_FORMAT,
    FRAMES_VERSION,
    ImageSet,
    RecordedFrames,
    natural_key,
    require_below,
    require_one_of,
)
from reconstruction.codes import code_of
from reconstruction.errors import CaptureError, InputError, few, require_integer, require_number
from reconstruction.patterns import AXES, Axis
from reconstruction.rig.sensor import SensorNoise
from reconstruction.words import WORDS

EntryKind = Literal["phase", "gray", "inverse", "gray_and_inverse", "white", "black"]
BitOrder = Literal["coarse_first", "fine_first"]
MOST_FRAMES = 4096
# Allowed periods and code word widths: a word may be narrower than a pixel, and a single fringe
# longer than the projector image.
PERIOD_RANGE_PX = (0.01, 1e6)
_RANGE = re.compile(r"\{(\d{1,9})\.\.(\d{1,9})(?:\.\.(\d{1,4}))?\}")


@dataclass(frozen=True)
class FrameEntry:
    """One table [[frames]]: a group of images of equal kind.

    Parameters
    ----------
    files : file names in the order of projection: a name; a name with * or ?, for all matching
        files in natural order; a name with a range of numbers as in {00..21} or {0..20..2}, also
        descending; or a list of these
    kind : kind of the patterns; with gray_and_inverse each Gray frame is followed by its inverse
    axis : projector axis along which the pattern varies; "column": vertical stripes. None: white or
        black
    period_px : period of the fringes; for bits the width of one code word, which must be given if
        there are more bits than the fringes need
    steps : number N of phase steps, which must be the number of images; None: not stated
    shift_deg : shift of each phase frame, degrees; a single number is the shift of the first frame,
        and further frames follow in steps of 360 / N
    sign : 1: the shift is added to 2 pi x / period; -1: it is subtracted
    bit : bit that each Gray frame shows, 0 for the coarsest; None: the order given by `bits`
    bits : whether the first frame shows the coarsest or the finest bit
    shifted : whether the frames are of the second code word, displaced by half a period
    exposure_ms : exposure time, if the pattern sequence was recorded with several exposures
    """

    files: str | list[str]
    kind: EntryKind
    axis: Axis | None = None
    period_px: float | None = None
    steps: int | None = None
    shift_deg: float | list[float] = 0.0
    sign: int = 1
    bit: int | list[int] | None = None
    bits: BitOrder = "coarse_first"
    shifted: bool = False
    exposure_ms: float | None = None

    def __post_init__(self) -> None:
        require_one_of("kind", self.kind, get_args(EntryKind))
        require_one_of("bits", self.bits, get_args(BitOrder))
        if not _all_of(str, self.files) or not self.files:
            raise InputError(f"frames files is {self.files!r}; give a name or a list of names")
        is_uniform = self.kind in ("white", "black")
        if (self.axis is None) != is_uniform or self.axis not in (None, *AXES):
            remedy = "leave it out" if is_uniform else "allowed are column and row"
            raise InputError(f"frames axis of kind {self.kind!r} is {self.axis!r}; {remedy}")
        if self.kind == "phase" and self.period_px is None:
            raise InputError(
                f"frames period_px of {self.files!r} is missing; give that of the fringes"
            )
        if self.period_px is not None:
            require_number("frames period_px", self.period_px, *PERIOD_RANGE_PX)
        if self.exposure_ms is not None:
            require_number("frames exposure_ms", self.exposure_ms, 0.0, 1e9, open_low=True)
        if self.sign not in (1, -1) or isinstance(self.sign, bool):
            raise InputError(f"frames sign is {self.sign!r}; allowed are 1 and -1")
        if not isinstance(self.shifted, bool):
            raise InputError(f"frames shifted is {self.shifted!r}; give true or false")
        if self.steps is not None:
            require_integer("frames steps", self.steps, 1, MOST_FRAMES)
        for shift in _as_list(self.shift_deg):
            require_number("frames shift_deg", shift, -36000.0, 36000.0)
        for bit in _as_list(self.bit if self.bit is not None else []):
            require_integer("frames bit", bit, 0, 16)


@dataclass(frozen=True, kw_only=True)
class ListedSet(ImageSet):
    """Content of a capture.toml with a list of frames.

    Parameters
    ----------
    projector : image size of the projector
    frames : groups of images
    word : encoding of code words as bits, see `PatternSet`
    code : name of the pattern code; "": the only code that has such frames. The name must be given
        if several codes have them
    """

    projector: ProjectorSize
    frames: tuple[FrameEntry, ...]
    word: str = "reflected"
    code: str = ""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.code != "":
            code_of(self.code)
        require_one_of("word", self.word, WORDS.names())
        object.__setattr__(self, "frames", _entries(self.frames))

    def recorded(self, folder: Path) -> RecordedFrames:
        """Return the frames on disk in a folder, in the order of decoding.

        Raises
        ------
        CaptureError : an image is missing or listed twice, a group has a wrong number of images, or
            the listed frames cannot be decoded
        """
        try:
            groups = [_expand(folder, entry, self.dark_file) for entry in self.frames]
            return self._arranged(folder, [frame for group in groups for frame in group])
        except InputError as error:
            raise CaptureError(f"{folder / DESCRIPTION_FILE}: {error}") from error

    def _arranged(self, folder: Path, frames: Sequence[ListedFrame]) -> RecordedFrames:
        exposures = sorted({frame.exposure_ms for frame in frames})
        sets = [
            [frame for frame in frames if frame.exposure_ms == exposure] for exposure in exposures
        ]
        arrangements = [
            Arrangement(frames_of_set, self.projector, self.word, self.code)
            for frames_of_set in sets
        ]
        for arrangement, exposure in zip(arrangements, exposures, strict=True):
            if arrangement.patterns != arrangements[0].patterns:
                raise CaptureError(
                    f"the frames of exposure_ms {exposure:g} show another sequence than those of "
                    f"{exposures[0]:g}; list all frames for every exposure"
                )
        files = [[folder / name for name in arrangement.files] for arrangement in arrangements]
        times_ms = tuple(exposures) if len(exposures) > 1 else ()
        return self.recorded_as(folder, arrangements[0].patterns, files, times_ms)


def read_listed(path: Path) -> ListedSet:
    """Read a capture.toml with a list of frames.

    Raises
    ------
    CaptureError : no TOML, wrong format or version, unknown or missing key, value out of range
    """
    tables = {"sensor": SensorNoise, "projector": ProjectorSize}
    return read_parts(path, (FRAMES_FORMAT, FRAMES_VERSION), ListedSet, tables)


def _entries(frames: Any) -> tuple[FrameEntry, ...]:
    """Return the tables [[frames]] as `FrameEntry` objects; such objects are not changed."""
    if not isinstance(frames, (list, tuple)) or not frames:
        raise CaptureError("frames is no list of tables; write each as [[frames]]")
    if all(isinstance(frame, FrameEntry) for frame in frames):
        return tuple(frames)
    if not all(isinstance(frame, dict) for frame in frames):
        raise CaptureError("frames is no list of tables; write each as [[frames]]")
    return tuple(build(FrameEntry, frame, "frames") for frame in frames)


def _expand(folder: Path, entry: FrameEntry, dark_file: str) -> list[ListedFrame]:
    """Return a `ListedFrame` for each image of a group."""
    names = _names(folder, entry, dark_file)
    common: dict[str, Any] = {
        "axis": entry.axis,
        "period_px": entry.period_px,
        "exposure_ms": entry.exposure_ms or 0.0,
    }
    if entry.kind == "phase":
        shifts = _shifts_deg(entry, len(names))
        return [
            ListedFrame(name, "phase", shift_deg=shift, **common)
            for name, shift in zip(names, shifts, strict=True)
        ]
    if entry.kind in ("white", "black"):
        if len(names) != 1:
            raise CaptureError(f"{entry.files!r} finds {len(names)} {entry.kind} images; give one")
        return [ListedFrame(names[0], entry.kind, **common)]
    kinds: Any = ("gray", "inverse") if entry.kind == "gray_and_inverse" else (entry.kind,)
    if len(names) % len(kinds):
        raise CaptureError(
            f"{entry.files!r} finds {len(names)} images of kind gray_and_inverse: an odd number; "
            "every Gray frame needs its inverse"
        )
    bits = _bits(entry, len(names) // len(kinds))
    return [
        ListedFrame(
            name,
            kinds[k % len(kinds)],
            bit=bits[k // len(kinds)],
            shifted=entry.shifted,
            **common,
        )
        for k, name in enumerate(names)
    ]


def _names(folder: Path, entry: FrameEntry, dark_file: str) -> list[str]:
    """Return the file names of the images of a group, relative to `folder`."""
    texts = [entry.files] if isinstance(entry.files, str) else entry.files
    names = [name for text in texts for name in _matching(folder, text, dark_file)]
    missing = [name for name in names if not reading.is_regular(folder / name)]
    if missing:
        raise CaptureError(
            f"{len(missing)} of {len(names)} {entry.kind} images are missing: {few(missing)}; "
            "record them, or correct files"
        )
    if not 0 < len(names) <= MOST_FRAMES:
        raise CaptureError(
            f"{entry.files!r} finds {len(names)} images; correct files of kind {entry.kind}"
        )
    return names


def _matching(folder: Path, text: str, dark_file: str) -> list[str]:
    require_below("frames files", text)
    match = _RANGE.search(text)
    if match:
        names = [text[: match.start()] + number + text[match.end() :] for number in _numbers(match)]
        if any(_RANGE.search(name) or set("*?") & set(name) for name in names):
            raise InputError(f"frames files is {text[:200]!r}; give one range, without * and ?")
        return names
    if not set("*?") & set(text):
        return [text]
    paths = (path for path in folder.glob(text) if reading.is_regular(path))
    names = [path.relative_to(folder).as_posix() for path in sorted(paths, key=natural_key)]
    return [name for name in names if name != dark_file]


def _numbers(match: re.Match[str]) -> Iterable[str]:
    first, last, step = match.group(1), match.group(2), int(match.group(3) or 1)
    width = len(first) if first.startswith("0") else 0
    low, high = int(first), int(last)
    if step < 1 or abs(high - low) // step >= MOST_FRAMES:
        raise InputError(f"frames files has the range {match.group()}; give up to {MOST_FRAMES}")
    steps = range(low, high + 1, step) if high >= low else range(low, high - 1, -step)
    return (f"{number:0{width}d}" for number in steps)


def _shifts_deg(entry: FrameEntry, count: int) -> list[float]:
    steps = entry.steps or count
    shifts = _as_list(entry.shift_deg)
    if not isinstance(entry.shift_deg, list):
        shifts = [entry.shift_deg + 360.0 * n / steps for n in range(count)]
    if len(shifts) != count or steps != count:
        stated = f"{len(shifts)} shifts" if len(shifts) != count else f"{steps} steps"
        raise CaptureError(
            f"{entry.files!r} finds {count} phase images, stated are {stated}; record the missing "
            "ones, or correct files"
        )
    return [round(entry.sign * shift, 6) % 360.0 for shift in shifts]


def _bits(entry: FrameEntry, count: int) -> list[int]:
    if entry.bit is not None:
        bits = _as_list(entry.bit)
        if len(bits) != count:
            raise CaptureError(
                f"{entry.files!r} finds {count} bits, bit names {len(bits)}; correct files or bit"
            )
        return bits
    return list(range(count)) if entry.bits == "coarse_first" else list(range(count))[::-1]


def _all_of(kind: type, value: object) -> bool:
    return isinstance(value, kind) or (
        isinstance(value, list) and all(isinstance(item, kind) for item in value)
    )


def _as_list(value: Any) -> list[Any]:
    return list(value) if isinstance(value, list) else [value]
