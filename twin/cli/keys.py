"""Description of the keys of an experiment file as text: all keys, or those with given words."""

import difflib
import shutil
import textwrap
from collections.abc import Iterable, Iterator

from reconstruction.errors import InputError
from twin.config.schema import Key, experiment_keys


def matching(pattern: str) -> list[Key]:
    """Return the keys that contain all words of `pattern` in path, allowed values or meaning.

    Raises
    ------
    InputError : there is no such key; the message contains the most similar keys
    """
    every = list(experiment_keys())
    words = pattern.lower().split()
    keys = [key for key in every if all(word in _text(key) for word in words)]
    if not keys:
        raise InputError(f"keys: no key contains '{pattern}'{_nearest(pattern, every)}")
    return keys


def lines_of(keys: Iterable[Key]) -> Iterator[str]:
    """Yield the description of keys as lines, wrapped to the width of the terminal."""
    width = max(40, shutil.get_terminal_size().columns)
    for key in keys:
        yield key.path
        default = key.default if key.default in ("", "required") else f"default: {key.default}"
        values_text = f"{key.allowed}; {default}" if default else key.allowed
        for text in (values_text, key.meaning):
            yield from textwrap.wrap(
                text, width, initial_indent="    ", subsequent_indent="    ", break_long_words=False
            )


def _text(key: Key) -> str:
    return f"{key.path} {key.allowed} {key.meaning}".lower()


def _nearest(pattern: str, every: Iterable[Key]) -> str:
    """Return a hint with up to three keys that have a similar last part; empty if none."""
    by_name = {key.path.rpartition(".")[2]: key.path for key in every}
    near = difflib.get_close_matches(pattern, by_name, n=3, cutoff=0.5)
    return f"; nearest: {', '.join(by_name[name] for name in near)}" if near else ""
