"""Poisson equation on the pixel grid, solved exactly by cosine or sine transforms.

The unknown is a height per pixel, the data a height step per edge between neighbours. The normal
equations of least squares, D^T D h = D^T s, are the five-point Laplacian:

| boundary | transform | eigenvalue of mode (k, l) of an M x N grid |
|---|---|---|
| neumann: free border, mean 0 | DCT-II | 4 sin^2(pi k / 2M) + 4 sin^2(pi l / 2N), k = 0..M-1 |
| dirichlet: border pixels at 0 | DST-I inside | 4 sin^2(pi k / 2(M-1)) + ..., k = 1..M-2 |

Strang 1999, The discrete cosine transform, SIAM Review 41, 135; Simchony, Chellappa, Shao 1990,
Direct analytical methods for solving Poisson equations in computer vision problems, IEEE TPAMI 12,
435.
"""

from functools import lru_cache
from typing import Literal

import numpy as np
from scipy.fft import dctn, dstn, idctn, idstn

from reconstruction.arrays import Doubles

Boundary = Literal["neumann", "dirichlet"]
BOUNDARIES = ("neumann", "dirichlet")


def edge_steps(slopes: Doubles, pitch_mm: float) -> tuple[Doubles, Doubles]:
    """Return the height steps to the next row, (M-1, N), and the next column, (M, N-1), mm.

    Parameters
    ----------
    slopes : (2, M, N) float, mm/mm: height per row direction (down), per column direction (right)

    Notes
    -----
    The trapezoid rule: slopes are known at pixel centres, steps are needed halfway between.
    """
    along_row, along_col = slopes
    half_mm = 0.5 * pitch_mm
    return (
        half_mm * (along_row[1:] + along_row[:-1]),
        half_mm * (along_col[:, 1:] + along_col[:, :-1]),
    )


def sum_of_steps(row_steps: Doubles, col_steps: Doubles) -> Doubles:
    """Return D^T s, (M, N): steps that lead to a pixel minus steps that leave it."""
    rows, cols = col_steps.shape[0], row_steps.shape[1]
    total = np.zeros((rows, cols), dtype=row_steps.dtype)
    total[1:] += row_steps
    total[:-1] -= row_steps
    total[:, 1:] += col_steps
    total[:, :-1] -= col_steps
    return total


def solve_poisson(right_side: Doubles, boundary: Boundary = "neumann") -> Doubles:
    """Return h with D^T D h = `right_side`, (M, N); mean 0 (neumann) or border 0 (dirichlet)."""
    return _neumann(right_side) if boundary == "neumann" else _dirichlet(right_side)


def _neumann(right_side: Doubles) -> Doubles:
    inverse = _inverse_neumann(right_side.shape)
    spectrum = dctn(right_side, type=2, norm="ortho")
    height: Doubles = idctn(spectrum * inverse, type=2, norm="ortho", overwrite_x=True)
    return height


def _dirichlet(right_side: Doubles) -> Doubles:
    height = np.zeros_like(right_side)
    spectrum = dstn(right_side[1:-1, 1:-1], type=1, norm="ortho")
    spectrum *= _inverse_dirichlet(spectrum.shape)
    height[1:-1, 1:-1] = idstn(spectrum, type=1, norm="ortho", overwrite_x=True)
    return height


@lru_cache(maxsize=8)
def _inverse_neumann(shape: tuple[int, int]) -> Doubles:
    modes = [4.0 * np.sin(0.5 * np.pi * np.arange(n) / n) ** 2 for n in shape]
    eigenvalues = modes[0][:, np.newaxis] + modes[1]
    eigenvalues[0, 0] = np.inf  # the mean is free: zero
    return _frozen(1.0 / eigenvalues)


@lru_cache(maxsize=8)
def _inverse_dirichlet(shape: tuple[int, int]) -> Doubles:
    modes = [4.0 * np.sin(0.5 * np.pi * np.arange(1, n + 1) / (n + 1)) ** 2 for n in shape]
    return _frozen(1.0 / (modes[0][:, np.newaxis] + modes[1]))


def _frozen(values: Doubles) -> Doubles:
    values.flags.writeable = False  # shared by all callers through the cache
    return values
