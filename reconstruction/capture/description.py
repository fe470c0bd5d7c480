"""capture.toml and the projected sequence as files: small facts, checked key by key.

| file | content |
|---|---|
| capture.toml | what is known about a capture |
| patterns.toml | format, version, files in the order of projection, [patterns] as in capture.toml |
| 000_phase_column_00.png ... | for a real projector: one grey 8-bit image each, of its size |

TOML is written by hand rather than by a library: it holds only numbers, flags and file names.

A real rig gives one image file per frame, and another kind of capture.toml:

| key | content |
|---|---|
| format, version | "fringe-frames", 1 |
| files | pattern of the file names: fields {index} (from 0), {number} (from 1), {name} and {set}, |
|       | as in "{index:03d}_{name}.png", at most 99 digits wide; or with * and ?, then in natural |
|       | order of the names; in the folder of capture.toml or below it |
| bit_depth | bits per pixel value, 8 to 16 |
| patterns_file | manifest that came with the projected images |
| calibration_file | OpenCV YAML, see `calibration` |
| dark_file | optional: one image without light, best a mean of many |
| exposures_ms | optional: one per set of frames, when the sequence was taken several times |
| channel | optional: "red", "green" or "blue" of colour images |
| [sensor] | see `SensorNoise` |

Paths are relative to the folder of capture.toml. For images that other programs wrote, [[frames]]
stands in the place of files and patterns_file, see `frame_list`.
"""

import difflib
import json
import re
import string
from collections.abc import Iterable, Mapping
from dataclasses import MISSING, asdict, dataclass, fields
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal, TypeVar, get_args

import numpy as np

from reconstruction import reading
from reconstruction.arrays import Stack
from reconstruction.errors import CaptureError, InputError, few, require_integer, require_number
from reconstruction.patterns import PatternSet
from reconstruction.rig.sensor import SensorNoise

DESCRIPTION_FILE = "capture.toml"
FORMAT = "fringe-capture"
VERSION = 1
ALWAYS_TOLD = (
    "width_px",
    "height_px",
    "period_px",
    "steps",
    "low_level",
    "high_level",
    "code",
    "further_periods_px",
)
TABLES: dict[str, type[Any]] = {"patterns": PatternSet, "sensor": SensorNoise}
Part = TypeVar("Part")


@dataclass(frozen=True)
class Description:
    """Content of capture.toml; file names are relative to its folder."""

    patterns: PatternSet
    sensor: SensorNoise
    width_px: int
    height_px: int
    bit_depth: int
    stack_file: str
    calibration_file: str

    def __post_init__(self) -> None:
        require_integer("width_px", self.width_px, 1, 1_000_000)
        require_integer("height_px", self.height_px, 1, 1_000_000)
        require_integer("bit_depth", self.bit_depth, 8, 16)
        for name in ("stack_file", "calibration_file"):
            value = getattr(self, name)
            if not isinstance(value, str) or not value or Path(value).name != value:
                raise InputError(f"{name} is {value!r}; give the name of a file in this folder")


def write_description(path: Path, description: Description) -> None:
    """Write `description` as TOML."""
    values: dict[str, Any] = {"format": FORMAT, "version": VERSION} | asdict(description)
    tables = {name: values.pop(name) for name in TABLES}
    write_toml(path, values, tables | {"patterns": pattern_table(description.patterns)})


def pattern_table(patterns: PatternSet) -> dict[str, Any]:
    """Return [patterns]: the keys of every sequence, and of the others those not by default."""
    return {
        name: value
        for name, value in asdict(patterns).items()
        if name in ALWAYS_TOLD or value != getattr(PatternSet, name)
    }


def write_toml(path: Path, values: Mapping[str, Any], tables: Mapping[str, Any]) -> None:
    """Write plain values, and tables of them."""
    lines = []
    for name, table in {"": values, **tables}.items():
        lines += ["", f"[{name}]"] if name else []
        # JSON text of a string, flag, finite number or list of them is valid TOML.
        lines += [f"{key} = {json.dumps(value)}" for key, value in table.items()]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def read_description(path: Path) -> Description:
    """Read capture.toml.

    Raises
    ------
    CaptureError : no TOML, wrong format or version, unknown or missing key, value out of range
    """
    return read_parts(path, (FORMAT, VERSION), Description, TABLES)


def read_parts(
    path: Path, header: tuple[str, int], whole: type[Part], tables: Mapping[str, type[Any]]
) -> Part:
    """Read a TOML file with this header as a dataclass, of which some fields are tables."""
    values = read_toml(path)
    try:
        take_header(values, header)
        parts: dict[str, Any] = {
            name: build(part, table_of(values, name), name) for name, part in tables.items()
        }
        return build(whole, values | parts, path.name)
    except InputError as error:
        raise CaptureError(f"{path}: {error}") from error


def read_toml(path: Path) -> dict[str, Any]:
    """Return the content of a TOML file, or raise CaptureError."""
    try:
        return reading.read_toml(path)
    except InputError as error:
        raise CaptureError(str(error)) from None


