"""Light of the three kinds of pixels of a moving scene, see `moving_stack`."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from reconstruction.arrays import BoolImage, FloatArray, FloatImage
from twin.optics.connection import FrameLight
from twin.optics.exposures import ExposureNodes, ExposureSequence
from twin.optics.moving_rig import LanePaths, Pixels, TimedRays
from twin.optics.piecewise_paths import PiecewisePaths
from twin.optics.time_paths import TimePaths

MOST_RAYS = 4_000_000
"""Rays that are traced together: each takes about 60 bytes."""


class MovingScene(Protocol):
    """A scene that moves relative to its rig."""

    def trace(self, rays: TimedRays) -> LanePaths:
        """Return the paths of camera rays, each traced at its own time."""


@dataclass(frozen=True, eq=False)
class Lanes:
    """All samples of selected pixels; the lanes are ordered by sample, then by pixel.

    Attributes
    ----------
    pixels : (pixel,) numbers of the pixels, row by row
    width_px : width of the image
    samples : rays per pixel, a square number
    """

    pixels: Pixels
    width_px: int
    samples: int

    @property
    def rows(self) -> Pixels:
        """Row of the image of every pixel, (pixel,)."""
        return self.pixels // np.uint32(self.width_px)

    def of(self, chosen: BoolImage) -> "Lanes":
        """Return the lanes of some of the pixels, chosen by a mask (pixel,)."""
        return replace(self, pixels=self.pixels[chosen])

    def each(self, values: FloatArray) -> FloatArray:
        """Return values of every pixel (..., pixel) as values of every lane, (... x lane,)."""
        return np.repeat(values[..., None, :], self.samples, axis=-2).ravel()

    def rays(self, times_s: FloatArray) -> TimedRays:
        """Return the rays at several times (time, pixel), ordered by time, sample, pixel."""
        shape = len(times_s), self.samples, len(self.pixels)
        sample = np.arange(self.samples, dtype=np.uint32)[:, None]
        return TimedRays(
            np.broadcast_to(self.pixels, shape).ravel(),
            np.broadcast_to(sample, shape).ravel(),
            self.each(times_s),
        )

    def means(self, values: FloatImage, times: int = 1) -> FloatArray:
        """Return the means over the samples, (time, pixel), of values ordered as `rays`."""
        shape = times, self.samples, len(self.pixels)
        return np.asarray(values.reshape(shape).mean(axis=1, dtype=np.float64))


@dataclass(frozen=True, eq=False)
class PixelTracer:
    """Traces pixels at the times of exposures.

    Attributes
    ----------
    scene : the moving scene
    sequence : times of the frames
    light : light of the frames
    """

    scene: MovingScene
    sequence: ExposureSequence
    light: FrameLight

    def places(self, lanes: Lanes, nodes: ExposureNodes) -> FloatArray:
        """Return the relative times (node, pixel) of the nodes of an exposure."""
        return np.asarray(nodes.places[:, None] + self.sequence.row_delay * lanes.rows)

    def paths(self, lanes: Lanes, places: FloatArray) -> LanePaths:
        """Return the paths of lanes at relative times (time, pixel)."""
        return self.scene.trace(lanes.rays(self.sequence.time_s(places)))

    def traced(self, jobs: list[tuple[int, Lanes]], count: int) -> list[FloatArray]:
        """Return the radiance (pixel,) of pixels in frames, traced at `count` times of each."""

        def traced_paths(chosen: list[tuple[int, Lanes]]) -> LanePaths:
            rays = [
                lanes.rays(
                    self.sequence.time_s(self.places(lanes, self.sequence.nodes(frame, count)))
                )
                for frame, lanes in chosen
            ]
            parts = ("pixels", "sample", "time_s")
            together = (np.concatenate([getattr(ray, part) for ray in rays]) for part in parts)
            return self.scene.trace(TimedRays(*together))

        return self.integrated(jobs, count, traced_paths)

    def integrated(
        self,
        jobs: list[tuple[int, Lanes]],
        count: int,
        paths_of: Callable[[list[tuple[int, Lanes]]], LanePaths],
    ) -> list[FloatArray]:
        """Return the radiance (pixel,) of pixels in frames, integrated over each exposure.

        Parameters
        ----------
        jobs : number of each frame, and its pixels
        count : nodes of each exposure
        paths_of : returns the paths of some jobs, ordered by job, node, sample, pixel
        """
        radiance = []
        for chosen in _batches(jobs, count):
            sizes = [count * lanes.samples * len(lanes.pixels) for _, lanes in chosen]
            frames = np.repeat([frame for frame, _ in chosen], sizes)
            values = self._looked_up(paths_of(chosen), frames)
            ends = np.cumsum(sizes)[:-1]
            for (frame, lanes), part in zip(chosen, np.split(values, ends), strict=True):
                shares = self.sequence.nodes(frame, count).shares
                radiance.append(shares @ lanes.means(part, count))
        return radiance

    def _looked_up(self, paths: LanePaths, frames: NDArray[np.int64]) -> FloatImage:
        values = np.zeros(len(frames), np.float32)
        along = self.light.is_along_columns(frames)
        for chosen in (along, ~along):
            if chosen.any():
                light = self.light.value(paths.of_lanes(chosen).connection(), frames[chosen])
                values[chosen] = np.array(light, np.float32)
        return values


def _batches(jobs: list[tuple[int, Lanes]], count: int) -> Iterator[list[tuple[int, Lanes]]]:
    """Yield jobs in groups of at most `MOST_RAYS` rays, or of one job."""
    group: list[tuple[int, Lanes]] = []
    rays = 0
    for frame, lanes in jobs:
        size = count * lanes.samples * len(lanes.pixels)
        if group and rays + size > MOST_RAYS:
            yield group
            group, rays = [], 0
        group.append((frame, lanes))
        rays += size
    if group:
        yield group


@dataclass(frozen=True, eq=False)
class CrossedPixels:
    """Pixels that cross an edge: linear in time between crossings, traced near them.

    Attributes
    ----------
    lanes : the samples of the pixels
    pieces : their paths between the crossings
    """

    lanes: Lanes
    pieces: PiecewisePaths

    def radiance(self, tracer: PixelTracer, frames: int, count: int) -> list[FloatArray]:
        """Return the radiance (pixel,) of every frame, at `count` nodes of each exposure."""
        places = [tracer.places(self.lanes, tracer.sequence.nodes(k, count)) for k in range(frames)]
        held = [self._held(at) for at in places]
        between = [(k, self.lanes.of(mask)) for k, mask in enumerate(held)]

        def interpolated(chosen: list[tuple[int, Lanes]]) -> LanePaths:
            numbers = [k for k, _ in chosen]
            lane_of = [np.flatnonzero(np.tile(held[k], self.lanes.samples)) for k in numbers]
            at = [self.lanes.of(held[k]).each(places[k][:, held[k]]) for k in numbers]
            lanes = np.concatenate([np.tile(lane, count) for lane in lane_of])
            return self.pieces.at(np.concatenate(at), lanes)

        smooth = tracer.integrated(between, count, interpolated)
        near = [(k, self.lanes.of(~mask)) for k, mask in enumerate(held)]
        edges = tracer.traced(near, count)
        images = []
        for mask, inside, outside in zip(held, smooth, edges, strict=True):
            light = np.zeros(len(mask))
            light[mask], light[~mask] = inside, outside
            images.append(light)
        return images

    def _held(self, places: FloatArray) -> BoolImage:
        """Return True for pixels (pixel,) without a sample near a crossing.

        Parameters
        ----------
        places : relative times (node, pixel)
        """
        samples = self.lanes.samples
        lanes = np.repeat(places[:, None, :], samples, axis=1).reshape(len(places), -1)
        held = self.pieces.held_at(lanes).reshape(len(places), samples, -1)
        return np.asarray(held.all(axis=(0, 1)))


@dataclass(frozen=True, eq=False)
class SampledPixels:
    """Pixels each sample of which is a polynomial of time."""

    lanes: Lanes
    paths: TimePaths

    def radiance(self, tracer: PixelTracer, frame: int, nodes: ExposureNodes) -> FloatArray:
        """Return the radiance (pixel,) of one frame."""
        values = self.paths.light(tracer.light, frame, nodes, tracer.sequence.row_delay)
        return np.asarray(self.lanes.means(values)[0])
