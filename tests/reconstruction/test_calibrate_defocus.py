"""Boards out of focus: where their features appear, and that the adjustment allows for it."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from reconstruction.calibration import AdjustOptions, DotBoard, Freedom, Observation, calibrate
from reconstruction.calibration.pipeline import parameters_of, pupil_diameter_mm
from reconstruction.calibration.plane_images import defocus_slopes_px
from reconstruction.rig.pinhole import Pinhole

CAMERA = Pinhole(1936, 1464, 14500.0, 14500.0, 967.5, 731.5)
PROJECTOR = Pinhole(1280, 720, 1536.0, 1536.0, 632.0, 920.0)
BOARD = DotBoard(9, 7, 3.0, 1.2, 1.8)
FOCUS_MM, MIDDLE_MM = 214.0, 216.0
# 50 mm, f/8: a pupil of 6.25 mm.
PUPIL_MM2 = 3.125**2 / 4.0
COEFFICIENTS = np.array([PUPIL_MM2, PUPIL_MM2 * (1.0 / FOCUS_MM - 1.0 / MIDDLE_MM)])


def board_pose(tilt_deg, azimuth_deg, z_mm=0.0, spin_deg=0.0):
    """Return T_cam_from_board of a camera that looks straight down from the focus distance."""
    turn = Rotation.from_euler("ZYZ", (azimuth_deg, tilt_deg, spin_deg - azimuth_deg), degrees=True)
    T = np.eye(4)
    T[:3, :3] = np.diag([1.0, -1.0, -1.0]) @ turn.as_matrix()
    T[:3, 3] = 0.0, 0.0, FOCUS_MM - z_mm
    return T


def pupil_places():
    """Return places that fill the pupil evenly, (place, xy) mm, with its exact centre."""
    radius = 3.125 * np.sqrt((np.arange(40) + 0.5) / 40)
    angle = 2.0 * np.pi * np.arange(24) / 24
    return np.stack([np.outer(radius, np.cos(angle)), np.outer(radius, np.sin(angle))], -1).reshape(
        -1, 2
    )


@pytest.mark.parametrize(("tilt_deg", "azimuth_deg", "z_mm"), [(20, 0, 5), (25, 130, -4)])
def test_displacement_is_that_of_rays_through_the_whole_pupil(tilt_deg, azimuth_deg, z_mm):
    """Setup: a board piece seen through 960 places of the pupil, each a pinhole of its own.

    Expected: the mean position, weighted by the area visible from each place (by differences), and
    the mean board position of one pixel through all places, displaced by b each, to 3 %.
    """
    T = board_pose(tilt_deg, azimuth_deg, z_mm)
    normal, f = T[:3, 2], CAMERA.fx_px
    piece = np.array([[0.3, 0.2, 0.0], [0.301, 0.2, 0.0], [0.3, 0.201, 0.0]])
    points = piece @ T[:3, :3].T + T[:3, 3]
    b = defocus_slopes_px(CAMERA, points[:1], normal, MIDDLE_MM)[0] @ COEFFICIENTS
    sharp = f * points[0, :2] / points[0, 2]
    observed, areas, met = [], [], []
    for x, y in pupil_places():
        s = np.array([x, y, 0.0])
        image = f * ((points - s)[:, :2] / points[:, 2:] + s[:2] / FOCUS_MM)
        (ax, ay), (bx, by) = image[1:] - image[0]
        observed.append(image[0])
        areas.append(abs(ax * by - ay * bx))
        toward = np.append(sharp * FOCUS_MM / f, FOCUS_MM) - s
        hit = s + toward * (normal @ (points[0] - s)) / (normal @ toward)
        met.append(hit)
    dot = np.average(observed, axis=0, weights=areas) - sharp
    middle = np.mean(met, axis=0)
    phase = f * middle[:2] / middle[2] - sharp
    size = np.linalg.norm(b)
    assert size > 5e-3
    assert np.linalg.norm(dot - b) < 0.03 * size
    assert np.linalg.norm(phase - b) < 0.03 * size


@pytest.fixture(scope="module")
def blurred():
    """Return exact images of eight poses with a finite aperture, and the true rig."""
    poses = [board_pose(0, 0)]
    poses += [board_pose(20 - 4 * (k % 2), 137.5 * k, k % 5 - 2.0, 40 * k) for k in range(1, 8)]
    T_proj_from_cam = np.eye(4)
    T_proj_from_cam[:3, :3] = Rotation.from_euler("YX", (25.0, -8.0), degrees=True).as_matrix()
    T_proj_from_cam[:3, 3] = -91.0, 20.0, 55.0
    observed = [observation(T, T_proj_from_cam, f"pose_{k}") for k, T in enumerate(poses)]
    return observed, T_proj_from_cam


def observation(T, T_proj_from_cam, name):
    """Return the features of one pose: points, no circles, displaced by defocus."""
    points = BOARD.points_mm
    inside = points @ T[:3, :3].T + T[:3, 3]
    b = defocus_slopes_px(CAMERA, inside, T[:3, 2], MIDDLE_MM) @ COEFFICIENTS

    def projector(at_board):
        there = (at_board @ T[:3, :3].T + T[:3, 3]) @ T_proj_from_cam[:3, :3].T
        return PROJECTOR.project(there + T_proj_from_cam[:3, 3])

    def camera(at_board):
        return CAMERA.project(at_board @ T[:3, :3].T + T[:3, 3])

    steps = 1e-3 * np.eye(3)[:2]
    by_board = [np.stack([(f(points + d) - f(points - d)) / 2e-3 for d in steps], -1)
                for f in (camera, projector)]  # fmt: skip
    slopes = by_board[1] @ np.linalg.inv(by_board[0])
    return Observation(
        name, points, np.zeros(len(points)), camera(points) + b,
        projector(points) + 2.0 * np.einsum("nij,nj->ni", slopes, b), slopes,
        np.arange(len(points)), (1936, 1464), (1280, 720),
    )  # fmt: skip


def test_rig_and_aperture_are_found(blurred):
    """Expected: exact observations give the exact rig and the pupil of 6.25 mm.

    Neglected, the defocus moves the projector's principal point by 0.06 px.
    """
    observed, T_proj_from_cam = blurred
    result = calibrate(observed)
    assert result.adjustment.pupil_mm2 == pytest.approx(PUPIL_MM2, rel=1e-4)
    assert pupil_diameter_mm(result.adjustment) == pytest.approx(6.25, rel=1e-4)
    true = parameters_of(replace(result.adjustment.rig, camera=CAMERA, projector=PROJECTOR,
                                 T_proj_from_cam=T_proj_from_cam))  # fmt: skip
    for parameter in result.parameters:
        size = max(abs(true[parameter.name]), 1.0)
        assert parameter.value == pytest.approx(true[parameter.name], abs=1e-6 * size)
    neglected = calibrate(observed, AdjustOptions(Freedom(camera_defocus=False)))
    centre = next(p.value for p in neglected.parameters if p.name == "projector_cy_px")
    assert abs(centre - true["projector_cy_px"]) > 0.02
    assert pupil_diameter_mm(neglected.adjustment) == 0.0
