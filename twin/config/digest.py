"""Names by content: the digest of an experiment, and seeds derived from its root seed."""

import hashlib
import json
from collections.abc import Callable
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from reconstruction.errors import InputError
from reconstruction.reading import read_bytes
from twin.assets import mesh_path
from twin.config.models import Experiment

# Names, descriptions and sources of numbers do not change any result.
_NOT_CONTENT = {"name", "description", "provenance", "links"}


def digest(experiment: Experiment) -> str:
    """Return 16 hex digits that name an experiment by everything that changes its result.

    Mesh files count by their content, not by their place.
    """
    content = with_file_contents(experiment.model_dump(mode="json", exclude=_NOT_CONTENT))
    canonical = json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.blake2b(canonical.encode(), digest_size=8).hexdigest()


def with_file_contents(node: Any) -> Any:
    """Replace every `file` in nested tables by the digest of that file's content."""
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
    """Bytes of a named file; None when it is missing, which the stage that needs it reports."""
    try:
        return read_bytes(mesh_path(name))
    except InputError:
        return None


def content_digest(*parts: object) -> str:
    """Return 16 hex digits that name arrays, dataclasses, sequences and texts by content."""
    held = hashlib.sha256()
    for part in parts:
        _feed(held.update, part)
    return held.hexdigest()[:16]


def _feed(take: Callable[[Any], None], part: object) -> None:
    if isinstance(part, np.ndarray):
        take(f"{part.dtype} {part.shape}".encode())
        take(np.ascontiguousarray(part))  # by its own bytes: a capture has hundreds of MB
    elif is_dataclass(part) and not isinstance(part, type):
        for field in fields(part):
            _feed(take, getattr(part, field.name))
    elif isinstance(part, tuple | list):
        for item in part:
            _feed(take, item)
    else:
        take(f"{part!r}\n".encode())


def seed_sequence(experiment: Experiment, stage: str, *keys: int) -> np.random.SeedSequence:
    """Child seed of the experiment's root seed, keyed by stage, case, trial and frame."""
    return keyed_sequence(experiment.seed, stage, *keys)


def keyed_sequence(seed: int, stage: str, *keys: int) -> np.random.SeedSequence:
    """Child seed of any root seed, keyed likewise."""
    stage_key = int.from_bytes(hashlib.blake2b(stage.encode(), digest_size=4).digest())
    return np.random.SeedSequence(seed, spawn_key=(stage_key, *keys))
