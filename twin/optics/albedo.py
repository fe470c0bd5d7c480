"""Albedo of the surface at every camera pixel: its reflectance at normal incidence.

It is the directional-hemispherical reflectance, diffuse and specular light together; transmitted
light is not included. The BSDF is integrated with the same points in all pixels. Pixels of one
material therefore have the same value, without noise. The integral is exact for matte surfaces and
for perfect mirrors. For a mixture of lobes its error is about 1 / POINTS. Rough metals have less
than the Fresnel reflectance by the light that their facets reflect twice, which the BSDF omits.
"""

from typing import TYPE_CHECKING, Any

import drjit as dr
import mitsuba as mi
import numpy as np

from reconstruction.arrays import FloatArray, FloatImage
from twin.optics.connection import Rig, first_hit
from twin.optics.devices import SubPixels

if TYPE_CHECKING:
    from twin.optics.colour_trace import LampRig

POINTS = 256


def albedo_of(scene: Any, rig: "Rig | LampRig") -> FloatImage:
    """Return the reflectance (row, col) at normal incidence of the surface at the pixel centres.

    A coat with flakes has its mean over the flakes. Pixels without a surface are 0.

    Parameters
    ----------
    scene : world in mm, with the materials of all surfaces
    """
    pinhole = rig.camera.pinhole
    centres = SubPixels.of_image(pinhole.width_px, pinhole.height_px, 1)
    ray = rig.camera.ray(centres.x_px, centres.y_px)
    ray = ray if rig.layers is None else rig.layers.refract(ray).ray
    hit = first_hit(scene, rig.heights, ray)
    bsdf = hit.bsdf(ray)
    # On the side of the surface that the camera views.
    hit.wi = mi.Vector3f(0.0, 0.0, dr.select(hit.wi.z < 0.0, -1.0, 1.0))
    lobe, across, along = (mi.Float(axis) for axis in integration_points(POINTS).T)

    def add(number: Any, total: Any) -> tuple[Any, Any]:
        u, v = dr.gather(mi.Float, across, number), dr.gather(mi.Float, along, number)
        first = dr.gather(mi.Float, lobe, number)
        sample, weight = bsdf.sample(mi.BSDFContext(), hit, first, mi.Point2f(u, v), hit.is_valid())
        reflected = hit.is_valid() & (sample.wo.z * hit.wi.z > 0.0)
        return number + 1, total + dr.select(reflected, weight[0], 0.0)

    start = mi.UInt32(0), dr.zeros(mi.Float, dr.width(hit.t))
    total = dr.while_loop(start, lambda number, _: number < POINTS, add)[1] / POINTS
    if rig.dots is not None:
        total *= rig.dots.factor(hit.p)
    return np.array(total, np.float32).reshape(pinhole.height_px, pinhole.width_px)


def integration_points(count: int) -> FloatArray:
    """Return the points (count, 3) of Hammersley's sequence in the unit cube, in bases 2 and 3."""
    numbers = np.arange(count)
    return np.stack([(numbers + 0.5) / count, _mirrored(numbers, 2), _mirrored(numbers, 3)], axis=1)


def _mirrored(numbers: Any, base: int) -> FloatArray:
    """Return numbers with their digits mirrored at the point, plus half of the last digit."""
    left, value, scale = numbers.copy(), np.zeros(len(numbers)), 1.0
    while left.any():
        scale /= base
        value += scale * (left % base)
        left //= base
    return np.asarray(value + scale / 2.0)
