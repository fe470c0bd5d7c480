"""Connection of a ray's hit point to the projector, which adds the projector's light to the frames.

A path that ends on the projector pixel (u, v) with weight w adds w * P_k(u, v) to every frame k.
`FrameLight` looks up P_k in the light tables, inside a kernel. `axial_range_mm` returns the range
of distances from the projector, for which the light tables need the blur.
"""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import drjit as dr
import mitsuba as mi
import numpy as np

from reconstruction.arrays import BoolImage, FloatArray, FloatImage, IntArray
from reconstruction.errors import InputError
from twin.optics.devices import Device, kernel_number
from twin.optics.heights import MarchedHeights
from twin.optics.layers import Arrival, LayerStack
from twin.optics.light import LEAST_VARIANCE_PX2, MARGIN_PX, OVERSAMPLING, BlurLevels, LightTable
from twin.optics.stack import Truth

if TYPE_CHECKING:
    from twin.optics.printed_dots import PrintedDots

# Shadow rays start at this distance from the surface along its normal: 50 x the float32 resolution
# of a point 250 mm away, 1/40 of the smallest mesh pitch.
_SHADOW_OFFSET_MM = 1e-3


@dataclass(frozen=True)
class Rig:
    """Inputs that all camera paths share.

    Attributes
    ----------
    irradiance_at_1mm : irradiance of a white field at 1 mm along the projector's axis, mW/mm^2
    layers : clear layers that refract the rays of both devices; None: air
    shadows : False if the scene provably casts no shadows; then no shadow rays are traced
    heights : the sheet, if it is the whole scene; then camera rays and shadow rays are marched over
        its grid. None: rays are intersected by the scene's tree
    dots : dots printed on the coat, if the scene has no other surface; None: none are printed
    """

    camera: Device
    projector: Device
    irradiance_at_1mm: float
    layers: LayerStack | None = None
    shadows: bool = True
    heights: MarchedHeights | None = None
    dots: "PrintedDots | None" = None

    def inked(self, value: Any, point_mm: Any) -> Any:
        """Return a reflectance, or light reflected at surface points, with the printed dots."""
        return value if self.dots is None else value * self.dots.factor(point_mm)


@dataclass(frozen=True)
class Connection:
    """A surface point connected to the projector: its projector pixel and its weight.

    `weight` is the radiance towards the camera in white light, mW / (mm^2 sr), and 0 where `lit` is
    False. `axial_mm` is the distance along the projector's axis, which determines the defocus.
    """

    column_px: Any
    row_px: Any
    weight: Any
    lit: Any
    axial_mm: Any


def connect(scene: Any, rig: Rig, hit: Any, bsdf: Any, coherent: bool = True) -> Connection:
    """Connect hit points to the projector's pinhole; the weight of occluded points is 0.

    Parameters
    ----------
    hit : surface interaction; where it is not valid, the weight is 0
    bsdf : BSDF of the hit surface
    coherent : True if neighbouring lanes have similar shadow rays
    """
    light = _arrive(rig, hit.p)
    column_px, row_px = light.column_px, light.row_px
    lit = hit.is_valid() & (light.axial_mm > 0.0) & on_image(rig, column_px, row_px, MARGIN_PX)
    if rig.shadows:
        to_light = light.direction, light.clear_mm
        lit &= ~shaded(scene, rig.heights, hit, to_light, lit, coherent=coherent)
    brdf_cos = bsdf.eval(mi.BSDFContext(), hit, hit.to_local(light.direction), lit)[0]
    weight = rig.inked(dr.select(lit, brdf_cos * light.irradiance, 0.0), hit.p)
    missed = ~hit.is_valid()
    column_px, row_px, axial_mm = (
        dr.select(missed, 0.0, value) for value in (column_px, row_px, light.axial_mm)
    )
    return Connection(column_px, row_px, weight, lit, axial_mm)


