"""Light of pixels the samples of which are followed one by one in a moving scene."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from reconstruction.arrays import BoolImage, FloatArray, FloatImage, IntArray
from twin.optics.connection import FrameLight
from twin.optics.exposures import ExposureSequence
from twin.optics.moving_rig import LanePaths, Pixels, TimedRays
from twin.optics.piecewise_paths import NodePaths, Numbers

_MOST_VALUES = 8_000_000
"""Nodes times lanes that are computed together: each takes about 60 bytes."""


class MovingScene(Protocol):
    """A scene that moves relative to its rig."""

    def trace(self, rays: TimedRays) -> LanePaths:
        """Return the paths of camera rays, each traced at its own time."""


@dataclass(frozen=True, eq=False)
class Lanes:
    """All samples of selected pixels; the lanes are ordered by pixel, then by sample.

    Rays of one pixel are near each other in memory, because they meet the same facets.

    Attributes
    ----------
    pixels : (pixel,) numbers of the pixels, row by row
    width_px : width of the image
    samples : rays per pixel, a square number
    """

    pixels: Pixels
    width_px: int
    samples: int

    def __len__(self) -> int:
        return len(self.pixels) * self.samples

    @property
    def rows(self) -> Pixels:
        """Row of the image of every pixel, (pixel,)."""
        return self.pixels // np.uint32(self.width_px)

    def of(self, chosen: BoolImage) -> "Lanes":
        """Return the lanes of some of the pixels, chosen by a mask (pixel,)."""
        return replace(self, pixels=self.pixels[chosen])

    def batches(self, most: int) -> "Iterator[Lanes]":
        """Yield the lanes of successive pixels, at most `most` lanes or those of one pixel."""
        count = max(1, most // self.samples)
        for first in range(0, len(self.pixels), count):
            yield replace(self, pixels=self.pixels[first : first + count])

    def rays(self, times_s: FloatArray) -> TimedRays:
        """Return all rays at several times (time, pixel), ordered by time and lane."""
        distinct, number = np.unique(times_s, return_inverse=True)
        lane = np.tile(np.arange(len(self), dtype=np.int32), len(times_s))
        return self.rays_of(lane, distinct, np.repeat(number.ravel(), self.samples))

    def rays_of(self, lane: Numbers, times_s: FloatArray, time_of: IntArray | Numbers) -> TimedRays:
        """Return rays of lanes, each at one of several times (time,)."""
        pixel, sample = np.divmod(lane, np.int32(self.samples))
        return TimedRays(self.pixels[pixel], sample.astype(np.uint32), times_s, time_of)

    def of_any(self, mask: BoolImage) -> BoolImage:
        """Return True for pixels (pixel,) with a lane in a mask (lane,)."""
        return np.asarray(mask.reshape(-1, self.samples).any(axis=1))


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

    def paths(self, lanes: Lanes, places: FloatArray) -> LanePaths:
        """Return the paths of lanes at relative times (time, pixel), ordered by time and lane."""
        return self.scene.trace(lanes.rays(self.sequence.time_s(places)))

    def tracer_of_nodes(
        self, lanes: Lanes, places: FloatArray
    ) -> Callable[[Numbers, Numbers], LanePaths]:
        """Return a function that traces lanes at nodes with these relative times in row 0."""
        delay, rows = self.sequence.row_delay, np.zeros(len(lanes.pixels), np.int32)
        if delay:
            rows = lanes.rows.astype(np.int32)
        count = int(rows.max(initial=0)) + 1
        times_s = self.sequence.time_s(places[:, None] + delay * np.arange(count)).ravel()

        def trace(node: Numbers, lane: Numbers) -> LanePaths:
            time_of = node * np.int32(count) + rows[lane // lanes.samples]
            return self.scene.trace(lanes.rays_of(lane, times_s, time_of))

        return trace

    def radiance(self, lanes: Lanes, frames: IntArray, count: int) -> FloatArray:
        """Return the radiance (pixel,) of each pixel in one frame of its own, traced at its nodes.

        Parameters
        ----------
        frames : (pixel,) number of the frame
        count : see `ExposureSequence.nodes`
        """
        nodes = self.sequence.nodes(frames, count)
        paths = self.paths(lanes, nodes.places.T + self.sequence.row_delay * lanes.rows)
        each = np.tile(np.repeat(frames, lanes.samples), len(nodes.shares))
        values = np.array(self.light.value(paths.connection(), each), np.float32)
        shape = len(nodes.shares), len(lanes.pixels), lanes.samples
        return np.asarray(nodes.shares @ values.reshape(shape).mean(axis=2, dtype=np.float64))


@dataclass(frozen=True, eq=False)
class SampledPixels:
    """Pixels of which each sample has its own paths.

    Attributes
    ----------
    lanes : the samples of the pixels
    paths_of : returns the paths of lanes at nodes with relative times (node,) in row 0
    """

    lanes: Lanes
    paths_of: Callable[[Lanes, FloatArray], NodePaths]

    def radiance(self, tracer: PixelTracer, count: int) -> tuple[FloatImage, BoolImage]:
        """Return the radiance (frame, pixel), and True for pixels (pixel,) that cross an edge.

        Parameters
        ----------
        count : see `ExposureSequence.nodes`
        """
        frames = np.arange(len(tracer.sequence.start))
        nodes = tracer.sequence.nodes(frames, count)
        frame_of = np.repeat(frames, len(nodes.shares))
        radiance = np.zeros((len(frames), len(self.lanes.pixels)), np.float32)
        crossed, first = np.zeros(len(self.lanes.pixels), bool), 0
        for lanes in self.lanes.batches(_MOST_VALUES // nodes.places.size):
            part = slice(first, first + len(lanes.pixels))
            paths = self._paths_at(lanes, nodes.places.ravel())
            crossed[part] = lanes.of_any(paths.crossed)
            values = _looked_up(tracer.light, paths, frame_of, lanes.samples)
            by_node = values.reshape(-1, *nodes.places.shape)
            radiance[:, part] = (by_node @ nodes.shares).T
            first = part.stop
        return radiance, crossed

    def _paths_at(self, lanes: Lanes, places: FloatArray) -> NodePaths:
        """Return the paths at relative times in any order."""
        if np.all(np.diff(places) > 0.0):
            return self.paths_of(lanes, places)
        ascending, number = np.unique(places, return_inverse=True)
        return self.paths_of(lanes, ascending).of_nodes(number)


def _looked_up(light: FrameLight, paths: NodePaths, frames: IntArray, samples: int) -> FloatImage:
    """Return the radiance (pixel, node) of pixels in the frame of each node (node,)."""
    lanes = np.array(light.value(paths.connection(), frames), np.float32)
    return np.asarray(lanes.reshape(-1, samples, len(frames)).mean(axis=1))
