"""Importer of JSON files with the usual names, such as scripts write with `json.dump`."""

from pathlib import Path

from reconstruction.arrays import FloatArray
from reconstruction.errors import CaptureError, InputError
from reconstruction.reading import read_json
from reconstruction.rig.importers import IMPORTERS, Importer, head_of
from reconstruction.rig.storage import numbers_of_tree


class Json(Importer):
    """Importer of JSON objects; a matrix is a list of rows."""

    name = "json"
    is_general = True
    summary = "JSON (numbers, and lists of rows, by name)"

    def recognises(self, path: Path) -> bool:
        """Return True if the first character of the file is an opening brace."""
        return head_of(path).lstrip("\ufeff \t\r\n").startswith("{")

    def read(self, path: Path) -> dict[str, FloatArray]:
        """Return the numbers and matrices by name, those in an object as `object/name`."""
        try:
            return numbers_of_tree(read_json(path))
        except InputError as error:
            raise CaptureError(str(error)) from None


IMPORTERS.register(Json())
