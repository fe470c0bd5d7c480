"""Geometry and light of the rig, from the experiment: pinholes, poses, the projector's irradiance.

Frames: world z up, undeformed coated face at z = 0. Device frames are OpenCV's (x right, y down,
z forward; pixel (0, 0) is the centre of the first pixel). The result is the true calibration: the
renderer traces with it, and an ideally calibrated decoder triangulates with it.

Irradiance on a plane that faces the projector at distance z (along its axis) is
`irradiance_at_1mm / z**2` for a full white field: the flux spread evenly over the image, as a DLP
fills a flat screen.
"""

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.rig.calibration import Calibration, Pinhole
from twin.config.models import Camera, Experiment, Pose, Projector


def true_calibration(experiment: Experiment) -> Calibration:
    """Return the calibration of the rig as it stands in the virtual laboratory."""
    camera = camera_pinhole(experiment.camera)
    projector = projector_pinhole(experiment.projector)
    return Calibration(
        camera=camera,
        projector=projector,
        T_world_from_cam=world_from_device(experiment.camera.pose, camera),
        T_world_from_proj=world_from_device(experiment.projector.pose, projector),
    )


def camera_pinhole(camera: Camera) -> Pinhole:
    """Pinhole of a thin lens focused at its standoff: image distance f u / (u - f)."""
    f_mm, u_mm = camera.focal_length_mm, camera.pose.standoff_mm
    image_distance_mm = f_mm * u_mm / (u_mm - f_mm)
    width_px, height_px = camera.width_px // camera.binning, camera.height_px // camera.binning
    focal_px = image_distance_mm / (camera.pixel_pitch_um * 1e-3 * camera.binning)
    return Pinhole(
        width_px=width_px,
        height_px=height_px,
        fx_px=focal_px,
        fy_px=focal_px,
        cx_px=(width_px - 1) / 2,
        cy_px=(height_px - 1) / 2,
        distortion=camera.distortion,
    )


def projector_pinhole(projector: Projector) -> Pinhole:
    """Pinhole of a DLP projector; 100 % offset puts the optical axis on the image's lower edge."""
    focal_px = projector.throw_ratio * projector.width_px
    return Pinhole(
        width_px=projector.width_px,
        height_px=projector.height_px,
        fx_px=focal_px,
        fy_px=focal_px,
        cx_px=(projector.width_px - 1) / 2,
        cy_px=(projector.height_px - 1) / 2
        + projector.offset_percent / 100 * projector.height_px / 2,
        distortion=projector.distortion,
    )


def world_from_device(pose: Pose, pinhole: Pinhole) -> FloatArray:
    """Pose (4, 4) of a device whose image-centre ray hits the world origin.

    At polar 0 and roll 0 the image's right is world +x and its top is world +y.
    """
    polar, azimuth = np.deg2rad(pose.polar_deg), np.deg2rad(pose.azimuth_deg)
    outward = np.array(
        [np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)]
    )
    pose_matrix = np.eye(4)
    pose_matrix[:3, :3] = (
        _looking_along(-outward) @ _about_z(np.deg2rad(pose.roll_deg)) @ _onto_z(_centre(pinhole))
    )
    pose_matrix[:3, 3] = pose.standoff_mm * outward
    return pose_matrix


def _looking_along(forward: FloatArray) -> FloatArray:
    """Rotation whose z axis is `forward` and whose y axis points away from world +y."""
    right = np.cross(forward, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(forward, right), forward], axis=1)


def _about_z(angle_rad: float) -> FloatArray:
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _onto_z(direction: FloatArray) -> FloatArray:
    """Smallest rotation that takes the unit vector `direction` onto the z axis (Rodrigues)."""
    x, y, z = direction
    cross = np.array([[0.0, 0.0, -x], [0.0, 0.0, -y], [x, y, 0.0]])
    return np.asarray(np.eye(3) + cross + cross @ cross / (1.0 + z))


def _centre(pinhole: Pinhole) -> FloatArray:
    centre_px = np.array([(pinhole.width_px - 1) / 2, (pinhole.height_px - 1) / 2])
    ray = np.append(pinhole.unproject(centre_px), 1.0)
    return np.asarray(ray / np.linalg.norm(ray))


def irradiance_at_1mm(projector: Projector, pinhole: Pinhole) -> float:
    """Irradiance of a white field at axial distance 1 mm, in mW/mm^2 (numerically mW/mm^2 mm^2)."""
    image_area_mm2 = (pinhole.width_px / pinhole.fx_px) * (pinhole.height_px / pinhole.fy_px)
    return projector.flux_mw / image_area_mm2
