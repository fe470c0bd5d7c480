"""Integrate slopes to heights by an exact Poisson solver, or by the vendor's with its scale error.

Height is positive towards the camera (an indentation is positive), row 0 is at the top. Slopes are
(2, row, col) mm/mm: slope downwards, and slope to the right. The zero of the heights
depends on the integration scheme.

The unknown is a height h for each pixel. The data are a height step s for each pair of adjacent
pixels, called an edge. D is the map from heights to steps. Without weights the normal equations of
least squares, D^T D h = D^T s, are the five-point Laplacian, which fast transforms solve exactly:

| boundary | transform | eigenvalue of mode (k, l) of an M x N grid |
|---|---|---|
| neumann: free border, mean 0 | DCT-II | 4 sin^2(pi k / 2M) + 4 sin^2(pi l / 2N), k = 0..M-1 |
| dirichlet: border pixels at 0 | DST-I inside | 4 sin^2(pi k / 2(M-1)) + ..., k = 1..M-2 |

Strang 1999, The discrete cosine transform, SIAM Review 41, 135; Simchony, Chellappa, Shao 1990,
Direct analytical methods for solving Poisson equations in computer vision problems, IEEE TPAMI 12,
435.

With weights w, conjugate gradients with this solver as preconditioner minimise the sum over edges
of w (step of h - measured step)^2. If there are holes (pixels of weight 0), the unknowns are the
other pixels. The preconditioner is then that of the fictitious domain: it solves on the whole grid
and uses the result outside the holes. The number of iterations depends on the ratio of the weights
and on the shape of the holes, but hardly on the number of pixels, because a height field around a
hole can be continued into the hole with bounded energy.
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
    """Return the height steps to the next row, (M-1, N), and to the next column, (M, N-1), mm.

    Parameters
    ----------
    slopes : (2, M, N) float, mm/mm, downwards and to the right
    pitch_mm : distance of neighbouring pixels on the surface

    Notes
    -----
    A step is the mean slope of the two pixels times the pitch (trapezoid rule).
    """
    along_row, along_col = slopes
    half_mm = 0.5 * pitch_mm
    return (
        half_mm * (along_row[1:] + along_row[:-1]),
        half_mm * (along_col[:, 1:] + along_col[:, :-1]),
    )


def sum_of_steps(row_steps: FloatArray, col_steps: FloatArray) -> FloatArray:
    """Return D^T s, (M, N): for each pixel the steps that end at it minus those that start at it.

    Parameters
    ----------
    row_steps, col_steps : (M-1, N), (M, N-1) steps to the next row and to the next column
    """
    rows, cols = col_steps.shape[0], row_steps.shape[1]
    total = np.zeros((rows, cols), dtype=row_steps.dtype)
    total[1:] += row_steps
    total[:-1] -= row_steps
    total[:, 1:] += col_steps
    total[:, :-1] -= col_steps
    return total


def solve_poisson(right_side: FloatArray, boundary: Boundary = "neumann") -> FloatArray:
    """Return the heights h, (M, N), that solve D^T D h = `right_side`.

    The mean of h is 0 for `neumann`; the border pixels are 0 for `dirichlet`.
    """
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
    """Weights of the height steps between neighbouring pixels.

    to_next_row is (M-1, N), to_next_col (M, N-1).
    """

    to_next_row: FloatArray
    to_next_col: FloatArray


def edge_weights(weights: FloatArray) -> EdgeWeights:
    """Return the weights of the steps from the weights of the pixels, (M, N).

    A step is proportional to the mean of two slopes. If weights are 1 / variance, the weight of the
    step is proportional to the harmonic mean of the two. It is 0 if either pixel has weight 0.
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
    """Return the heights (M, N) with the least weighted sum of squares, in the unit of the steps.

    Pixels of weight 0 get the height 0. With a free border (`neumann`) the mean over the other
    pixels is 0. If pixels of weight 0 separate the image into parts, the heights of the parts
    relative to each other are undetermined.

    Parameters
    ----------
    row_steps, col_steps : (M-1, N), (M, N-1) steps to the next row and to the next column
    weights : (M, N), at least 0

    Raises
    ------
    FitError : the iteration does not converge, because the weights differ by too many orders of
        magnitude
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
    """Return the heights (row, col), mm, by an integration scheme of `SCHEMES`.

    Parameters
    ----------
    slopes, pitch_mm, boundary, weights : as in `corrected`; boundary and weights have no effect on
        the vendor's schemes
    integration : name of the scheme

    Raises
    ------
    InputError : the scheme is unknown, or for the reasons of `corrected` and `sdk_faithful`
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
    """Return the heights that best fit the slopes, in (weighted) least squares.

    The difference of the heights of two neighbouring pixels is fitted to their mean slope times the
    pitch.

    Parameters
    ----------
    slopes : (2, row, col) float, mm/mm, downwards and to the right
    pitch_mm : distance of neighbouring pixels on the surface
    boundary : `neumann` has a free border and mean 0; `dirichlet` fixes the border pixels at 0,
        which is correct only if the gel is undeformed there
    weights : (row, col) float >= 0, proportional to 1 / variance of the slopes; a pixel of weight 0
        is ignored and gets the height 0. None: equal weights

    Returns
    -------
    (row, col) float, mm

    Raises
    ------
    InputError : shapes are wrong, values are not finite, a weight is below 0, the boundary is
        unknown, or the pitch is not above 0
    FitError : the weights span too many orders of magnitude
    """
    field = _checked(slopes, pitch_mm)
    if boundary not in BOUNDARIES:
        raise InputError(f"boundary is {boundary!r}; give one of {', '.join(BOUNDARIES)}")
    steps = edge_steps(field, pitch_mm)
    if weights is None:
        return solve_poisson(sum_of_steps(*steps), boundary)
    return solve_weighted(*steps, _checked_weights(weights, field.shape[1:]), boundary)


def sdk_faithful(slopes: ArrayLike, pitch_mm: float, form: Form = "2025") -> FloatArray:
    """Return the heights by the vendor's Poisson solver, including its wrong height scale.

    Parameters
    ----------
    slopes : (2, row, col) float, mm/mm, downwards and to the right
    pitch_mm : distance of neighbouring pixels on the surface
    form : year of the vendor's program: `2024` (also used in a derived research kit) or `2025`

    Returns
    -------
    (row, col) float, mm

    Raises
    ------
    InputError : the shape is wrong, values are not finite, the form is unknown, or the pitch is not
        above 0

    Notes
    -----
    This function reproduces the behaviour of the published programs; their code was not used. The
    scheme is that of `corrected` with a free border, with two differences:

    1. The form 2024 divides the central difference of the slopes by one pixel instead of two, which
       doubles all heights. The form 2025 uses a one-sided difference without this factor of two.
    2. The eigenvalues are those of modes 1..N instead of 0..N-1, and that of the mean is not
       excluded. Mode k is multiplied by about (k / (k + 1))^2, so wider shapes become flatter.
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
    """Return the difference of slopes along axis 0, (row, col), with the border values repeated.

    The difference is over two pixels for the form 2024, and over one pixel for 2025.
    """
    after = np.concatenate([along_axis[1:], along_axis[-1:]])
    before = np.concatenate([along_axis[:1], along_axis[:-1]])
    return np.asarray(after - (before if form == "2024" else along_axis))


def _flow_through_border(along_row: FloatArray, along_col: FloatArray) -> FloatArray:
    """Return the outward slope at border pixels, (row, col), and 0 at all others.

    It is subtracted from the divergence for an inhomogeneous Neumann condition.
    """
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
