"""Weighted least squares for heights: conjugate gradients, preconditioned by the fast solver.

Minimises sum over edges of w (step of h - measured step)^2. Without weights the preconditioner is
the solution. With holes (weight 0) the unknowns are the other pixels and the preconditioner is that
of the fictitious domain: solve on the whole grid, keep the pixels that are there. The number of
iterations then depends on the ratio of the weights and on the shape of the holes, hardly on the
number of pixels: a height given around a hole continues into it with bounded energy.
"""

from dataclasses import dataclass

import numpy as np

from reconstruction.arrays import BoolImage, Doubles
from reconstruction.errors import FitError
from reconstruction.photometric.poisson import Boundary, solve_poisson, sum_of_steps

RELATIVE_TOLERANCE = 1e-5
MAX_ITERATIONS = 500


@dataclass(frozen=True, eq=False)
class EdgeWeights:
    """Weights of the steps to the next row, (M-1, N), and to the next column, (M, N-1)."""

    to_next_row: Doubles
    to_next_col: Doubles


def edge_weights(weights: Doubles) -> EdgeWeights:
    """Return the weight of a step from those of both pixels, (M, N).

    A step is the mean of two slopes; with weights 1 / variance its own is proportional to the
    harmonic mean, which also vanishes where one of the pixels is invalid.
    """
    return EdgeWeights(
        _harmonic_mean(weights[1:], weights[:-1]), _harmonic_mean(weights[:, 1:], weights[:, :-1])
    )


def _harmonic_mean(a: Doubles, b: Doubles) -> Doubles:
    total = a + b
    mean: Doubles = 2.0 * a * b / np.where(total > 0.0, total, 1.0)
    return mean


def solve_weighted(
    row_steps: Doubles, col_steps: Doubles, weights: Doubles, boundary: Boundary = "neumann"
) -> Doubles:
    """Return the heights that fit the steps best, (M, N), in the unit of the steps.

    Pixels of weight 0 get height 0. With a free border (neumann) the mean over the other pixels
    is 0; parts that weight-0 pixels separate have each its own unknown constant.

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


def _apply(height: Doubles, edges: EdgeWeights, used: BoolImage) -> Doubles:
    steps = edges.to_next_row * np.diff(height, axis=0), edges.to_next_col * np.diff(height, axis=1)
    return sum_of_steps(*steps) * used


def _conjugate_gradients(
    right: Doubles, edges: EdgeWeights, used: BoolImage, boundary: Boundary
) -> Doubles:
    height, residual = np.zeros_like(right), right.copy()
    direction = preconditioned = solve_poisson(residual, boundary) * used
    power = start = float(np.vdot(residual, preconditioned))
    for _ in range(MAX_ITERATIONS):
        if power <= RELATIVE_TOLERANCE**2 * start:
            return height
        image = _apply(direction, edges, used)
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
