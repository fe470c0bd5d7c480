"""Geometry and light of the rig, from the experiment: pinholes, poses, lens, projector irradiance.

The world's z axis points up, and the undeformed coated face is at z = 0. Device frames are those of
OpenCV (x right, y down, z forward; pixel (0, 0) is the centre of the first pixel). Pinholes and
poses form the true calibration: the renderer traces with it, and an ideally calibrated decoder
triangulates with it.

The irradiance of a full white field on a plane that faces the projector at distance z (along the
projector's axis) is `irradiance_at_1mm / z**2`. The flux is distributed evenly over the image, as a
DLP projector illuminates a flat screen.

With a thin lens the camera's rays start on the lens pupil. Every sub-pixel sample has a fixed pupil
position, the same for every pixel and frame: random positions would act as phase noise. For any
number of samples, the positions have exactly the centroid and variance of the disc. Phase and mean
blur of a smooth surface out of focus are therefore exact. More samples fill the disc evenly.

Only this module converts to Mitsuba's conventions. The project uses OpenCV device frames (x right,
y down, z forward), with pixel (0, 0) at the CENTRE of the first pixel. Mitsuba uses device frames
with x left, y up, z forward, and pixel coordinates counted from the CORNER. It uses fields of view
instead of focal lengths, and principal point offsets as fractions of the image size.
"""

from dataclasses import dataclass
from functools import lru_cache
from math import gcd
from typing import Any

import numpy as np

from reconstruction.arrays import FloatArray, FloatImage
from reconstruction.errors import InputError
from reconstruction.pixel_shape import width_over_height
from reconstruction.rig.calibration import Calibration, Pinhole
from reconstruction.rig.layers import plane_layers
from twin.config.layers import media_of
from twin.config.models import Camera, Experiment, Pose, Projector


def true_calibration(experiment: Experiment) -> Calibration:
    """Return the exact calibration of the virtual rig: pinholes, poses and clear layers."""
    camera = camera_pinhole(experiment.camera)
    projector = projector_pinhole(experiment.projector)
    return Calibration(
        camera=camera,
        projector=projector,
        T_world_from_cam=world_from_device(experiment.camera.pose, camera),
        T_world_from_proj=world_from_device(experiment.projector.pose, projector),
        layers=plane_layers(
            [(medium.top_mm, medium.ior) for medium in media_of(experiment.layers)]
        ),
    )


def camera_pinhole(camera: Camera) -> Pinhole:
    """Return the camera's pinhole; the lens is focused at the standoff u of the camera.

    The image distance of a thin lens of focal length f is then f u / (u - f).
    """
    f_mm, u_mm = camera.focal_length_mm, camera.pose.standoff_mm
    image_distance_mm = f_mm * u_mm / (u_mm - f_mm)
    width_px, height_px = camera.width_px // camera.binning, camera.height_px // camera.binning
    focal_px = image_distance_mm / (camera.pixel_pitch_um * 1e-3 * camera.binning)
    centre = (width_px - 1) / 2, (height_px - 1) / 2
    return Pinhole(width_px, height_px, focal_px, focal_px, *centre, camera.distortion)


def projector_pinhole(projector: Projector) -> Pinhole:
    """Return a projector's pinhole; at 100 % offset, the axis is at the lower edge of the image."""
    width_px, height_px = projector.width_px, projector.height_px
    focal_px = projector.throw_ratio * width_px
    focal_rows_px = focal_px * width_over_height(projector.pixel_ratio)
    axis_row_px = (height_px - 1) / 2 + projector.offset_percent / 100 * height_px / 2
    centre = (width_px - 1) / 2, axis_row_px
    return Pinhole(width_px, height_px, focal_px, focal_rows_px, *centre, projector.distortion)


def world_from_device(pose: Pose, pinhole: Pinhole) -> FloatArray:
    """Return T_world_from_device (4, 4), mm; the image centre's ray is through the world origin.

    At polar 0 and roll 0 the right of the image is world +x and the top is world +y.
    """
    polar, azimuth = np.deg2rad(pose.polar_deg), np.deg2rad(pose.azimuth_deg)
    outward = np.array(
        [np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)]
    )
    pose_matrix = np.eye(4)
    pose_matrix[:3, :3] = (
        _looking_along(-outward) @ about_z(np.deg2rad(pose.roll_deg)) @ _onto_z(_centre(pinhole))
    )
    pose_matrix[:3, 3] = pose.standoff_mm * outward
    return pose_matrix


def _looking_along(forward: FloatArray) -> FloatArray:
    """Return the rotation (3, 3) with z axis along `forward` and y axis away from world +y."""
    right = np.cross(forward, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(forward, right), forward], axis=1)


