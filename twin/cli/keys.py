"""The keys of an experiment file as text: all of them, or those that hold some words."""

import difflib
import shutil
import textwrap
from collections.abc import Iterable, Iterator

from reconstruction.errors import InputError
from twin.config.schema import Key, experiment_keys


def matching(pattern: str) -> list[Key]:
    """Return the keys of which path, allowed values or meaning hold every word of `pattern`.

    Raises
    ------
    InputError : there is none; the nearest keys are told
    """
    every = list(experiment_keys())
    words = pattern.lower().split()
    found = [key for key in every if all(word in _text(key) for word in words)]
    if not found:
        raise InputError(f"keys: found none with '{pattern}'{_nearest(pattern, every)}")
    return found


def lines_of(keys: Iterable[Key]) -> Iterator[str]:
    """Yield the lines that tell of some keys, wrapped to the terminal, nothing left out."""
    width = max(40, shutil.get_terminal_size().columns)
    for key in keys:
        yield key.path
        default = key.default if key.default in ("", "required") else f"default: {key.default}"
        told = f"{key.allowed}; {default}" if default else key.allowed
        for text in (told, key.meaning):
            yield from textwrap.wrap(
                text, width, initial_indent="    ", subsequent_indent="    ", break_long_words=False
            )


def _text(key: Key) -> str:
    return f"{key.path} {key.allowed} {key.meaning}".lower()


def _nearest(pattern: str, every: Iterable[Key]) -> str:
    """Name the keys whose last part is spelt alike."""
    by_name = {key.path.rpartition(".")[2]: key.path for key in every}
    near = difflib.get_close_matches(pattern, by_name, n=3, cutoff=0.5)
    return f"; nearest: {', '.join(by_name[name] for name in near)}" if near else ""
