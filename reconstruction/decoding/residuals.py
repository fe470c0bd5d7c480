"""Mask pixels whose phase frames are not those of a fringe at rest."""

import numpy as np

from reconstruction.arrays import Reason
from reconstruction.compact import Half
from reconstruction.decoding import DecodeOptions
from reconstruction.decoding._decode import Maps, Plan
from reconstruction.decoding._rows import BIAS
from reconstruction.decoding.grey_levels import variance_dn2
from reconstruction.patterns import AXES, PatternSet


def mask_residuals(
    maps: Maps, patterns: PatternSet, plan: Plan, options: DecodeOptions, noise_share: float
) -> None:
    """Mask valid pixels with a large residual of the sine fit with the reason MOTION, in place.

    By noise alone, residual^2 / sigma^2 has the distribution chi-square / (N - 3) with N - 3
    degrees of freedom. Three steps have no residual.

    Parameters
    ----------
    options : with `max_residual_sigmas`, the largest RMS residual in standard deviations of a
        level at the mean level; None: no pixel is masked
    noise_share : noise variance of a phase frame as a share of that of a frame of the camera
    """
    most_sigmas = options.max_residual_sigmas
    if most_sigmas is None or not patterns.steps:
        return
    unit_dn = BIAS / float(plan.units.level)
    for axis in patterns.axes:
        k = AXES.index(axis)
        mean_dn, residual_dn = (
            Half(image[k], unit_dn).expand() for image in (maps.mean, maps.residual)
        )
        limit_dn = most_sigmas * np.sqrt(noise_share * variance_dn2(mean_dn, plan))
        moved = (maps.reason == Reason.VALID) & (residual_dn > limit_dn)
        maps.reason[moved] = Reason.MOTION
    for lines in (maps.coordinate_px, maps.sigma):
        lines[:, maps.reason != Reason.VALID] = 0
