"""What the package ships as data: every file of scenes/, with the line that says what it is."""

import re
import tomllib
from dataclasses import dataclass
from pathlib import Path

SCENES = Path(__file__).resolve().parents[1] / "scenes"
EXPERIMENT_FOLDERS = ("examples", "paper")


@dataclass(frozen=True)
class Shipped:
    """One file of scenes/: its name as a command takes it, and what it says of itself."""

    name: str
    description: str
    comment: str


def files(folder: str) -> list[Shipped]:
    """Return the TOML files of one folder of scenes/, by name."""
    return [shipped(file) for file in sorted((SCENES / folder).glob("*.toml"))]


def experiments() -> list[Shipped]:
    """Return every shipped experiment: what has a specimen, its own or that of its base."""
    return [
        shipped(file)
        for folder in EXPERIMENT_FOLDERS
        for file in sorted((SCENES / folder).glob("*.toml"))
        if has_specimen(file)
    ]


def shipped(file: Path) -> Shipped:
    """Read the comment on top of a file, and its description."""
    lines = file.read_text(encoding="utf-8").splitlines()
    comment = []
    for line in lines:
        if not line.startswith("#"):
            break
        comment.append(line.removeprefix("#").strip())
    read = tomllib.loads("\n".join(lines))
    name = file.relative_to(SCENES).with_suffix("").as_posix()
    description = read.get("description", "")
    return Shipped(name, description if isinstance(description, str) else "", " ".join(comment))


def first_sentence(text: str) -> str:
    """Return a text up to the end of its first sentence."""
    return re.split(r"(?<=[.?])\s", text, maxsplit=1)[0]


def has_specimen(file: Path) -> bool:
    """Return True if an experiment file or the scene that it extends describes a specimen."""
    read = tomllib.loads(file.read_text(encoding="utf-8"))
    if "specimen" in read:
        return True
    base = str(read.get("use", ""))
    return base.startswith("scenes/") and has_specimen(SCENES.parent / f"{base}.toml")


def picture_of(name: str) -> Path:
    """Return where the gallery keeps the picture of an experiment."""
    return Path(__file__).with_name("gallery") / f"{name.replace('/', '_')}.jpg"
