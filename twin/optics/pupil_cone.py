"""Directions into which a rough flake reflects the pupil of the projector into that of the camera.

Directions are plane coordinates around the direction to the camera, rad; `glints` computes them
from slopes, so that areas of the plane are solid angles.
"""

from dataclasses import dataclass

import numpy as np
from scipy import integrate, special

from reconstruction.arrays import FloatArray

# Circles, and directions on each of them, by which a mean over the cone is computed.
_RINGS, _AZIMUTHS = 5, 8
_NODES = 512
# Half-width of the table beyond the pupils, and largest wave number times the scatter.
_TAIL, _CUTOFF = 5.0, 6.5


@dataclass(frozen=True, eq=False)
class Cone:
    """Directions into which one flake reflects the projector's pupil, seen by the camera's pupil.

    Attributes
    ----------
    density : share of the light per solid angle, 1/sr, at equally spaced distances from 0
    reach : distance at which the table ends, rad
    samples : (sample, 3); x and y of directions, and their shares of the light
    """

    density: FloatArray
    reach: float
    samples: FloatArray

    @classmethod
    def of(cls, camera: float, projector: float, scatter: float) -> "Cone":
        """Return the cone of two pupils and a rough flake.

        Parameters
        ----------
        camera, projector : radii of the pupils over their distance from the coat
        scatter : standard deviation of the reflected directions along one axis, rad; above 0
        """
        reach = camera + projector + _TAIL * scatter
        distances, step = np.linspace(0.0, reach, _NODES, retstep=True)
        count = max(128, int(2.0 * reach * _CUTOFF / scatter))  # at most 0.25 rad per step
        waves = np.linspace(0.0, _CUTOFF / scatter, 2 * count + 1)
        spectrum = np.exp(-0.5 * (waves * scatter) ** 2) * _disc(waves * camera)
        spectrum *= waves * _disc(waves * projector)
        density = integrate.simpson(
            special.j0(np.outer(distances, waves)) * spectrum, waves, axis=1
        )
        density = np.maximum(density, 0.0)
        density /= 2.0 * np.pi * step * np.sum(density * distances)
        variance = scatter**2 + 0.25 * (camera**2 + projector**2)
        return cls(density, float(reach), _samples(variance))


def _samples(variance: float) -> FloatArray:
    """Return directions and weights (sample, x y weight) for means of functions over the cone.

    Exact for polynomials of degree 7 if the cone is a normal distribution (Gauss-Laguerre).
    """
    halves, weights = np.polynomial.laguerre.laggauss(_RINGS)
    radius = np.repeat(np.sqrt(2.0 * variance * halves), _AZIMUTHS)
    turn = np.arange(radius.size) + np.repeat(0.5 * np.arange(_RINGS), _AZIMUTHS)
    angle = turn * (2.0 * np.pi / _AZIMUTHS)
    weight = np.repeat(weights / _AZIMUTHS, _AZIMUTHS)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), weight], axis=-1)


def _disc(x: FloatArray) -> FloatArray:
    """Return the Fourier transform of a uniform disc of unit light at wave number x / radius."""
    safe = np.where(x > 0.0, x, 1.0)
    return np.where(x > 0.0, 2.0 * special.j1(safe) / safe, 1.0)
