"""Light through plane-parallel clear layers: Snell and Fresnel in closed form, without sampling.

Coordinates are in the world frame, z up. Light propagates down from the air through the media
1 .. m, each below its own horizontal interface; medium m contains the surface. d_i is the vertical
distance in medium i (air is 0) and n_i the index of medium i. t is the tangent of the angle to the
vertical IN AIR. Snell's invariant s = t / sqrt(1 + t^2) determines the horizontal distance

    r(t) = sum_i d_i t / q_i,   q_i = sqrt(n_i^2 + (n_i^2 - 1) t^2) = sqrt((n_i^2 - s^2) (1 + t^2)),

so that cos(theta_i) = q_i / (n_i sqrt(1 + t^2)). For n_i >= 1, r(t) is concave and increasing:
Newton's method from the left of the root never overshoots and needs no bounds.

Light that is reflected between the interfaces, or from them back to the surface, is not modelled
(ghosts, total internal reflection). Scatter in the media and dispersion within the spectral width
of the projector's light are not modelled either.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import drjit as dr
import mitsuba as mi

from twin.config.layers import Medium
from twin.optics.devices import Device

NEWTON_TURNS = 4
"""Number of Newton steps. For a gel behind a window, one step is exact to float32. Layers that fill
90 % of the distance, or have index 3, need three steps at 50 degrees and four at 80 degrees."""

# Smallest cosine of the angle to the vertical in air: rays beyond 89.94 degrees have no hit.
_FLATTEST = 1e-3


@dataclass(frozen=True)
class RefractedRay:
    """A camera ray below the last interface, and the transmission of radiance along it."""

    ray: Any
    transmittance: Any
    absorption_per_mm: float

    def transmission(self, distance_mm: Any) -> Any:
        """Return radiance in air / radiance at the surface, which is at `distance_mm` on the ray.

        If the medium absorbs, the ratio is 0 for rays without a hit (infinite distance).
        """
        if not self.absorption_per_mm:
            return self.transmittance
        absorbed = dr.exp(-self.absorption_per_mm * distance_mm)
        return self.transmittance * dr.select(dr.isfinite(distance_mm), absorbed, 0.0)


@dataclass(frozen=True)
class Arrival:
    """Projector light at a surface point.

    Attributes
    ----------
    column_px, row_px : mi.Float; projector pixel of the light
    axial_mm : mi.Float; distance along the projector's axis to the sagittal image of the point,
        which the layers form
    direction : mi.Vector3f; unit vector from the point towards the incident light
    clear_mm : mi.Float; distance along `direction` within which surfaces cast shadows
    irradiance : mi.Float; on a surface element that faces `direction`, mW/mm^2
    """

    column_px: Any
    row_px: Any
    axial_mm: Any
    direction: Any
    clear_mm: Any
    irradiance: Any


@dataclass(frozen=True)
class LayerStack:
    """The media below the open air, from the top down; the last contains the surface."""

    media: tuple[Medium, ...]

    @property
    def floor_mm(self) -> float:
        """World z of the last interface; all surfaces are below it."""
        return self.media[-1].top_mm

    def refract(self, ray: Any) -> RefractedRay:
        """Refract camera rays (`mi.Ray3f`, unit direction, in air) to below the last interface.

        The ratio of radiance to squared index changes by transmission only: L_air = T L_medium /
        n^2 (Nicodemus, Applied Optics 2, 1371 (1963)).
        """
        down = -ray.d.z
        enters = down > _FLATTEST
        down = dr.select(enters, down, 1.0)
        t_square = dr.maximum(1.0 - down * down, 0.0) / (down * down)
        depths_mm = self._depths_mm(ray.o.z, self.floor_mm)[:-1]
        reach = _reach(depths_mm, self._q(t_square)[:-1])
        lateral = ray.d / down * reach
        start = mi.Point3f(ray.o.x + lateral.x, ray.o.y + lateral.y, self.floor_mm)
        n = self.media[-1].ior
        below = mi.Vector3f(ray.d.x / n, ray.d.y / n, -down * self._q(t_square)[-1] / n)
        refracted = mi.Ray3f(ray)
        refracted.o = dr.select(enters, start, ray.o)
        refracted.d = dr.select(enters, below, ray.d)
        left = self._transmittance(t_square, depths_mm) / (n * n)
        return RefractedRay(
            refracted, dr.select(enters, left, 0.0), self.media[-1].absorption_per_mm
        )

    def arrive(self, projector: Device, irradiance_at_1mm: Any, point_mm: Any) -> Arrival:
        """Return the projector's light at points below the last interface.

        Parameters
        ----------
        irradiance_at_1mm : irradiance E1 of a white field in air at 1 mm along the projector's
            axis, mW/mm^2

        Notes
        -----
        theta is the angle to the vertical in air, and T the transmittance of the layers. A pinhole
        of radiant intensity I sends I T sin(theta) dtheta dphi into the ring r dr dphi:
        E_horizontal = I T cos^3(theta) (t / r) / r'(t), r'(t) = sum_i d_i n_i^2 / q_i^3, and
        t / r = 1 / sum_i d_i / q_i has no singularity at r = 0. The sagittal image of the point is
        on the vertical through the point, r / t below the pinhole. In air, the light propagates
        from the pinhole towards this image. With I = E1 / cos^3(axis), E_horizontal = T E1 /
        axial^3 (r / t)^2 / r'(t), where axial is the axial distance of the image.
        """
        pinhole = projector.position_mm
        offset = point_mm - pinhole
        depths_mm = self._depths_mm(pinhole.z, point_mm.z)
        t_square = self._tangent_square(depths_mm, offset.x * offset.x + offset.y * offset.y)
        q = self._q(t_square)
        image_mm, spread_mm = _reach(depths_mm, q), self._slope(depths_mm, q)
        image = mi.Point3f(point_mm.x, point_mm.y, pinhole.z - image_mm)
        column_px, row_px, axial_mm = projector.project(image)
        n = self.media[-1].ior
        slant = dr.sqrt(1.0 + t_square)
        cosine = q[-1] / (n * slant)
        sideways = -1.0 / (image_mm * slant * n)
        direction = mi.Vector3f(offset.x * sideways, offset.y * sideways, cosine)
        horizontal = irradiance_at_1mm * image_mm * image_mm / (axial_mm**3 * spread_mm)
        return Arrival(
            column_px=column_px,
            row_px=row_px,
            axial_mm=axial_mm,
            direction=direction,
            clear_mm=depths_mm[-1] / cosine,
            irradiance=horizontal * self._transmittance(t_square, depths_mm) / cosine,
        )

    def _depths_mm(self, from_mm: Any, to_mm: Any) -> list[Any]:
        """Return the vertical distances, mm, in the air and in each medium.

        Parameters
        ----------
        from_mm, to_mm : world z of a device and of a point
        """
        tops = [medium.top_mm for medium in self.media]
        between = [upper - lower for upper, lower in pairwise(tops)]
        return [from_mm - tops[0], *between, tops[-1] - to_mm]

    def _q(self, t_square: Any) -> list[Any]:
        """Return q_0 = 1 of the air, then q_i of each medium (equation of the module)."""
        squares = [medium.ior**2 for medium in self.media]
        return [1.0, *(dr.sqrt(dr.fma(n2 - 1.0, t_square, n2)) for n2 in squares)]

    @property
    def _n(self) -> list[float]:
        """Refractive index of the air, then of each medium."""
        return [1.0, *(medium.ior for medium in self.media)]

    def _tangent_square(self, depths_mm: list[Any], r_square: Any) -> Any:
        """Solve r(t) = r for t^2; Newton's method starts at t = r / r'(0), left of the root."""
        r = dr.sqrt(r_square)
        t = r / _reach(depths_mm, self._n)
        for _ in range(NEWTON_TURNS):
            q = self._q(t * t)
            t = t + (r - t * _reach(depths_mm, q)) / self._slope(depths_mm, q)
        return t * t

    def _slope(self, depths_mm: list[Any], q: list[Any]) -> Any:
        """Return the derivative r'(t) of the horizontal distance, mm."""
        parts = zip(depths_mm, self._n, q, strict=True)
        return _sum(d * (n * n) / (q * q * q) for d, n, q in parts)

    def _transmittance(self, t_square: Any, depths_mm: list[Any]) -> Any:
        """Return the transmittance of all interfaces (Fresnel, unpolarised light) and media.

        All interfaces share the plane of incidence, so that s and p polarisation are conserved. The
        transmittances of all interfaces are multiplied for s and for p, and the mean of both
        products is taken (Born and Wolf, Principles of Optics, 1.5). The result also includes the
        transmittance of the absorbing media; media without an entry in `depths_mm` do not absorb.
        """
        slant = dr.sqrt(1.0 + t_square)
        normal = [q / slant for q in self._q(t_square)]  # n_i cos(theta_i)
        n = self._n
        s_light, p_light = mi.Float(1.0), mi.Float(1.0)
        for i in range(len(self.media)):
            product = 4.0 * normal[i] * normal[i + 1]
            s_sum = normal[i] + normal[i + 1]
            p_sum = n[i] / n[i + 1] * normal[i + 1] + n[i + 1] / n[i] * normal[i]
            s_light, p_light = s_light * product / s_sum**2, p_light * product / p_sum**2
        depth = _sum(
            medium.absorption_per_mm * medium.ior * d / cosine
            for d, cosine, medium in zip(depths_mm[1:], normal[1:], self.media, strict=False)
            if medium.absorption_per_mm
        )
        return 0.5 * (s_light + p_light) * dr.exp(-depth)


def _reach(depths_mm: list[Any], q: list[Any]) -> Any:
    """Return r / t, mm: horizontal distance divided by the tangent of the angle in air."""
    return _sum(d / q_i for d, q_i in zip(depths_mm, q, strict=True))


def _sum(parts: Iterable[Any]) -> Any:
    return sum(parts, 0.0)
