"""A list of frames in capture.toml: which image is what, for sets that other programs recorded.

| key | content |
|---|---|
| format, version | "fringe-frames", 1 |
| bit_depth, calibration_file, dark_file, | |
| channel, [sensor], [response] | as with `files`, see `frame_set` |
| [projector] | width_px, height_px |
| [[frames]] | one table for each group of images, see `FrameEntry` |

Every group is expanded into `ListedFrame`s, one per image; these are sorted into the order that
the decoder works in, whatever their names and order were, and give the `PatternSet`. A set that
comes with the manifest of `twin patterns` is the short form of such a list.

A phase frame shows A + B cos(2 pi x / period + sign * shift); a set of N must be N equal steps of
360 degrees / N from anywhere. The finest bits of a reflected word may be left out: what remains
numbers stripes of twice the width, so that bits finer than the fringes need are not used.
"""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

from reconstruction import reading
from reconstruction.capture.description import (
    DESCRIPTION_FILE,
    build,
    read_response,
    read_toml,
    table_of,
    take_header,
)
from reconstruction.capture.frame_arrangement import Arrangement, ListedFrame, ProjectorSize
from reconstruction.capture.frame_set import (
    CHANNELS,
    FRAMES_FORMAT,
    FRAMES_VERSION,
    Channel,
    natural_key,
)
from reconstruction.codes import code_of
from reconstruction.errors import CaptureError, InputError, few, require_integer, require_number
from reconstruction.patterns import AXES, WORDS, Axis, Kind, PatternSet, WordName
from reconstruction.rig.projected_light import ProjectorResponse
from reconstruction.rig.sensor import SensorNoise

EntryKind = Literal["phase", "gray", "inverse", "gray_and_inverse", "white", "black"]
BitOrder = Literal["coarse_first", "fine_first"]
MOST_FRAMES = 4096
# Words may be finer than a pixel, and a single fringe longer than the projector.
PERIOD_RANGE_PX = (0.01, 1e6)
_RANGE = re.compile(r"\{(\d{1,9})\.\.(\d{1,9})(?:\.\.(\d{1,4}))?\}")


