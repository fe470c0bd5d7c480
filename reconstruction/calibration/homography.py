"""Plane-to-plane maps: fit by normalised direct linear transformation (Hartley 1997), apply."""

import numpy as np

from reconstruction.arrays import Doubles
from reconstruction.errors import InputError


def apply_homography(H: Doubles, points: Doubles) -> Doubles:
    """Map points (n, 2) by H (3, 3)."""
    mapped = points @ H[:, :2].T + H[:, 2]
    return np.asarray(mapped[:, :2] / mapped[:, 2:])


def fit_homography(source: Doubles, target: Doubles) -> Doubles:
    """Return the H (3, 3) that maps source (n, 2) to target (n, 2), n >= 4, least squares.

    Raises
    ------
    InputError : fewer than four points, or all on one line
    """
    if len(source) < 4:
        raise InputError(f"a homography needs 4 points, found {len(source)}")
    scale_source, scale_target = _normaliser(source), _normaliser(target)
    x, y = apply_homography(scale_source, source).T
    u, v = apply_homography(scale_target, target).T
    zero, one = np.zeros_like(x), np.ones_like(x)
    upper = np.column_stack([x, y, one, zero, zero, zero, -u * x, -u * y, -u])
    lower = np.column_stack([zero, zero, zero, x, y, one, -v * x, -v * y, -v])
    design = np.concatenate([upper, lower])
    # The eigenvector of the smallest eigenvalue of A^T A: 9 x 9 however many points there are.
    values, vectors = np.linalg.eigh(design.T @ design)
    if values[1] < 1e-12 * values[-1]:
        raise InputError("the points of a homography lie on one line")
    H = np.linalg.inv(scale_target) @ vectors[:, 0].reshape(3, 3) @ scale_source
    return np.asarray(H / H[2, 2])


def _normaliser(points: Doubles) -> Doubles:
    centre = points.mean(axis=0)
    spread = float(np.sqrt(np.mean((points - centre) ** 2)))
    scale = 1.0 / spread if spread > 0.0 else 1.0
    return np.array(
        [[scale, 0.0, -scale * centre[0]], [0.0, scale, -scale * centre[1]], [0.0, 0.0, 1.0]]
    )
