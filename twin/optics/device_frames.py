"""The one place where our conventions meet Mitsuba's.

Ours: OpenCV device frames (x right, y down, z forward), pixel (0, 0) at the CENTRE of the first
pixel. Mitsuba: device frames with x left, y up, z forward, pixel coordinates counted from the
CORNER, fields of view instead of focal lengths, principal point offsets as fractions.
"""

from typing import Any

import numpy as np

from reconstruction.arrays import FloatArray, FloatImage
from reconstruction.rig.calibration import Pinhole
from twin.optics.rig import ThinLens

_OPENCV_FROM_MITSUBA = np.diag([-1.0, -1.0, 1.0, 1.0])


def to_world(T_world_from_device: FloatArray) -> FloatImage:
    """Mitsuba's `to_world` matrix of a device whose OpenCV pose is given."""
    return (T_world_from_device @ _OPENCV_FROM_MITSUBA).astype(np.float32)


def perspective_sensor(
    pinhole: Pinhole, T_world_from_cam: FloatArray, samples: int, lens: ThinLens | None = None
) -> dict[str, Any]:
    """Mitsuba `perspective` or `thinlens` sensor, box filter, as a dictionary for `mi.load_dict`.

    Raises
    ------
    ValueError : the pinhole has what stock Mitsuba cannot express: lens distortion, or an off-axis
        principal point behind a thin lens
    """
    import mitsuba as mi

    if any(pinhole.distortion):
        raise ValueError("stock Mitsuba cannot express lens distortion; use engine = 'one_trace'")
    width, height = pinhole.width_px, pinhole.height_px
    return {
        "fov_axis": "x",
        "fov": field_of_view_deg(width, pinhole.fx_px),
        **_sensor_kind(pinhole, lens),
        "near_clip": 1.0,
        "far_clip": 1e4,
        "to_world": mi.ScalarTransform4f(to_world(T_world_from_cam)),
        "film": {
            "type": "hdrfilm",
            "width": width,
            "height": height,
            "pixel_format": "luminance",
            "component_format": "float32",
            "rfilter": {"type": "box"},
        },
        "sampler": {"type": "independent", "sample_count": samples},
    }


def _sensor_kind(pinhole: Pinhole, lens: ThinLens | None) -> dict[str, Any]:
    # Offsets move the image in fractions of its size; pixel centres are half a pixel in.
    offset_x = (pinhole.cx_px + 0.5) / pinhole.width_px - 0.5
    offset_y = (pinhole.cy_px + 0.5) / pinhole.height_px - 0.5
    if lens is None:
        return {
            "type": "perspective",
            "principal_point_offset_x": offset_x,
            "principal_point_offset_y": offset_y,
        }
    if offset_x or offset_y:
        raise ValueError("stock Mitsuba's thin lens has no off-axis principal point")
    return {
        "type": "thinlens",
        "aperture_radius": lens.radius_mm,
        "focus_distance": lens.focus_mm,
    }


def field_of_view_deg(width_px: float, focal_px: float) -> float:
    """Full opening angle of an image `width_px` wide, symmetric about the optical axis."""
    return float(2.0 * np.degrees(np.arctan(width_px / (2.0 * focal_px))))
