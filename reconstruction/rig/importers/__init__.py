"""Importers, which read calibration files of other programs. Each module registers one importer.

An importer is one module of this package, of an installed package (entry points of the group
`fringe_twin.importers`) or of the user (`--plugin`). It returns all numbers and matrices of a file
by the names that they have in the file. `reconstruction.rig.importing` makes a calibration of them.
Minimal example:

    class Plain(Importer):
        name, summary = "plain", "text: a name and its numbers in each line (.cal)"

        def recognises(self, path):
            return path.suffix == ".cal"

        def read(self, path):
            lines = map(str.split, path.read_text().splitlines())
            return {name: np.array(numbers, float) for name, *numbers in lines}

    IMPORTERS.register(Plain())
"""

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

from reconstruction.arrays import FloatArray
from reconstruction.errors import CaptureError, InputError, one_line
from reconstruction.reading import regular_file, shown
from reconstruction.registry import Registry


class Importer:
    """Base class of the importers. An importer reads calibration files of one format.

    Attributes
    ----------
    name : name of the format
    summary : one line of documentation, which also appears in error messages
    unit : unit of length that the program always writes; None: that of the user's board
    keys : name in the file by quantity, see `reconstruction.rig.named_numbers.QUANTITIES`, where
        the program's names are not the usual ones
    is_general : whether the format is not that of one program; such an importer is tried last
    """

    name: str
    summary: str
    unit: str | None = None
    keys: Mapping[str, str] = MappingProxyType({})
    is_general: bool = False

    def recognises(self, path: Path) -> bool:
        """Return True if an existing file has this format, judged by its name or first bytes."""
        raise NotImplementedError(f"importer {self.name!r} has no function recognises")

    def read(self, path: Path) -> dict[str, FloatArray]:
        """Return every number and matrix of a file by its path in the file, e.g. `camera/matrix`.

        Raises
        ------
        CaptureError : the file is damaged, or contains no numbers
        """
        raise NotImplementedError(f"importer {self.name!r} has no function read")


IMPORTERS: Registry[Importer] = Registry(
    "importers", "reconstruction.rig.importers", lambda importer: importer.name
)
"""All importers by the name of their format."""


def head_of(path: Path) -> str:
    """Return the first 64 kB of a file as text, by which importers recognise formats."""
    with path.open("rb") as file:
        return file.read(65536).decode("utf-8", "replace")


def importer_of(path: Path) -> Importer:
    """Return the importer that recognises a calibration file.

    Raises
    ------
    CaptureError : the file cannot be read, or no importer recognises it
    """
    try:
        file = regular_file(path)
        for importer in sorted(IMPORTERS, key=lambda importer: importer.is_general):
            if importer.recognises(file):
                return importer
    except InputError as error:
        raise CaptureError(str(error)) from None
    except OSError as error:
        raise CaptureError(f"{shown(path)}: cannot be read: {one_line(error)}") from None
    formats = "; ".join(f"{importer.name}: {importer.summary}" for importer in IMPORTERS)
    raise CaptureError(f"{shown(path)}: found no calibration of a known format, allowed: {formats}")
