"""Indirect light: from coat to coat, between specimen and stage, through clear bodies.

Each camera ray is continued by BSDF sampling. The first surface on a light path from the projector
determines the estimator, so that every path is counted once:

- If this surface is matte or rough, the camera path is connected to the projector there.
- If it is sharp (clear or polished) and the stage follows on the path, photons carry the light to
  the stage. The camera path gathers this light at the stage.
- If it is sharp and only sharp surfaces follow up to the camera, the camera path is connected to
  the projector there.

All frames use the same random numbers. The noise therefore shifts a pixel's phase slightly, but is
the same in all frames.

Not modelled are highlights of perfectly smooth bodies (between two pinholes they have no width),
and light from sharp bodies to surfaces other than the stage.
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
"""Largest number of reflections and refractions at sharp bodies on a camera path."""


@dataclass(frozen=True)
class Bounces:
    """Settings and surfaces for the indirect light that `add_bounces` traces.

    Attributes
    ----------
    most : largest number of reflections after the first one; with 1, light is reflected at most
        twice. Reflections and refractions at clear or polished bodies are not counted.
    paths : number of random continuations of each camera sample
    seed : seed of the random numbers
    surfaces : the sharp (clear or polished) bodies and the stage
    stage_light : irradiance on the stage, computed from photons; None: no photons were traced
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
    """Return `frames` plus the light that is reflected at least twice, mW / (mm^2 sr).

    One loop runs over all path segments of all samples. After the last bounce, or if a path exits
    the scene, the lane starts its next sample. The kernel is launched up to `LAUNCHES` times; after
    each launch, `progress` is called with the finished fraction.
    """
    walks, width = grid.samples * bounces.paths, dr.width(grid.x_px)
    next_segment = _next_segment(scene, rig, light, grid, bounces)
    random = random_streams(width, bounces.seed)
    limits = np.linspace(0, walks, min(walks, LAUNCHES) + 1).astype(int).tolist()
    for first, last in pairwise(limits):
        # Opaque: with a literal, every launch would compile its own kernel.
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
    """Return the loop's body, a function that extends the path of each lane by one segment."""
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
        # Direct light at the first surface is rendered separately, without noise.
        connects = ~fresh & (~sharp | (matte == 0))
        path = connect(scene, rig, hit, bsdf, coherent=False)
        sums = _add_connected(sums, light, path, throughput / walks, connects)
        if bounces.stage_light is not None:
            on_stage = surfaces.on_stage(hit)
            share = throughput * bsdf.eval_diffuse_reflectance(hit, on_stage)[0] / (dr.pi * walks)
            draw = rng.next_float32(), rng.next_float32()
            arguments = (hit.p.x, hit.p.y, share, on_stage, draw)
            sums = _add_where(on_stage, bounces.stage_light.values, arguments, sums)
        ray, weight, through = _go_on(bsdf, hit, rng)
        weight = rig.inked(weight, hit.p)
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
    """Draw a path's next ray; return the ray, its weight and whether the light is transmitted.

    The path ends where the weight is 0.
    """
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
    """Return the sums of the frames; `values(*arguments)` is added in active lanes.

    The computation of `values` is skipped where no lane of a packet is active.
    """

    def add(arguments: tuple[Any, ...], sums: list[Any]) -> list[Any]:
        added = values(*arguments)
        return [total + value for total, value in zip(sums, added, strict=True)]

    result = dr.if_stmt((arguments, sums), active, add, lambda _, sums: sums)
    return list(result)
