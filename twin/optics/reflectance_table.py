"""Reflectance by a table of the RGL material database: its value, and directions drawn by it.

Names as in J. Dupuy and W. Jakob, ACM Trans. Graph. 37, 274 (2018): wi and wo directions to the
eye and of the reflected light, m half vector, u_m its coordinates in the unit square.

Directions of reflected light between surfaces (render.bounces) are drawn by the table, as in
Mitsuba's `measured`, but with the density of this wavelength in place of the luminance. Compared
with the density of a matte surface (cosine), for tables of a GGX conductor of roughness 0.1 and
0.4: variance of the weight of one direction 1/2500 to 1/36000 and 1/230 to 1/1300, of a pixel's
light from two reflections in a corner 1/3.8 and 1/1.35 (the direction to the projector is not
drawn), run time of `add_bounces` 1.2 to 1.4 times. Tables without the factor `jacobian` keep the
density of a matte surface: their coordinates do not follow the reflected light.
"""

from collections.abc import Mapping
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

_LEAST = 1e-3


class ReflectanceTable:
    """A table at one wavelength.

    Parameters
    ----------
    fields : arrays of the file by name
    spectra : of one wavelength, (phi_i, theta_i, row, col)
    """

    def __init__(self, fields: Mapping[str, Any], spectra: Any) -> None:
        angles = [fields["phi_i"].tolist(), fields["theta_i"].tolist()]
        self._is_isotropic = len(angles[0]) <= 2
        self._has_jacobian = bool(fields["jacobian"][0])
        # Any: Mitsuba's type information does not accept the points that its functions return.
        self._vndf: Any = mi.MarginalContinuous2D2(fields["vndf"], angles)
        self._spectra = mi.MarginalContinuous2D2(spectra, angles, False, False)
        self._shares: Any = mi.MarginalContinuous2D2(_density(spectra), angles)
        faces = (fields["ndf"], fields["sigma"])
        self._ndf, self._sigma = (
            mi.MarginalContinuous2D0(face, [], False, False) for face in faces
        )

    def value_and_density(self, wi: Any, wo: Any, active: Any) -> tuple[Any, Any]:
        """Return BSDF times cosine, and the density with which `draw` returns wo, 1/sr."""
        angles, half = _angles(wi), dr.normalize(wi + wo)
        theta_m, phi_m = _spherical(half)
        u_m = _unit_square(theta_m, phi_m - angles.x if self._is_isotropic else phi_m)
        u_m.y -= dr.floor(u_m.y)
        place, lobe = self._vndf.invert(u_m, angles, active)
        density = mi.warp.square_to_cosine_hemisphere_pdf(wo)
        if self._has_jacobian:
            lobe *= self._shares.eval(place, angles, active)
            density = lobe / _solid_angle(u_m.x, theta_m, dr.dot(wi, half))
        lit = active & (wi.z > 0.0) & (wo.z > 0.0)
        value = self._value(place, u_m, angles, active)
        return dr.select(lit, value, 0.0), dr.select(lit, density, 0.0)

    def draw(self, wi: Any, sample: Any, active: Any) -> tuple[Any, Any, Any]:
        """Draw wo from two numbers in [0, 1); return it, BSDF times cosine, and density, 1/sr.

        The density is 0 for directions below the surface.
        """
        if not self._has_jacobian:
            wo = mi.warp.square_to_cosine_hemisphere(sample)
            return (wo, *self.value_and_density(wi, wo, active))
        angles = _angles(wi)
        place, share = self._shares.sample(sample, angles, active)
        u_m, lobe = self._vndf.sample(place, angles, active)
        theta_m, phi_m = u_m.x**2 * (np.pi / 2.0), (2.0 * u_m.y - 1.0) * np.pi
        phi_m += angles.x if self._is_isotropic else 0.0
        radius, height = dr.sincos(theta_m)
        y, x = dr.sincos(phi_m)
        half = mi.Vector3f(radius * x, radius * y, height)
        cosine = dr.dot(wi, half)
        wo = 2.0 * cosine * half - wi
        density = share * lobe / _solid_angle(u_m.x, theta_m, cosine)
        lit = active & (wi.z > 0.0) & (wo.z > 0.0)
        return wo, self._value(place, u_m, angles, active), dr.select(lit, density, 0.0)

    def _value(self, place: Any, u_m: Any, angles: Any, active: Any) -> Any:
        """Return BSDF times cosine at a place of the spectra, with its half vector."""
        value = self._spectra.eval(place, angles, active)
        if self._has_jacobian:
            sigma = self._sigma.eval(_unit_square(angles.y, angles.x))
            value *= self._ndf.eval(u_m) / (4.0 * sigma)
        return value


def _density(spectra: Any) -> Any:
    """Return the spectra with a least value, as a density: also rows of zeros can be normalised."""
    largest = spectra.max(axis=(-2, -1), keepdims=True)
    return np.maximum(spectra, np.where(largest > 0.0, _LEAST * largest, 1.0)).astype(np.float32)


def _solid_angle(u: Any, theta: Any, cosine: Any) -> Any:
    """Return the solid angle of reflected directions per area of the unit square, sr.

    Parameters
    ----------
    u, theta : half vector's first coordinate in the unit square, and its angle to the normal, rad
    cosine : of the angle between half vector and either direction
    """
    return 4.0 * dr.maximum(cosine, _LEAST) * dr.maximum(2.0 * np.pi**2 * u * dr.sin(theta), 1e-6)


def _angles(wi: Any) -> Any:
    """Return azimuth and angle to the normal, rad, as the tables have them."""
    theta_i, phi_i = _spherical(wi)
    return mi.Vector2f(phi_i, theta_i)


def _spherical(direction: Any) -> tuple[Any, Any]:
    """Return the polar angle (to the normal, z) and the azimuth of unit vectors, rad."""
    chord = dr.norm(direction - type(direction)(0.0, 0.0, 1.0))
    return 2.0 * dr.safe_asin(0.5 * chord), dr.atan2(direction.y, direction.x)


def _unit_square(theta: Any, phi: Any) -> Any:
    """Return the table coordinates (0 to 1) of polar angle `theta` and azimuth `phi`, rad."""
    return mi.Point2f(dr.sqrt(theta * (2.0 / np.pi)), (phi + np.pi) / (2.0 * np.pi))
