"""Importer of YAML files with the usual names, such as scripts write with `yaml.dump`."""

from pathlib import Path

from reconstruction.arrays import FloatArray
from reconstruction.rig.importers import IMPORTERS, Importer
from reconstruction.rig.importers.opencv import OpenCV
from reconstruction.rig.storage import numbers_of_tree, read_yaml


class Yaml(Importer):
    """Importer of YAML maps without OpenCV's first line; a matrix is a list of rows."""

    name = "yaml"
    is_general = True
    summary = "YAML (.yaml, .yml; numbers, and lists of rows, by name)"

    def recognises(self, path: Path) -> bool:
        """Return True if the file name ends with .yaml or .yml and the file is not of OpenCV."""
        return path.suffix.lower() in (".yaml", ".yml") and not OpenCV().recognises(path)

    def read(self, path: Path) -> dict[str, FloatArray]:
        """Return the numbers and matrices by name, those in a map as `map/name`."""
        return numbers_of_tree(read_yaml(path))


IMPORTERS.register(Yaml())
