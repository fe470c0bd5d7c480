"""Light of the projector per frame, as continuous 1-D profiles over its pixel coordinate.

Column patterns depend on the projector column u only, row patterns on the row v only. A frame's
light at (u, v) is therefore profile(u) * edge(v) or profile(v) * edge(u); `edge` is the blurred
outline of the image. Profiles include 8-bit levels, response, black level (finite
contrast), the DMD's pixel box and the lens blur.

With a projector aperture the blur depends on the distance from the focal plane, and there are
profiles at several blurs. A pupil point has the offset a from the axis (mm); f is the focal length
in pixels. At axial distance z, light from this point is offset from the chief ray by
f a (1/z - 1/z_focus) projector pixels. This is exact for a thin lens, anywhere in the field. Light
from a uniformly filled pupil of diameter D therefore spreads over a circle of confusion of diameter
c = f D |1/z - 1/z_focus| pixels. The standard deviation of this disc along each axis is c / 4.

Lengths of the blur are in columns; in rows they are larger by the ratio of a pixel's width to its
height.

Approximations: the disc is replaced by a Gaussian of equal variance, which is added to the variance
of the lens blur. The transfer functions of disc and Gaussian agree to second order in c times the
spatial frequency. f is that of the undistorted image. Irradiance and shadows are those of the
pupil's centre: shadows have no penumbra.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from reconstruction.arrays import FloatArray, FloatImage, Levels
from reconstruction.patterns import PatternFrame, PatternSet
from reconstruction.pixel_shape import pixels_per_column, smear_px
from reconstruction.rig.projected_light import blurred, relative_light
from twin.config.models import Patterns, Projector
from twin.optics.rig import projector_pinhole, world_from_device

OVERSAMPLING = 16
"""Number of table nodes per projector pixel. The error of linear interpolation between nodes is
below 1e-3 of white at the edge of a Gray bit blurred by 0.5 px, and below 1e-4 on an 18 px
fringe."""

MARGIN_PX = 8.0
"""Width of the margin of the tables outside the image; the margin contains the blurred edge."""


LEVELS_PER_OCTAVE = 4
"""Number of blur levels per doubling of the variance. Between two levels the light is interpolated
in the logarithm of the variance. The second derivative of an edge by this logarithm is at most
0.081, so that the error is at most 0.081 / 8 (ln(2) / 4)^2 = 3e-4 of white."""

LEAST_VARIANCE_PX2 = 0.1**2
"""Smallest blur variance of the tables; nodes at a spacing of 1/16 px do not resolve less blur."""


@dataclass(frozen=True)
class Defocus:
    """Blur of a projector as a function of the axial distance z.

    Attributes
    ----------
    blur_px : standard deviation of the blur in the focal plane
    growth_px_mm : standard deviation of the defocus per difference of 1/z from the focal plane:
        focal length (px) times pupil diameter (mm) / 4
    focus_mm : axial distance of the focal plane
    """

    blur_px: float
    growth_px_mm: float
    focus_mm: float

    @classmethod
    def of(cls, projector: Projector) -> "Defocus | None":
        """Return the blur of a projector; None if its aperture is 0, so that the blur is constant.

        Without `projector.focus_mm`, the focal plane contains the world origin.
        """
        if projector.aperture_mm == 0.0:
            return None
        pinhole = projector_pinhole(projector)
        growth_px_mm = pinhole.fx_px * projector.aperture_mm / 4.0
        if projector.focus_mm is not None:
            return cls(projector.blur_px, growth_px_mm, projector.focus_mm)
        pose = world_from_device(projector.pose, pinhole)
        origin_axial_mm = float(-pose[:3, 3] @ pose[:3, 2])
        return cls(projector.blur_px, growth_px_mm, origin_axial_mm)

    def variance_px2(self, axial_mm: Any) -> Any:
        """Return the variance of the blur (px^2) at an axial distance.

        Parameters
        ----------
        axial_mm : number, numpy array or `mi.Float`
        """
        spread_px = self.growth_px_mm * (1.0 / axial_mm - 1.0 / self.focus_mm)
        return spread_px * spread_px + self.blur_px**2


@dataclass(frozen=True)
class BlurLevels:
    """Blur variances (px^2) of the light tables, equally spaced in their natural logarithm.

    `first_log` is the logarithm of the smallest variance, `count` the number of variances.
    """

    defocus: Defocus
    first_log: float
    count: int

    @classmethod
    def between(cls, defocus: Defocus, near_mm: float, far_mm: float) -> "BlurLevels":
        """Return the levels that cover every blur between two axial distances."""
        at_ends = [float(defocus.variance_px2(z)) for z in (near_mm, far_mm)]
        in_focus = near_mm <= defocus.focus_mm <= far_mm
        least = defocus.blur_px**2 if in_focus else min(at_ends)
        first_log, last_log = np.log(np.maximum([least, max(at_ends)], LEAST_VARIANCE_PX2))
        count = int(np.ceil((last_log - first_log) / cls.step_log())) + 1
        return cls(defocus, float(first_log), max(count, 2))

    @staticmethod
    def step_log() -> float:
        """Return the natural logarithm of the ratio of two neighbouring variances."""
        return float(np.log(2.0) / LEVELS_PER_OCTAVE)

    def blurs_px(self) -> list[float]:
        """Return the standard deviation of the blur at each level, px."""
        logs = self.first_log + self.step_log() * np.arange(self.count)
        return [float(sigma) for sigma in np.exp(0.5 * logs)]


@dataclass(frozen=True)
class LightTable:
    """Light of the frames along one projector axis, as profiles on equally spaced nodes.

    Attributes
    ----------
    profiles : (node, frame) float32; relative light at best focus, 1 for a full white field; the
        last column is the outline of the image
    first_px : projector coordinate of node 0, px; the node spacing is 1 / OVERSAMPLING px
    frames : (frame,) int; index of each profile's frame in the sequence
    levels : blurs of `defocused`; None if the blur is the same at every distance
    defocused : (level, node, frame) float32; `profiles` at each of these blurs
    """

    profiles: FloatImage
    first_px: float
    frames: tuple[int, ...]
    levels: BlurLevels | None = None
    defocused: FloatImage | None = None


def pattern_set(projector: Projector, patterns: Patterns) -> PatternSet:
    """Return the sequence of patterns that the projector shows and the decoder assumes."""
    shown = patterns.model_dump() | {"pixel_ratio": projector.pixel_ratio}
    return PatternSet(projector.width_px, projector.height_px, **shown)


def light_tables(
    projector: Projector, patterns: PatternSet, axial_mm: tuple[float, float] | None = None
) -> dict[str, LightTable]:
    """Return the light tables of both axes by name: "column" (with white and black) and "row".

    Parameters
    ----------
    axial_mm : (nearest, farthest) distance of the surfaces along the projector's axis; required if
        the projector has an aperture

    Raises
    ------
    ValueError : the projector has an aperture, and no distances are given
    """
    defocus, levels = Defocus.of(projector), None
    if defocus is not None:
        if axial_mm is None:
            raise ValueError("a projector with an aperture needs the scene's axial distances")
        levels = BlurLevels.between(defocus, *axial_mm)
    return {axis: _table(axis, projector, patterns, levels) for axis in ("column", "row")}


def _table(
    axis: str, projector: Projector, patterns: PatternSet, blur_levels: BlurLevels | None
) -> LightTable:
    length = projector.width_px if axis == "column" else projector.height_px
    chosen = [k for k, frame in enumerate(patterns.frames) if along(frame) == axis]
    levels = np.zeros((length, len(chosen)), np.uint8)
    for column, k in enumerate(chosen):
        levels[:, column] = patterns.profile(patterns.frames[k])
    shown = response(levels, projector) + dithering_error(levels, projector, chosen)
    light = np.concatenate([shown, np.ones((length, 1))], axis=1)
    first_px = -0.5 - MARGIN_PX
    nodes_px = np.arange(first_px, length - 0.5 + MARGIN_PX, 1.0 / OVERSAMPLING)
    shape = projector.pixel_ratio
    smear, scale = smear_px(shape, axis), pixels_per_column(shape, axis)
    sharp = blurred(light, nodes_px, scale * projector.blur_px, smear)
    table = LightTable(sharp.astype(np.float32), first_px, tuple(chosen))
    if blur_levels is None:
        return table
    defocused = [blurred(light, nodes_px, scale * blur, smear) for blur in blur_levels.blurs_px()]
    return replace(table, levels=blur_levels, defocused=np.stack(defocused).astype(np.float32))


def along(frame: PatternFrame) -> str:
    """Return the axis of the table that contains a frame; uniform frames are in "column"."""
    return frame.axis or "column"


def response(levels: Levels | FloatArray, projector: Projector) -> FloatArray:
    """Return the light of 8-bit levels relative to white: black level plus power law or table.

    The black level is 1 / contrast.
    """
    black = 1.0 / projector.contrast
    relative = relative_light(levels, projector.gamma, projector.response or ())
    return np.asarray(black + (1.0 - black) * relative)


def dithering_error(levels: Levels, projector: Projector, frames: Sequence[int]) -> FloatArray:
    """Return the light of levels (pixel, frame), relative to white, minus that of whole periods.

    Parameters
    ----------
    frames : number of each frame in the sequence, which determines the start of its exposure
    """
    periods = projector.dither_periods
    if periods is None:
        return np.zeros(levels.shape)
    relative = relative_light(levels, projector.gamma, projector.response or ())
    codes = np.rint(255.0 * relative).astype(np.int64)
    start = np.array(frames) * periods
    bits = np.arange(7, -1, -1)
    lengths = np.asarray(2.0**bits / 255.0, np.float64)
    on = _time_on(start + periods, lengths) - _time_on(start, lengths)
    error = (on / periods - lengths[:, None])[:, None] * (codes >> bits[:, None, None] & 1)
    return np.asarray((1.0 - 1.0 / projector.contrast) * error.sum(axis=0))


def _time_on(until: FloatArray, lengths: FloatArray) -> FloatArray:
    """Return for how many periods each bit was shown from 0 to `until` periods, (bit, frame).

    Parameters
    ----------
    lengths : (bit,) share of the period, in the order of the bits
    """
    first = np.concatenate([[0.0], np.cumsum(lengths)[:-1]])[:, None]
    within = np.clip(until % 1.0 - first, 0.0, lengths[:, None])
    return np.asarray(np.floor(until) * lengths[:, None] + within)
