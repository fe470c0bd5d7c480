"""All pixels of a moving scene at the moments, and which of them are smooth.

All samples of a pixel are traced in the middle of the sequence. Another moment adds the change of
the ray through the pixel's centre since then: over a smooth patch all samples change alike. A ray
does not show an edge that is in another part of its pixel. Such an edge is in the middle of the
sequence between the centres of two pixels, or crosses one of them. A pixel is smooth only if the
image is smooth there in the middle, and if the centres of the eight pixels around it are smooth.
"""

import functools
import operator
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, Protocol

import drjit as dr
import mitsuba as mi
import numpy as np
from scipy.ndimage import binary_erosion

from reconstruction.arrays import BoolImage
from twin.optics.connection import Connection, FrameLight
from twin.optics.exposures import ExposureSequence
from twin.optics.moving_pixels import MovingScene
from twin.optics.one_trace import SMOOTH_WITHIN_PX, Patches
from twin.optics.time_paths import (
    COORDINATE_PX,
    MOMENTS,
    WEIGHT_SHARE,
    LitMoment,
    coefficients,
    moment_places,
)

_PLACES = ("column_px", "row_px")
# Rays of a sampled pixel over those of all pixels at one more moment, per pixel: about 7 rays of
# each of 4 samples, with 3 times the time. A pressed face is pressed at each moment.
_SAMPLED_OVER_MOMENT = {True: 100, False: 20}
# Largest second differences of neighbouring pixels, px and relative to the mean weight.
_JUMP_PX, _JUMP_OF_WHITE = 0.25, 0.05
# Largest difference of the mean weight of all samples from that of the centre, of which it is a
# share. One missing sample of 16 is more.
_LIKE_CENTRE = 0.05


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

    def patches_at(self, time_s: float, samples: int | None = None) -> Patches:
        """Return the traced rays of all pixels at a time.

        Parameters
        ----------
        samples : rays per pixel; None: as many as the experiment has
        """


