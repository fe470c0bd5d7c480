"""Importer of files of `cv2.FileStorage`, which OpenCV's samples and scan3d-capture write."""

import re
from pathlib import Path

from reconstruction.arrays import FloatArray
from reconstruction.rig.importers import IMPORTERS, Importer, head_of
from reconstruction.rig.storage import XML, YAML, numbers_in


class OpenCV(Importer):
    """Importer of the YAML and XML files of OpenCV, which it recognises by their first bytes."""

    name = "opencv"
    is_general = True
    summary = f"OpenCV's FileStorage (the first line begins with {YAML} or {XML})"

    def recognises(self, path: Path) -> bool:
        """Return True if the file begins with the first bytes of a YAML or XML file."""
        with path.open("rb") as file:
            return file.read(len(YAML)).startswith((YAML.encode(), XML.encode()))

    def read(self, path: Path) -> dict[str, FloatArray]:
        """Return the numbers and matrices by name, those in a map as `map/name`."""
        return numbers_in(path)


class NamedStorage(OpenCV):
    """Base class of importers of programs that write by OpenCV's FileStorage with their own names.

    A file is recognised if it has all names of `keys`.
    """

    is_general = False

    def recognises(self, path: Path) -> bool:
        """Return True if the file is of OpenCV's FileStorage and contains every name of `keys`."""
        if not super().recognises(path):
            return False
        words = set(re.findall(r"\w+", head_of(path)))
        return words.issuperset(self.keys.values())


IMPORTERS.register(OpenCV())
