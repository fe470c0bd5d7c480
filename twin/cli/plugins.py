"""Option --plugin of every command: Python files that add kinds of coatings and other parts."""

from collections.abc import Sequence
from itertools import takewhile

from reconstruction.errors import InputError

OPTION = "--plugin"


def without_plugins(words: Sequence[str]) -> tuple[list[str], list[str]]:
    """Split a command line into the words without --plugin FILE, and the list of the files.

    Raises
    ------
    InputError : the option is given without a file
    """
    options = list(takewhile(lambda word: word != "--", words))
    other_words: list[str] = []
    files: list[str] = []
    remaining = iter(options)
    for word in remaining:
        name, is_joined, file = word.partition("=")
        if name != OPTION:
            other_words.append(word)
            continue
        file = file if is_joined else next(remaining, "")
        if not file:
            raise InputError(f"{OPTION}: found no file; give the path of a Python file")
        files.append(file)
    return [*other_words, *words[len(options) :]], files


def load_plugins(words: Sequence[str]) -> list[str]:
    """Load the plugin files of a command line; return the words without --plugin FILE.

    Raises
    ------
    InputError : the option is given without a file, or a file cannot be loaded
    """
    other_words, files = without_plugins(words)
    if files:
        from reconstruction.registry import load_plugin

        for file in files:
            load_plugin(file)
    return other_words
