"""Read and write capture.toml of a rendered capture, and projected patterns as files.

| file | content |
|---|---|
| capture.toml | patterns, sensor, image size and file names of a capture |
| patterns.toml | format, version, image files in projection order, [patterns] as in capture.toml |
| 000_phase_column_00.png ... | images for a real projector, 8-bit grey, one per frame |

patterns.toml is called the manifest of the images. Every key is checked when a file is read. TOML
is written without a library, because the files have only numbers, flags and file names. A real rig
gives one image file per frame and another kind of capture.toml, see `recorded`.
"""

import difflib
import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import MISSING, asdict, dataclass, fields
from pathlib import Path
from typing import Any, TypeVar

from reconstruction import reading
from reconstruction.capture.recorded import RecordedFrames
from reconstruction.errors import CaptureError, InputError, require_integer
from reconstruction.motion.positions import StageMotion
from reconstruction.patterns import PatternSet
from reconstruction.rig.projected_light import ProjectorResponse
from reconstruction.rig.sensor import SensorNoise
from reconstruction.writing import write_png, write_text

DESCRIPTION_FILE = "capture.toml"
FORMAT = "fringe-capture"
VERSION = 1
ALWAYS_STATED = (
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
RESPONSE, STAGE = "response", "stage"
OPTIONAL: dict[str, type[Any]] = {RESPONSE: ProjectorResponse, STAGE: StageMotion}
Part = TypeVar("Part")


@dataclass(frozen=True)
class Description:
    """Content of the capture.toml of a capture with one stack file.

    The names of the stack and calibration files are relative to the folder of capture.toml. The
    image size of the camera is `width_px` and `height_px`. The other fields are as in `Capture`.
    """

    patterns: PatternSet
    sensor: SensorNoise
    width_px: int
    height_px: int
    bit_depth: int
    stack_file: str
    calibration_file: str
    response: ProjectorResponse | None = None
    stage: StageMotion | None = None

    def __post_init__(self) -> None:
        require_integer("width_px", self.width_px, 1, 1_000_000)
        require_integer("height_px", self.height_px, 1, 1_000_000)
        require_integer("bit_depth", self.bit_depth, 8, 16)
        for name in ("stack_file", "calibration_file"):
            value = getattr(self, name)
            if not isinstance(value, str) or not value or Path(value).name != value:
                raise InputError(f"{name} is {value!r}; give the name of a file in this folder")

    def recorded(self, folder: Path) -> RecordedFrames:
        """Return the frames on disk in the folder that contains this description."""
        return RecordedFrames(
            folder,
            self.patterns,
            self.sensor,
            self.bit_depth,
            folder / self.calibration_file,
            self.response,
            self.stage,
            stack_file=folder / self.stack_file,
            shape=(self.height_px, self.width_px),
        )


def write_description(path: Path, description: Description) -> None:
    """Write `description` as the file capture.toml."""
    values: dict[str, Any] = {"format": FORMAT, "version": VERSION} | asdict(description)
    tables = {name: values.pop(name) for name in TABLES}
    tables["patterns"] = pattern_table(description.patterns)
    tables |= response_table(description.response) | stage_table(description.stage)
    write_toml(path, {k: values[k] for k in values if k not in (RESPONSE, STAGE)}, tables)


def response_table(response: ProjectorResponse | None) -> dict[str, Any]:
    """Return {"response": table} for capture.toml; {} for a projector that is assumed linear."""
    if response is None:
        return {}
    values = asdict(response)
    del values["gamma" if response.curve else "curve"]
    return {RESPONSE: values}


def stage_table(stage: StageMotion | None) -> dict[str, Any]:
    """Return {"stage": table} for capture.toml; {} for a specimen at rest."""
    if stage is None:
        return {}
    values = asdict(stage)
    return {STAGE: {name: value for name, value in values.items() if value not in ((), None)}}


def pattern_table(patterns: PatternSet) -> dict[str, Any]:
    """Return the table [patterns]: keys that are always written, and others if not the default."""
    return {
        name: value
        for name, value in asdict(patterns).items()
        if name in ALWAYS_STATED or value != getattr(PatternSet, name)
    }


def write_toml(path: Path, values: Mapping[str, Any], tables: Mapping[str, Any]) -> None:
    """Write a TOML file of keys at the top level, `values`, and tables by name, `tables`."""
    lines = []
    for name, table in {"": values, **tables}.items():
        lines += ["", f"[{name}]"] if name else []
        # JSON text of a string, flag, finite number or list of them is valid TOML.
        lines += [f"{key} = {json.dumps(value)}" for key, value in table.items()]
    write_text(path, "\n".join(lines) + "\n")


def read_description(path: Path) -> Description:
    """Read the capture.toml of a capture with one stack file.

    Raises
    ------
    CaptureError : no TOML, wrong format or version, unknown or missing key, value out of range
    """
    return read_parts(path, (FORMAT, VERSION), Description, TABLES)


def read_parts(
    path: Path, header: tuple[str, int], whole: type[Part], tables: Mapping[str, type[Any]]
) -> Part:
    """Read a TOML file as an instance of a dataclass.

    Parameters
    ----------
    header : expected values of the keys format and version
    whole : dataclass with one field for each key of the file
    tables : dataclass of each field that is a table, by name; also [response] and [stage], if given

    Raises
    ------
    CaptureError : no TOML, another header, unknown or missing key, value out of range
    """
    values = read_toml(path)
    try:
        take_header(values, header)
        parts: dict[str, Any] = {
            name: build(part, table_of(values, name), name) for name, part in tables.items()
        }
        for name in OPTIONAL.keys() & values.keys():
            parts[name] = build(OPTIONAL[name], table_of(values, name), name)
        return build(whole, values | parts, path.name)
    # TypeError: a value of a type that cannot be compared with the allowed ones.
    except (InputError, TypeError) as error:
        raise CaptureError(f"{path}: {error}") from error


def read_toml(path: Path) -> dict[str, Any]:
    """Return the top-level table of a TOML file, or raise CaptureError."""
    try:
        return reading.read_toml(path)
    except InputError as error:
        raise CaptureError(str(error)) from None


def take_header(values: dict[str, Any], expected: tuple[str, int]) -> None:
    """Remove format and version from `values`; raise CaptureError unless they are `expected`."""
    header = (values.pop("format", None), values.pop("version", None))
    if header != expected:
        raise CaptureError(f"format and version are {header}; this program reads {expected}")


def table_of(values: Mapping[str, Any], name: str) -> dict[str, Any]:
    """Return the table `name` of a TOML file's content, or raise CaptureError if it is missing."""
    table = values.get(name)
    if not isinstance(table, dict):
        raise CaptureError(f"table [{name}] is missing")
    return table


def build(part: type[Part], table: Mapping[str, Any], where: str) -> Part:
    """Return an instance of the dataclass `part` with the values of `table`.

    Parameters
    ----------
    where : name of the table or file, for messages

    Raises
    ------
    CaptureError : a key is unknown, or a required key is missing
    """
    by_name = {item.name: item for item in fields(part)}  # type: ignore[arg-type]
    for key in table:
        if key not in by_name:
            close = difflib.get_close_matches(key, by_name, n=1)
            hint = f"did you mean {close[0]}?" if close else f"allowed are {', '.join(by_name)}"
            raise CaptureError(f"unknown key {key} in {where}; {hint}")
    required = [k for k, item in by_name.items() if item.default is item.default_factory is MISSING]
    missing = [name for name in required if name not in table]
    if missing:
        raise CaptureError(f"missing in {where}: {', '.join(missing)}")
    return part(**table)


MANIFEST_FILE = "patterns.toml"
PATTERN_FORMAT, PATTERN_VERSION = "fringe-patterns", 1


def file_names(patterns: PatternSet) -> tuple[str, ...]:
    """Return the file name of each frame's image; their order by name is that of projection."""
    return tuple(f"{i:03d}_{frame.name}.png" for i, frame in enumerate(patterns.frames))


def write_patterns(
    folder: Path | str, patterns: PatternSet, progress: Callable[[float], None] = lambda _: None
) -> None:
    """Write the images of the patterns and the manifest into an existing folder.

    Parameters
    ----------
    progress : function that is called with the share of images written, up to 1
    """
    folder = Path(folder)
    named = zip(file_names(patterns), patterns.frames, strict=True)
    for number, (name, frame) in enumerate(named, start=1):
        write_png(folder / name, patterns.image(frame))
        progress(number / len(patterns.frames))
    write_manifest(folder / MANIFEST_FILE, patterns)


def write_manifest(path: Path, patterns: PatternSet) -> None:
    """Write the manifest of a pattern set, without the images, to the file `path`."""
    files = file_names(patterns)
    header = {"format": PATTERN_FORMAT, "version": PATTERN_VERSION, "files": files}
    write_toml(path, header, {"patterns": pattern_table(patterns)})


def read_manifest(path: Path | str) -> PatternSet:
    """Return the pattern set that a manifest describes.

    Parameters
    ----------
    path : the manifest, or the folder that contains it

    Raises
    ------
    CaptureError : no TOML, wrong format or version, unknown key, or file names that do not belong
        to the pattern set
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
    """Return True if `path` is a TOML file with only a pattern set, such as a manifest."""
    return reading.is_regular(path) and read_toml(path).get("format") == PATTERN_FORMAT


def read_sequence(path: Path, settings: Mapping[str, Any]) -> PatternSet:
    """Return the pattern set of a manifest, which need not list the image files.

    Parameters
    ----------
    settings : values that replace those of the file, by keys such as "patterns.steps"

    Raises
    ------
    CaptureError : no TOML, wrong format or version, unknown key, or an invalid pattern set
    """
    values = read_toml(path)
    try:
        take_header(values, (PATTERN_FORMAT, PATTERN_VERSION))
        foreign = [key for key in settings if not key.startswith("patterns.")]
        if foreign:
            raise CaptureError(f"--set {foreign[0]}: allowed are keys of [patterns], patterns.KEY")
        replaced = {key.removeprefix("patterns."): value for key, value in settings.items()}
        return build(PatternSet, table_of(values, "patterns") | replaced, "patterns")
    except InputError as error:
        raise CaptureError(f"{path}: {error}") from error


def _check_files(files: object, patterns: PatternSet) -> None:
    expected = file_names(patterns)
    if not isinstance(files, Iterable) or tuple(files) != expected:
        raise CaptureError(
            f"files do not name the {len(expected)} images of [patterns] in their order, from"
            f" {expected[0]} to {expected[-1]}; write the sequence again"
        )
