"""Reference renderer for tests (engine "stock"): one render with stock Mitsuba per frame.

The projector is Mitsuba's `projector` emitter, or a `spot` emitter with the pattern as its
texture. The integrator is `direct`. Both emitters are symmetric about their axis and have neither
an offset principal point nor distortion. The pattern is therefore drawn on a larger canvas, which
is centred on the optical axis. An off-axis image is drawn outside the canvas centre, and distortion
is drawn as a warp of the image.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import mitsuba as mi
import numpy as np

from reconstruction.arrays import FloatArray, FloatImage
from reconstruction.patterns import PatternFrame, PatternSet
from reconstruction.rig.pinhole import distort, distortion_jacobian, fold_square, is_before_fold
from twin.optics.connection import Rig
from twin.optics.light import MARGIN_PX, OVERSAMPLING, LightTable, along
from twin.optics.materials import bitmap
from twin.optics.rig import field_of_view_deg, perspective_sensor, to_world
from twin.optics.stack import Frames

Emitter = Literal["projector", "spot"]

TEXELS_PER_PX = 4
"""Number of canvas texels along a projector pixel. Bilinear look-up then adds a blur of 0.1 px."""


@dataclass(frozen=True)
class Canvas:
    """Texture plane centred on the projector's optical axis.

    Attributes
    ----------
    kind : "projector" or "spot"; emitter that has this texture
    half_width_px, half_height_px : half of the width and height, in projector pixels
    texels_per_px : number of texels along a projector column
    rows_per_column : width of a projector column in rows; texels are square
    """

    kind: Emitter
    half_width_px: float
    half_height_px: float
    texels_per_px: int
    rows_per_column: float = 1.0

    def centres_px(self) -> tuple[FloatArray, FloatArray]:
        """Return x (col,) and y (row,) of the texel centres, px relative to the optical axis."""
        return (
            _centres(self.half_width_px, self.texels_per_px),
            _centres(self.half_height_px, self.texels_per_px / self.rows_per_column),
        )


def _centres(half_px: float, texels_per_px: float) -> FloatArray:
    count = 2 * round(half_px * texels_per_px)
    return (np.arange(count, dtype=np.float64) + 0.5) * (2.0 * half_px / count) - half_px


def canvas_for(rig: Rig, kind: Emitter, texels_per_px: int = TEXELS_PER_PX) -> Canvas:
    """Return the smallest canvas around the optical axis that contains the projector's image.

    The canvas includes a margin for the blur of the edge of the image. For "spot", the canvas is a
    square that contains the circle round these.
    """
    p = rig.projector.pinhole
    half_width = max(p.cx_px, p.width_px - 1 - p.cx_px) + MARGIN_PX
    ratio = p.fy_px / p.fx_px
    half_height = (max(p.cy_px, p.height_px - 1 - p.cy_px) + MARGIN_PX) / ratio  # in columns
    if kind == "spot":  # the texture is square; the round cone of the spot must contain all of it
        half_width = half_height = float(np.hypot(half_width, half_height))
    height_px = float(np.ceil(half_height)) * ratio
    return Canvas(kind, float(np.ceil(half_width)), height_px, texels_per_px, ratio)


def frame_texture(
    frame: PatternFrame, index: int, rig: Rig, tables: dict[str, LightTable], canvas: Canvas
) -> FloatImage:
    """Return the light of one frame on the canvas as a texture, (row, col) float32.

    For a `projector` emitter, row 0 is the top of the image. A `spot` emitter has a radiant
    intensity I, so that a plane receives I cos^3 / z^2. Its texture is therefore divided by cos^3.
    It is also mirrored in both directions.

    Parameters
    ----------
    index : number of the frame in the sequence
    """
    column_px, row_px = _pixels_on(canvas, rig)
    axis = along(frame)
    across = "row" if axis == "column" else "column"
    here, there = (column_px, row_px) if axis == "column" else (row_px, column_px)
    profile = tables[axis].frames.index(index)
    light = _interpolate(tables[axis], profile, here) * _interpolate(tables[across], -1, there)
    if canvas.kind == "spot":
        light = (light / _cos_cubed(canvas, rig))[::-1, ::-1]
    return np.ascontiguousarray(light, np.float32)


def _pixels_on(canvas: Canvas, rig: Rig) -> tuple[FloatArray, FloatArray]:
    """Return the projector column and row (px) of every texel, each (row, col).

    Without distortion, the shapes are (1, col) and (row, 1).
    """
    p = rig.projector.pinhole
    x_px, y_px = canvas.centres_px()
    x, y = x_px[None, :] / p.fx_px, y_px[:, None] / p.fy_px
    if any(p.distortion):
        imaged = is_before_fold(
            x, y, distortion_jacobian(x, y, p.distortion), fold_square(p.distortion)
        )
        x, y = (np.where(imaged, axis, np.inf) for axis in distort(x, y, p.distortion))
    return x * p.fx_px + p.cx_px, y * p.fy_px + p.cy_px


def _interpolate(table: LightTable, profile: int, at_px: FloatArray) -> FloatArray:
    nodes_px = table.first_px + np.arange(len(table.profiles)) / OVERSAMPLING
    values = table.profiles[:, profile].astype(np.float64)
    return np.interp(at_px.ravel(), nodes_px, values, left=0.0, right=0.0).reshape(at_px.shape)


def emitter_dict(texture: FloatImage, rig: Rig, canvas: Canvas) -> dict[str, Any]:
    """Return the dictionary of a stock emitter with the light of a frame and the rig's irradiance.

    Parameters
    ----------
    texture : result of `frame_texture` for the same canvas
    """
    full_angle_deg = field_of_view_deg(2.0 * canvas.half_width_px, rig.projector.pinhole.fx_px)
    place = {"to_world": mi.ScalarTransform4f(to_world(rig.projector.T_world_from_device))}
    if canvas.kind == "projector":
        return {
            "type": "projector",
            **place,
            "fov": full_angle_deg,
            "irradiance": bitmap(texture),
            "scale": rig.irradiance_at_1mm / np.pi,  # the emitter multiplies by pi
        }
    return {
        "type": "spot",
        **place,
        "cutoff_angle": full_angle_deg / 2.0,
        "beam_width": full_angle_deg / 2.0,
        "intensity": rig.irradiance_at_1mm,
        "texture": bitmap(texture),
    }


def _cos_cubed(canvas: Canvas, rig: Rig) -> FloatArray:
    p = rig.projector.pinhole
    x_px, y_px = canvas.centres_px()
    square = (x_px[None, :] / p.fx_px) ** 2 + (y_px[:, None] / p.fy_px) ** 2
    return np.asarray((1.0 + square) ** -1.5)


def frame_scene(
    mesh: Any, emitter: dict[str, Any], sensor: dict[str, Any], bounces: int = 0
) -> Any:
    """Return the stock Mitsuba scene of one frame, with the integrator for `bounces`."""
    return mi.load_dict(
        {
            "type": "scene",
            "integrator": integrator(bounces),
            "mesh": mesh,
            "emitter": emitter,
            "sensor": sensor,
        },
        optimize=False,
    )


def integrator(bounces: int) -> dict[str, Any]:
    """Return the dictionary of the integrator: direct light plus `bounces` further reflections."""
    if bounces == 0:
        return {"type": "direct", "emitter_samples": 1, "bsdf_samples": 0}
    # A depth of 2 is one reflection. Without Russian roulette, both renderers estimate the same
    # sum.
    return {"type": "path", "max_depth": bounces + 2, "rr_depth": bounces + 3}


def render_frame(scene: Any, seed: int) -> FloatImage:
    """Return the radiance of one rendered frame, (row, col) float32, mW / (mm^2 sr)."""
    return np.asarray(mi.render(scene, seed=seed), np.float32)[:, :, 0]


def render_stack(
    mesh: Any,
    rig: Rig,
    patterns: PatternSet,
    tables: dict[str, LightTable],
    *,
    emitter: Emitter,
    samples: int,
    bounces: int,
    seeds: list[int],
    progress: Callable[[float], None],
) -> Frames:
    """Render each frame separately; return their radiance, (row, col) float32, mW / (mm^2 sr).

    Parameters
    ----------
    emitter : "projector" or "spot"
    samples : number of rays per pixel
    bounces : number of reflections after the first one
    seeds : seed of the random numbers of each frame
    progress : called with the finished fraction

    Raises
    ------
    InputError : the camera has lens distortion, or a thin lens with an off-axis principal point
    """
    sensor = perspective_sensor(
        rig.camera.pinhole, rig.camera.T_world_from_device, samples, rig.camera.lens
    )
    canvas = canvas_for(rig, emitter)
    textures = (
        frame_texture(frame, k, rig, tables, canvas) for k, frame in enumerate(patterns.frames)
    )
    scene = frame_scene(mesh, emitter_dict(next(textures), rig, canvas), sensor, bounces)
    frames = [render_frame(scene, seeds[0])]
    # One scene for all frames: a new scene would compile a new kernel.
    pattern = mi.traverse(scene)
    texels = f"emitter.{'irradiance' if emitter == 'projector' else 'texture'}.data"
    for texture, seed in zip(textures, seeds[1:], strict=True):
        pattern[texels] = texture[..., None]
        pattern.update()
        frames.append(render_frame(scene, seed))
        progress(len(frames) / len(patterns.frames))
    return tuple(frames)
