"""Blur of the projector by distance, from captures of surfaces at several heights.

Each capture's fit gives one blur b. With u = 1 / z, the inverse of its points' axial distance, the
thin lens makes b^2 = b_0^2 + g^2 (u - u_0)^2 (`twin.optics.light.Defocus`), a parabola in u: three
heights give best focus 1 / u_0, the blur b_0 there, and the growth g, focal length (px) times the
diameter of the exit pupil over 4. A surface has many distances: the means of u and of u^2 over its
points stand for them.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.characterise import UncertainValue
from twin.adoption.findings import RigField

LEAST_CAPTURES = 3
# Relative, of each blur: one Gaussian was fitted to a surface whose points are blurred unlike. Two
# rendered rigs are off by 1 to 4 % (tests/adoption).
_MIXED = 0.02
# Of the growth, over its uncertainty: less is no defocus.
_SEEN = 3.0
# Captures nearer than this to one another, as a share of the distance, are at one height.
_APART = 0.002


@dataclass(frozen=True)
class SeenBlur:
    """Blur of one capture, and the inverse axial distances of its points: mean and spread."""

    inverse_per_mm: float
    spread_per_mm: float
    blur_px: UncertainValue


@dataclass(frozen=True)
class FoundDefocus:
    """A projector's blur by distance."""

    blur_px: UncertainValue
    growth_px_mm: UncertainValue
    focus_mm: UncertainValue


def defocus_of(seen: Sequence[SeenBlur]) -> FoundDefocus | None:
    """Return the parabola through blurs; None where the captures show none.

    They are fewer than three heights, or too near one another, or best focus lies beyond twice
    their range, where the blur at it is no more than a guess.
    """
    u = np.array([one.inverse_per_mm for one in seen])
    spread = np.array([one.spread_per_mm for one in seen])
    blur = np.array([one.blur_px.value for one in seen])
    if len(_heights(u)) < LEAST_CAPTURES:
        return None
    middle, scale = float(u.mean()), float(np.ptp(u))
    x = (u - middle) / scale
    basis = np.stack([np.ones_like(x), x, x * x + (spread / scale) ** 2], axis=1)
    own = np.array([one.blur_px.uncertainty for one in seen])
    sigma = 2.0 * blur * np.hypot(own, _MIXED * blur)
    weighted = basis / sigma[:, None]
    covariance = np.linalg.inv(weighted.T @ weighted)
    a, b, c = (covariance @ weighted.T @ (blur**2 / sigma)).tolist()
    if c < _SEEN * np.sqrt(covariance[2, 2]):
        return None
    top, least = -b / (2.0 * c), a - b * b / (4.0 * c)
    if abs(top) > 1.0 or least <= 0.0:
        return None
    focus_mm = 1.0 / (middle + scale * top)
    slopes = {
        "blur": np.array([1.0, -b / (2.0 * c), b * b / (4.0 * c * c)]) / (2.0 * np.sqrt(least)),
        "growth": np.array([0.0, 0.0, 0.5 / np.sqrt(c)]) / scale,
        "focus": focus_mm**2 * scale * np.array([0.0, 0.5 / c, -b / (2.0 * c * c)]),
    }
    sigmas = {name: float(np.sqrt(one @ covariance @ one)) for name, one in slopes.items()}
    return FoundDefocus(
        UncertainValue(float(np.sqrt(least)), sigmas["blur"]),
        UncertainValue(float(np.sqrt(c)) / scale, sigmas["growth"]),
        UncertainValue(focus_mm, sigmas["focus"]),
    )


def _heights(u: FloatArray) -> list[float]:
    """Return inverse distances that are apart."""
    kept: list[float] = []
    for one in sorted(u.tolist()):
        if not kept or one - kept[-1] > _APART * one:
            kept.append(one)
    return kept


def defocus_fields(found: FoundDefocus, focal_px: float, captures: int) -> dict[str, RigField]:
    """Return blur, pupil and best focus as fields of a rig.

    Parameters
    ----------
    focal_px : of the projector
    captures : how many they were found from
    """
    how = f"blur of {captures} captures over their distance"
    growth, per_mm = found.growth_px_mm, 4.0 / focal_px
    aperture = UncertainValue(per_mm * growth.value, per_mm * growth.uncertainty)
    fields = [
        RigField.measured("projector.blur_px", found.blur_px, how),
        RigField.measured("projector.aperture_mm", aperture, how),
        RigField.measured("projector.focus_mm", found.focus_mm, how),
    ]
    return {one.path: one for one in fields}
