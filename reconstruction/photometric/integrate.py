"""Heights from slopes: an exact Poisson solver, and the vendor's with their scale error.

Height is positive towards the camera (an indentation is positive), row 0 at the top; slopes are
(2, row, col) mm/mm, along rows (down) and along columns (right). Each scheme sets its own zero.

Steps between pixels: Poisson equation, solved exactly, and weighted least squares.

The unknown is a height per pixel, the data a height step per edge between neighbours. The normal
equations of least squares, D^T D h = D^T s, are the five-point Laplacian:

| boundary | transform | eigenvalue of mode (k, l) of an M x N grid |
|---|---|---|
| neumann: free border, mean 0 | DCT-II | 4 sin^2(pi k / 2M) + 4 sin^2(pi l / 2N), k = 0..M-1 |
| dirichlet: border pixels at 0 | DST-I inside | 4 sin^2(pi k / 2(M-1)) + ..., k = 1..M-2 |

Strang 1999, The discrete cosine transform, SIAM Review 41, 135; Simchony, Chellappa, Shao 1990,
Direct analytical methods for solving Poisson equations in computer vision problems, IEEE TPAMI 12,
435.

With weights: conjugate gradients, preconditioned by the fast solver. They minimise sum over edges
of w (step of h - measured step)^2. Without weights the preconditioner is the solution. With holes
(weight 0) the unknowns are the other pixels and the preconditioner is that of the fictitious
domain: solve on the whole grid, use the pixels outside the holes. The number of iterations then
depends on the ratio of the weights and on the shape of the holes, hardly on the number of pixels: a
height field around a hole can be continued into it with bounded energy.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.fft import dctn, dstn, idctn, idstn

from reconstruction.arrays import BoolImage, FloatArray
from reconstruction.errors import FitError, InputError, require_number
from reconstruction.integration_schemes import SCHEMES, Boundary

BOUNDARIES = ("neumann", "dirichlet")
RELATIVE_TOLERANCE = 1e-5
MAX_ITERATIONS = 500


def edge_steps(slopes: FloatArray, pitch_mm: float) -> tuple[FloatArray, FloatArray]:
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


def sum_of_steps(row_steps: FloatArray, col_steps: FloatArray) -> FloatArray:
    """Return D^T s, (M, N): steps into a pixel minus steps out of it."""
    rows, cols = col_steps.shape[0], row_steps.shape[1]
    total = np.zeros((rows, cols), dtype=row_steps.dtype)
    total[1:] += row_steps
    total[:-1] -= row_steps
    total[:, 1:] += col_steps
    total[:, :-1] -= col_steps
    return total


def solve_poisson(right_side: FloatArray, boundary: Boundary = "neumann") -> FloatArray:
    """Return h with D^T D h = `right_side`, (M, N); mean 0 (neumann) or border 0 (dirichlet)."""
    return _neumann(right_side) if boundary == "neumann" else _dirichlet(right_side)


def _neumann(right_side: FloatArray) -> FloatArray:
    inverse = _inverse_neumann(right_side.shape)
    spectrum = dctn(right_side, type=2, norm="ortho")
    return np.asarray(idctn(spectrum * inverse, type=2, norm="ortho", overwrite_x=True))


def _dirichlet(right_side: FloatArray) -> FloatArray:
    height = np.zeros_like(right_side)
    spectrum = dstn(right_side[1:-1, 1:-1], type=1, norm="ortho")
    spectrum *= _inverse_dirichlet(spectrum.shape)
    height[1:-1, 1:-1] = idstn(spectrum, type=1, norm="ortho", overwrite_x=True)
    return height


@lru_cache(maxsize=8)
def _inverse_neumann(shape: tuple[int, int]) -> FloatArray:
    modes = [4.0 * np.sin(0.5 * np.pi * np.arange(n) / n) ** 2 for n in shape]
    eigenvalues = modes[0][:, np.newaxis] + modes[1]
    eigenvalues[0, 0] = np.inf  # the mean is free: zero
    return _frozen(1.0 / eigenvalues)


@lru_cache(maxsize=8)
def _inverse_dirichlet(shape: tuple[int, int]) -> FloatArray:
    modes = [4.0 * np.sin(0.5 * np.pi * np.arange(1, n + 1) / (n + 1)) ** 2 for n in shape]
    return _frozen(1.0 / (modes[0][:, np.newaxis] + modes[1]))


def _frozen(values: FloatArray) -> FloatArray:
    values.flags.writeable = False  # shared by all callers through the cache
    return values


@dataclass(frozen=True, eq=False)
class EdgeWeights:
    """Weights of the height differences between neighbouring pixels.

    Shape (M-1, N) for differences to the next row, (M, N-1) for those to the next column.
    """

    to_next_row: FloatArray
    to_next_col: FloatArray


def edge_weights(weights: FloatArray) -> EdgeWeights:
    """Return the weight of a step from those of both pixels, (M, N).

    A step is the mean of two slopes. With weights 1 / variance its own weight is proportional to
    the harmonic mean, which is also 0 if one of the pixels is invalid.
    """
    return EdgeWeights(
        _harmonic_mean(weights[1:], weights[:-1]), _harmonic_mean(weights[:, 1:], weights[:, :-1])
    )


def _harmonic_mean(a: FloatArray, b: FloatArray) -> FloatArray:
    total = a + b
    return np.asarray(2.0 * a * b / np.where(total > 0.0, total, 1.0))


def solve_weighted(
    row_steps: FloatArray,
    col_steps: FloatArray,
    weights: FloatArray,
    boundary: Boundary = "neumann",
) -> FloatArray:
    """Return the heights that fit the steps best, (M, N), in the unit of the steps.

    Pixels of weight 0 get height 0. With a free border (neumann) the mean over the other pixels
    is 0; each part separated by weight-0 pixels has its own unknown constant.

    Raises
    ------
    FitError : no convergence, since the weights differ by too many orders of magnitude
    """
    edges, used = edge_weights(weights), weights > 0.0
    if boundary == "dirichlet":
        used = used & _inside(used.shape)
    right = sum_of_steps(edges.to_next_row * row_steps, edges.to_next_col * col_steps) * used
    height = _conjugate_gradients(right, edges, used, boundary)
    if boundary == "neumann" and bool(np.any(used)):
        height -= height[used].mean()
    return height * used


def _inside(shape: tuple[int, ...]) -> BoolImage:
    inside = np.zeros(shape, dtype=np.bool_)
    inside[1:-1, 1:-1] = True
    return inside


def _conjugate_gradients(
    right: FloatArray, edges: EdgeWeights, used: BoolImage, boundary: Boundary
) -> FloatArray:
    height, residual = np.zeros_like(right), right.copy()
    direction = preconditioned = solve_poisson(residual, boundary) * used
    power = start = float(np.vdot(residual, preconditioned))
    for _ in range(MAX_ITERATIONS):
        if power <= RELATIVE_TOLERANCE**2 * start:
            return height
        along_row, along_col = np.diff(direction, axis=0), np.diff(direction, axis=1)
        image = sum_of_steps(edges.to_next_row * along_row, edges.to_next_col * along_col) * used
        step = power / float(np.vdot(direction, image))
        height = height + step * direction
        residual = residual - step * image
        preconditioned = solve_poisson(residual, boundary) * used
        power, before = float(np.vdot(residual, preconditioned)), power
        direction = preconditioned + (power / before) * direction
    raise FitError(
        f"heights did not converge in {MAX_ITERATIONS} iterations: weights above 0 span "
        "too many orders of magnitude; set the smallest to 0"
    )


Form = Literal["2024", "2025"]
FORMS = ("2024", "2025")
SMALLEST_IMAGE_PX = 4


def integrate(
    slopes: ArrayLike,
    pitch_mm: float,
    integration: str = "corrected",
    boundary: Boundary = "neumann",
    weights: ArrayLike | None = None,
) -> FloatArray:
    """Integrate by a scheme of `SCHEMES`; boundary and weights have no effect on the vendor's.

    Raises
    ------
    InputError : unknown scheme, or as `corrected` and `sdk_faithful`
    """
    if integration not in SCHEMES:
        raise InputError(
            f"integration is {integration!r}; give one of {', '.join(SCHEMES.names())}"
        )
    field = _checked(slopes, pitch_mm)
    return SCHEMES[integration].heights_mm(
        field, pitch_mm, boundary, None if weights is None else np.asarray(weights, np.float64)
    )


def corrected(
    slopes: ArrayLike,
    pitch_mm: float,
    boundary: Boundary = "neumann",
    weights: ArrayLike | None = None,
) -> FloatArray:
    """Return the heights with steps nearest to the slopes, in (weighted) least squares.

    Parameters
    ----------
    slopes : (2, row, col) float, mm/mm
    pitch_mm : distance of neighbouring pixels on the surface
    boundary : `neumann` has a free border and mean 0; `dirichlet` fixes the border pixels at 0,
        which is right only if the gel is undeformed there
    weights : (row, col) float >= 0, proportional to 1 / variance of the slopes; 0: ignore the
        pixel, its height is returned as 0. None: equal weights

    Returns
    -------
    (row, col) float, mm

    Raises
    ------
    InputError : wrong shape, values not finite, weight below 0, unknown boundary, pitch not above 0
    FitError : weights span too many orders of magnitude
    """
    field = _checked(slopes, pitch_mm)
    if boundary not in BOUNDARIES:
        raise InputError(f"boundary is {boundary!r}; give one of {', '.join(BOUNDARIES)}")
    steps = edge_steps(field, pitch_mm)
    if weights is None:
        return solve_poisson(sum_of_steps(*steps), boundary)
    return solve_weighted(*steps, _checked_weights(weights, field.shape[1:]), boundary)


def sdk_faithful(slopes: ArrayLike, pitch_mm: float, form: Form = "2025") -> FloatArray:
    """Integrate slopes as the vendor's Poisson step does, including its wrong height scale.

    Parameters
    ----------
    slopes : (2, row, col) float, mm/mm
    pitch_mm : distance of neighbouring pixels on the surface
    form : `2024` (also that of the derived research kit) or `2025`

    Returns
    -------
    (row, col) float, mm

    Raises
    ------
    InputError : wrong shape, values not finite, unknown form, pitch not above 0

    Notes
    -----
    Written from the behaviour of the published programs, not from their code. The scheme is that
    of `corrected` with a free border and two deviations:

    1. 2024 divides the central difference of the slopes by one pixel instead of two, which doubles
       all heights; 2025 takes a one-sided difference, which halves them again.
    2. The eigenvalues are those of modes 1..N instead of 0..N-1, and the mean's is not excluded:
       mode k is reduced by about (k / (k + 1))^2, so wider shapes become flatter.
    """
    if form not in FORMS:
        raise InputError(f"form is {form!r}; give one of {', '.join(FORMS)}")
    along_row, along_col = _checked(slopes, pitch_mm)
    divergence = _change(along_row, form) + _change(along_col.T, form).T
    divergence -= _flow_through_border(along_row, along_col)
    modes = [4.0 * np.sin(0.5 * np.pi * np.arange(1, n + 1) / n) ** 2 for n in divergence.shape]
    spectrum = dctn(-divergence, type=2, norm="ortho") / (modes[0][:, np.newaxis] + modes[1])
    return np.asarray(pitch_mm * idctn(spectrum, type=2, norm="ortho"))


def _change(along_axis: FloatArray, form: Form) -> FloatArray:
    """Difference along axis 0 with the border repeated."""
    after = np.concatenate([along_axis[1:], along_axis[-1:]])
    before = np.concatenate([along_axis[:1], along_axis[:-1]])
    return np.asarray(after - (before if form == "2024" else along_axis))


def _flow_through_border(along_row: FloatArray, along_col: FloatArray) -> FloatArray:
    """Return the outward slope at the border, subtracted for an inhomogeneous Neumann condition."""
    flow = np.zeros_like(along_row)
    flow[0] -= along_row[0]
    flow[-1] += along_row[-1]
    flow[:, 0] -= along_col[:, 0]
    flow[:, -1] += along_col[:, -1]
    return flow


def _checked(slopes: ArrayLike, pitch_mm: float) -> FloatArray:
    require_number("pitch_mm", pitch_mm, 0.0, open_low=True)
    field = np.asarray(slopes, dtype=np.float64)
    if field.ndim != 3 or field.shape[0] != 2 or min(field.shape[1:]) < SMALLEST_IMAGE_PX:
        raise InputError(
            f"slopes have shape {field.shape}; give (2, row, col) of at least "
            f"{SMALLEST_IMAGE_PX} rows and columns"
        )
    if not bool(np.all(np.isfinite(field))):
        raise InputError("slopes hold NaN or infinity; give finite numbers and weight 0 instead")
    return field


def _checked_weights(weights: ArrayLike, shape: tuple[int, ...]) -> FloatArray:
    values = np.asarray(weights, dtype=np.float64)
    if values.shape != shape:
        raise InputError(f"weights have shape {values.shape}; the slopes need {shape}")
    if not bool(np.all(np.isfinite(values) & (values >= 0.0))):
        raise InputError("weights hold a negative or infinite number; give finite numbers from 0")
    return values