def take_header(values: dict[str, Any], expected: tuple[str, int]) -> None:
    """Remove format and version from `values`; raise CaptureError unless they are `expected`."""
    found = (values.pop("format", None), values.pop("version", None))
    if found != expected:
        raise CaptureError(f"format and version are {found}; this program reads {expected}")


def table_of(values: Mapping[str, Any], name: str) -> dict[str, Any]:
    """Return one table of a TOML file, or raise CaptureError."""
    table = values.get(name)
    if not isinstance(table, dict):
        raise CaptureError(f"table [{name}] is missing")
    return table


def build(part: type[Part], table: Mapping[str, Any], where: str) -> Part:
    """Make the dataclass `part` from exactly its own keys."""
    known = {item.name: item for item in fields(part)}  # type: ignore[arg-type]
    for key in table:
        if key not in known:
            close = difflib.get_close_matches(key, known, n=1)
            told = f"did you mean {close[0]}?" if close else f"allowed are {', '.join(known)}"
            raise CaptureError(f"unknown key {key} in {where}; {told}")
    required = [name for name, item in known.items() if item.default is MISSING]
    missing = [name for name in required if name not in table]
    if missing:
        raise CaptureError(f"missing in {where}: {', '.join(missing)}")
    return part(**table)


MANIFEST_FILE = "patterns.toml"
PATTERN_FORMAT, PATTERN_VERSION = "fringe-patterns", 1


def file_names(patterns: PatternSet) -> tuple[str, ...]:
    """Return the name of each frame's image; sorted by name they are in projection order."""
    return tuple(f"{i:03d}_{frame.name}.png" for i, frame in enumerate(patterns.frames))


def write_patterns(folder: Path | str, patterns: PatternSet) -> None:
    """Write images and manifest into an existing folder."""
    import imageio.v3 as imageio  # 0.1 s that reading a manifest need not pay

    folder = Path(folder)
    for name, frame in zip(file_names(patterns), patterns.frames, strict=True):
        imageio.imwrite(folder / name, patterns.image(frame))
    write_manifest(folder / MANIFEST_FILE, patterns)


def write_manifest(path: Path, patterns: PatternSet) -> None:
    """Write the manifest alone."""
    files = file_names(patterns)
    header = {"format": PATTERN_FORMAT, "version": PATTERN_VERSION, "files": files}
    write_toml(path, header, {"patterns": pattern_table(patterns)})


def read_manifest(path: Path | str) -> PatternSet:
    """Return the sequence that a manifest, or the folder that holds it, describes.

    Raises
    ------
    CaptureError : no TOML, wrong format or version, unknown key, or files of another sequence
    """
    path = Path(path)
    path = path / MANIFEST_FILE if path.is_dir() else path
    values = read_toml(path)
    try:
        take_header(values, (PATTERN_FORMAT, PATTERN_VERSION))
        patterns = build(PatternSet, table_of(values, "patterns"), "patterns")
        _check_files(values.get("files"), patterns)
    except InputError as error:
        raise CaptureError(f"{path}: {error}") from error
    return patterns


def is_sequence(path: Path) -> bool:
    """Tell whether a TOML file describes a sequence alone, as a manifest does."""
    return reading.is_regular(path) and read_toml(path).get("format") == PATTERN_FORMAT


def read_sequence(path: Path, settings: Mapping[str, Any]) -> PatternSet:
    """Return the sequence of [patterns] in a file like a manifest, files or not.

    Parameters
    ----------
    settings : values by key, as "patterns.steps", that stand in the place of the file's

    Raises
    ------
    CaptureError : no TOML, wrong format or version, unknown key, a sequence that cannot be
    """
    values = read_toml(path)
    try:
        take_header(values, (PATTERN_FORMAT, PATTERN_VERSION))
        foreign = [key for key in settings if not key.startswith("patterns.")]
        if foreign:
            raise CaptureError(f"--set {foreign[0]}: allowed are keys of [patterns], patterns.KEY")
        given = {key.removeprefix("patterns."): value for key, value in settings.items()}
        return build(PatternSet, table_of(values, "patterns") | given, "patterns")
    except InputError as error:
        raise CaptureError(f"{path}: {error}") from error


def _check_files(found: object, patterns: PatternSet) -> None:
    expected = file_names(patterns)
    if not isinstance(found, Iterable) or tuple(found) != expected:
        raise CaptureError(
            f"files do not name the {len(expected)} images of [patterns] in their order, from"
            f" {expected[0]} to {expected[-1]}; write the sequence anew"
        )


FRAMES_FORMAT, FRAMES_VERSION = "fringe-frames", 1
_MOST_SIGNS = 200
FIELDS = ("index", "number", "name", "set")
Channel = Literal["", "red", "green", "blue"]
CHANNELS: tuple[Channel, ...] = get_args(Channel)
_FILES = "{index:03d}_{name}.png"


