"""Kernels for one image row: fill, add, multiply, and conversion to and from 16 bits.

Non-negative values are stored as 16-bit floats (IEEE 754 binary16). Compiled code has no float16
type, so the bits are taken from a float32. The value is first multiplied by 2^(15 - 127), where the
exponent is the difference of the exponent offsets of the two formats. The 16 bits below the sign
bit are then those of the 16-bit float. The multiplication also makes those values subnormal that
are too small for a normal 16-bit float.
"""

from typing import Any

import numpy as np

from reconstruction.compiling import compiled, inlined, nested

BIAS = 2.0**-112
DROPPED = np.uint32(13)
HALF_STEP = np.uint32(1 << 12)
LARGEST = np.float32(65504.0 * BIAS)


@inlined
def larger(a: Any, b: Any) -> Any:
    return a if a > b else b


@inlined
def smaller(a: Any, b: Any) -> Any:
    return a if a < b else b


@compiled
def fill(line: Any, value: Any) -> None:
    for col in range(line.size):
        line[col] = value


@compiled
def add(a: Any, total: Any) -> None:
    for col in range(total.size):
        total[col] += a[col]


@compiled
def multiply(line: Any, factor: Any) -> None:
    for col in range(line.size):
        line[col] *= factor[col]


@nested
def copy_row(line: Any, out: Any) -> None:
    # A loop: an assignment of slices compiles the text of its errors, which takes 3 s.
    for col in range(out.size):
        out[col] = line[col]


@nested
def move_row(line: Any, factor: Any, by: Any, out: Any) -> None:
    """Write line + factor * by to `out`."""
    for col in range(out.size):
        out[col] = line[col] + factor * by[col]


@compiled
def pack_row(line: Any, factor: Any, spare: Any, out: Any) -> None:
    """Write values / unit, rounded, as the bits of float16; all values must be non-negative.

    Values above the range of float16 and NaN become the largest value of float16.

    line : (col,) values
    factor : BIAS / unit
    spare : (col,) float32 scratch line
    """
    bits = spare.view(np.uint32)
    for col in range(line.size):
        value = line[col] * factor
        spare[col] = value if value < LARGEST else LARGEST
    for col in range(line.size):
        out[col] = np.uint16((bits[col] + HALF_STEP) >> DROPPED)


@compiled
def unpack_row(stored: Any, factor: Any, line: Any) -> None:
    """Write the values, (col,) float32, of which `pack_row` wrote the bits.

    factor : unit / BIAS
    """
    bits = line.view(np.uint32)
    for col in range(line.size):
        bits[col] = np.uint32(stored[col]) << DROPPED
    for col in range(line.size):
        line[col] *= factor
