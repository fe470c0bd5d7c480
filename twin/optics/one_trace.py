"""The one-trace renderer: geometry is traced once, all pattern frames come from that trace.

Light transport is linear in the pattern: a camera path that reaches projector pixel (u, v) with
weight w adds w * P_k(u, v) to every frame k. Sub-pixel positions are a fixed square grid shared by
all frames; independent jitter would act as phase noise larger than the sensor's. Camera rays,
shadow rays, BSDF, table look-ups and all frames of all samples are fused into one kernel.

Does: direct light, occlusion, any BSDF, lens distortion of both devices. Does not: light that
bounces between surfaces, refraction.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from twin.optics.devices import Device
from twin.optics.light import MARGIN_PX, OVERSAMPLING, LightTable
from twin.optics.stack import Frames, Truth

# Shadow rays start this far off the surface along its normal: 50 times the float32 resolution of
# a point 250 mm away, 1/40 of the smallest mesh pitch.
_SHADOW_OFFSET_MM = 1e-3
_PACKET = 4

SMOOTH_WITHIN_PX = 0.25
"""A pixel whose samples lie this close together on the projector sees one smooth patch: the light
is looked up once, at their weighted mean. The mean position, and so the phase, is exact; what is
left out is half the pattern's curvature times the samples' variance, below 0.4 % of white on the
edge of a Gray bit blurred by 0.7 px and 0.1 % of the fringe amplitude."""


@dataclass(frozen=True)
class Rig:
    """What a path needs: the two devices and the projector's irradiance at 1 mm (mW/mm^2)."""

    camera: Device
    projector: Device
    irradiance_at_1mm: float


@dataclass(frozen=True)
class _Connection:
    """A camera ray connected to the projector: where it lands and how much it carries."""

    point: Any
    column_px: Any
    row_px: Any
    weight: Any
    lit: Any