@dataclass(frozen=True)
class FrameEntry:
    """One group of images of a kind.

    Parameters
    ----------
    files : names, in the order shown: one; with * or ?, then in natural order; with a range of
        numbers as in {00..21} or {0..20..2}, also downwards; or a list of these
    kind : gray_and_inverse: each Gray frame is followed by its inverse
    axis : along which the pattern varies: "column" has vertical stripes
    period_px : of fringes; of bits the width of one word, needed where the bits are more than the
        fringes need
    steps : phase steps N, if not all images of the group
    shift_deg : of every phase frame; a single number: of the first one, the others follow by
        360 / N
    sign : -1: the shift is subtracted from 2 pi x / period, not added
    bit : of every Gray frame, 0 the coarsest; left out: as in `bits`
    bits : in which order the frames of a word follow one another
    shifted : this is the second word, half a period aside
    exposure_ms : where the sequence was taken several times
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
        _require_one_of("kind", self.kind, get_args(EntryKind))
        _require_one_of("bits", self.bits, get_args(BitOrder))
        if not _all_of(str, self.files) or not self.files:
            raise InputError(f"frames files is {self.files!r}; give a name or a list of names")
        is_uniform = self.kind in ("white", "black")
        if (self.axis is None) != is_uniform or self.axis not in (None, *AXES):
            told = "leave it out" if is_uniform else "allowed are column and row"
            raise InputError(f"frames axis of kind {self.kind!r} is {self.axis!r}; {told}")
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


@dataclass(frozen=True)
class ListedSet:
    """Content of a capture.toml with a list of frames.

    Parameters
    ----------
    word : how words are shown as bits, see `PatternSet`
    channel : of colour images the one to read; "": images are grey
    code : name of the pattern code; "": the one that the frames show, which is stated where several
        codes project such frames
    """

    sensor: SensorNoise
    projector: ProjectorSize
    frames: tuple[FrameEntry, ...]
    bit_depth: int
    calibration_file: str = "calibration.yaml"
    dark_file: str = ""
    channel: Channel = ""
    word: WordName = "reflected"
    response: ProjectorResponse | None = None
    code: str = ""

    def __post_init__(self) -> None:
        if self.code != "":
            code_of(self.code)
        require_integer("bit_depth", self.bit_depth, 8, 16)
        _require_one_of("channel", self.channel, CHANNELS)
        _require_one_of("word", self.word, WORDS)
        for name in ("calibration_file", "dark_file"):
            if not isinstance(getattr(self, name), str):
                raise InputError(f"{name} is {getattr(self, name)!r}; give the name of a file")
        largest = 2**self.bit_depth - 1
        if self.sensor.saturation_dn > largest:
            raise InputError(
                f"sensor saturation_dn is {self.sensor.saturation_dn:g}; {self.bit_depth} bits end "
                f"at {largest}, give at most that"
            )


@dataclass(frozen=True)
class FoundFrames:
    """What is shown, and the image of every frame in the order of `patterns.frames`, set by set."""

    patterns: PatternSet
    files: list[list[Path]]
    exposures_ms: tuple[float, ...] = ()


def is_listed(path: Path) -> bool:
    """Tell whether a capture.toml of single images lists its frames."""
    content = read_toml(path)
    return content.get("format") == FRAMES_FORMAT and "frames" in content


def read_listed(path: Path) -> ListedSet:
    """Read capture.toml with a list of frames.

    Raises
    ------
    CaptureError : no TOML, wrong format or version, unknown or missing key, value out of range
    """
    values = read_toml(path)
    try:
        take_header(values, (FRAMES_FORMAT, FRAMES_VERSION))
        entries = values.get("frames")
        if not _all_of(dict, entries) or not isinstance(entries, list) or not entries:
            raise CaptureError("frames is no list of tables; write each as [[frames]]")
        parts: dict[str, Any] = {
            "sensor": build(SensorNoise, table_of(values, "sensor"), "sensor"),
            "projector": build(ProjectorSize, table_of(values, "projector"), "projector"),
            "frames": tuple(build(FrameEntry, one, "frames") for one in entries),
            "response": read_response(values),
        }
        return build(ListedSet, values | parts, path.name)
    except (InputError, TypeError) as error:
        raise CaptureError(f"{path}: {error}") from error


def find_listed(folder: Path, description: ListedSet) -> FoundFrames:
    """Return the images of a list in the order of decoding, and what they show.

    Raises
    ------
    CaptureError : an image is missing, listed twice or in no group's number; the list shows nothing
        that can be decoded
    """
    try:
        frames = [
            one for entry in description.frames for one in _expand(folder, entry, description)
        ]
        return _arranged(folder, frames, description)
    except InputError as error:
        raise CaptureError(f"{folder / DESCRIPTION_FILE}: {error}") from error


def _arranged(folder: Path, frames: Sequence[ListedFrame], description: ListedSet) -> FoundFrames:
    exposures = sorted({frame.exposure_ms for frame in frames})
    sets = [[one for one in frames if one.exposure_ms == exposure] for exposure in exposures]
    size, word = description.projector, description.word
    found = [Arrangement(one, size, word, description.code) for one in sets]
    for one, exposure in zip(found, exposures, strict=True):
        if one.patterns != found[0].patterns:
            raise CaptureError(
                f"the frames of exposure_ms {exposure:g} show another sequence than those of "
                f"{exposures[0]:g}; list all frames for every exposure"
            )
    files = [[folder / name for name in one.files] for one in found]
    return FoundFrames(found[0].patterns, files, tuple(exposures) if len(exposures) > 1 else ())


def _expand(folder: Path, entry: FrameEntry, description: ListedSet) -> list[ListedFrame]:
    names = _names(folder, entry, description.dark_file)
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
    if entry.kind != "gray_and_inverse":
        bits = _bits(entry, len(names))
        pairs = zip(names, bits, strict=True)
        kind: Any = entry.kind
        return [ListedFrame(one, kind, bit=k, shifted=entry.shifted, **common) for one, k in pairs]
    if len(names) % 2:
        raise CaptureError(
            f"{entry.files!r} finds {len(names)} images of kind gray_and_inverse: an odd number; "
            "every Gray frame needs its inverse"
        )
    bits = _bits(entry, len(names) // 2)
    kinds: tuple[Kind, Kind] = ("gray", "inverse")
    return [
        ListedFrame(one, kinds[k % 2], bit=bits[k // 2], shifted=entry.shifted, **common)
        for k, one in enumerate(names)
    ]


def _names(folder: Path, entry: FrameEntry, dark_file: str) -> list[str]:
    """Return the names that a group stands for, below the folder."""
    given = [entry.files] if isinstance(entry.files, str) else entry.files
    names = [name for text in given for name in _matching(folder, text, dark_file)]
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
    parts = text.split("/")
    if parts[0] in ("", "~") or ".." in parts or "**" in text or "\0" in text:
        raise InputError(
            f"frames files is {text[:200]!r}; give names in the folder of capture.toml or in a "
            "named folder below it, without .. or **"
        )
    found = _RANGE.search(text)
    if found:
        names = [text[: found.start()] + number + text[found.end() :] for number in _numbers(found)]
        if any(_RANGE.search(name) or set("*?") & set(name) for name in names):
            raise InputError(f"frames files is {text[:200]!r}; give one range, without * and ?")
        return names
    if not set("*?") & set(text):
        return [text]
    paths = (path for path in folder.glob(text) if reading.is_regular(path))
    names = [path.relative_to(folder).as_posix() for path in sorted(paths, key=natural_key)]
    return [name for name in names if name != dark_file]


def _numbers(found: re.Match[str]) -> Iterable[str]:
    first, last, step = found.group(1), found.group(2), int(found.group(3) or 1)
    width = len(first) if first.startswith("0") else 0
    low, high = int(first), int(last)
    if step < 1 or abs(high - low) // step >= MOST_FRAMES:
        raise InputError(f"frames files has the range {found.group()}; give up to {MOST_FRAMES}")
    steps = range(low, high + 1, step) if high >= low else range(low, high - 1, -step)
    return (f"{number:0{width}d}" for number in steps)


def _shifts_deg(entry: FrameEntry, count: int) -> list[float]:
    steps = entry.steps or count
    shifts = _as_list(entry.shift_deg)
    if not isinstance(entry.shift_deg, list):
        shifts = [entry.shift_deg + 360.0 * n / steps for n in range(count)]
    if len(shifts) != count or steps != count:
        told = f"{len(shifts)} shifts" if len(shifts) != count else f"{steps} steps"
        raise CaptureError(
            f"{entry.files!r} finds {count} phase images, stated are {told}; record the missing "
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


def _require_one_of(name: str, value: object, allowed: tuple[str, ...]) -> None:
    if value not in allowed:
        shown = ", ".join(repr(one) for one in allowed)
        raise InputError(f"{name} is {value!r}; allowed are {shown}")


def _all_of(kind: type, value: object) -> bool:
    return isinstance(value, kind) or (
        isinstance(value, list) and all(isinstance(one, kind) for one in value)
    )


def _as_list(value: Any) -> list[Any]:
    return list(value) if isinstance(value, list) else [value]
