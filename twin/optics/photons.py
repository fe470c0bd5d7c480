"""Photon tracing: light from the projector to the stage, through clear or off polished bodies.

No camera path can be connected to a pinhole through a smooth refracting surface, so this light is
traced in the direction of propagation. Each photon starts at the projector with its pixel (u, v)
and a share of the white image's flux; refractions and reflections follow until it is on the stage.
The camera's paths gather the light that the stage reflects. All frames share the photons: their
noise is common to all frames and cancels in the phase.

For gathering, the flux of each photon is distributed to the four nearest nodes of a regular grid,
with bilinear weights. In every frame, the flux is multiplied by the light of the photon's projector
pixel. The expected value of a camera path is interpolated between the nodes. Distribution and
interpolation together blur by 0.06 mm standard deviation, 0.33 projector pixels of the paper's rig.

The model contains smooth and slightly rough clear bodies, polished metals, absorption and any
number of reflections inside a body. It does not contain light on surfaces other than the stage,
which `Balance` counts as lost.

Two tests check the accuracy. For a clear ball on a stage and a lamp of 3 mm radius 60 mm away,
shadow and caustic agree with stock Mitsuba within 3 % of the caustic. For a pinhole, the view
through the middle of the ball agrees with Snell's law and Fresnel's equations within 0.5 % in the
mean.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np

from reconstruction.arrays import FloatArray, FloatImage
from reconstruction.compiling import Function, compile_and_keep, digest_of_sources
from twin.optics.connection import Rig, box_corners_mm, on_image
from twin.optics.light import MARGIN_PX, OVERSAMPLING, LightTable
from twin.optics.scene import Surfaces

MOST_EVENTS = 64
"""Largest number of reflections and refractions of a photon; flux beyond it counts as `cut`."""

# The kernel allocates an array, therefore not `reconstruction.compiling.OPTIONS`.
_OPTIONS: dict[str, Any] = {"nogil": True, "fastmath": {"contract"}, "error_model": "numpy"}
_SOURCE_DIGEST = digest_of_sources(Path(__file__).parent, ("photons.py",))

# Steps of the R2 sequence (Roberts 2018), the powers of the inverse plastic number, times 2^32.
_R2_STEPS = (3242174889, 2447445414)


def _compiled(function: Function) -> Function:
    return compile_and_keep(function, _OPTIONS, _SOURCE_DIGEST)


@dataclass(frozen=True)
class Balance:
    """Destinations of the flux (mW, white image) first incident on clear or polished bodies.

    Attributes
    ----------
    sent : sum of all destinations
    absorbed : absorbed in or at clear or polished bodies
    deposited : incident on the stage
    escaped : out of the scene
    lost : incident on other bodies, except the stage
    cut : flux of photons that did not end within `MOST_EVENTS` reflections and refractions
    """

    sent: float
    absorbed: float
    deposited: float
    escaped: float
    lost: float
    cut: float


@dataclass(frozen=True, eq=False)
class Photons:
    """Photons that ended on the stage.

    Attributes
    ----------
    x_mm, y_mm : (photon,) float32; world position
    column_px, row_px : (photon,) float32; projector pixel of each photon
    flux_mw : (photon,) float32; flux of each photon in the white image
    balance : flux of all photons by destination
    """

    x_mm: FloatImage
    y_mm: FloatImage
    column_px: FloatImage
    row_px: FloatImage
    flux_mw: FloatImage
    balance: Balance


@dataclass(frozen=True)
class _Ends:
    """State of every photon at the end of its path, as Dr.Jit variables with one lane per photon.

    `weight` and `absorbed` are shares of the photon's initial flux.
    """

    point_mm: Any
    weight: Any
    absorbed: Any
    met_sharp: Any
    on_stage: Any
    missed: Any
    under_way: Any


def trace_photons(scene: Any, surfaces: Surfaces, rig: Rig, *, count: int, seed: int) -> Photons:
    """Trace photons from the projector; return those that end on the stage.

    Parameters
    ----------
    scene : world in mm; its stage must be horizontal
    count : number of photons sent towards the bounding boxes of the sharp bodies
    seed : seed of the random numbers
    """
    low, high = _window(surfaces, rig)
    rotation = rig.projector.T_world_from_device[:3, :3]
    right, down, forward = (mi.Vector3f(*axis) for axis in rotation.T.tolist())
    x, y = _spread(count, low, high, seed)
    ray: Any = mi.Ray3f(rig.projector.position_mm, dr.normalize(x * right + y * down + forward))
    column_px, row_px, _ = rig.projector.project(ray.o + ray.d)
    ends = _follow(scene, surfaces, ray, seed)
    # The density is uniform over the image plane at 1 mm, as the white image's irradiance is.
    flux_mw = rig.irradiance_at_1mm * float(np.prod(high - low)) / count
    counted = ends.met_sharp & on_image(rig, column_px, row_px, MARGIN_PX)
    on_stage: Any = dr.compress(counted & ends.on_stage)

    def chosen(values: Any) -> FloatImage:
        return np.array(dr.gather(mi.Float, values, on_stage))

    return Photons(
        chosen(ends.point_mm.x),
        chosen(ends.point_mm.y),
        chosen(column_px),
        chosen(row_px),
        chosen(ends.weight) * np.float32(flux_mw),
        _balance(ends, counted, flux_mw),
    )


def _window(surfaces: Surfaces, rig: Rig) -> tuple[FloatArray, FloatArray]:
    """Return the corners (low, high) of the rectangle into which photons are sent.

    The rectangle is on the projector's image plane at 1 mm axial distance, x and y in mm. It
    contains the bounding boxes of all sharp bodies, as far as they are in the image.
    """
    corners = np.concatenate([box_corners_mm(body.shape.bbox()) for body in surfaces.sharp])
    T = rig.projector.T_world_from_device
    in_device = (corners - T[:3, 3]) @ T[:3, :3]
    on_plane = in_device[:, :2] / in_device[:, 2:]
    image = rig.projector.pinhole.unproject(_image_border(rig))
    low = np.maximum(on_plane.min(axis=0), image.min(axis=0))
    high = np.minimum(on_plane.max(axis=0), image.max(axis=0))
    return low, np.maximum(low, high)


def _image_border(rig: Rig) -> FloatArray:
    """Return points (n, 2) along the outer border of the projector's image with its margin, px."""
    p, along = rig.projector.pinhole, np.linspace(0.0, 1.0, 33)
    low, end = -0.5 - MARGIN_PX, MARGIN_PX - 0.5
    x, y = low + along * (p.width_px + end - low), low + along * (p.height_px + end - low)
    sides = [(x, 0 * x + y[0]), (x, 0 * x + y[-1]), (0 * y + x[0], y), (0 * y + x[-1], y)]
    return np.concatenate([np.stack(side, axis=-1) for side in sides])


