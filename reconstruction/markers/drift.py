"""Displacements of all dots at once, without an assignment: coherent point drift.

Each dot of the pressed elastomer is drawn from a mixture of Gaussians about the displaced dots, or
is an outlier. The displacements are a smooth function of the place: a sum of Gaussian kernels with
a penalty on its roughness (Myronenko, Song 2010, IEEE TPAMI 32, 2262). Expectation and maximisation
alternate while the width of the mixture decreases, so that a dot between two candidates is decided
by all its neighbours. Lengths are in spacings.
"""

import numpy as np
from scipy.spatial.distance import cdist

from reconstruction.arrays import FloatArray

# Width of the kernels and weight of the penalty. Of 1.5 to 3 and 0.5 to 3 these kept most dots of
# twisted patterns (`tests/markers/test_matching.py`).
_KERNEL, _PENALTY = 3.0, 3.0
# Share of outliers, and width of the mixture at the start and at least.
_OUTLIERS, _START, _LEAST = 0.1, 0.4, 0.03
_ROUNDS = 60


def drifted(
    before_px: FloatArray, after_px: FloatArray, spacing_px: float, start_px: FloatArray
) -> FloatArray:
    """Return smooth displacements (n, 2) px of dots, near the dots of the pressed elastomer.

    Parameters
    ----------
    before_px, after_px : (n, 2) and (m, 2), centres of dots, row and column
    spacing_px : distance of neighbouring dots
    start_px : (n, 2) expected displacements
    """
    places, targets = before_px / spacing_px, after_px / spacing_px
    kernel = np.exp(-cdist(places, places, "sqeuclidean") / (2.0 * _KERNEL**2))
    start = start_px / spacing_px
    moved, variance = start, _START**2
    for _ in range(_ROUNDS):
        share = _shares(places + moved, targets, variance)
        weight = share.sum(axis=1)
        system = weight[:, None] * kernel + _PENALTY * variance * np.eye(len(places))
        wanted = share @ targets - weight[:, None] * (places + start)
        moved = start + kernel @ np.linalg.solve(system, wanted)
        apart = cdist(places + moved, targets, "sqeuclidean")
        variance = float((share * apart).sum() / (2.0 * share.sum() + _LEAST**2))
        variance = max(variance, _LEAST**2)
    return np.asarray(moved * spacing_px)


def _shares(places: FloatArray, targets: FloatArray, variance: float) -> FloatArray:
    """Return the probabilities (n, m) that a target belongs to a dot; columns sum to at most 1.

    The outliers have a uniform density of one dot per square of the spacing.
    """
    density = np.exp(-cdist(places, targets, "sqeuclidean") / (2.0 * variance))
    outliers = 2.0 * np.pi * variance * _OUTLIERS / (1.0 - _OUTLIERS)
    return np.asarray(density / (density.sum(axis=0) + outliers))
