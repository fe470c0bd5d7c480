"""Digest of an experiment, which names it by its content, and seeds from its root seed."""

import hashlib
import json
from collections.abc import Callable
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from reconstruction.arrays import LATER
from reconstruction.errors import InputError
from reconstruction.reading import read_bytes
from twin.assets import mesh_path
from twin.config.models import Experiment

# Fields that do not change any measured value: names, descriptions, sources of numbers, and keys
# from which others were computed. With and without [optics], only the layout differs: the figures
# `working_distance_mm` and `baseline_mm`, and the warning about the lit field.
_NOT_CONTENT = {"name", "description", "provenance", "links", "optics"}


def digest(experiment: Experiment) -> str:
    """Return 16 hex digits computed from all fields that change the result of an experiment.

    A mesh file is included by its content, not by its path.
    """
    content = with_file_contents(experiment.model_dump(mode="json", exclude=_NOT_CONTENT))
    canonical = json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.blake2b(canonical.encode(), digest_size=8).hexdigest()


def with_file_contents(node: Any) -> Any:
    """Return nested tables in which every key `file` has a digest of the file as its value.

    The digest is that of the content of the file. A file that cannot be read keeps its name.
    """
    if not isinstance(node, dict):
        return node
    named = node.get("file")
    read = _read(named) if isinstance(named, str) else None
    return {
        key: hashlib.blake2b(read, digest_size=8).hexdigest()
        if key == "file" and read is not None
        else with_file_contents(value)
        for key, value in node.items()
    }


def _read(name: str) -> bytes | None:
    """Return the content of a named file; None if it cannot be read.

    The stage that needs the file reports the error.
    """
    try:
        return read_bytes(mesh_path(name))
    except InputError:
        return None


def content_digest(*parts: object) -> str:
    """Return 16 hex digits computed from the content of arrays, dataclasses and other values.

    A field with the metadata `LATER` counts only if its value is not the default.
    """
    held = hashlib.sha256()
    for part in parts:
        _feed(held.update, part)
    return held.hexdigest()[:16]


def _feed(take: Callable[[Any], None], part: object) -> None:
    if isinstance(part, np.ndarray):
        take(f"{part.dtype} {part.shape}".encode())
        take(np.ascontiguousarray(part))  # without a copy: a capture has hundreds of MB
    elif is_dataclass(part) and not isinstance(part, type):
        for field in fields(part):
            value = getattr(part, field.name)
            if LATER.keys() <= field.metadata.keys() and value == field.default:
                continue
            _feed(take, value)
    elif isinstance(part, tuple | list):
        for item in part:
            _feed(take, item)
    else:
        take(f"{part!r}\n".encode())


def seed_sequence(experiment: Experiment, stage: str, *keys: int) -> np.random.SeedSequence:
    """Return the seed of a stage of an experiment, derived from the experiment's root seed.

    `keys` are further numbers that distinguish seeds, such as trial and frame.
    """
    return keyed_sequence(experiment.seed, stage, *keys)


def keyed_sequence(seed: int, stage: str, *keys: int) -> np.random.SeedSequence:
    """Return the seed of a stage and further keys, derived from a given root seed."""
    stage_key = int.from_bytes(hashlib.blake2b(stage.encode(), digest_size=4).digest())
    return np.random.SeedSequence(seed, spawn_key=(stage_key, *keys))
