"""The one place where our conventions meet Mitsuba's.

Ours: OpenCV device frames (x right, y down, z forward), pixel (0, 0) at the CENTRE of the first
pixel. Mitsuba: device frames with x left, y up, z forward, pixel coordinates counted from the
CORNER, fields of view instead of focal lengths, principal point offsets as fractions.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from reconstruction.calibration import Pinhole

_OPENCV_FROM_MITSUBA = np.diag([-1.0, -1.0, 1.0, 1.0])

Matrix = NDArray[np.float64]


def to_world(T_world_from_device: Matrix) -> NDArray[np.float32]:
    """Mitsuba's `to_world` matrix of a device whose OpenCV pose is given."""
    return (T_world_from_device @ _OPENCV_FROM_MITSUBA).astype(np.float32)


def perspective_sensor(pinhole: Pinhole, T_world_from_cam: Matrix, samples: int) -> dict[str, Any]:
    """Mitsuba `perspective` sensor with a box filter film, as a dictionary for `mi.load_dict`.

    Raises
    ------
    ValueError
        The pinhole has lens distortion, which stock Mitsuba cannot express.
    """
    import mitsuba as mi

    if any(pinhole.distortion):
        raise ValueError("stock Mitsuba cannot express lens distortion; use engine = 'one_trace'")
    width, height = pinhole.width_px, pinhole.height_px
    return {
        "type": "perspective",
        "fov_axis": "x",
        "fov": field_of_view_deg(width, pinhole.fx_px),
        # Offsets move the image in fractions of its size; pixel centres are half a pixel in.
        "principal_point_offset_x": (pinhole.cx_px + 0.5) / width - 0.5,
        "principal_point_offset_y": (pinhole.cy_px + 0.5) / height - 0.5,
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


def field_of_view_deg(width_px: float, focal_px: float) -> float:
    """Full opening angle of an image `width_px` wide, symmetric about the optical axis."""
    return float(2.0 * np.degrees(np.arctan(width_px / (2.0 * focal_px))))