def see(scene: Any, rig: Rig, ray: Any) -> tuple[Any, Connection]:
    """Follow a camera ray to the surface; return the hit and its connection to the projector."""
    sight = None if rig.layers is None else rig.layers.refract(ray)
    ray = ray if sight is None else sight.ray
    hit = first_hit(scene, rig.heights, ray)
    path = connect(scene, rig, hit, hit.bsdf(ray))
    if sight is not None:
        path = replace(path, weight=path.weight * sight.transmission(hit.t))
    return hit, path


def first_hit(scene: Any, heights: MarchedHeights | None, ray: Any) -> Any:
    """Return the first intersection of each ray with the scene, a surface interaction.

    Parameters
    ----------
    heights : the sheet, if it is the whole scene: rays are marched over its grid; None: rays are
        intersected by the scene's tree
    """
    if heights is not None:
        # The facet has no derivative; that of the hit point follows from the facet.
        with dr.scoped_set_flag(dr.JitFlag.SymbolicLoops, True):
            met = heights.first_hit(scene.shape, dr.detach(ray))
        return met.compute_surface_interaction(ray, mi.RayFlags.All)
    # Not as packets: neighbouring pixels hit different facets. Embree's single rays take 0.5 x the
    # time on a face of 2.4 M facets (1.17 x on a face of 6000, which is fast in either mode).
    return scene.ray_intersect(ray, mi.RayFlags.All, coherent=False)


def _arrive(rig: Rig, point_mm: Any) -> Arrival:
    """Return the projector's light at a point, along a straight line or through the layers."""
    irradiance_at_1mm = kernel_number(rig.irradiance_at_1mm)
    if rig.layers is not None:
        return rig.layers.arrive(rig.projector, irradiance_at_1mm, point_mm)
    column_px, row_px, axial_mm = rig.projector.project(point_mm)
    to_projector = rig.projector.position_mm - point_mm
    distance_mm = dr.norm(to_projector)
    return Arrival(
        column_px=column_px,
        row_px=row_px,
        axial_mm=axial_mm,
        direction=to_projector / distance_mm,
        clear_mm=distance_mm,
        # A plane facing the projector receives E1 / z^2; a surface element facing the ray gets
        # 1 / cos(ray, axis) = distance / z more; its own cosine is in the BSDF.
        irradiance=irradiance_at_1mm * distance_mm / (axial_mm * axial_mm * axial_mm),
    )


def direction_to(rig: Rig, device: Device, point_mm: Any) -> Any:
    """Return the unit vectors from points to a device, in the medium around the points."""
    if rig.layers is not None:
        return rig.layers.arrive(device, 1.0, point_mm).direction
    return dr.normalize(device.position_mm - point_mm)


def on_image(rig: Rig, column_px: Any, row_px: Any, margin_px: float) -> Any:
    """Return True for coordinates on the projector's image, or at most `margin_px` outside it."""
    pinhole, low = rig.projector.pinhole, -0.5 - margin_px
    return (
        (column_px > low)
        & (column_px < pinhole.width_px - 1 - low)
        & (row_px > low)
        & (row_px < pinhole.height_px - 1 - low)
    )


def shaded(
    scene: Any,
    heights: MarchedHeights | None,
    hit: Any,
    to_light: tuple[Any, Any],
    active: Any,
    *,
    coherent: bool,
) -> Any:
    """Return True for the hits that another surface shades, `mi.Bool`.

    Parameters
    ----------
    heights : as in `first_hit`
    to_light : direction to the light (unit vector), and distance within which surfaces cast
        shadows, mm
    active : lanes to be tested
    coherent : True if neighbouring lanes have similar shadow rays
    """
    direction, distance_mm = to_light
    shadow = shadow_ray(hit, direction, distance_mm)
    if heights is None:
        return scene.ray_test(shadow, coherent=coherent, active=active)
    with dr.scoped_set_flag(dr.JitFlag.SymbolicLoops, True):
        free = heights.is_free(dr.detach(hit.p), dr.detach(direction), active)
        return heights.is_crossed(dr.detach(shadow), active & ~free)


