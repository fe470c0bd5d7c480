"""Connect a ray's hit point to the projector: the one event that puts light into the frames.

A path that ends on the projector pixel (u, v) with weight w adds w * P_k(u, v) to every frame k.
"""

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from twin.optics.devices import Device
from twin.optics.light import MARGIN_PX

# Shadow rays start this far off the surface along its normal: 50 times the float32 resolution of
# a point 250 mm away, 1/40 of the smallest mesh pitch.
_SHADOW_OFFSET_MM = 1e-3


@dataclass(frozen=True)
class Rig:
    """What a path needs: the two devices and the projector's irradiance at 1 mm (mW/mm^2)."""

    camera: Device
    projector: Device
    irradiance_at_1mm: float


@dataclass(frozen=True)
class Connection:
    """A surface point connected to the projector: where it is on its image, how much it carries."""

    column_px: Any
    row_px: Any
    weight: Any
    lit: Any


def connect(scene: Any, rig: Rig, hit: Any, bsdf: Any, coherent: bool = True) -> Connection:
    """Connect a hit point to the projector's pinhole; occluded points carry nothing.

    Parameters
    ----------
    scene : mi.Scene
    rig : Rig
    hit : mi.SurfaceInteraction3f
        May be invalid: then nothing is lit.
    bsdf : mi.BSDFPtr
        Of the hit surface.
    coherent : bool
        Neighbouring lanes ask for similar shadow rays.
    """
    column_px, row_px, axial_mm = rig.projector.project(hit.p)
    to_projector = rig.projector.position_mm - hit.p
    distance_mm = dr.norm(to_projector)
    direction = to_projector / distance_mm
    lit = hit.is_valid() & (axial_mm > 0.0) & on_image(rig, column_px, row_px, MARGIN_PX)
    lit &= ~_blocked(scene, hit, direction, distance_mm, lit, coherent=coherent)
    brdf_cos = bsdf.eval(mi.BSDFContext(), hit, hit.to_local(direction), lit)[0]
    # A plane facing the projector receives E1 / z^2; a surface element facing the ray gets
    # 1 / cos(ray, axis) = distance / z more, and its own cosine is in brdf_cos.
    irradiance = rig.irradiance_at_1mm * distance_mm / (axial_mm * axial_mm * axial_mm)
    weight = dr.select(lit, brdf_cos * irradiance, 0.0)
    nothing = ~hit.is_valid()
    column_px, row_px = (dr.select(nothing, 0.0, value) for value in (column_px, row_px))
    return Connection(column_px, row_px, weight, lit)


def on_image(rig: Rig, column_px: Any, row_px: Any, margin_px: float) -> Any:
    """Inside the projector's image, or within the margin into which its blurred edge reaches."""
    pinhole, low = rig.projector.pinhole, -0.5 - margin_px
    return (
        (column_px > low)
        & (column_px < pinhole.width_px - 1 - low)
        & (row_px > low)
        & (row_px < pinhole.height_px - 1 - low)
    )


def _blocked(
    scene: Any, hit: Any, direction: Any, distance_mm: Any, active: Any, *, coherent: bool
) -> Any:
    """Test the shadow ray; surfaces that face away from the projector shade themselves."""
    facing = dr.dot(hit.n, direction)
    start = hit.p + dr.copysign(_SHADOW_OFFSET_MM, facing) * hit.n
    shadow = mi.Ray3f(start, direction)
    shadow.maxt = distance_mm * (1.0 - 1e-4)
    return scene.ray_test(shadow, coherent=coherent, active=active)
