"""The one-trace renderer: geometry is traced once, all pattern frames are computed from that trace.

Light transport is linear in the pattern: a camera path that reaches projector pixel (u, v) with
weight w adds w * P_k(u, v) to every frame k. Sub-pixel positions are a fixed square grid shared by
all frames; independent jitter would act as phase noise larger than the sensor's. Camera rays,
shadow rays, BSDF, table look-ups and all frames of all samples are fused into one kernel.

The renderer models direct light, occlusion, any BSDF, lens distortion of both devices, depth of
field, the projector's defocus, and plane clear layers between the devices and the scene (`layers`).
On request it adds light between surfaces (`bounces`). Without `bounces` it does not model light
through clear objects.
"""

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.rig.pinhole import Pinhole
from twin.optics.bounces import Bounces, add_bounces
from twin.optics.connection import Connection, FrameLight, Rig, on_image, see, truth_of
from twin.optics.devices import SubPixels
from twin.optics.light import LightTable
from twin.optics.scene import Surfaces
from twin.optics.stack import Frames, TraceMaps, Truth

_OPAQUE = Surfaces()

SMOOTH_WITHIN_PX = 0.25
"""Largest distance (projector pixels) between a pixel's samples for which they form a smooth patch.
For a smooth patch, the light is looked up once, at the weighted mean position. This position, and
therefore the phase, is exact. The error of the light is 1/2 x the pattern's curvature x the
samples' variance: below 0.4 % of white on the edge of a Gray bit blurred by 0.7 px, and 0.1 % of
the fringe amplitude."""


@dataclass(frozen=True)
class GlintLight:
    """Light of discrete flakes, which replaces a share of the light of each pixel's samples.

    Attributes
    ----------
    kept : share of each sample's weight that remains
    light : light of the flakes, as one connection per pixel
    """

    kept: Any
    light: Connection

    def remaining(self, path: Connection) -> Connection:
        """Return one sample of each pixel without the light that the flakes replace."""
        return replace(path, weight=path.weight * self.kept)


@dataclass(frozen=True)
class Patches:
    """Sums over all samples of each camera pixel: weight and weighted projector position.

    `lowest` and `highest` are the extreme projector positions of the lit samples. All values depend
    on geometry, rig and coat, but not on the patterns. An evaluated trace can therefore be used for
    any number of pattern sequences. The sums include `glints`; None: the coat is smooth.
    """

    samples: int
    weight: Any
    weighted_column: Any
    weighted_row: Any
    weighted_axial_mm: Any
    lowest: Any
    highest: Any
    glints: GlintLight | None = None

    def evaluate(self) -> "Patches":
        """Run the recorded trace, store its result and return the patches."""
        no_sums = ("samples", "glints")
        dr.eval(*(getattr(self, field.name) for field in fields(self) if field.name not in no_sums))
        if self.glints is not None:
            dr.eval(self.glints.kept, *vars(self.glints.light).values())
        return self

    @property
    def spread_px(self) -> Any:
        """Largest distance, px, between two lit samples of a pixel along either projector axis."""
        return dr.maximum(self.highest.x - self.lowest.x, self.highest.y - self.lowest.y)

    def mean_connection(self, active: Any) -> Connection:
        """Return one connection per pixel: weighted mean position and mean weight of its samples.

        Parameters
        ----------
        active : pixels to be connected; the others have weight 0
        """
        lit = active & (self.weight > 0.0)
        scale = dr.select(lit, dr.rcp(self.weight), 0.0)
        column_px, row_px = self.weighted_column * scale, self.weighted_row * scale
        # One distance, one blur: over a patch of a quarter pixel the blur's spread is negligible.
        axial_mm = self.weighted_axial_mm * scale
        return Connection(column_px, row_px, dr.select(lit, self.weight, 0.0), lit, axial_mm)


def maps_of(patches: Patches, camera: Pinhole) -> TraceMaps:
    """Return the sums of all pixels as images; positions are divided by the weight."""
    shape = camera.height_px, camera.width_px

    def image(values: Any) -> FloatArray:
        return np.asarray(values, np.float64).reshape(shape)

    weight = image(patches.weight)
    lit = weight > 0.0
    scale = np.divide(1.0, weight, out=np.zeros(shape), where=lit)
    reach = dr.select(patches.weight > 0.0, patches.highest - patches.lowest, 0.0)
    return TraceMaps(
        weight=weight,
        column_px=image(patches.weighted_column) * scale,
        row_px=image(patches.weighted_row) * scale,
        axial_mm=np.where(lit, image(patches.weighted_axial_mm) * scale, 1.0),
        column_range_px=image(reach.x),
        row_range_px=image(reach.y),
        lit=lit,
        samples=patches.samples,
    )