def _spread(count: int, low: Any, high: Any, seed: int) -> tuple[Any, Any]:
    """Return x and y of `count` points, evenly distributed over the rectangle from low to high.

    The points are the R2 sequence, shifted by a random offset that depends on the seed.
    """
    index = dr.arange(mi.UInt32, count)
    shifts = np.random.default_rng(seed).integers(0, 2**32, 2)
    unit = [
        mi.Float((index * mi.UInt32(step) + dr.opaque(mi.UInt32, int(shift))) >> 8) * 2.0**-24
        for step, shift in zip(_R2_STEPS, shifts, strict=True)
    ]
    x, y = (dr.fma(u, float(b - a), float(a)) for u, a, b in zip(unit, low, high, strict=True))
    return x, y


def _follow(scene: Any, surfaces: Surfaces, ray: Any, seed: int) -> _Ends:
    """Trace every photon until it reaches the stage, a matte body or the outside of the scene."""
    width = dr.width(ray.d)
    context = mi.BSDFContext(mi.TransportMode.Importance)
    random = random_streams(width, seed)

    def next_event(*state: Any) -> tuple[Any, ...]:
        _, event, ray, point, weight, absorbed, inside, _, _, rng = state
        hit = scene.ray_intersect(ray)
        sharp = surfaces.is_sharp(hit)
        arrived = weight * surfaces.transmittance(hit, inside & sharp)
        sample, share = hit.bsdf(ray).sample(
            context,
            hit,
            rng.next_float32(),
            mi.Point2f(rng.next_float32(), rng.next_float32()),
            sharp,
        )
        goes_on = sharp & (share[0] > 0.0)
        left = dr.select(sharp, arrived * share[0], arrived)
        through = mi.has_flag(sample.sampled_type, mi.BSDFFlags.Transmission)
        return (
            goes_on,
            event + 1,
            hit.spawn_ray(hit.to_world(sample.wo)),
            dr.select(hit.is_valid(), hit.p, point),
            left,
            absorbed + weight - left,
            inside ^ (goes_on & through),
            surfaces.on_stage(hit),
            ~hit.is_valid(),
            rng,
        )

    start = (
        dr.full(mi.Bool, True, width),
        dr.zeros(mi.UInt32, width),
        ray,
        dr.zeros(mi.Point3f, width),
        dr.ones(mi.Float, width),
        dr.zeros(mi.Float, width),
        *(dr.full(mi.Bool, False, width) for _ in range(3)),
        random,
    )
    end = dr.while_loop(
        start, lambda under_way, event, *_: under_way & (event < MOST_EVENTS), next_event
    )
    under_way, event, _, point, weight, absorbed, _, on_stage, missed, _ = end
    dr.eval(under_way, event, point, weight, absorbed, on_stage, missed)
    met_sharp = under_way | (event > 1)
    return _Ends(point, weight, absorbed, met_sharp, on_stage, missed, under_way)


