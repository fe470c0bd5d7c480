"""Light that is reflected more than once: from coat to coat, specimen to stage, and so on.

Each camera ray is continued by BSDF sampling; at every further surface the path is connected to
the projector, and what it carries is added to all frames. The random numbers are the same for all
frames, so their noise shifts a pixel's phase a little but never differs from frame to frame.

Does: any number of bounces between opaque surfaces. Does not: light that reaches a surface through
or off perfectly specular ones (no connection can be drawn to a pinhole projector).
"""

from dataclasses import dataclass, replace
from typing import Any

import drjit as dr
import mitsuba as mi

from twin.optics.connection import Rig, connect
from twin.optics.look_up import FrameLight
from twin.optics.subpixels import SubPixels


@dataclass(frozen=True)
class Bounces:
    """How much indirect light is traced.

    Attributes
    ----------
    most : int
        Largest number of reflections after the first; 1 is light reflected twice.
    paths : int
        Random continuations per camera sample.
    seed : int
    """

    most: int
    paths: int
    seed: int


def add_bounces(
    scene: Any,
    rig: Rig,
    light: FrameLight,
    grid: SubPixels,
    *,
    bounces: Bounces,
    frames: list[Any],
) -> list[Any]:
    """Return `frames` plus the light of two and more reflections; same units.

    One loop runs over all path segments of all samples: after the last bounce, or when a path
    leaves the scene, the lane starts its next sample.
    """
    total = grid.samples * bounces.paths
    width = dr.width(grid.x_px)
    generator: Any = mi.PCG32
    # Opaque: a literal seed would be compiled into the kernel, a new one for every trial.
    seed = dr.opaque(mi.UInt64, bounces.seed)
    random = generator(size=width, initstate=seed, initseq=dr.arange(mi.UInt64, width))

    def next_segment(*state: Any) -> tuple[Any, ...]:
        walk, depth, ray, throughput, rng, *sums = state
        fresh = depth == 0
        ray = dr.select(fresh, rig.camera.ray(*grid.position(walk // bounces.paths)), ray)
        throughput = dr.select(fresh, 1.0, throughput)
        hit = scene.ray_intersect(ray)
        bsdf = hit.bsdf(ray)
        path = connect(scene, rig, hit, bsdf, coherent=False)
        # The first surface's own light is the direct part, rendered without noise.
        path = replace(path, weight=path.weight * throughput / total, lit=path.lit & ~fresh)
        sums = [value + one for value, one in zip(sums, light.values(path), strict=True)]
        sample, weight = bsdf.sample(
            mi.BSDFContext(),
            hit,
            rng.next_float32(),
            mi.Point2f(rng.next_float32(), rng.next_float32()),
            hit.is_valid(),
        )
        throughput = throughput * weight[0]
        ends = ~hit.is_valid() | (throughput == 0.0) | (depth >= bounces.most)
        return (
            dr.select(ends, walk + 1, walk),
            dr.select(ends, 0, depth + 1),
            hit.spawn_ray(hit.to_world(sample.wo)),
            throughput,
            rng,
            *sums,
        )

    start = (
        dr.zeros(mi.UInt32, width),
        dr.zeros(mi.UInt32, width),
        dr.zeros(mi.Ray3f, width),
        dr.ones(mi.Float, width),
        random,
        *frames,
    )
    end = dr.while_loop(start, lambda walk, *_: walk < total, next_segment)
    return list(end[5:])
