"""Importer of npz files, such as scripts write by NumPy's savez with arrays K1, D1, ..."""

from pathlib import Path

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.errors import CaptureError, InputError
from reconstruction.reading import read_arrays
from reconstruction.rig.importers import IMPORTERS, Importer


class Numpy(Importer):
    """Importer of the numeric arrays of npz files."""

    name = "numpy"
    summary = "NumPy (.npz, arrays by name)"

    def recognises(self, path: Path) -> bool:
        """Return True if the file name ends with .npz."""
        return path.suffix.lower() == ".npz"

    def read(self, path: Path) -> dict[str, FloatArray]:
        """Return the numeric arrays by name."""
        try:
            arrays = read_arrays(path)
        except InputError as error:
            raise CaptureError(str(error)) from None
        numeric = {name: array for name, array in arrays.items() if array.dtype.kind in "iuf"}
        return {name: np.asarray(array, np.float64) for name, array in numeric.items()}


IMPORTERS.register(Numpy())