@dataclass(frozen=True, eq=False)
class Moments:
    """All pixels at the moments.

    Attributes
    ----------
    at : pixels at each moment
    patch : (pixel,) True for pixels without light, or of which the samples form a smooth patch
    width_px : width of the image
    by_centres : True if all moments but the middle are traced through the centres of the pixels
    """

    at: list[LitMoment]
    patch: BoolImage
    width_px: int
    by_centres: bool

    @cached_property
    def lit(self) -> BoolImage:
        """Pixels (pixel,) with light at all moments."""
        return np.array(self._always_lit)

    @cached_property
    def ever_lit(self) -> BoolImage:
        """Pixels (pixel,) with light at one moment or more."""
        return np.array(functools.reduce(operator.or_, self._lit_at))

    @cached_property
    def white(self) -> float:
        """Mean weight of all lit pixels."""
        weights = np.array([np.array(moment.path.weight) for moment in self.at])
        lit = np.count_nonzero(weights)
        return float(weights.sum(dtype=np.float64) / lit) if lit else 1.0

    @cached_property
    def smooth(self) -> BoolImage:
        """Pixels (pixel,) that are dark, or a smooth patch that is a polynomial of time."""
        limits = dict.fromkeys(_PLACES, COORDINATE_PX)
        limits |= dict.fromkeys(("on_columns", "on_rows"), WEIGHT_SHARE * self.white)
        steady = self._always_lit
        for name, limit in limits.items():
            steady &= dr.abs(self._last(name)) <= dr.opaque(mi.Float, limit)
        smooth = np.array(steady) | ~self.ever_lit
        if self.by_centres:
            image = smooth.reshape(-1, self.width_px)
            smooth = binary_erosion(image, np.ones((3, 3)), border_value=1).ravel()
            smooth &= ~self._broken()
        return np.asarray(smooth & self.patch)

    def _broken(self) -> BoolImage:
        """Return True for pixels (pixel,) next to an edge in the middle of the sequence.

        The image has a large second difference there along rows or columns.
        """
        path, limits = self.at[len(self.at) // 2].path, dict.fromkeys(_PLACES, _JUMP_PX)
        limits["weight"] = _JUMP_OF_WHITE * self.white
        broken = np.zeros((self.patch.size // self.width_px, self.width_px), bool)
        for name, limit in limits.items():
            image = np.array(getattr(path, name), np.float32).reshape(broken.shape)
            broken[1:-1] |= np.abs(np.diff(image, 2, axis=0)) > limit
            broken[:, 1:-1] |= np.abs(np.diff(image, 2, axis=1)) > limit
        return broken.ravel()

    def curved_share(self) -> float:
        """Return the share of lit pixels that further moments may make smooth."""
        largest_px = dr.maximum(*(dr.abs(self._last(name)) for name in _PLACES))
        curved = self._always_lit & (largest_px > COORDINATE_PX) & (largest_px < 1.0)
        return float(np.mean(np.array(curved)))

    def moved_px(self) -> float:
        """Return the median change of a coordinate from first to last moment, see the result."""
        if not self.lit.any():
            return 0.0
        first, last = self.at[0].path, self.at[-1].path
        changes_px = last.column_px - first.column_px, last.row_px - first.row_px
        return max(float(np.median(np.abs(np.array(of)[self.lit]))) for of in changes_px)

    @cached_property
    def speed_px(self) -> float:
        """Largest speed of a coordinate, px per relative time, of 99 % of the pixels."""
        if not self.lit.any():
            return 0.0
        largest, widths = mi.Float(0.0), np.diff(moment_places(len(self.at)))
        for before, after, width in zip(self.at, self.at[1:], widths.tolist(), strict=False):
            for name in _PLACES:
                change_px = after.quantity(name) - before.quantity(name)
                largest = dr.maximum(largest, dr.abs(change_px) / width)
        return float(np.percentile(np.array(largest)[self.lit], 99))

    @property
    def _lit_at(self) -> list[Any]:
        return [moment.path.lit for moment in self.at]

    @property
    def _always_lit(self) -> Any:
        return functools.reduce(operator.and_, self._lit_at)

    def _last(self, name: str) -> Any:
        """Return the last Chebyshev coefficient of a quantity."""
        return coefficients([moment.quantity(name) for moment in self.at])[-1]


@dataclass(frozen=True, eq=False)
class MomentTracer:
    """Traces all pixels at the moments."""

    scene: PatchedScene
    sequence: ExposureSequence
    light: FrameLight
    width_px: int

    def moments(self) -> Moments:
        """Return 3 moments, or more if they cost less than tracing pixels one by one."""
        counts = MOMENTS if self.scene.any_time else MOMENTS[:-1]
        over = _SAMPLED_OVER_MOMENT[self.scene.any_time]
        # At 3 moments an odd function of time, such as a sine, is equal to a straight line.
        for count in counts[1:] if self.scene.vibrates else counts:
            moments = self._of(count)
            if moments.curved_share() * over <= count - 1:
                break
        return moments

    def _of(self, count: int) -> Moments:
        places = [round(float(place), 12) for place in moment_places(count)]
        traced = [self._at(place) for place in places]
        patch = np.array(functools.reduce(operator.and_, (is_patch for _, is_patch in traced)))
        at = [LitMoment.of(path, self.light) for path, _ in traced]
        dr.eval(at)
        return Moments(at, patch, self.width_px, self.scene.any_time)

    @cached_property
    def _traced(self) -> dict[tuple[float, int | None], tuple[Connection, Any]]:
        return {}

    def _means(self, place: float, samples: int | None) -> tuple[Connection, Any]:
        """Return all pixels at a relative time, and where their samples are a patch, `mi.Bool`."""
        if (place, samples) not in self._traced:
            patches = self.scene.patches_at(self.sequence.time_s(place), samples)
            is_patch = (patches.spread_px <= SMOOTH_WITHIN_PX) | (patches.weight == 0.0)
            # Evaluated at once: otherwise a further number of moments would trace them again.
            traced = patches.mean_connection(mi.Bool(True)), is_patch
            dr.eval(traced)
            self._traced[place, samples] = traced
        return self._traced[place, samples]

    def _at(self, place: float) -> tuple[Connection, Any]:
        middle, is_patch = self._means(0.0, None)
        if not self.scene.any_time:
            return self._means(place, None)
        before, after = (self._means(time, 1)[0] for time in (0.0, place))
        unlike = dr.abs(middle.weight - before.weight) > _LIKE_CENTRE * before.weight
        return _changed(middle, before, after), is_patch & ~unlike


def _changed(path: Connection, before: Connection, after: Connection) -> Connection:
    """Return a connection plus the change of another one, or the other one if either was dark."""
    both = path.lit & before.lit
    column_px, row_px, axial_mm, weight = (
        getattr(after, name)
        + dr.select(both, getattr(path, name) - getattr(before, name), mi.Float(0.0))
        for name in (*_PLACES, "axial_mm", "weight")
    )
    lit = after.lit & (weight > 0.0)
    return Connection(column_px, row_px, dr.select(lit, weight, 0.0), lit, axial_mm)
