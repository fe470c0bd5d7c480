"""Light between surfaces: from coat to coat, between specimen and stage, through clear bodies.

Each camera ray is continued by BSDF sampling. Which light is added where depends on the surface
that the projector lit first on the way, so that every way is counted once:

- a matte or rough one: the camera path is connected to the projector when it gets there;
- a sharp one (clear or polished), and later the stage: photons brought that light to the stage,
  the camera path gathers it there;
- sharp ones only, all the way to the camera: connected, as far as the camera path met no other.

The random numbers are the same for all frames, so their noise shifts a pixel's phase a little but
never differs from frame to frame.

Left out: highlights of perfectly smooth bodies (between two pinholes they have no width), and light
that sharp bodies throw on other surfaces than the stage.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from itertools import pairwise
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from twin.optics.connection import Connection, FrameLight, Rig, connect
from twin.optics.devices import SubPixels
from twin.optics.photons import StageLight, random_streams
from twin.optics.scene import Surfaces

LAUNCHES = 8

MOST_SHARP = 24
"""Reflections and refractions at sharp bodies that a camera path may go through."""


@dataclass(frozen=True)
class Bounces:
    """How much indirect light is traced.

    Attributes
    ----------
    most : largest number of reflections after the first; 1 is light reflected twice. Sharp bodies
        do not count.
    paths : random continuations per camera sample
    stage_light : what photons brought to the stage
    """

    most: int
    paths: int
    seed: int
    surfaces: Surfaces = field(default_factory=Surfaces)
    stage_light: StageLight | None = None


def add_bounces(
    scene: Any,
    rig: Rig,
    light: FrameLight,
    grid: SubPixels,
    *,
    bounces: Bounces,
    frames: list[Any],
    progress: Callable[[float], None] = lambda _: None,
) -> list[Any]:
    """Return `frames` plus the light of two and more reflections; same units.

    One loop runs over all path segments of all samples: after the last bounce, or when a path
    leaves the scene, the lane starts its next sample. The walks are done in a few launches of one
    kernel, between which `progress` is told the finished fraction.
    """
    walks, width = grid.samples * bounces.paths, dr.width(grid.x_px)
    next_segment = _next_segment(scene, rig, light, grid, bounces)
    random = random_streams(width, bounces.seed)
    limits = np.linspace(0, walks, min(walks, LAUNCHES) + 1).astype(int).tolist()
    for first, last in pairwise(limits):
        # Opaque: a literal would make every launch a kernel of its own.
        begin, stop = dr.opaque(mi.UInt32, first, width), dr.opaque(mi.UInt32, last)
        start = (
            begin,
            *(dr.zeros(mi.UInt32, width) for _ in range(2)),
            dr.full(mi.Bool, False, width),
            dr.zeros(mi.Ray3f, width),
            dr.ones(mi.Float, width),
            random,
            *frames,
        )
        end = dr.while_loop(start, lambda walk, *_, stop=stop: walk < stop, next_segment)
        random, frames = end[6], list(end[7:])
        dr.eval(random, frames)
        progress(last / walks)
    return frames


def _next_segment(
    scene: Any, rig: Rig, light: FrameLight, grid: SubPixels, bounces: Bounces
) -> Callable[..., tuple[Any, ...]]:
    """Return the body of the loop: it follows each lane's path by one segment."""
    walks, surfaces = grid.samples * bounces.paths, bounces.surfaces

    def next_segment(*state: Any) -> tuple[Any, ...]:
        walk, matte, events, inside, ray, throughput, rng, *sums = state
        fresh = events == 0
        ray = dr.select(fresh, grid.ray(rig.camera, walk // bounces.paths), ray)
        hit = scene.ray_intersect(ray)
        bsdf = hit.bsdf(ray)
        sharp = surfaces.is_sharp(hit)
        throughput = dr.select(fresh, 1.0, throughput)
        throughput *= surfaces.transmittance(hit, inside & sharp)
        # The first surface's own light is the direct part, rendered without noise.
        connects = ~fresh & (~sharp | (matte == 0))
        path = connect(scene, rig, hit, bsdf, coherent=False)
        sums = _add_connected(sums, light, path, throughput / walks, connects)
        if bounces.stage_light is not None:
            on_stage = surfaces.on_stage(hit)
            share = throughput * bsdf.eval_diffuse_reflectance(hit, on_stage)[0] / (dr.pi * walks)
            draw = rng.next_float32(), rng.next_float32()
            found = (hit.p.x, hit.p.y, share, on_stage, draw)
            sums = _add_where(on_stage, bounces.stage_light.values, found, sums)
        ray, weight, through = _go_on(bsdf, hit, rng)
        matte += dr.select(sharp, 0, 1)
        events += 1
        ends = (weight == 0.0) | (matte > bounces.most) | (events > matte + MOST_SHARP)
        return (
            dr.select(ends, walk + 1, walk),
            dr.select(ends, 0, matte),
            dr.select(ends, 0, events),
            ~ends & (inside ^ through),
            ray,
            throughput * weight,
            rng,
            *sums,
        )

    return next_segment


def _add_connected(
    sums: list[Any], light: FrameLight, path: Connection, share: Any, active: Any
) -> list[Any]:
    active &= path.lit
    path = replace(path, weight=path.weight * share, lit=active)
    # As a plain tuple: Dr.Jit cannot carry a frozen dataclass through a branch.
    parts = tuple(getattr(path, part.name) for part in fields(path))
    return _add_where(active, lambda *parts: light.values(Connection(*parts)), parts, sums)


def _go_on(bsdf: Any, hit: Any, rng: Any) -> tuple[Any, Any, Any]:
    """Draw the next ray; return it, its weight (0 where the path ends) and whether it went in."""
    sample, weight = bsdf.sample(
        mi.BSDFContext(),
        hit,
        rng.next_float32(),
        mi.Point2f(rng.next_float32(), rng.next_float32()),
        hit.is_valid(),
    )
    through = mi.has_flag(sample.sampled_type, mi.BSDFFlags.Transmission)
    left = dr.select(hit.is_valid(), weight[0], 0.0)
    return hit.spawn_ray(hit.to_world(sample.wo)), left, through


def _add_where(
    active: Any, values: Callable[..., list[Any]], arguments: tuple[Any, ...], sums: list[Any]
) -> list[Any]:
    """Add `values(*arguments)` to the sums; skipped where no lane of a packet is active."""

    def add(arguments: tuple[Any, ...], sums: list[Any]) -> list[Any]:
        found = values(*arguments)
        return [total + value for total, value in zip(sums, found, strict=True)]

    result = dr.if_stmt((arguments, sums), active, add, lambda _, sums: sums)
    return list(result)