def random_streams(width: int, seed: int) -> Any:
    """Return a random number generator with an independent stream in each of `width` lanes."""
    # Opaque: a literal seed would compile a new kernel.
    generator: Any = mi.PCG32
    return generator(
        size=width,
        initstate=dr.opaque(mi.UInt64, seed),
        initseq=dr.arange(mi.UInt64, width),
    )


def _balance(ends: _Ends, counted: Any, flux_mw: float) -> Balance:
    def flux(values: Any, where: Any) -> float:
        # in double precision: a float32 sum of millions of photons has four good digits
        return flux_mw * float(np.array(dr.select(where, values, 0.0)).sum(dtype=np.float64))

    rest = counted & ~ends.on_stage & ~ends.missed & ~ends.under_way
    return Balance(
        sent=flux(1.0, counted),
        absorbed=flux(ends.absorbed, counted),
        deposited=flux(ends.weight, counted & ends.on_stage),
        escaped=flux(ends.weight, counted & ends.missed),
        lost=flux(ends.weight, rest),
        cut=flux(ends.weight, counted & ends.under_way),
    )


PITCH_MM = 0.1
_PACKET = 4


@dataclass(frozen=True, eq=False)
class IrradianceMap:
    """Irradiance of the stage in every frame, computed from photons, on a regular grid of nodes.

    Attributes
    ----------
    irradiance : (row, col, frame) float32, mW/mm^2; frames of the column table, then frames of the
        row table; padded with zeros to a multiple of four frames
    first_x_mm, first_y_mm : world position of node (0, 0); x increases with column, y with row
    pitch_mm : distance of neighbouring nodes
    frames : number of entries of the last axis without padding
    """

    irradiance: FloatImage
    first_x_mm: float
    first_y_mm: float
    pitch_mm: float
    frames: int

    def flux_mw(self, frame: int) -> float:
        """Return the flux of one frame on the whole map, mW."""
        total = self.irradiance[:, :, frame].sum(dtype=np.float64)
        return float(total) * self.pitch_mm**2


class _Places(NamedTuple):
    """Positions of photons in nodes of the map (x, y) and of the light tables (column, row).

    `density` is the flux of a photon per area of a node of the map, mW/mm^2.
    """

    x: FloatImage
    y: FloatImage
    column: FloatImage
    row: FloatImage
    density: FloatImage


