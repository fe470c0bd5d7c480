"""Importer of MATLAB files: Camera Calibration Toolbox and stereo calibrator."""

import io
from pathlib import Path

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.errors import CaptureError, InputError, one_line
from reconstruction.native import read_in_child
from reconstruction.reading import regular_file
from reconstruction.rig.importers import IMPORTERS, Importer


class Matlab(Importer):
    """Importer of MAT files, read by a child process: SciPy crashes on some damaged files."""

    name = "matlab"
    summary = "MATLAB (.mat)"

    def recognises(self, path: Path) -> bool:
        """Return True if the file name ends with .mat."""
        return path.suffix.lower() == ".mat"

    def read(self, path: Path) -> dict[str, FloatArray]:
        """Return the numbers and matrices by name, those in a structure as `structure/name`."""
        try:
            content = read_in_child("MATLAB", regular_file(path))
        except InputError as error:
            raise CaptureError(str(error)) from None
        except OSError as error:
            raise CaptureError(f"{path}: is no MATLAB file: {one_line(error)}") from None
        with np.load(io.BytesIO(content), allow_pickle=False) as file:
            numbers = {name: file[name] for name in file.files}
        if not numbers:
            raise CaptureError(
                f"{path}: holds no numbers that can be read, as of MATLAB's own objects; save a "
                'structure: s = toStruct(stereoParams); save("x.mat", "-struct", "s", "-v7")'
            )
        return numbers


IMPORTERS.register(Matlab())
