"""Importer of text with names and numbers, such as exports of scanners and SLStudio's .slcalib, .m.

A name is followed by its numbers: after a colon or equals sign, or in the lines below. Numbers are
separated by blanks, commas, semicolons or brackets. Lines that begin with # or % are comments.
"""

import re
from pathlib import Path

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.errors import CaptureError, InputError
from reconstruction.reading import read_text
from reconstruction.rig.importers import IMPORTERS, Importer

_SUFFIXES = (".txt", ".slcalib", ".m", ".ini", ".cfg", ".dat")
_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?")
_SEPARATORS = str.maketrans(dict.fromkeys(",;:=[](){}", " "))
MOST_BYTES = 1_000_000


class Text(Importer):
    """Importer of text files with a name before each number, vector or matrix."""

    name = "text"
    is_general = True
    summary = f"text ({', '.join(_SUFFIXES)}: a name, then its numbers)"

    def recognises(self, path: Path) -> bool:
        """Return True if the file name has one of the known endings."""
        return path.suffix.lower() in _SUFFIXES

    def read(self, path: Path) -> dict[str, FloatArray]:
        """Return the numbers by name."""
        try:
            lines = read_text(path, MOST_BYTES).lstrip("\ufeff").splitlines()
        except InputError as error:
            raise CaptureError(str(error)) from None
        numbers: dict[str, list[float]] = {}
        name = ""
        for line in lines:
            if not line.strip() or line.lstrip().startswith(("#", "%", "//")):
                continue
            words, values = _split(line)
            if words:
                name = words if words[0].isalpha() or words[0] == "_" else ""
            if name:
                numbers.setdefault(name, []).extend(values)
        arrays = {name: np.array(values) for name, values in numbers.items() if values}
        if not arrays:
            raise CaptureError(f"{path}: found no name with numbers; write NAME, then its numbers")
        return arrays


def _split(line: str) -> tuple[str, list[float]]:
    """Return the words of a line as a name, "" if there are none, and the numbers that follow."""
    words = line.translate(_SEPARATORS).split()
    first = len(words)
    while first and _NUMBER.fullmatch(words[first - 1]):
        first -= 1
    return " ".join(words[:first]), [float(word) for word in words[first:]]


IMPORTERS.register(Text())
