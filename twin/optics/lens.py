"""Thin lens of the camera: where its rays start on the pupil.

Every sub-pixel sample has one place on the lens, the same on every pixel and in every frame: random
places would act as phase noise. The places have the disc's centroid and variance exactly, whatever
their number, so that a smooth surface out of focus keeps its phase and its mean blur; with more
samples they fill the disc evenly.
"""

from dataclasses import dataclass
from functools import lru_cache
from math import gcd

import numpy as np

from reconstruction.arrays import FloatArray
from twin.config.models import Camera

_GOLDEN_ANGLE = np.pi * (3.0 - np.sqrt(5.0))
# A correlation of place with position changes the size of the blur, one of their squares its shape.
_FIRST_POWERS_COUNT = 10.0


@dataclass(frozen=True)
class ThinLens:
    """Pupil of a camera; its centre is the pinhole.

    Attributes
    ----------
    radius_mm : float
    focus_mm : float
        Axial distance of the plane in focus.
    """

    radius_mm: float
    focus_mm: float

    @classmethod
    def of(cls, camera: Camera, T_world_from_cam: FloatArray) -> "ThinLens | None":
        """Return the lens of a camera, in focus at the world origin's axial distance, or None."""
        if not camera.depth_of_field:
            return None
        focus_mm = float(-T_world_from_cam[:3, 3] @ T_world_from_cam[:3, 2])
        return cls(camera.focal_length_mm / camera.f_number / 2.0, focus_mm)


@lru_cache(maxsize=8)
def lens_places(side: int) -> FloatArray:
    """Return the place of every sub-pixel sample on the unit disc, (side * side, 2), x and y.

    A spiral of equal areas (Vogel 1979), whose points are dealt out to the square grid of
    sub-pixels in steps of a number without common factor, so that neighbours on the grid lie far
    apart on the lens. Of all such steps and some turns of the spiral that is taken whose places
    correlate least with the sub-pixel positions: pixel box and lens then blur independently (with
    fewer than 25 samples only roughly).
    """
    samples = side * side
    if samples == 1:
        return np.zeros((1, 2))
    grid, turns = _moments(_cell_centres(side)), 64 // side
    steps = [step for step in range(1, samples) if gcd(step, samples) == 1]
    dealt = (
        _spiral(samples, turn)[np.arange(samples) * step % samples]
        for step in steps
        for turn in np.arange(turns) * (2.0 * np.pi / turns)
    )
    return min(dealt, key=lambda places: float(np.sum((grid.T @ _moments(places)) ** 2)))


def _spiral(samples: int, turn_rad: float) -> FloatArray:
    index = np.arange(samples)
    angle_rad = index * _GOLDEN_ANGLE + turn_rad
    radius = np.sqrt((index + 0.5) / samples)
    places = np.stack([radius * np.cos(angle_rad), radius * np.sin(angle_rad)], axis=-1)
    places -= places.mean(axis=0)
    # Exactly the disc's covariance, 1/4 along every axis.
    variances, axes = np.linalg.eigh(places.T @ places / samples)
    return np.asarray(places @ (axes * (0.5 / np.sqrt(variances))) @ axes.T)


def _cell_centres(side: int) -> FloatArray:
    line = (np.arange(side) + 0.5) / side - 0.5
    y, x = (axis.ravel() for axis in np.meshgrid(line, line, indexing="ij"))
    return np.stack([x, y], axis=-1)


def _moments(places: FloatArray) -> FloatArray:
    """First and second powers of positions (n, 2), centred and weighted: (n, 5)."""
    x, y = places.T
    features = np.stack([x, y, x * x, y * y, x * y], axis=-1)
    features -= features.mean(axis=0)
    length = np.linalg.norm(features, axis=0)
    weight = np.array([_FIRST_POWERS_COUNT, _FIRST_POWERS_COUNT, 1.0, 1.0, 1.0])
    return np.asarray(weight * features / np.where(length > 1e-9, length, 1.0))
