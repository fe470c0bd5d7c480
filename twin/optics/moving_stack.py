"""All frames of a moving scene for little more than those of a scene at rest.

The scene is traced at a few moments of the sequence (`time_paths`). Three kinds of pixels differ in
how a frame follows from the moments:

- smooth: the samples of the pixel form a smooth patch at all moments. Mean projector coordinate and
  weight are polynomials of time.
- sampled: each sample of the pixel has its own polynomials, for example on a steep slope.
- crossed: a sample crosses an edge, a shadow or the end of the light during the sequence. Between
  the crossings it is linear in time (`piecewise_paths`). For frames near a crossing all samples of
  the pixel are traced at the times of the exposure.

The light of each frame is integrated over its exposure by Gauss's quadrature, with one node more
than the pixels by which the projector coordinate moves. Random pixels are traced at random frames
with one node more. Their differences are the stated error.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar, Protocol

import numpy as np
from numpy.polynomial import chebyshev

from reconstruction.arrays import BoolImage, FloatArray, FloatImage, IntArray
from twin.optics.connection import FrameLight
from twin.optics.exposures import ExposureSequence
from twin.optics.moving_pixels import (
    CrossedPixels,
    Lanes,
    MovingScene,
    PixelTracer,
    SampledPixels,
)
from twin.optics.moving_rig import LanePaths, Pixels
from twin.optics.one_trace import SMOOTH_WITHIN_PX, Patches
from twin.optics.piecewise_paths import INTERVALS, PiecewisePaths
from twin.optics.stack import Frames, MotionAccuracy
from twin.optics.time_paths import (
    COORDINATE_PX,
    MOMENTS,
    TimePaths,
    coefficients,
    moment_places,
    smooth_lanes,
)

PROBES = 2048
"""Largest number of random pixels by which the error is measured."""

_MOST_NODES = 16
_STILL_PX = 0.1
# Between two moments of either number of moments.
_CHECKED_PLACE = 0.4


class PatchedScene(MovingScene, Protocol):
    """A moving scene of which the patches of all pixels can be traced at one time.

    Attributes
    ----------
    any_time : True if rays can be traced at any time; False: each time takes as long as a press, so
        that pixels that cross an edge are interpolated between the moments, and the error is that
        of one frame
    """

    any_time: ClassVar[bool]

    @property
    def vibrates(self) -> bool:
        """Whether the motion has a vibration."""

    def patches_at(self, time_s: float) -> Patches:
        """Return the traced rays of all pixels at a time."""


@dataclass(frozen=True, eq=False)
class _Moments:
    """Mean paths of all pixels at the moments, and whether the samples form a smooth patch."""

    paths: list[LanePaths]
    patch: list[BoolImage]

    @cached_property
    def lit(self) -> BoolImage:
        """Pixels (pixel,) with light at all moments."""
        return np.asarray(np.all([path.weight > 0.0 for path in self.paths], axis=0))

    @cached_property
    def ever_lit(self) -> BoolImage:
        """Pixels (pixel,) with light at one moment or more."""
        return np.asarray(np.any([path.weight > 0.0 for path in self.paths], axis=0))

    @cached_property
    def white(self) -> float:
        """Mean weight of all lit pixels."""
        weights = np.asarray([path.weight for path in self.paths])
        return float(weights[weights > 0.0].mean()) if self.ever_lit.any() else 1.0

    @cached_property
    def smooth(self) -> BoolImage:
        """Pixels (pixel,) that are dark, or a smooth patch that is a polynomial of time."""
        return np.asarray(smooth_lanes(self.paths, self.white) & np.all(self.patch, axis=0))

    def curved_share(self) -> float:
        """Return the share of lit pixels that further moments may make smooth."""
        last_px = [
            np.abs(coefficients([getattr(path, name) for path in self.paths])[-1])
            for name in ("column_px", "row_px")
        ]
        largest_px = np.maximum(*last_px)
        return float(np.mean(self.lit & (largest_px > COORDINATE_PX) & (largest_px < 1.0)))

    def moved_px(self) -> float:
        """Return the median change of a coordinate from first to last moment, see the result."""
        first, last = self.paths[0], self.paths[-1]
        changes = (
            np.abs(getattr(last, name) - getattr(first, name))[self.lit]
            for name in ("column_px", "row_px")
        )
        return max(float(np.median(change)) for change in changes) if self.lit.any() else 0.0

    def speed_px(self) -> float:
        """Return the largest speed of a coordinate, px per relative time, of 99 % of the pixels."""
        if not self.lit.any():
            return 0.0
        widths = np.diff(moment_places(len(self.paths)))[:, None]
        speeds = [
            np.abs(np.diff([getattr(path, name)[self.lit] for path in self.paths], axis=0) / widths)
            for name in ("column_px", "row_px")
        ]
        return float(np.percentile(np.max(speeds, axis=(0, 1)), 99))


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
        moments = self._moments()
        count = self._nodes(moments)
        pixels = np.arange(self.size_px[0] * self.size_px[1], dtype=np.uint32)
        smooth = self._polynomials([_where(p, moments.smooth) for p in moments.paths], pixels)
        sampled, crossed = self._rest(moments, pixels[~moments.smooth])
        edges = crossed.radiance(self._tracer, len(self.sequence.start), count)
        images = []
        for frame, light in enumerate(edges):
            nodes = self.sequence.nodes(frame, count)
            image = smooth.light(self.light, frame, nodes, self.sequence.row_delay)
            if len(sampled.lanes.pixels):
                image[sampled.lanes.pixels] = sampled.radiance(self._tracer, frame, nodes)
            image[crossed.lanes.pixels] = light
            images.append(image.reshape(self.size_px[::-1]))
            progress((frame + 1) / len(edges))
        share = len(crossed.lanes.pixels) / max(1, int(moments.ever_lit.sum()))
        return tuple(images), self._accuracy(moments, images, share, rng)

    @cached_property
    def _tracer(self) -> PixelTracer:
        return PixelTracer(self.scene, self.sequence, self.light)

    def _moments(self) -> _Moments:
        """Trace 3 moments, and more if this costs less than tracing pixels at equal steps."""
        traced: dict[float, tuple[LanePaths, BoolImage]] = {}
        counts = MOMENTS if self.scene.any_time else MOMENTS[:-1]
        # At 3 moments an odd function of time, such as a sine, is equal to a straight line.
        for count in counts[1:] if self.scene.vibrates else counts:
            places = [round(float(place), 12) for place in moment_places(count)]
            for place in places:
                if place not in traced:
                    traced[place] = _means(self.scene.patches_at(self.sequence.time_s(place)))
            moments = _Moments(*map(list, zip(*(traced[at] for at in places), strict=True)))
            near_edges = 2 * len(self.sequence.start) * self._nodes(moments) / INTERVALS
            if moments.curved_share() * (INTERVALS + near_edges) <= count - 1:
                break
        return moments

    def _nodes(self, moments: _Moments) -> int:
        """Return the number of Gauss nodes: one more than the pixels of an exposure's motion."""
        moved_px = moments.speed_px() * float(self.sequence.duration.max())
        return 1 if moved_px <= _STILL_PX else min(int(np.ceil(moved_px)) + 1, _MOST_NODES)

    def _rest(self, moments: _Moments, pixels: Pixels) -> tuple[SampledPixels, CrossedPixels]:
        """Return the pixels that are not smooth, traced sample by sample."""
        rest = Lanes(pixels, self.size_px[0], self.samples)
        places = moment_places(len(moments.paths))
        paths = [self._at(rest, place) for place in places]
        steady = self._steady(paths, moments.white)
        lanes, edges = rest.of(steady), rest.of(~steady)
        chosen = np.tile(steady, self.samples)
        polynomials = self._polynomials(
            [path.of_lanes(chosen) for path in paths], np.tile(lanes.pixels, self.samples)
        )
        if self.scene.any_time:
            pieces = PiecewisePaths.of(lambda place: self._at(edges, place), moments.white)
        else:
            pieces = PiecewisePaths.between(places, [path.of_lanes(~chosen) for path in paths])
        return SampledPixels(lanes, polynomials), CrossedPixels(edges, pieces)

    def _steady(self, paths: list[LanePaths], white: float) -> BoolImage:
        """Return True for the pixels (pixel,) whose samples are polynomials of time."""
        steady = smooth_lanes(paths, white)
        if not self.scene.any_time:
            lit = np.sum([path.weight > 0.0 for path in paths], axis=0)
            steady = np.asarray((lit == 0) | (lit == len(paths)))
        return np.asarray(steady.reshape(self.samples, -1).all(axis=0))

    def _at(self, lanes: Lanes, place: float) -> LanePaths:
        return self._tracer.paths(lanes, np.full((1, len(lanes.pixels)), round(float(place), 12)))

    def _polynomials(self, paths: list[LanePaths], pixels: Pixels) -> TimePaths:
        rows = pixels // np.uint32(self.size_px[0])
        return TimePaths.through(paths, rows, defocused=self.light.defocused)

    def _accuracy(
        self,
        moments: _Moments,
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
        jobs = [
            (int(frame), Lanes(pixels[frame_of == frame], self.size_px[0], self.samples))
            for frame in np.unique(frame_of)
        ]
        traced = self._tracer.traced(jobs, count + 1)
        errors = [
            images[frame].ravel()[lanes.pixels] - light
            for (frame, lanes), light in zip(jobs, traced, strict=True)
        ]
        return MotionAccuracy(
            moments=len(moments.paths),
            exposure_nodes=count,
            crossed_share=crossed_share,
            radiance_rms_percent=100.0 * _rms(errors) / moments.white,
            coordinate_rms_px=_rms([self._column_errors_px(moments, pixels, frame_of)]),
            moved_px=moments.moved_px(),
        )

    def _column_errors_px(
        self, moments: _Moments, pixels: Pixels, frame_of: IntArray
    ) -> FloatArray:
        """Return the errors of the mean column of smooth pixels in the middle of their frames."""
        probes = Lanes(pixels, self.size_px[0], self.samples)
        start, duration = self.sequence.start[frame_of], self.sequence.duration[frame_of]
        places = start + duration / 2.0 + self.sequence.row_delay * probes.rows
        chosen = (moments.smooth & moments.lit)[pixels]
        lanes, places = probes.of(chosen), places[chosen]
        paths = self._tracer.paths(lanes, places[None])
        column_px = lanes.means(paths.column_px * paths.weight)[0]
        at_moments = [path.column_px[lanes.pixels] for path in moments.paths]
        smooth_px = chebyshev.chebval(places, coefficients(at_moments), tensor=False)
        weight = lanes.means(paths.weight)[0]
        seen = weight > 0.0
        return np.asarray(smooth_px[seen] - column_px[seen] / weight[seen])


def _means(patches: Patches) -> tuple[LanePaths, BoolImage]:
    """Return the mean paths (pixel,) of traced patches, and where the samples are a patch."""
    weight, column, row, axial_mm, spread_px = (
        np.array(values, np.float32)
        for values in (
            patches.weight,
            patches.weighted_column,
            patches.weighted_row,
            patches.weighted_axial_mm,
            patches.spread_px,
        )
    )
    scale = np.divide(1.0, weight, out=np.zeros_like(weight), where=weight > 0.0)
    paths = LanePaths(column * scale, row * scale, axial_mm * scale, weight)
    return paths, np.asarray((spread_px <= SMOOTH_WITHIN_PX) | (weight == 0.0))


def _where(path: LanePaths, mask: BoolImage) -> LanePaths:
    return replace(path, weight=np.where(mask, path.weight, np.float32(0.0)))


def _rms(errors: list[FloatArray]) -> float:
    together = np.concatenate([np.zeros(0), *errors])
    return float(np.sqrt(np.mean(together**2))) if len(together) else 0.0
