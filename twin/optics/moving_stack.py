"""All frames of a moving scene for little more than those of a scene at rest.

The scene is traced at a few moments of the sequence (`time_paths`). Two kinds of pixels differ in
how a frame follows from them:

- smooth: the samples of the pixel form a smooth patch at all moments. Mean projector coordinate and
  weight are polynomials of time.
- sampled: all others, on a steep slope or where a sample crosses an edge, a shadow or the end of
  the light during the sequence. Each sample is traced at further times, and is linear in time
  between them (`piecewise_paths`); at a crossing these times are those of the exposure.

The light of each frame is integrated over its exposure by Gauss's quadrature, with one node more
than the pixels by which the projector coordinate moves. Random pixels are traced at random frames
with one node more. Their differences are the stated error.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial

import mitsuba as mi
import numpy as np
from numpy.polynomial import chebyshev

from reconstruction.arrays import FloatArray, FloatImage, IntArray
from twin.optics.connection import FrameLight
from twin.optics.exposures import ExposureSequence
from twin.optics.moving_moments import Moments, MomentTracer, PatchedScene
from twin.optics.moving_pixels import Lanes, PixelTracer, SampledPixels
from twin.optics.moving_rig import LanePaths, Pixels
from twin.optics.piecewise_paths import NodePaths, between_moments, traced_where_needed
from twin.optics.stack import Frames, MotionAccuracy
from twin.optics.time_paths import TimePaths, coefficients, moment_places

PROBES = 2048
"""Largest number of random pixels by which the error is measured."""

_MOST_NODES = 16
_STILL_PX = 0.1
# Between two moments of either number of moments.
_CHECKED_PLACE = 0.4


@dataclass(frozen=True, eq=False)
class MovingStack:
    """Frames of a moving scene.

    Attributes
    ----------
    scene : the scene at any time
    sequence : times of the frames
    light : light of the frames
    size_px : width and height of the image
    samples : rays per pixel
    """

    scene: PatchedScene
    sequence: ExposureSequence
    light: FrameLight
    size_px: tuple[int, int]
    samples: int

    def frames(
        self, rng: np.random.Generator, progress: Callable[[float], None] = lambda _: None
    ) -> tuple[Frames, MotionAccuracy]:
        """Return the direct light of every frame, (row, col) each, and its error.

        Parameters
        ----------
        rng : random generator of the pixels that are traced for the error
        progress : called with the finished fraction
        """
        tracer = MomentTracer(self.scene, self.sequence, self.light, self.size_px[0])
        moments = tracer.moments()
        count, pixels = self._nodes(moments), np.arange(len(moments.smooth), dtype=np.uint32)
        smooth = self._polynomials(moments)
        sampled = SampledPixels(self._lanes(pixels[~moments.smooth]), self._paths(moments))
        radiance, crossed = sampled.radiance(self._tracer, count)
        images = []
        for frame, light in enumerate(radiance):
            nodes = self.sequence.nodes(frame, count)
            image = smooth.light(self.light, frame, nodes, self.sequence.row_delay)
            image[sampled.lanes.pixels] = light
            images.append(image.reshape(self.size_px[::-1]))
            progress((frame + 1) / len(radiance))
        share = float(crossed.sum()) / max(1, int(moments.ever_lit.sum()))
        return tuple(images), self._accuracy(moments, images, share, rng)

    @cached_property
    def _tracer(self) -> PixelTracer:
        return PixelTracer(self.scene, self.sequence, self.light)

    def _nodes(self, moments: Moments) -> int:
        """Return the number of Gauss nodes: one more than the pixels of an exposure's motion."""
        moved_px = moments.speed_px * float(self.sequence.duration.max())
        return 1 if moved_px <= _STILL_PX else min(int(np.ceil(moved_px)) + 1, _MOST_NODES)

    def _lanes(self, pixels: Pixels) -> Lanes:
        return Lanes(pixels, self.size_px[0], self.samples)

    def _paths(self, moments: Moments) -> Callable[[Lanes, FloatArray], NodePaths]:
        """Return the function that returns the paths of sampled pixels at nodes."""
        if self.scene.any_time:
            return lambda lanes, places: traced_where_needed(
                self._tracer.tracer_of_nodes(lanes, places), places, len(lanes), moments.white
            )
        return partial(self._between, moment_places(len(moments.at)))

    def _between(self, moments: FloatArray, lanes: Lanes, places: FloatArray) -> NodePaths:
        """Return the paths of sampled pixels from their traces at the moments."""
        paths = [self._at(lanes, place) for place in moments]
        lit = np.sum([path.weight > 0.0 for path in paths], axis=0)
        return between_moments(moments, paths, places, (lit == 0) | (lit == len(paths)))

    def _at(self, lanes: Lanes, place: float) -> LanePaths:
        return self._tracer.paths(lanes, np.full((1, len(lanes.pixels)), round(float(place), 12)))

    def _polynomials(self, moments: Moments) -> TimePaths:
        rows = np.repeat(np.arange(self.size_px[1]), self.size_px[0])
        return TimePaths.through(moments.at, mi.Bool(moments.smooth), rows)

    def _accuracy(
        self,
        moments: Moments,
        images: list[FloatImage],
        crossed_share: float,
        rng: np.random.Generator,
    ) -> MotionAccuracy:
        """Return the error of random pixels of random frames, traced with one node more."""
        count, lit = self._nodes(moments), np.flatnonzero(moments.ever_lit).astype(np.uint32)
        pixels = rng.choice(lit, min(PROBES, len(lit)), replace=False)
        frame_of = rng.integers(len(images), size=len(pixels))
        if not self.scene.any_time:
            frame_of[:] = np.abs(self.sequence.start - _CHECKED_PLACE).argmin()
        traced = self._tracer.radiance(self._lanes(pixels), frame_of, count + 1)
        rendered = np.array([images[f].flat[p] for f, p in zip(frame_of, pixels, strict=True)])
        return MotionAccuracy(
            moments=len(moments.at),
            exposure_nodes=count,
            crossed_share=crossed_share,
            radiance_rms_percent=100.0 * _rms(rendered - traced) / moments.white,
            coordinate_rms_px=_rms(self._column_errors_px(moments, pixels, frame_of)),
            moved_px=moments.moved_px(),
        )

    def _column_errors_px(self, moments: Moments, pixels: Pixels, frame_of: IntArray) -> FloatArray:
        """Return the errors of the mean column of smooth pixels in the middle of their frames."""
        nodes = self.sequence.nodes(frame_of, 1)
        places = nodes.places[:, 0] + self.sequence.row_delay * self._lanes(pixels).rows
        chosen = (moments.smooth & moments.lit)[pixels]
        lanes, places = self._lanes(pixels[chosen]), places[chosen]
        paths = self._tracer.paths(lanes, places[None])
        weight, column_px = (
            values.reshape(-1, self.samples).sum(axis=1, dtype=np.float64)
            for values in (paths.weight, paths.column_px * paths.weight)
        )
        at_moments = [np.array(moment.path.column_px)[lanes.pixels] for moment in moments.at]
        smooth_px = chebyshev.chebval(places, np.array(coefficients(at_moments)), tensor=False)
        seen = weight > 0.0
        return np.asarray(smooth_px[seen] - column_px[seen] / weight[seen])


def _rms(errors: FloatArray) -> float:
    return float(np.sqrt(np.mean(errors**2))) if len(errors) else 0.0
