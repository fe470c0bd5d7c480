"""Array types; axis order is (frame, row, col) and (row, col, xyz), row 0 at the top."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
FloatImage = NDArray[np.float32]
OrderImage = NDArray[np.int16]
ReasonImage = NDArray[np.uint8]
BoolImage = NDArray[np.bool_]
Levels = NDArray[np.uint8]
Stack = NDArray[Any]