def shadow_ray(hit: Any, direction: Any, distance_mm: Any) -> Any:
    """Return the shadow ray from a hit towards a light.

    The ray starts on the side of the surface that faces the light. The surfaces of a closed body
    that face away from the light are therefore in the shadow of the body.
    """
    facing = dr.dot(hit.n, direction)
    start = hit.p + dr.copysign(_SHADOW_OFFSET_MM, facing) * hit.n
    shadow = mi.Ray3f(start, direction)
    shadow.maxt = distance_mm * (1.0 - 1e-4)
    return shadow


def truth_of(
    camera: Device, hit: Any, projector_px: tuple[Any, Any], lit: Any, measured: Any
) -> Truth:
    """Return the hits of the rays through all pixel centres of a camera as images, see `Truth`."""
    image, valid = (camera.pinhole.height_px, camera.pinhole.width_px), hit.is_valid()
    point, normal = (dr.select(valid, value, 0.0) for value in (hit.p, hit.sh_frame.n))
    depth_mm = dr.select(valid, camera.project(hit.p)[2], 0.0)
    dr.eval(point, normal, depth_mm, *projector_px, lit, measured)
    points, normals = (
        np.stack([np.asarray(axis).reshape(image) for axis in value], axis=-1)
        for value in (point, normal)
    )
    values = (depth_mm, *projector_px, lit, measured)
    return Truth(points, normals, *(np.array(value).reshape(image) for value in values))


def axial_range_mm(scene: Any, rig: Rig) -> tuple[float, float]:
    """Return the smallest and largest distance of a scene along the projector's axis, mm.

    The distances are those of the corners of the scene's bounding box.

    Parameters
    ----------
    rig : its layers make points appear nearer, but never above the highest face of the layers

    Raises
    ------
    InputError : the scene reaches behind the projector
    """
    corners = box_corners_mm(scene.bbox())
    if rig.layers is not None:
        raised = corners.copy()
        raised[:, 2] = np.maximum(raised[:, 2], max(medium.top_mm for medium in rig.layers.media))
        corners = np.concatenate([corners, raised])
    T_world_from_proj = rig.projector.T_world_from_device
    axial_mm = (corners - T_world_from_proj[:3, 3]) @ T_world_from_proj[:3, 2]
    if axial_mm.min() <= 0.0:
        raise InputError(
            f"projector.pose.standoff_mm: the scene reaches {-axial_mm.min():.3g} mm behind the "
            "projector along its axis, where it emits no light; allowed: a scene in front of it; "
            "enlarge the standoff, or make stage.size_mm or the elastomer smaller"
        )
    return float(axial_mm.min()), float(axial_mm.max())


def box_corners_mm(box: Any) -> FloatArray:
    """Return the eight corners of a `mi.BoundingBox3f`, (corner, xyz), mm."""
    low, high = np.array(box.min, np.float64).ravel(), np.array(box.max, np.float64).ravel()
    return np.where(np.array(list(np.ndindex(2, 2, 2))), high, low)


_PACKET = 4


