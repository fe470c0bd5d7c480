"""The projected sequence as files for a real projector: 8-bit PNG images and their manifest.

| file | content |
|---|---|
| patterns.toml | format, version, files in the order of projection, [patterns] as in capture.toml |
| 000_phase_column_00.png ... | one grey image each, of the projector's size |
"""

from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path

from reconstruction.capture.description import assignments, build, read_toml, table_of, take_header
from reconstruction.errors import CaptureError, InputError
from reconstruction.patterns import PatternSet

MANIFEST_FILE = "patterns.toml"
FORMAT, VERSION = "fringe-patterns", 1


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
    header = assignments({"format": FORMAT, "version": VERSION, "files": file_names(patterns)})
    lines = [*header, "", "[patterns]", *assignments(asdict(patterns))]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


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
        take_header(values, (FORMAT, VERSION))
        patterns = build(PatternSet, table_of(values, "patterns"), "patterns")
        _check_files(values.get("files"), patterns)
    except InputError as error:
        raise CaptureError(f"{path}: {error}") from error
    return patterns


def _check_files(found: object, patterns: PatternSet) -> None:
    expected = file_names(patterns)
    if not isinstance(found, Iterable) or tuple(found) != expected:
        raise CaptureError(
            f"files do not name the {len(expected)} images of [patterns] in their order, from"
            f" {expected[0]} to {expected[-1]}; write the sequence anew"
        )
