"""All frames of a moving scene for little more than those of a scene at rest.

The scene is traced at a few moments of the sequence (`time_paths`). Three kinds of pixels differ in
how a frame follows from the moments:

- smooth: the samples of the pixel form a smooth patch at all moments. Mean projector coordinate and
  weight are polynomials of time.
- sampled: each sample of the pixel has its own polynomials, for example on a steep slope.
- traced: a sample crosses an edge, a shadow or the end of the light during the sequence. All
  samples are traced at the exposure of each frame.

The light of each frame is integrated over its exposure by Gauss's quadrature, as many nodes as the
coordinate moves pixels. Random pixels are traced at random frames with one node more. Their
differences are the stated error.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from reconstruction.arrays import BoolImage, FloatArray, FloatImage
from twin.optics.connection import FrameLight, Rig
from twin.optics.frame_times import FrameTimes
from twin.optics.moving_rig import LanePaths, Lanes
from twin.optics.one_trace import SMOOTH_WITHIN_PX, Patches
from twin.optics.stack import Frames, MotionAccuracy
from twin.optics.time_paths import (
    COORDINATE_PX,
    MOMENTS,
    ExposureNodes,
    TimePaths,
    coefficients,
    moment_places,
    smooth_lanes,
)

PROBES = 4096
"""Largest number of random pixels by which the error is measured."""

BANDS = 16
"""Groups of rows of a rolling shutter that are traced at the same time, that of their middle."""

_MOST_NODES = 16


class MovingScene(Protocol):
    """A scene that moves relative to its rig; times are seconds from the sequence's middle."""

    def at(self, time_s: float) -> tuple[Any, Rig]:
        """Return scene and rig at a time."""

    def patches_at(self, time_s: float) -> Patches:
        """Return the traced rays of all pixels at a time."""


@dataclass(frozen=True, eq=False)
class ExposureSequence:
    """Times of all frames, relative to half of the sequence; its middle is 0.

    Attributes
    ----------
    half_s : half of the time from the first exposure to the end of the last one, in all rows
    start, duration : (frame,) relative start and duration of the exposures in row 0
    row_delay : relative time from one row to the next
    """

    half_s: float
    start: FloatArray
    duration: FloatArray
    row_delay: float

    @classmethod
    def of(cls, times: FrameTimes, row_delay_s: float) -> "ExposureSequence":
        """Return the relative times of exposures in row 0."""
        half_s = float(-times.start_s[0])
        return cls(
            half_s, times.start_s / half_s, times.duration_s / half_s, row_delay_s / half_s
        )

    def nodes(self, frame: int, count: int, delay: float = 0.0) -> ExposureNodes:
        """Return the Gauss nodes of a frame, later by a relative delay than in row 0."""
        start, duration = float(self.start[frame]), float(self.duration[frame])
        return ExposureNodes.of(start + delay, duration, count)


@dataclass(frozen=True, eq=False)
class _Moments:
    """Mean paths of all pixels at the moments, and whether the samples form a smooth patch."""

    paths: list[LanePaths]
    patch: list[BoolImage]

    @property
    def white(self) -> float:
        """Mean weight of all lit pixels."""
        weights = np.asarray([path.weight for path in self.paths])
        return float(weights[weights > 0.0].mean()) if (weights > 0.0).any() else 1.0

    @property
    def smooth(self) -> BoolImage:
        """Pixels (pixel,) that are dark, or a smooth patch that is a polynomial of time."""
        return np.asarray(smooth_lanes(self.paths, self.white) & np.all(self.patch, axis=0))

    def speed_px(self) -> float:
        """Return the largest speed of a coordinate, px per relative time, of 99 % of the pixels."""
        lit = np.all([path.weight > 0.0 for path in self.paths], axis=0)
        changes = [
            np.abs(np.diff([getattr(path, name) for path in self.paths], axis=0)).max(axis=0)[lit]
            for name in ("column_px", "row_px")
        ]
        shortest = float(np.diff(moment_places(len(self.paths))).min())
        return float(np.percentile(np.maximum(*changes), 99)) / shortest if lit.any() else 0.0