def trace_stack(
    scene: Any,
    rig: Rig,
    tables: dict[str, LightTable],
    traced: Patches | int,
    *,
    bounces: Bounces | None = None,
    progress: Callable[[float], None] = lambda _: None,
    smooth_within_px: float = SMOOTH_WITHIN_PX,
) -> Frames:
    """Return the radiance of all frames, mW / (mm^2 sr), in the order of the projected sequence.

    Parameters
    ----------
    scene : world in mm; emitters and sensors in it are ignored
    tables : light tables of the axes "column" and "row"
    traced : an earlier trace; or the number of camera rays per pixel, a square number, for a new
        trace
    bounces : settings of the light that is reflected more than once; None: this light is omitted
    progress : called with the finished fraction of the bounces
    smooth_within_px : see `SMOOTH_WITHIN_PX`
    """
    patches = trace_patches(scene, rig, traced) if isinstance(traced, int) else traced
    width, height = rig.camera.pinhole.width_px, rig.camera.pinhole.height_px
    light, grid = FrameLight(tables), SubPixels.of_image(width, height, patches.samples)
    frames = frames_of_patches(scene, rig, light, patches, smooth_within_px)
    if bounces is not None:
        frames = add_bounces(
            scene, rig, light, grid, bounces=bounces, frames=frames, progress=progress
        )
    dr.eval(frames)
    dr.sync_thread()
    return _in_sequence(frames, light.sequence, (height, width))


def frames_of_patches(
    scene: Any,
    rig: Rig,
    light: FrameLight,
    patches: Patches,
    smooth_within_px: float = SMOOTH_WITHIN_PX,
) -> list[Any]:
    """Return the direct light of every frame, in the order of `light.sequence`, not yet evaluated.

    The values are Dr.Jit variables with one lane per pixel.
    """
    width, height = rig.camera.pinhole.width_px, rig.camera.pinhole.height_px
    grid = SubPixels.of_image(width, height, patches.samples)
    smooth = patches.spread_px <= smooth_within_px
    frames = light.values(patches.mean_connection(smooth))
    glints = patches.glints
    if glints is not None:
        apart = light.values(replace(glints.light, lit=glints.light.lit & ~smooth))
        frames = [mean + glint for mean, glint in zip(frames, apart, strict=True)]

    def sample_values(sample: Any) -> list[Any]:
        path = see(scene, rig, grid.ray(rig.camera, sample))[1]
        return light.values(path if glints is None else glints.remaining(path))

    return _add_samples(sample_values, grid, ~smooth, frames)


def trace_patches(scene: Any, rig: Rig, samples: int) -> Patches:
    """Trace all samples of each pixel and return their sums: 8 numbers instead of 53 frame values.

    The trace is recorded but not run. `trace_stack` fuses it into its own kernel, and
    `Patches.evaluate` runs it separately.
    """
    grid = SubPixels.of_image(rig.camera.pinhole.width_px, rig.camera.pinhole.height_px, samples)

    def add_sample(*state: Any) -> tuple[Any, ...]:
        sample, weight, column, row, axial_mm, lowest, highest = state
        path = see(scene, rig, grid.ray(rig.camera, sample))[1]
        share = path.weight / grid.samples
        place = mi.Point2f(path.column_px, path.row_px)
        return (
            sample + 1,
            weight + share,
            dr.fma(share, path.column_px, column),
            dr.fma(share, path.row_px, row),
            dr.fma(share, path.axial_mm, axial_mm),
            dr.select(path.lit, dr.minimum(lowest, place), lowest),
            dr.select(path.lit, dr.maximum(highest, place), highest),
        )

    zero = dr.zeros(mi.Float, dr.width(grid.x_px))
    start = (mi.UInt32(0), *[zero] * 4, mi.Point2f(dr.inf), mi.Point2f(-dr.inf))
    sums: tuple[Any, ...] = dr.while_loop(
        start, lambda sample, *_: sample < grid.samples, add_sample
    )
    return Patches(samples, *sums[1:])


def _add_samples(
    frame_values: Callable[[Any], list[Any]], grid: SubPixels, active: Any, frames: list[Any]
) -> list[Any]:
    """Return `frames` plus the mean light of all samples in active pixels.

    Parameters
    ----------
    frame_values : light of one sample number in every frame
    active : pixels with samples that do not form a smooth patch
    """

    def add_sample(*state: Any) -> tuple[Any, ...]:
        sample, *totals = state
        values = frame_values(sample)
        shares = (dr.fma(v, 1.0 / grid.samples, t) for v, t in zip(values, totals, strict=True))
        return (sample + 1, *shares)

    end = dr.while_loop(
        (mi.UInt32(0), *frames),
        lambda sample, *_: active & (sample < grid.samples),
        add_sample,
    )
    return list(end[1:])


def trace_truth(scene: Any, rig: Rig, surfaces: Surfaces = _OPAQUE) -> Truth:
    """Trace one ray through every pixel centre and return the true surface at its hit.

    With layers, points and depth are still those of the surface, which is then not on the straight
    ray of the pixel. Projector coordinates are those of the light at this point. The stage in
    `surfaces` is not a measured surface.
    """
    width, height = rig.camera.pinhole.width_px, rig.camera.pinhole.height_px
    centres = SubPixels.of_image(width, height, 1)
    hit, path = see(scene, rig, rig.camera.ray(centres.x_px, centres.y_px))
    lit = path.lit & on_image(rig, path.column_px, path.row_px, 0.0)
    measured = hit.is_valid() & ~surfaces.is_stage(hit)
    return truth_of(rig.camera, hit, (path.column_px, path.row_px), lit, measured)


def _in_sequence(frames: list[Any], order: list[int], shape: tuple[int, int]) -> Frames:
    """Return the frames as images (row, col) in the order of the projected sequence.

    The images are views, because copying would take as long as tracing.
    """
    images = {k: np.asarray(frame).reshape(shape) for frame, k in zip(frames, order, strict=True)}
    return tuple(images[k] for k in range(len(images)))
