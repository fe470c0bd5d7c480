"""Covariance of an adjustment, with independent features and with features correlated in a pose.

**Independent residuals** (Gauss-Markov): s^2 (J^T J)^-1, with the Jacobian J of the weighted
residuals and s^2 their mean square per degree of freedom.

**Residuals correlated within a pose.** Blur, a bent board, uneven light or a lens that the model
does not describe displace neighbouring features alike. Their errors do not average out as those of
independent features do. The poses, however, are independent, and their spread is used: the
delete-one jackknife over poses (Efron and Stein 1981), which for clusters of observations is the
covariance CR3 of Bell and McCaffrey (2002). The parameters d_k that change if pose k is left out
follow from one linear step, and

    V = (G - 1) / G sum_k d_k d_k^T

for G poses. With few poses V is uncertain and has at most the rank G. Therefore the mean of V and
of a target is used (Schaefer and Strimmer 2005), with weights of G - 1 and of `TARGET_POSES` poses.
The target is the covariance of independent residuals times one factor, the design effect: the mean
square of all poses' scores over its expectation for independent residuals, at least 1.

From disjoint sets of five simulated poses, with errors of the dots correlated over a third of the
board, 94 % of all parameters agree within two standard uncertainties. By the covariance of
independent residuals it is 45 % (`benchmarks/reality_intervals.py`).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular

from reconstruction.arrays import FloatArray, IntArray
from reconstruction.errors import InputError

# Least ratio of singular values. It only guards against rounding errors: weakly determined
# parameters are accepted and have a large uncertainty.
MIN_SINGULAR_RATIO = 1e-9
# Weight of the target, as a number of poses.
TARGET_POSES = 2.0
# Least share of the information about a direction in parameter space that the other poses have: if
# one pose alone determines a direction, the step without that pose is not linear.
LEAST_SHARE = 0.02


@dataclass(frozen=True, eq=False)
class PoseBlock:
    """Part of the linearised least squares problem that one pose contributes.

    Parameters
    ----------
    slopes : (residuals of the pose, free) derivatives of the weighted residuals
    residuals : (residuals of the pose,) weighted residuals at the solution
    own : (6,) int, columns of `slopes` of the parameters that occur in this pose only
    """

    slopes: FloatArray
    residuals: FloatArray
    own: IntArray


def inverse_normal(jacobian: FloatArray) -> FloatArray:
    """Return the inverse of J^T J for a Jacobian J; raise InputError if J^T J is singular.

    It is computed from the QR decomposition of J, scaled to columns of unit length, and the
    singular values of R.
    """
    scale = np.linalg.norm(jacobian, axis=0)
    if np.any(scale == 0.0):
        raise _undetermined()
    values, vectors = np.linalg.svd(np.linalg.qr(jacobian / scale, mode="r"))[1:]
    if values[-1] < MIN_SINGULAR_RATIO * values[0]:
        raise _undetermined()
    half = vectors.T / values
    return np.asarray(half @ half.T / np.outer(scale, scale))


def _undetermined() -> InputError:
    return InputError(
        "the board poses do not determine every free parameter: tilt the board by 10 to 25 degrees "
        "in at least three directions, or estimate fewer parameters"
    )


def robust_covariance(
    blocks: Sequence[PoseBlock], independent: FloatArray, variance: float
) -> FloatArray:
    """Return the covariance (free, free) for residuals that are correlated within each pose.

    Parameters
    ----------
    blocks : one per pose
    independent : (free, free) covariance for independent residuals
    variance : mean square of the weighted residuals per degree of freedom
    """
    if not variance > 0.0:
        return independent
    common = np.setdiff1d(np.arange(len(independent)), np.concatenate([b.own for b in blocks]))
    parts = [_without_own(block, common) for block in blocks]
    root = np.linalg.qr(np.concatenate([slopes for slopes, _ in parts]), mode="r")
    whitened = [solve_triangular(root, slopes.T, trans="T").T for slopes, _ in parts]
    shares = np.stack([slopes.T @ slopes for slopes in whitened])
    scores = np.stack([w.T @ block.residuals for w, block in zip(whitened, blocks, strict=True)])
    effect = design_effect(shares, scores, variance)
    freedom, target = len(blocks) - 1.0, effect * variance * np.eye(len(common))
    spread = freedom * _jackknife(shares, scores) + TARGET_POSES * target
    spread /= freedom + TARGET_POSES
    half = solve_triangular(root, np.linalg.cholesky(spread))
    lever = _lever([own for _, own in parts], blocks, common, len(independent))
    own_part = independent - lever @ independent[np.ix_(common, common)] @ lever.T
    return np.asarray(effect * own_part + lever @ half @ half.T @ lever.T)


def _without_own(block: PoseBlock, common: IntArray) -> tuple[FloatArray, FloatArray]:
    """Return the slopes by the common parameters with the pose's own motion adjusted.

    The second array (6, common) is the change of the own parameters by the common ones.
    """
    basis, triangle = np.linalg.qr(block.slopes[:, block.own])
    along = basis.T @ block.slopes[:, common]
    slopes = block.slopes[:, common] - basis @ along
    return slopes, -solve_triangular(triangle, along)


def design_effect(shares: FloatArray, scores: FloatArray, variance: float) -> float:
    """Return the mean square of the poses' scores over that of independent residuals, at least 1.

    Parameters
    ----------
    shares : (pose, common, common) share of the information in each pose; their sum is 1
    scores : (pose, common) gradient of each pose's half sum of squares
    variance : mean square of the weighted residuals per degree of freedom
    """
    expected = np.einsum("kii->", shares) - np.sum(shares**2)
    return max(1.0, float(np.sum(scores**2) / (variance * expected)))


def _jackknife(shares: FloatArray, scores: FloatArray) -> FloatArray:
    values, vectors = np.linalg.eigh(np.eye(shares.shape[1]) - shares)
    along = np.einsum("kij,ki->kj", vectors, scores) / np.maximum(values, LEAST_SHARE)
    steps = np.einsum("kij,kj->ki", vectors, along)
    return np.asarray((len(steps) - 1) / len(steps) * steps.T @ steps)


def _lever(
    changes: Sequence[FloatArray], blocks: Sequence[PoseBlock], common: IntArray, size: int
) -> FloatArray:
    """Return the matrix (size, common) from changes of the common parameters to those of all."""
    lever = np.zeros((size, len(common)))
    lever[common] = np.eye(len(common))
    for change, block in zip(changes, blocks, strict=True):
        lever[block.own] = change
    return lever
