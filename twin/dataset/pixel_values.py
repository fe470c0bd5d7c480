"""Arrays of the quantities of a sample, over camera pixels (row, col).

No value is NaN: a quantity is 0 where it does not exist. Axes, unit and meaning of each quantity
are those of `quantities`.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RegularGridInterpolator

from reconstruction.arrays import FloatArray
from reconstruction.patterns import Axis
from twin.dataset.taken import TakenSample

Array = NDArray[Any]

STAGE, MEASURED = 1, 2
"""Labels of a pixel: 0 no surface, 1 the stage, 2 the measured surface (coat or specimen)."""

_TURN = 2.0 * np.pi


def frames(taken: TakenSample) -> Array:
    """Return the recorded frames, (frame, row, col) DN, in the type of the bit depth."""
    capture = taken.fringes.capture
    kind = np.uint8 if capture.bit_depth <= 8 else np.uint16
    stack = capture.stack  # float without noise
    whole = stack if np.issubdtype(stack.dtype, np.integer) else np.rint(stack)
    return whole.astype(kind, copy=False)


def white(taken: TakenSample) -> Array:
    """Return the noise-free radiance under the white frame, mW / (mm^2 sr)."""
    return np.asarray(taken.fringes.radiance.frames[taken.patterns.index("white").start])


def albedo(taken: TakenSample) -> Array:
    """Return the reflectance of the surface at normal incidence."""
    if taken.albedo is None:
        raise TypeError("the albedo was not traced")
    return taken.albedo


def label(taken: TakenSample) -> Array:
    """Return the label of each pixel, uint8."""
    truth = taken.truth
    stage = np.where(truth.depth_mm > 0, STAGE, 0)
    return np.where(truth.measured, MEASURED, stage).astype(np.uint8)


def coordinate_px(taken: TakenSample, axis: Axis) -> Array:
    """Return the true projector coordinate along an axis, px."""
    return taken.truth.column_px if axis == "column" else taken.truth.row_px


def phase(taken: TakenSample, axis: Axis) -> FloatArray:
    """Return the true absolute phase, rad; 0 at pixels that the projector does not light."""
    turns = coordinate_px(taken, axis) / taken.patterns.period_along(axis)
    return np.asarray(np.where(taken.truth.lit, _TURN * turns, 0.0))


def phase_32(taken: TakenSample, axis: Axis) -> Array:
    """Return `phase` as float32."""
    return phase(taken, axis).astype(np.float32)


def wrapped_phase(taken: TakenSample, axis: Axis) -> Array:
    """Return the true phase in [0, 2 pi), rad."""
    # Rounding to float32 must not give 2 pi, which is the next fringe.
    below_turn = np.nextafter(np.float32(_TURN), np.float32(0))
    return np.minimum(np.mod(phase(taken, axis), _TURN).astype(np.float32), below_turn)


def order(taken: TakenSample, axis: Axis) -> Array:
    """Return the true fringe order, int16."""
    return np.floor(phase(taken, axis) / _TURN).astype(np.int16)


def decoded_phase(taken: TakenSample, axis: Axis) -> Array:
    """Return the decoded absolute phase, rad; 0 where masked."""
    decoded = taken.maps.decoded
    maps = decoded.column if axis == "column" else decoded.row
    turns = maps.coordinate_px / taken.patterns.period_along(axis)
    return np.where(decoded.valid, _TURN * turns, 0.0).astype(np.float32)


def decoded_wrapped_phase(taken: TakenSample, axis: Axis) -> Array:
    """Return the decoded phase of the single pixel, rad in [0, 2 pi)."""
    decoded = taken.maps.decoded
    return np.asarray((decoded.column if axis == "column" else decoded.row).phase_rad, np.float32)


def decoded_modulation(taken: TakenSample, axis: Axis) -> Array:
    """Return the decoded amplitude of the fringes, DN."""
    decoded = taken.maps.decoded
    maps = decoded.column if axis == "column" else decoded.row
    return np.asarray(maps.modulation_dn, np.float32)


def decoded_depth(taken: TakenSample) -> Array:
    """Return the decoded depth along the optical axis of the camera, mm; 0 where masked."""
    if taken.colours is None:
        return np.asarray(taken.maps.point_map.points_cam_mm[..., 2], np.float32)
    heights = taken.colours.heights
    # The camera looks along -z: the depth is its distance from z = 0, less the height.
    depth_mm = taken.experiment.camera.pose.standoff_mm - heights.height_mm
    return np.where(heights.valid, depth_mm, 0.0).astype(np.float32)


def decoded_normal(taken: TakenSample) -> Array:
    """Return the decoded unit normal, world, (row, col, xyz); 0 where masked."""
    if taken.colours is None:
        return np.asarray(taken.maps.point_map.normals_world, np.float32)
    heights = taken.colours.heights
    # Slopes are downwards and to the right, world y is upwards.
    down, right = heights.slopes
    normal = np.stack([-right, down, np.ones_like(down)], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    return np.where(heights.valid[..., None], normal, 0.0).astype(np.float32)


def decoded_reason(taken: TakenSample) -> Array:
    """Return the reason code of each pixel, uint8; 0: it has a result."""
    if taken.colours is None:
        return np.asarray(taken.maps.point_map.mask_reason, np.uint8)
    return np.asarray(taken.colours.heights.mask_reason, np.uint8)


def _on_pixels(
    taken: TakenSample, x_mm: FloatArray, y_mm: FloatArray, values: Array, method: str = "linear"
) -> FloatArray:
    """Return a field of the press, (y, x), at the world x and y of the point of each pixel."""
    field = RegularGridInterpolator(
        (y_mm, x_mm), values.astype(np.float64), method, bounds_error=False, fill_value=0.0
    )
    points = taken.truth.points_world_mm
    shown = field(np.stack([points[..., 1], points[..., 0]], axis=-1).astype(np.float64))
    return np.asarray(np.where(taken.truth.measured, shown, 0.0))


def contact(taken: TakenSample) -> Array:
    """Return 1 where the elastomer below the point touches the object, uint8."""
    face = taken.face
    return _on_pixels(taken, face.x_mm, face.y_mm, face.contact, "nearest").astype(np.uint8)


def pressure(taken: TakenSample) -> Array:
    """Return the contact pressure below the point, kPa."""
    face = taken.face
    return _on_pixels(taken, face.x_mm, face.y_mm, face.pressure_kpa).astype(np.float32)


def touched_face(taken: TakenSample) -> Array:
    """Return world z of the touched face below the point, mm."""
    face = taken.face
    return _on_pixels(taken, face.x_mm, face.y_mm, face.touched_face_mm).astype(np.float32)


def thickness(taken: TakenSample) -> Array:
    """Return the local thickness of the sheet below the point, mm."""
    face = taken.face
    assert face.sheet is not None  # `check_held`
    field = face.sheet.thickness_mm
    return _on_pixels(taken, face.face_x_mm, face.face_y_mm, field).astype(np.float32)
