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
_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_NUMBERS = re.compile(rf"[\s,;\[\](){{}}]*(?:{_NUMBER}[\s,;\[\](){{}}]*)*")
_NAMED = re.compile(r"\s*\[?\s*([A-Za-z_][\w .\-]*?)\s*\]?\s*[:=]?\s*([\s\d+\-.,;\[\](){}eE]*)$")
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
            rest = line
            if not _NUMBERS.fullmatch(line):
                name, rest = _split(line)
            if name:
                numbers.setdefault(name, []).extend(map(float, re.findall(_NUMBER, rest)))
        found = {name: np.array(values) for name, values in numbers.items() if values}
        if not found:
            raise CaptureError(f"{path}: found no name with numbers; write NAME, then its numbers")
        return found


def _split(line: str) -> tuple[str, str]:
    """Return the name and the numbers of a line; two empty texts if the line has another form."""
    match = _NAMED.fullmatch(line)
    return (match[1], match[2]) if match else ("", "")


IMPORTERS.register(Text())
