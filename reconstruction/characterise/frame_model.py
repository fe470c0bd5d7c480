"""Model of the values of some pixels in all frames, and the elimination of the pixels' unknowns.

The model is that of `projector_fit`: o_p + s_p L_k(u_p or v_p; gamma, blur), DN.
"""

from dataclasses import dataclass

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.patterns import AXES, PatternSet
from reconstruction.pixel_shape import pixels_per_column, smear_px
from reconstruction.rig.projected_light import ProjectorResponse, blurred
from reconstruction.rig.sensor import SensorNoise

PER_PX = 16
_DIFFERENCE = 1e-3


@dataclass(frozen=True, eq=False)
class FittedPixels:
    """The fitted pixels and their unknowns.

    frames : (pixel, frame) measured values, DN
    own : (pixel, 2 + number of axes) unknowns of each pixel: o, s, DN, then u and v, projector px
    block : (pixel,) number of the image block that contains the pixel
    axes : index in `AXES` of each projector axis
    """

    frames: FloatArray
    own: FloatArray
    block: FloatArray
    axes: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class LinearFrames:
    """The model and its derivatives at given values of all unknowns.

    predicted : (pixel, frame) predicted values, DN
    own : (pixel, frame, unknown of the pixel) derivatives by o, s, u, v
    common : (pixel, frame, 2) derivatives by gamma and blur
    """

    predicted: FloatArray
    own: FloatArray
    common: FloatArray


class LightNodes:
    """Tables (node, frame) of the light L_k along one axis, with 16 nodes per projector pixel.

    Further tables have its derivatives by position, gamma and blur.
    """

    def __init__(self, patterns: PatternSet, axis: int, light: FloatArray) -> None:
        name = AXES[axis]
        self.frames = [k for k, frame in enumerate(patterns.frames) if frame.axis == name]
        levels = np.stack([patterns.profile(patterns.frames[k]) for k in self.frames], axis=1)
        self._nodes_px = np.arange(0.0, patterns.length_px(name) - 1.0, 1.0 / PER_PX)

        per_column = pixels_per_column(patterns.pixel_ratio, name)
        smear = smear_px(patterns.pixel_ratio, name)

        def shown(gamma: float, blur_px: float) -> FloatArray:
            relative = ProjectorResponse(gamma).light(levels)
            return blurred(relative, self._nodes_px, per_column * blur_px, smear)

        gamma, blur_px = light.tolist()
        self.light = shown(gamma, blur_px)
        up, wide = gamma + _DIFFERENCE, blur_px + _DIFFERENCE
        down, narrow = gamma - _DIFFERENCE, blur_px - _DIFFERENCE
        self.by_gamma = (shown(up, blur_px) - shown(down, blur_px)) / (2.0 * _DIFFERENCE)
        self.by_blur = (shown(gamma, wide) - shown(gamma, narrow)) / (2.0 * _DIFFERENCE)
        self.by_place = np.gradient(self.light, 1.0 / PER_PX, axis=0)

    def at(self, table: FloatArray, u_px: FloatArray) -> FloatArray:
        """Return a table interpolated at positions (pixel,), projector px: (pixel, frame)."""
        place = np.clip(u_px * PER_PX, 0.0, len(self._nodes_px) - 1.001)
        node = place.astype(int)
        share = (place - node)[:, None]
        return np.asarray(table[node] + share * (table[node + 1] - table[node]))


def linear_frames(pixels: FittedPixels, patterns: PatternSet, light: FloatArray) -> LinearFrames:
    """Return the model and its derivatives; `light` is gamma and blur, projector px."""
    count = len(patterns.frames)
    shape = len(pixels.frames), count
    relative, by_gamma, by_blur = np.zeros(shape), np.zeros(shape), np.zeros(shape)
    own = np.zeros((*shape, pixels.own.shape[1]))
    for place, axis in enumerate(pixels.axes):
        table = LightNodes(patterns, axis, light)
        u_px = pixels.own[:, 2 + place]
        relative[:, table.frames] = table.at(table.light, u_px)
        by_gamma[:, table.frames] = table.at(table.by_gamma, u_px)
        by_blur[:, table.frames] = table.at(table.by_blur, u_px)
        by_place = table.at(table.by_place, u_px) * pixels.own[:, 1:2]
        own[:, table.frames, 2 + place] = by_place
    for k, frame in enumerate(patterns.frames):
        if frame.axis is None:
            relative[:, k] = _uniform(patterns, frame.kind == "white", light[0])
            change = _uniform(patterns, frame.kind == "white", light[0] + _DIFFERENCE)
            by_gamma[:, k] = (change - relative[:, k]) / _DIFFERENCE
    own[..., 0], own[..., 1] = 1.0, relative
    scale = pixels.own[:, 1:2]
    predicted = pixels.own[:, 0:1] + scale * relative
    return LinearFrames(predicted, own, np.stack([scale * by_gamma, scale * by_blur], axis=-1))


def _uniform(patterns: PatternSet, is_white: bool, gamma: float) -> float:
    level = patterns.high_level if is_white else patterns.low_level
    return float((level / 255.0) ** gamma)


def _weights(predicted: FloatArray, noise: SensorNoise) -> FloatArray:
    return np.asarray(1.0 / np.maximum(noise.variance_dn2(predicted), 1e-3))


@dataclass(frozen=True, eq=False)
class Eliminated:
    """Residuals and derivatives by gamma and blur after elimination of the pixels' own unknowns.

    weight : (pixel, frame) 1 / variance
    inverse : (pixel, unknown, unknown) inverse of the normal matrix of the pixel's own unknowns
    residual, common : (pixel, frame) and (pixel, frame, 2), residuals and derivatives, orthogonal
        to the derivatives by the pixel's own unknowns
    own_step : (pixel, unknown) Gauss-Newton step of the own unknowns at fixed gamma and blur
    own_by_common : (pixel, unknown, 2) reduction of that step per change of gamma and blur
    """

    weight: FloatArray
    inverse: FloatArray
    residual: FloatArray
    common: FloatArray
    own_step: FloatArray
    own_by_common: FloatArray


def eliminated(pixels: FittedPixels, model: LinearFrames, noise: SensorNoise) -> Eliminated:
    """Eliminate the pixels' own unknowns from residuals and derivatives (variable projection)."""
    weight = _weights(model.predicted, noise)
    residual = pixels.frames - model.predicted
    weighted = model.own * weight[..., None]
    normal = np.einsum("pki,pkj->pij", weighted, model.own)
    # If the values of a pixel do not depend on its coordinate, the coordinate is not changed.
    normal += 1e-9 * np.einsum("pii->pi", normal)[:, :, None] * np.eye(normal.shape[-1])
    inverse = np.linalg.inv(normal)
    own_step = np.einsum("pij,pkj,pk->pi", inverse, weighted, residual)
    own_by_common = np.einsum("pij,pkj,pkc->pic", inverse, weighted, model.common)
    return Eliminated(
        weight,
        inverse,
        residual - np.einsum("pki,pi->pk", model.own, own_step),
        model.common - np.einsum("pki,pic->pkc", model.own, own_by_common),
        own_step,
        own_by_common,
    )