@dataclass(frozen=True, eq=False)
class MovingStack:
    """Frames of a moving scene, traced at the moments that it needs.

    Attributes
    ----------
    scene : the scene and its rig at any time
    sequence : times of the frames
    light : light of the frames
    size_px : width and height of the image
    samples : rays per pixel
    """

    scene: MovingScene
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
        renderer = self._renderer(moments, count)
        images = []
        for frame in range(len(self.sequence.start)):
            images.append(renderer.image(frame))
            progress((frame + 1) / len(self.sequence.start))
        return tuple(images), renderer.error(images, rng)

    def _moments(self) -> _Moments:
        """Trace 3 moments, and more if this costs less than tracing pixels frame by frame."""
        traced: dict[float, tuple[LanePaths, BoolImage]] = {}
        for count in MOMENTS:
            places = [round(float(place), 12) for place in moment_places(count)]
            for place in places:
                if place not in traced:
                    patches = self.scene.patches_at(place * self.sequence.half_s)
                    traced[place] = _means(patches)
            moments = _Moments(*map(list, zip(*(traced[at] for at in places), strict=True)))
            traced_work = _curved_share(moments) * len(self.sequence.start) * self._nodes(moments)
            if traced_work <= count - 1:
                break
        return moments

    def _nodes(self, moments: _Moments) -> int:
        """Return the number of Gauss nodes: one more than the pixels of an exposure's motion."""
        moved_px = moments.speed_px() * float(self.sequence.duration.max())
        return min(1 if moved_px <= 0.1 else int(np.ceil(moved_px)) + 1, _MOST_NODES)

    def _renderer(self, moments: _Moments, count: int) -> "_Renderer":
        width, height = self.size_px
        smooth = moments.smooth
        pixels = np.arange(width * height, dtype=np.uint32)
        rest = Lanes(pixels[~smooth], width, self.samples)
        paths = [rest.traced(*self.scene.at(time_s)) for time_s in self._times(moments)]
        steady = smooth_lanes(paths, moments.white).reshape(self.samples, -1).all(axis=0)
        chosen = np.tile(steady, self.samples)
        return _Renderer(
            stack=self,
            count=count,
            white=moments.white,
            smooth=self._polynomials([_where(path, smooth) for path in moments.paths], pixels),
            sampled=rest.of(steady),
            samples=self._polynomials(
                [_chosen(path, chosen) for path in paths],
                np.tile(rest.of(steady).pixels, self.samples),
            ),
            traced=rest.of(~steady),
            moments=moments,
        )

    def _times(self, moments: _Moments) -> list[float]:
        return [float(at) * self.sequence.half_s for at in moment_places(len(moments.paths))]

    def _polynomials(self, paths: list[LanePaths], pixels: NDArray[np.uint32]) -> TimePaths:
        rows = pixels // np.uint32(self.size_px[0])
        return TimePaths.through(paths, rows, defocused=self.light.defocused)


