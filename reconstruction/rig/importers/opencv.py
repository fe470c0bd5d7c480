"""Files of `cv2.FileStorage`: OpenCV's samples, scan3d-capture and many other programs."""

from pathlib import Path

from reconstruction.arrays import FloatArray
from reconstruction.rig.importers import IMPORTERS, Importer
from reconstruction.rig.storage import XML, YAML, numbers_in


class OpenCV(Importer):
    """YAML and XML, recognised by their first bytes."""

    name = "opencv"
    summary = f"OpenCV's FileStorage (the first line begins with {YAML} or {XML})"

    def recognises(self, path: Path) -> bool:
        """Whether the first line is that of such a file."""
        with path.open("rb") as file:
            return file.read(len(YAML)).startswith((YAML.encode(), XML.encode()))

    def read(self, path: Path) -> dict[str, FloatArray]:
        """Return numbers and matrices, those of maps by `map/name`."""
        return numbers_in(path)


IMPORTERS.register(OpenCV())
