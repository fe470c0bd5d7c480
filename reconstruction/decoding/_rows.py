"""Kernels for an image row: fill, add, multiply; pack to 16 bits and unpack.

Non-negative values are stored as 16-bit floats (IEEE 754 binary16). Compiled code has no float16,
so its bits are made from those of float32: after a factor of 2^(15 - 127), the difference of the
exponents' offsets, they are the upper 16 bits below the sign. By the same factor, values that are
too small for a normal number become subnormal.
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
    """Write line + factor by."""
    for col in range(out.size):
        out[col] = line[col] + factor * by[col]


@compiled
def pack_row(line: Any, factor: Any, spare: Any, out: Any) -> None:
    """Write line / unit as the bits of float16, rounded; too large and NaN become the largest.

    factor : BIAS / unit
    """
    bits = spare.view(np.uint32)
    for col in range(line.size):
        value = line[col] * factor
        spare[col] = value if value < LARGEST else LARGEST
    for col in range(line.size):
        out[col] = np.uint16((bits[col] + HALF_STEP) >> DROPPED)


@compiled
def unpack_row(stored: Any, factor: Any, line: Any) -> None:
    """Write the values behind the bits; factor : unit / BIAS."""
    bits = line.view(np.uint32)
    for col in range(line.size):
        bits[col] = np.uint32(stored[col]) << DROPPED
    for col in range(line.size):
        line[col] *= factor