def about_z(angle_rad: float) -> FloatArray:
    """Return the matrix (3, 3) of a right-handed rotation about the z axis."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _onto_z(direction: FloatArray) -> FloatArray:
    """Return the smallest rotation (3, 3) of unit vector `direction` onto z (Rodrigues)."""
    x, y, z = direction
    cross = np.array([[0.0, 0.0, -x], [0.0, 0.0, -y], [x, y, 0.0]])
    return np.asarray(np.eye(3) + cross + cross @ cross / (1.0 + z))


def _centre(pinhole: Pinhole) -> FloatArray:
    centre_px = np.array([(pinhole.width_px - 1) / 2, (pinhole.height_px - 1) / 2])
    ray = np.append(pinhole.unproject(centre_px), 1.0)
    return np.asarray(ray / np.linalg.norm(ray))


def irradiance_at_1mm(projector: Projector, pinhole: Pinhole) -> float:
    """Return the irradiance of a full white field at axial distance 1 mm, mW/mm^2."""
    image_area_mm2 = (pinhole.width_px / pinhole.fx_px) * (pinhole.height_px / pinhole.fy_px)
    return projector.flux_mw / image_area_mm2


_GOLDEN_ANGLE = np.pi * (3.0 - np.sqrt(5.0))
# A correlation of pupil and pixel positions changes the size of the blur; a correlation of their
# squares changes its shape. The first is weighted by this factor.
_FIRST_POWERS_COUNT = 10.0


@dataclass(frozen=True)
class ThinLens:
    """Pupil of a camera; the centre of the pupil is the pinhole.

    Attributes
    ----------
    radius_mm : radius of the pupil
    focus_mm : axial distance of the plane in focus
    """

    radius_mm: float
    focus_mm: float

    @classmethod
    def of(cls, camera: Camera, T_world_from_cam: FloatArray) -> "ThinLens | None":
        """Return the lens of a camera, focused on the plane that contains the world origin.

        Returns None if the camera has no depth of field.
        """
        if not camera.depth_of_field:
            return None
        focus_mm = float(-T_world_from_cam[:3, 3] @ T_world_from_cam[:3, 2])
        return cls(camera.focal_length_mm / camera.f_number / 2.0, focus_mm)


@lru_cache(maxsize=8)
def lens_places(side: int) -> FloatArray:
    """Return the pupil position of every sub-pixel sample, (side * side, xy), in lens radii.

    The points of a spiral of equal areas (Vogel 1979) are assigned to the square grid of sub-pixels
    with a stride that is coprime to the number of points. Neighbours on the grid are therefore at a
    large distance on the lens. Of all strides and several rotations of the spiral, the function
    uses the pair with the smallest correlation of pupil and sub-pixel positions. The blurs of pixel
    box and lens are then independent (with fewer than 25 samples only approximately).
    """
    samples = side * side
    if samples == 1:
        return np.zeros((1, 2))
    grid, turns = _moments(_cell_centres(side)), 64 // side
    steps = [step for step in range(1, samples) if gcd(step, samples) == 1]
    dealt = (
        _spiral(samples, turn)[np.arange(samples) * step % samples]
        for step in steps
        for turn in np.arange(turns) * (2.0 * np.pi / turns)
    )
    return min(dealt, key=lambda places: float(np.sum((grid.T @ _moments(places)) ** 2)))


def _spiral(samples: int, turn_rad: float) -> FloatArray:
    index = np.arange(samples)
    angle_rad = index * _GOLDEN_ANGLE + turn_rad
    radius = np.sqrt((index + 0.5) / samples)
    places = np.stack([radius * np.cos(angle_rad), radius * np.sin(angle_rad)], axis=-1)
    places -= places.mean(axis=0)
    # Exactly the disc's covariance, 1/4 along every axis.
    variances, axes = np.linalg.eigh(places.T @ places / samples)
    return np.asarray(places @ (axes * (0.5 / np.sqrt(variances))) @ axes.T)


def _cell_centres(side: int) -> FloatArray:
    line = (np.arange(side) + 0.5) / side - 0.5
    y, x = (axis.ravel() for axis in np.meshgrid(line, line, indexing="ij"))
    return np.stack([x, y], axis=-1)


def _moments(places: FloatArray) -> FloatArray:
    """Return x, y, x^2, y^2 and x y of positions (n, 2), as (n, 5).

    Each column has mean 0 and unit length, times the weight of its power.
    """
    x, y = places.T
    features = np.stack([x, y, x * x, y * y, x * y], axis=-1)
    features -= features.mean(axis=0)
    length = np.linalg.norm(features, axis=0)
    weight = np.array([_FIRST_POWERS_COUNT, _FIRST_POWERS_COUNT, 1.0, 1.0, 1.0])
    return np.asarray(weight * features / np.where(length > 1e-9, length, 1.0))


_OPENCV_FROM_MITSUBA = np.diag([-1.0, -1.0, 1.0, 1.0])


def to_world(T_world_from_device: FloatArray) -> FloatImage:
    """Return Mitsuba's `to_world` matrix (4, 4) of a device with an OpenCV pose, mm."""
    return (T_world_from_device @ _OPENCV_FROM_MITSUBA).astype(np.float32)


def perspective_sensor(
    pinhole: Pinhole, T_world_from_cam: FloatArray, samples: int, lens: ThinLens | None = None
) -> dict[str, Any]:
    """Return a Mitsuba sensor (`perspective` or `thinlens`) as a dictionary for `mi.load_dict`.

    The sensor's reconstruction filter is a box of one pixel. `samples` is the number of rays per
    pixel.

    Raises
    ------
    InputError : the pinhole has a property that stock Mitsuba lacks: lens distortion, or an
        off-axis principal point behind a thin lens
    """
    import mitsuba as mi

    if any(pinhole.distortion):
        raise InputError(
            "camera.distortion: stock Mitsuba cannot express lens distortion; set it to 0, or "
            "render.engine = 'one_trace'"
        )
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
        raise InputError(
            "camera.depth_of_field: stock Mitsuba's thin lens has no off-axis principal point; set "
            "it to false, or render.engine = 'one_trace'"
        )
    return {
        "type": "thinlens",
        "aperture_radius": lens.radius_mm,
        "focus_distance": lens.focus_mm,
    }


def field_of_view_deg(width_px: float, focal_px: float) -> float:
    """Return the full opening angle, deg, of an image `width_px` wide around the optical axis."""
    return float(2.0 * np.degrees(np.arctan(width_px / (2.0 * focal_px))))