class _Table:
    """A light table on the device, rows padded to whole packets of contiguous profiles."""

    def __init__(self, table: LightTable) -> None:
        nodes, profiles = table.profiles.shape
        self.packets = -(-profiles // _PACKET)
        padded = np.zeros((nodes, self.packets * _PACKET), np.float32)
        padded[:, :profiles] = table.profiles
        self.values = mi.Float(padded.ravel())
        self.first_px, self.nodes, self.profiles = table.first_px, nodes, profiles

    def look_up(self, position_px: Any, active: Any) -> list[Any]:
        """Interpolate every profile at a projector coordinate; 0 outside the table."""
        x = (position_px - self.first_px) * OVERSAMPLING
        inside = active & (x >= 0.0) & (x < self.nodes - 1.0)
        node = mi.UInt32(dr.select(inside, x, 0.0))
        upper = x - mi.Float(node)
        lower = 1.0 - upper
        values: list[Any] = []
        for packet in range(self.packets):
            index = dr.fma(node, self.packets, packet)
            a = dr.gather(mi.Vector4f, self.values, index, inside)
            b = dr.gather(mi.Vector4f, self.values, index + self.packets, inside)
            values += [dr.fma(a[i], lower, b[i] * upper) for i in range(_PACKET)]
        return values[: self.profiles]


def trace_stack(
    scene: Any,
    rig: Rig,
    tables: dict[str, LightTable],
    samples: int,
    smooth_within_px: float = SMOOTH_WITHIN_PX,
) -> Frames:
    """Render all frames.

    Parameters
    ----------
    scene : mi.Scene
        World in mm; emitters and sensors in it are ignored.
    rig : Rig
    tables : dict
        Light tables of the axes "column" and "row".
    samples : int
        A square number: camera rays per pixel.
    smooth_within_px : float
        Pixels whose samples lie within this many projector pixels look the light up once.

    Returns
    -------
    tuple of (row, col) float32
        Radiance of each frame in mW / (mm^2 sr).
    """
    width, height = rig.camera.pinhole.width_px, rig.camera.pinhole.height_px
    on_device = {axis: _Table(table) for axis, table in tables.items()}
    order = [k for axis in ("column", "row") for k in tables[axis].frames]
    grid = _Grid(*_pixel_centres(width, height), round(samples**0.5))
    patch = _trace_patches(scene, rig, grid)
    smooth = patch.spread_px <= smooth_within_px
    frames = _frame_values(patch.mean_connection(smooth), on_device)
    frames = _add_samples(
        lambda x_px, y_px: _frame_values(_connect(scene, rig, x_px, y_px), on_device),
        grid,
        ~smooth,
        frames,
    )
    dr.eval(frames)
    dr.sync_thread()
    return _in_sequence(frames, order, (height, width))


@dataclass(frozen=True)
class _Grid:
    """Sub-pixel positions: the centres of side x side cells on every pixel."""

    x_px: Any
    y_px: Any
    side: int

    @property
    def samples(self) -> int:
        return self.side * self.side

    def position(self, sample: Any) -> tuple[Any, Any]:
        row = sample // self.side
        column = sample - row * self.side
        dx, dy = ((mi.Float(index) + 0.5) / self.side - 0.5 for index in (column, row))
        return self.x_px + dx, self.y_px + dy


@dataclass(frozen=True)
class _Patch:
    """What all samples of a pixel see together: weight, weighted position and its extent."""

    weight: Any
    weighted_column: Any
    weighted_row: Any
    lowest: Any
    highest: Any

    @property
    def spread_px(self) -> Any:
        """Largest distance between two lit samples along either projector axis."""
        return dr.maximum(self.highest.x - self.lowest.x, self.highest.y - self.lowest.y)

    def mean_connection(self, active: Any) -> _Connection:
        """One path at the samples' weighted mean position; its weight is their mean weight."""
        lit = active & (self.weight > 0.0)
        scale = dr.select(lit, dr.rcp(self.weight), 0.0)
        column_px, row_px = self.weighted_column * scale, self.weighted_row * scale
        return _Connection(None, column_px, row_px, dr.select(lit, self.weight, 0.0), lit)


def _trace_patches(scene: Any, rig: Rig, grid: _Grid) -> _Patch:
    """Trace all samples and keep sums instead of frames: five numbers per pixel, not 53."""

    def add_sample(*state: Any) -> tuple[Any, ...]:
        sample, weight, column, row, lowest, highest = state
        path = _connect(scene, rig, *grid.position(sample))
        share = path.weight / grid.samples
        place = mi.Point2f(path.column_px, path.row_px)
        return (
            sample + 1,
            weight + share,
            dr.fma(share, path.column_px, column),
            dr.fma(share, path.row_px, row),
            dr.select(path.lit, dr.minimum(lowest, place), lowest),
            dr.select(path.lit, dr.maximum(highest, place), highest),
        )

    nothing = dr.zeros(mi.Float, dr.width(grid.x_px))
    start = (mi.UInt32(0), nothing, nothing, nothing, mi.Point2f(dr.inf), mi.Point2f(-dr.inf))
    end = dr.while_loop(start, lambda sample, *_: sample < grid.samples, add_sample)
    return _Patch(*end[1:])


def _add_samples(
    frame_values: Callable[[Any, Any], list[Any]], grid: _Grid, active: Any, frames: list[Any]
) -> list[Any]:
    """Add every sample by itself where a pixel's samples do not see one smooth patch."""

    def add_sample(*state: Any) -> tuple[Any, ...]:
        sample, *totals = state
        values = frame_values(*grid.position(sample))
        shares = (dr.fma(v, 1.0 / grid.samples, t) for v, t in zip(values, totals, strict=True))
        return (sample + 1, *shares)

    end = dr.while_loop(
        (mi.UInt32(0), *frames),
        lambda sample, *_: active & (sample < grid.samples),
        add_sample,
    )
    return list(end[1:])


def trace_truth(scene: Any, rig: Rig) -> Truth:
    """Trace one ray through every pixel centre and report what it hits."""
    width, height = rig.camera.pinhole.width_px, rig.camera.pinhole.height_px
    path = _connect(scene, rig, *_pixel_centres(width, height))
    lit = path.lit & _on_image(rig, path.column_px, path.row_px, 0.0)
    dr.eval(path.point, path.column_px, path.row_px, lit)
    image = (height, width)
    points = np.stack([np.asarray(axis).reshape(image) for axis in path.point], axis=-1)
    return Truth(
        points_world_mm=points.astype(np.float32),
        column_px=np.array(path.column_px).reshape(image),
        row_px=np.array(path.row_px).reshape(image),
        lit=np.array(lit).reshape(image),
    )


def _pixel_centres(width: int, height: int) -> tuple[Any, Any]:
    index = dr.arange(mi.UInt32, width * height)
    row = index // width
    return mi.Float(index - row * width), mi.Float(row)


def _connect(scene: Any, rig: Rig, x_px: Any, y_px: Any) -> _Connection:
    """Follow a camera ray to the surface and connect the hit to the projector's pinhole."""
    ray = rig.camera.ray(x_px, y_px)
    hit = scene.ray_intersect(ray, mi.RayFlags.All, coherent=True)
    column_px, row_px, axial_mm = rig.projector.project(hit.p)
    to_projector = rig.projector.position_mm - hit.p
    distance_mm = dr.norm(to_projector)
    direction = to_projector / distance_mm
    lit = hit.is_valid() & (axial_mm > 0.0) & _on_image(rig, column_px, row_px, MARGIN_PX)
    lit &= ~_blocked(scene, hit, direction, distance_mm, lit)
    brdf_cos = hit.bsdf(ray).eval(mi.BSDFContext(), hit, hit.to_local(direction), lit)[0]
    # A plane facing the projector receives E1 / z^2; a surface element facing the ray gets
    # 1 / cos(ray, axis) = distance / z more, and its own cosine is in brdf_cos.
    irradiance = rig.irradiance_at_1mm * distance_mm / (axial_mm * axial_mm * axial_mm)
    weight = dr.select(lit, brdf_cos * irradiance, 0.0)
    nothing = ~hit.is_valid()
    point = dr.select(nothing, mi.Point3f(0.0), hit.p)
    return _Connection(
        point,
        dr.select(nothing, 0.0, column_px),
        dr.select(nothing, 0.0, row_px),
        weight,
        lit,
    )


def _on_image(rig: Rig, column_px: Any, row_px: Any, margin_px: float) -> Any:
    """Inside the projector's image, or within the margin into which its blurred edge reaches."""
    pinhole, low = rig.projector.pinhole, -0.5 - margin_px
    return (
        (column_px > low)
        & (column_px < pinhole.width_px - 1 - low)
        & (row_px > low)
        & (row_px < pinhole.height_px - 1 - low)
    )


def _blocked(scene: Any, hit: Any, direction: Any, distance_mm: Any, active: Any) -> Any:
    """Test the shadow ray; surfaces that face away from the projector shade themselves."""
    facing = dr.dot(hit.n, direction)
    start = hit.p + dr.copysign(_SHADOW_OFFSET_MM, facing) * hit.n
    shadow = mi.Ray3f(start, direction)
    shadow.maxt = distance_mm * (1.0 - 1e-4)
    return scene.ray_test(shadow, coherent=True, active=active)


def _frame_values(path: _Connection, tables: dict[str, _Table]) -> list[Any]:
    """Light of every frame on one path; the last profile of each table is the image's outline."""
    *columns, column_outline = tables["column"].look_up(path.column_px, path.lit)
    *rows, row_outline = tables["row"].look_up(path.row_px, path.lit)
    on_columns, on_rows = path.weight * row_outline, path.weight * column_outline
    return [light * on_columns for light in columns] + [light * on_rows for light in rows]


def _in_sequence(frames: list[Any], order: list[int], shape: tuple[int, int]) -> Frames:
    """Sort the frames into the projected sequence, as views: copying costs as much as tracing."""
    images = {k: np.asarray(frame).reshape(shape) for frame, k in zip(frames, order, strict=True)}
    return tuple(images[k] for k in range(len(images)))