@dataclass(frozen=True)
class FrameSet:
    """Content of capture.toml; see the module."""

    sensor: SensorNoise
    files: str
    bit_depth: int
    patterns_file: str = "patterns.toml"
    calibration_file: str = "calibration.yaml"
    dark_file: str = ""
    exposures_ms: tuple[float, ...] = ()
    channel: Channel = ""

    def __post_init__(self) -> None:
        require_integer("bit_depth", self.bit_depth, 8, 16)
        for name in ("files", "patterns_file", "calibration_file", "dark_file"):
            value = getattr(self, name)
            if not isinstance(value, str) or not (value or name == "dark_file"):
                raise InputError(f"{name} is {value!r}; give the name of a file")
        object.__setattr__(self, "exposures_ms", _exposures(self.exposures_ms))
        if self.channel not in CHANNELS:
            raise InputError(f"channel is {self.channel!r}; allowed are red, green and blue")
        _require_below(self.files)
        _check_fields(self.files, self.sets)
        largest = 2**self.bit_depth - 1
        if self.sensor.saturation_dn > largest:
            raise InputError(
                f"sensor saturation_dn is {self.sensor.saturation_dn:g}; {self.bit_depth} bits end "
                f"at {largest}, give at most that"
            )

    @property
    def sets(self) -> int:
        """How many times the sequence was taken."""
        return max(1, len(self.exposures_ms))


def is_frame_set(path: Path) -> bool:
    """Tell whether a capture.toml describes single images."""
    return read_toml(path).get("format") == FRAMES_FORMAT


def read_frame_set(path: Path) -> FrameSet:
    """Read capture.toml.

    Raises
    ------
    CaptureError : no TOML, wrong format or version, unknown or missing key, value out of range
    """
    return read_parts(path, (FRAMES_FORMAT, FRAMES_VERSION), FrameSet, {"sensor": SensorNoise})


def frame_files(folder: Path, description: FrameSet, patterns: PatternSet) -> list[list[Path]]:
    """Return the image of every frame, in the order of `patterns.frames`, set by set.

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


def natural_key(path: Path) -> list[tuple[int, str]]:
    """Sort key by which frame_2 comes before frame_10."""
    parts = re.split(r"(\d+)", path.as_posix())
    return [(int(part), "") if part.isdigit() else (-1, part) for part in parts]


def _gap(files: list[Path]) -> str:
    """Name the first jump in the running numbers, if the names end in one."""
    found = [re.search(r"(\d+)\D*$", path.name) for path in files]
    numbers = [int(match.group(1)) for match in found if match]
    for before, after in pairwise(numbers):
        if after - before > 1:
            return f" (their numbers jump from {before} to {after})"
    return ""


def _is_glob(files: str) -> bool:
    return any(sign in files for sign in "*?")


def _require_below(files: str) -> None:
    """Refuse names that lead out of the folder, and patterns that search all below it."""
    parts = files.split("/")
    if parts[0] in ("", "~") or ".." in parts or "**" in files or "\0" in files:
        raise InputError(
            f"files is {files[:_MOST_SIGNS]!r}; give names in the folder of capture.toml or in a "
            "named folder below it, without .. or **"
        )


def _check_fields(files: str, sets: int) -> None:
    try:
        parts = [part[1:] for part in string.Formatter().parse(files) if part[1] is not None]
    except ValueError:
        parts = [("", "", None)]
    named, allowed = [str(part[0]) for part in parts], ("set",) if _is_glob(files) else FIELDS
    if not all(name in allowed and _is_narrow(name, *form) for name, *form in parts):
        raise InputError(
            f"files is {files[:_MOST_SIGNS]!r}; allowed are the fields {', '.join(FIELDS)} in "
            "braces, numbers with up to two digits of width as in {index:03d}, or * and ? with at "
            "most {set}"
        )
    if not (_is_glob(files) or {"index", "number", "name"} & set(named)):
        raise InputError(f"files is {files!r}: the same name for all frames; use {{index}}")
    if (sets > 1) != ("set" in named):
        raise InputError(
            f"files is {files!r} with {sets} sets of frames; {{set}} stands for the number (from 0)"
            " of each of exposures_ms, use both or neither"
        )


def _is_narrow(name: str | None, form: str | None, conversion: str | None) -> bool:
    """Tell whether a field is written plainly: a width of ten digits takes as many GB."""
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
    """Write images, manifest and description into an existing folder; no calibration file.

    Parameters
    ----------
    stack : (frame, row, col) uint8 or uint16, DN; images have its type
    sensor : noise of these images
    bit_depth : 8 to 16

    Raises
    ------
    CaptureError : the stack does not fit the patterns, or holds no integers
    """
    import imageio.v3 as imageio  # 0.1 s that reading need not pay

    folder = Path(folder)
    require_integer("bit_depth", bit_depth, 8, 16)
    if len(stack) != len(patterns.frames) or stack.dtype not in (np.uint8, np.uint16):
        raise CaptureError(
            f"stack is {stack.dtype} {stack.shape}; images need uint8 or uint16 of "
            f"{len(patterns.frames)} frames"
        )
    for name, frame in zip(file_names(patterns), stack, strict=True):
        imageio.imwrite(folder / name, frame)
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