def map_photons(photons: Photons, tables: dict[str, LightTable]) -> IrradianceMap:
    """Return the irradiance of the stage in every frame, summed over all photons."""
    columns, rows = tables["column"], tables["row"]
    frames = len(columns.frames) + len(rows.frames)
    padded = -(-frames // _PACKET) * _PACKET
    x, first_x_mm, cols = _node_coordinates(photons.x_mm)
    y, first_y_mm, lines = _node_coordinates(photons.y_mm)
    irradiance = np.zeros((lines, cols, padded), np.float32)
    places = _Places(
        x,
        y,
        _table_coordinates(photons.column_px, columns),
        _table_coordinates(photons.row_px, rows),
        photons.flux_mw / np.float32(PITCH_MM**2),
    )
    _deposit(places, columns.profiles, rows.profiles, irradiance)
    return IrradianceMap(irradiance, first_x_mm, first_y_mm, PITCH_MM, frames)


def _node_coordinates(position_mm: FloatImage) -> tuple[FloatImage, float, int]:
    """Return positions in node units, the first node's position (mm) and the number of nodes."""
    if position_mm.size == 0:
        return position_mm, 0.0, 2
    first = np.floor(float(position_mm.min()) / PITCH_MM)
    coordinate = position_mm.astype(np.float64) / PITCH_MM - first
    return coordinate.astype(np.float32), float(first * PITCH_MM), int(coordinate.max()) + 2


def _table_coordinates(position_px: FloatImage, table: LightTable) -> FloatImage:
    x = (position_px - np.float32(table.first_px)) * np.float32(OVERSAMPLING)
    return np.asarray(np.clip(x, 0.0, len(table.profiles) - 1.001), np.float32)


@_compiled
def _deposit(
    places: _Places,
    column_profiles: FloatImage,
    row_profiles: FloatImage,
    irradiance: FloatImage,
) -> None:
    """Add the light of every photon in every frame to the four nearest nodes of `irradiance`."""
    x, y, column, row, density = places
    on_columns, on_rows = column_profiles.shape[1] - 1, row_profiles.shape[1] - 1
    frames = on_columns + on_rows
    light = np.zeros(frames, np.float32)
    for photon in range(x.size):
        i, j = int(x[photon]), int(y[photon])
        right, up = x[photon] - np.float32(i), y[photon] - np.float32(j)
        a, b = int(column[photon]), int(row[photon])
        at_a, at_b = column[photon] - np.float32(a), row[photon] - np.float32(b)
        left_a, left_b = column_profiles[a], row_profiles[b]
        right_a, right_b = column_profiles[a + 1], row_profiles[b + 1]
        edge_a = left_a[on_columns] + at_a * (right_a[on_columns] - left_a[on_columns])
        edge_b = left_b[on_rows] + at_b * (right_b[on_rows] - left_b[on_rows])
        for k in range(on_columns):
            light[k] = edge_b * (left_a[k] + at_a * (right_a[k] - left_a[k]))
        for k in range(on_rows):
            light[on_columns + k] = edge_a * (left_b[k] + at_b * (right_b[k] - left_b[k]))
        for dj in range(2):
            along = density[photon] * (up if dj else np.float32(1.0) - up)
            for di in range(2):
                share = along * (right if di else np.float32(1.0) - right)
                node = irradiance[j + dj, i + di]
                for k in range(frames):
                    node[k] += share * light[k]


class StageLight:
    """An irradiance map of the stage on the computing device."""

    def __init__(self, received: IrradianceMap) -> None:
        rows, cols, padded = received.irradiance.shape
        self._values = mi.Float(received.irradiance.ravel())
        self._rows, self._cols, self._packets = rows, cols, padded // _PACKET
        self._map = received

    def values(
        self, x_mm: Any, y_mm: Any, weight: Any, active: Any, random: tuple[Any, Any]
    ) -> list[Any]:
        """Return the irradiance (mW/mm^2) of every frame at points on the stage, times `weight`.

        One of the four nodes around a point is drawn, with its bilinear weight as probability. The
        expected value equals bilinear interpolation, but only a quarter of the memory is read.

        Parameters
        ----------
        random : two random numbers in [0, 1)
        """
        x = (x_mm - self._map.first_x_mm) / self._map.pitch_mm
        y = (y_mm - self._map.first_y_mm) / self._map.pitch_mm
        inside = active & (x >= 0.0) & (y >= 0.0) & (x < self._cols - 1) & (y < self._rows - 1)
        i, j = (
            mi.UInt32(dr.select(inside, place + shift, 0.0))
            for place, shift in zip((x, y), random, strict=True)
        )
        first = dr.fma(j, self._cols, i) * self._packets
        weight = dr.select(inside, weight, 0.0)
        values: list[Any] = []
        for packet in range(self._packets):
            packet_values = dr.gather(mi.Vector4f, self._values, first + packet, inside)
            values += [packet_values[k] * weight for k in range(_PACKET)]
        return values[: self._map.frames]
