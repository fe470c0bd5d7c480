"""An importer as a plug-in: calibrations as text, a name and its numbers in each line."""

import numpy as np

from reconstruction.errors import CaptureError
from reconstruction.rig.importers import IMPORTERS, Importer


class CalibrationText(Importer):
    """Lines such as `cam_K 1800 0 321.5 0 1795 238.25 0 0 1`; matrices row by row."""

    name = "calibration_text"
    summary = "text (.cal): a name and its numbers in each line"

    def recognises(self, path):
        """Whether the file's name ends with .cal."""
        return path.suffix == ".cal"

    def read(self, path):
        """Return the numbers by their names."""
        try:
            lines = [line.split() for line in path.read_text("utf-8").splitlines() if line.strip()]
            return {name: np.array(numbers, float) for name, *numbers in lines}
        except ValueError as error:
            raise CaptureError(f"{path}: is damaged: {error}") from error


CALIBRATION_TEXT = IMPORTERS.register(CalibrationText())