@dataclass(frozen=True, eq=False)
class _Renderer:
    """The three kinds of pixels of a moving stack, ready for its frames."""

    stack: MovingStack
    count: int
    white: float
    smooth: TimePaths
    sampled: Lanes
    samples: TimePaths
    traced: Lanes
    moments: _Moments

    def image(self, frame: int) -> FloatImage:
        """Return one frame (row, col), mW / (mm^2 sr)."""
        stack, (width, height) = self.stack, self.stack.size_px
        nodes, delay = stack.sequence.nodes(frame, self.count), stack.sequence.row_delay
        image = self.smooth.light(stack.light, frame, nodes, delay)
        if len(self.sampled.pixels):
            values = self.samples.light(stack.light, frame, nodes, delay)
            image[self.sampled.pixels] = self.sampled.means(values)
        if len(self.traced.pixels):
            image[self.traced.pixels] = self.traced_light(self.traced, frame, self.count)
        return image.reshape(height, width)

    def traced_light(self, lanes: Lanes, frame: int, count: int) -> FloatArray:
        """Return the radiance (pixel,) of one frame, traced at `count` nodes of its exposure."""
        sequence, light = self.stack.sequence, np.zeros(len(lanes.pixels))
        for band, row in self._bands(lanes.rows):
            chosen = lanes.of(band)
            nodes = sequence.nodes(frame, count, row * sequence.row_delay)
            for place, share in zip(nodes.places, nodes.shares, strict=True):
                at = self.stack.scene.at(float(place) * sequence.half_s)
                values = self.stack.light.value(chosen.connections(*at), frame)
                light[band] += share * chosen.means(np.array(values, np.float32))
        return light

    def _bands(self, rows: NDArray[np.intp]) -> Iterator[tuple[BoolImage, float]]:
        """Yield masks (pixel,) of groups of rows that are traced at one time, and their middle."""
        if self.stack.sequence.row_delay == 0.0:
            yield np.ones(len(rows), bool), 0.0
            return
        edges = np.linspace(0, self.stack.size_px[1], BANDS + 1).astype(int)
        for first, last in zip(edges[:-1], edges[1:], strict=True):
            band = (rows >= first) & (rows < last)
            if band.any():
                yield band, (first + last - 1) / 2.0

    def error(self, images: list[FloatImage], rng: np.random.Generator) -> MotionAccuracy:
        """Return the error of random pixels of random frames, traced with one node more."""
        lit = np.any([path.weight > 0.0 for path in self.moments.paths], axis=0)
        pixels = np.flatnonzero(lit).astype(np.uint32)
        chosen = rng.choice(pixels, min(PROBES, len(pixels)), replace=False)
        frame_of = rng.integers(len(images), size=len(chosen))
        radiance, coordinate = [np.zeros(0)], [np.zeros(0)]
        for frame in np.unique(frame_of):
            probes = Lanes(chosen[frame_of == frame], self.stack.size_px[0], self.stack.samples)
            light = self.traced_light(probes, int(frame), self.count + 1)
            radiance.append(images[frame].ravel()[probes.pixels] - light)
            coordinate.append(self._coordinate_errors_px(probes, int(frame)))
        return MotionAccuracy(
            moments=len(self.moments.paths),
            exposure_nodes=self.count,
            traced_share=len(self.traced.pixels) / max(1, len(pixels)),
            radiance_rms_percent=100.0 * _rms(np.concatenate(radiance)) / self.white,
            coordinate_rms_px=_rms(np.concatenate(coordinate)),
        )

    def _coordinate_errors_px(self, probes: Lanes, frame: int) -> FloatArray:
        """Return the errors of the mean column of smooth pixels in the middle of a frame."""
        sequence = self.stack.sequence
        lanes = probes.of(self.moments.smooth[probes.pixels])
        errors = [np.zeros(0)]
        for band, row in self._bands(lanes.rows):
            chosen = lanes.of(band)
            (place,) = sequence.nodes(frame, 1, row * sequence.row_delay).places
            paths = chosen.traced(*self.stack.scene.at(float(place) * sequence.half_s))
            weight = chosen.means(paths.weight)
            column_px = chosen.means(paths.column_px * paths.weight)[weight > 0.0]
            moments = [path.column_px[chosen.pixels] for path in self.moments.paths]
            smooth_px = np.polynomial.chebyshev.chebval(place, coefficients(moments))
            errors.append(smooth_px[weight > 0.0] - column_px / weight[weight > 0.0])
        return np.concatenate(errors)


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


def _chosen(path: LanePaths, mask: BoolImage) -> LanePaths:
    return LanePaths(*(getattr(path, name)[mask] for name in vars(path)))


def _curved_share(moments: _Moments) -> float:
    """Return the share of pixels that further moments may make smooth: lit, and close to it."""
    always = np.all([path.weight > 0.0 for path in moments.paths], axis=0)
    last_px = [
        np.abs(coefficients([getattr(path, name) for path in moments.paths])[-1])
        for name in ("column_px", "row_px")
    ]
    curved = always & (np.maximum(*last_px) > COORDINATE_PX) & (np.maximum(*last_px) < 1.0)
    return float(np.mean(curved))


def _rms(errors: FloatArray) -> float:
    return float(np.sqrt(np.mean(errors**2))) if len(errors) else 0.0