class FrameLight:
    """The light tables of both projector axes, on the computing device."""

    def __init__(self, tables: dict[str, LightTable]) -> None:
        self._columns, self._rows = _on_device(tables["column"]), _on_device(tables["row"])
        #: True if the blur depends on the distance, which paths then have to carry
        self.defocused = tables["column"].levels is not None
        #: index of each value that `values` returns in the projected sequence
        self.sequence = [*tables["column"].frames, *tables["row"].frames]

    def values(self, path: Connection) -> list[Any]:
        """Return the radiance that one path adds to each frame, in the order of `sequence`."""
        # The last profile of each table is the image's blurred outline.
        *columns, column_outline = self._columns.look_up(path.column_px, path.axial_mm, path.lit)
        *rows, row_outline = self._rows.look_up(path.row_px, path.axial_mm, path.lit)
        on_columns, on_rows = path.weight * row_outline, path.weight * column_outline
        return [light * on_columns for light in columns] + [light * on_rows for light in rows]

    def value(self, path: Connection, frames: "int | IntArray") -> Any:
        """Return the radiance that each path adds to one frame, by its number in the sequence.

        Parameters
        ----------
        frames : frame of all paths, or of successive paths, repeated until the last path. They are
            data of the kernel: one kernel computes all frames along an axis
        """
        numbers = np.atleast_1d(frames)
        along = self.is_along_columns(numbers)
        columns, rows = self._columns, self._rows
        if along.all():
            light = self._in_frames(path, numbers, columns) * self._outline(path, rows)
        elif not along.any():
            light = self._in_frames(path, numbers, rows) * self._outline(path, columns)
        else:
            on_columns = dr.tile(mi.Bool(along), dr.width(path.weight) // len(along))
            first, second = (replace(path, lit=path.lit & of) for of in (on_columns, ~on_columns))
            light = dr.select(
                on_columns,
                self._in_frames(first, numbers, columns) * self._outline(first, rows),
                self._in_frames(second, numbers, rows) * self._outline(second, columns),
            )
        return path.weight * light

    def relative(self, path: Connection, frame: int) -> Any:
        """Return the light of one frame relative to white, without the image's outline across."""
        numbers = np.atleast_1d(frame)
        own = self._columns if self.is_along_columns(numbers)[0] else self._rows
        return self._in_frames(path, numbers, own)

    def outlines(self, path: Connection) -> tuple[Any, Any]:
        """Return the image's outline across the frames along columns, and across those by row."""
        return self._outline(path, self._rows), self._outline(path, self._columns)

    def _in_frames(self, path: Connection, frames: IntArray, table: "_LookUpTable") -> Any:
        # The frames of a table ascend. Opaque: a number is no literal of the kernel's code.
        shown = np.searchsorted(table.frames, frames).astype(np.uint32)
        each = dr.opaque(mi.UInt32, int(shown[0]))
        if len(shown) > 1:
            each = dr.tile(mi.UInt32(shown), dr.width(path.weight) // len(shown))
        return self._profile(path, each, table)

    def _outline(self, path: Connection, table: "_LookUpTable") -> Any:
        return self._profile(path, dr.opaque(mi.UInt32, table.profiles - 1), table)

    def _profile(self, path: Connection, profile: Any, table: "_LookUpTable") -> Any:
        place = path.column_px if table is self._columns else path.row_px
        return table.profile_at(profile, place, path.axial_mm, path.lit)

    def is_along_columns(self, frames: IntArray) -> BoolImage:
        """Return True for frames (frame,) in the table of columns: uniform ones, or by column."""
        return np.isin(frames, self._columns.frames)


def _on_device(table: LightTable) -> "_LookUpTable":
    return _LookUpTable(table) if table.levels is None else _DefocusedTable(table, table.levels)


class _LookUpTable:
    """A light table on the computing device; each node has a row with the values of all profiles.

    Rows are padded with zeros to whole packets of four values, which are read together.
    """

    def __init__(self, table: LightTable) -> None:
        self.nodes, self.profiles = table.profiles.shape
        self.first_px, self.packets = table.first_px, -(-self.profiles // _PACKET)
        self.frames = table.frames
        self.values = self._padded(table.profiles)

    def _padded(self, profiles: FloatImage) -> Any:
        padded = np.zeros((*profiles.shape[:-1], self.packets * _PACKET), np.float32)
        padded[..., : self.profiles] = profiles
        return _aligned(padded.ravel())

    def look_up(self, position_px: Any, _axial_mm: Any, active: Any) -> list[Any]:
        """Return every profile at a projector coordinate, interpolated; 0 outside the table."""
        node, upper, inside = self._between_nodes(position_px, active)
        lower = 1.0 - upper
        values: list[Any] = []
        for packet in range(self.packets):
            index = dr.fma(node, self.packets, packet)
            a = dr.gather(mi.Vector4f, self.values, index, inside)
            b = dr.gather(mi.Vector4f, self.values, index + self.packets, inside)
            values += [dr.fma(a[i], lower, b[i] * upper) for i in range(_PACKET)]
        return values[: self.profiles]

    def profile_at(self, profile: Any, position_px: Any, _axial_mm: Any, active: Any) -> Any:
        """Return one profile at a projector coordinate, interpolated; 0 outside the table."""
        node, upper, inside = self._between_nodes(position_px, active)
        return self._along_nodes(node, upper, inside, profile)

    def _along_nodes(self, row: Any, upper: Any, inside: Any, profile: Any) -> Any:
        """Return a profile between a row of the padded values and the next one."""
        width = self.packets * _PACKET
        index = dr.fma(row, width, profile)
        a, b = (dr.gather(mi.Float, self.values, at, inside) for at in (index, index + width))
        return dr.lerp(a, b, upper)

    def _between_nodes(self, position_px: Any, active: Any) -> tuple[Any, Any, Any]:
        """Return the lower node, the weight of the upper node, and True inside the table."""
        x = (position_px - self.first_px) * OVERSAMPLING
        inside = active & (x >= 0.0) & (x < self.nodes - 1.0)
        node = mi.UInt32(dr.select(inside, x, 0.0))
        return node, x - mi.Float(node), inside


def _aligned(values: FloatImage) -> Any:
    """Return numbers as `mi.Float` in memory of Dr.Jit, which is aligned to whole packets.

    NumPy's memory is aligned by chance. In other memory Dr.Jit reads the numbers of a packet one by
    one, with another kernel.
    """
    copied = dr.zeros(mi.Float, values.size)
    dr.scatter(copied, mi.Float(values), dr.arange(mi.UInt32, values.size))
    return copied


class _DefocusedTable(_LookUpTable):
    """Light tables at several blurs, interpolated at the blur of each path's distance."""

    def __init__(self, table: LightTable, levels: BlurLevels) -> None:
        super().__init__(table)
        self.levels = levels
        self.values = self._padded(np.asarray(table.defocused))

    def look_up(self, position_px: Any, axial_mm: Any, active: Any) -> list[Any]:
        """Return every profile at a projector coordinate and axial distance, interpolated.

        The values are 0 outside the table.
        """
        node, upper, inside = self._between_nodes(position_px, active)
        level, blurred = self._between_levels(axial_mm, inside)
        next_level = self.nodes * self.packets
        first = dr.fma(level, self.nodes, node)
        values: list[Any] = []
        for packet in range(self.packets):
            index = dr.fma(first, self.packets, packet)
            corners = (index, index + self.packets)
            a, b = (dr.gather(mi.Vector4f, self.values, at, inside) for at in corners)
            c, d = (dr.gather(mi.Vector4f, self.values, at + next_level, inside) for at in corners)
            packet_values = dr.lerp(dr.lerp(a, b, upper), dr.lerp(c, d, upper), blurred)
            values += [packet_values[i] for i in range(_PACKET)]
        return values[: self.profiles]

    def profile_at(self, profile: Any, position_px: Any, axial_mm: Any, active: Any) -> Any:
        """Return one profile at a projector coordinate and axial distance; 0 outside the table."""
        node, upper, inside = self._between_nodes(position_px, active)
        level, blurred = self._between_levels(axial_mm, inside)
        lower, higher = (
            self._along_nodes(dr.fma(at, self.nodes, node), upper, inside, profile)
            for at in (level, level + 1)
        )
        return dr.lerp(lower, higher, blurred)

    def _between_levels(self, axial_mm: Any, active: Any) -> tuple[Any, Any]:
        """Return the lower blur level at an axial distance, and the weight of the next level."""
        variance_px2 = dr.select(active, self.levels.defocus.variance_px2(axial_mm), 1.0)
        variance_px2 = dr.maximum(variance_px2, LEAST_VARIANCE_PX2)
        level = (dr.log(variance_px2) - self.levels.first_log) / self.levels.step_log()
        level = dr.clip(level, 0.0, self.levels.count - 1.0)
        lower = dr.minimum(mi.UInt32(level), self.levels.count - 2)
        return lower, level - mi.Float(lower)
