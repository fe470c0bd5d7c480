"""Mistakes of the input end with an error that names them; unusual rigs are calibrated."""

import re
from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from reconstruction.calibration import AdjustOptions, Chessboard, Freedom, Observation, calibrate
from reconstruction.calibration.pipeline import pupil_diameter_mm
from reconstruction.calibration.plane_images import PHASE_SHARE, defocus_slopes_px
from reconstruction.calibration.plausibility import pupil_doubt
from reconstruction.errors import InputError
from reconstruction.rig.pinhole import Pinhole

CAMERA = Pinhole(1000, 800, 1400.0, 1400.0, 510.0, 390.0)
# The axis of a projector on a table is at the lower rim of its image.
PROJECTOR = Pinhole(1280, 720, 1800.0, 1800.0, 640.0, 719.0)
NOISE_PX = 0.05


@dataclass(frozen=True)
class Rig:
    """Camera above the board, the projector turned towards it about the vertical axis."""

    camera: Pinhole = CAMERA
    projector: Pinhole = PROJECTOR
    distance_mm: float = 600.0
    angle_deg: float = 22.0
    square_mm: float = 28.0
    poses: int = 5
    tilt_deg: float = 22.0
    lens_tilt_deg: float = 0.0

    def observe(self) -> list[Observation]:
        """Return noisy corners of a board of 6 x 5."""
        rng = np.random.default_rng(7)
        return [self._pose(number, rng) for number in range(self.poses)]

    def _pose(self, number: int, rng: np.random.Generator) -> Observation:
        points_mm = Chessboard(6, 5, self.square_mm).points_mm
        into_cam = self._into_camera(number)
        camera_px, projector_px = self._seen(points_mm, into_cam)
        ends = [self._seen(points_mm + 1e-3 * axis, into_cam) for axis in np.eye(3)[:2]]
        by_camera, by_projector = (
            np.stack([end[k] - here for end in ends], axis=-1)
            for k, here in enumerate((camera_px, projector_px))
        )
        slopes = by_projector @ np.linalg.inv(by_camera)
        miss = NOISE_PX * rng.standard_normal(camera_px.shape)
        own = NOISE_PX * rng.standard_normal(camera_px.shape)
        return Observation(
            f"pose_{number}",
            points_mm,
            np.zeros(len(points_mm)),
            camera_px + miss,
            projector_px + np.einsum("nij,nj->ni", slopes, miss) + own,
            slopes,
            np.arange(len(points_mm)),
            (self.camera.width_px, self.camera.height_px),
            (self.projector.width_px, self.projector.height_px),
        )

    def _into_camera(self, number: int) -> np.ndarray:
        """Boards look at the camera, tilted in all directions and turned in their planes."""
        angles = 137.5 * number, self.tilt_deg * (number > 0), 40.0 * number - 137.5 * number
        T = np.eye(4)
        flip = np.diag([1.0, -1.0, -1.0])
        lens = Rotation.from_euler("X", self.lens_tilt_deg, degrees=True).as_matrix()
        turn = Rotation.from_euler("ZYZ", angles, degrees=True).as_matrix()
        T[:3, :3] = lens @ flip @ turn
        T[:3, 3] = lens @ (0.0, 0.0, self.distance_mm + self.square_mm * (number % 3 - 1))
        return T

    def _seen(self, points_mm: np.ndarray, into_cam: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        inside = points_mm @ into_cam[:3, :3].T + into_cam[:3, 3]
        lens = Rotation.from_euler("X", -self.lens_tilt_deg, degrees=True).as_matrix()
        upright = inside @ lens.T - (0.0, 0.0, self.distance_mm)
        turn = Rotation.from_euler("Y", self.angle_deg, degrees=True).as_matrix()
        # The middle of its image, not its axis, shows the board.
        down = (self.projector.cy_px - self.projector.height_px / 2) / self.projector.fy_px
        shift = np.array([0.0, -down, 1.0]) * self.distance_mm
        return self.camera.project(inside), self.projector.project(upright @ turn.T + shift)


@pytest.fixture(scope="module")
def observed() -> list[Observation]:
    return Rig().observe()


def columns_by(views: Observation, factor: float) -> Observation:
    """Return the observations with `factor` times as many projector columns."""
    width, height = views.projector_size_px
    return replace(
        views,
        projector_px=views.projector_px * (factor, 1.0),
        slopes=views.slopes * np.array([[factor], [1.0]]),
        projector_size_px=(round(factor * width), height),
    )


def backwards(views: Observation) -> Observation:
    columns, rows = views.projector_px.T
    return replace(
        views,
        projector_px=np.column_stack([views.projector_size_px[0] - 1 - columns, rows]),
        slopes=views.slopes * np.array([[-1.0], [1.0]]),
    )


def exchanged(views: Observation) -> Observation:
    return replace(
        views,
        projector_px=views.projector_px[:, ::-1].copy(),
        slopes=views.slopes[:, ::-1].copy(),
        projector_size_px=views.projector_size_px[::-1],
    )


def camera_columns_halved(views: Observation) -> Observation:
    width, height = views.camera_size_px
    return replace(
        views,
        camera_px=views.camera_px * (0.5, 1.0),
        slopes=views.slopes * np.array([[2.0, 1.0]]),
        camera_size_px=(width // 2, height),
    )


def not_projected(views: Observation) -> Observation:
    return replace(views, projector_px=0.0 * views.projector_px + 7.0, slopes=0.0 * views.slopes)


ALL = {
    "half the columns": (
        lambda views: columns_by(views, 0.5),
        r"the projector's pixels are 2 times as wide as high .*--projector-pixel-ratio 2, or "
        r"correct its size, 640 x 720 px: of square pixels it is 1280 x 720",
    ),
    "1280 x 768 as 720 rows": (
        lambda views: columns_by(views, 720.0 / 768.0),
        r"pixel_ratio_over_declared is .*--projector-pixel-ratio 1\.07",
    ),
    "camera of half the columns": (camera_columns_halved, r"--camera-pixel-ratio 2"),
    "columns backwards": (backwards, "columns or rows are counted backwards"),
    "axes exchanged": (exchanged, "columns and rows are exchanged"),
    "one level": (not_projected, "projector columns of all features are within 0 px"),
}


@pytest.mark.parametrize("name", ALL)
def test_a_mistake_in_all_poses_is_named(observed, name):
    change, message = ALL[name]
    with pytest.raises(InputError, match=message) as caught:
        calibrate([change(views) for views in observed])
    assert "\n" not in str(caught.value)


def another_board(views: Observation) -> Observation:
    return replace(views, points_mm=1.05 * views.points_mm)


def test_one_pose_with_another_board_is_named(observed):
    changed = [another_board(views) if k == 2 else views for k, views in enumerate(observed)]
    with pytest.raises(InputError, match=r"pose_2.*remove (it|this pose)"):
        calibrate(changed)


def test_a_pose_that_moved_a_little_is_a_warning(observed):
    """Setup: between columns and rows one board moves by 1.5 px; noise is 0.05 px."""
    assert calibrate(observed).doubts == ()
    moved = replace(observed[2], projector_px=observed[2].projector_px + np.array([0.0, 1.5]))
    result = calibrate([*observed[:2], moved, *observed[3:]])
    assert any("times the scatter of detection" in text for text in result.doubts)


def out_of_focus(views: Observation, number: int, pupil_diameter_mm: float) -> Observation:
    """Return images of that aperture, in best focus at the first board's distance."""
    T = Rig()._into_camera(number)
    inside = views.points_mm @ T[:3, :3].T + T[:3, 3]
    slopes = defocus_slopes_px(CAMERA, inside, T[:3, 2], Rig().distance_mm)
    shift = slopes @ (pupil_diameter_mm**2 / 16.0, 0.0)
    along = PHASE_SHARE * np.einsum("nij,nj->ni", views.slopes, shift)
    return replace(
        views, camera_px=views.camera_px + shift, projector_px=views.projector_px + along
    )


def test_an_aperture_that_no_lens_has_is_left_out(observed):
    """Setup: displacements as of 50 and 250 mm; a lens of 1400 px has up to 60 mm.

    Expected: the small one is found; the large one is not estimated, and a warning names it.
    """
    small, large = (
        calibrate([out_of_focus(views, k, diameter) for k, views in enumerate(observed)])
        for diameter in (50.0, 250.0)
    )
    assert small.doubts == ()
    assert pupil_diameter_mm(small.adjustment) in (0.0, pytest.approx(50.0, abs=25.0))
    assert re.match(
        r"camera_pupil_diameter_mm is 2\d\d, plausible up to (59|60|61).*calibrated without",
        large.doubts[0],
    )
    assert pupil_diameter_mm(large.adjustment) == 0.0
    assert large.calibration.camera.fx_px == pytest.approx(CAMERA.fx_px, rel=0.02)


@pytest.mark.parametrize(
    ("pupil_mm2", "message"), [(-4.0, "plausible from 0"), (-2.9, ""), (16.0, ""), (250.0, "up to")]
)
def test_limits_of_the_aperture_by_hand(pupil_mm2, message):
    """D = 4 sqrt(pupil_mm2), at most 0.043 mm a pixel of focal length: 60 mm, 225 mm2."""
    rig = SimpleNamespace(camera=CAMERA)
    fit = SimpleNamespace(pupil_mm2=pupil_mm2, pupil_sigma_mm2=1.0, rig=rig)
    assert message in pupil_doubt(fit)
    assert bool(message) == bool(pupil_doubt(fit))


def test_declared_pixel_ratios_give_the_rig(observed):
    """Setup: the projector's columns counted by halves. Expected: fy = 2 fx, all else as it was."""
    halved = [columns_by(views, 0.5) for views in observed]
    result = calibrate(halved, AdjustOptions(Freedom(projector_pixel_ratio=2.0)))
    whole = calibrate(observed)
    projector, expected = result.calibration.projector, whole.calibration.projector
    assert projector.fy_px == 2.0 * projector.fx_px
    assert projector.fx_px == pytest.approx(0.5 * expected.fx_px, rel=1e-3)
    assert result.calibration.camera.fx_px == pytest.approx(CAMERA.fx_px, rel=0.01)
    ratio = result.adjustment.pixel_ratios[1]
    assert abs(ratio.value - 2.0) < 5.0 * ratio.sigma < 0.05


EDGES = {
    "long focal length": Rig(
        replace(CAMERA, fx_px=20000.0, fy_px=20000.0),
        replace(PROJECTOR, fx_px=20000.0, fy_px=20000.0),
        square_mm=2.5,
        poses=7,
    ),
    "wide angle": Rig(
        replace(CAMERA, fx_px=420.0, fy_px=420.0),
        replace(PROJECTOR, fx_px=600.0, fy_px=600.0),
        distance_mm=150.0,
    ),
    "axis far below the projector's image": Rig(projector=replace(PROJECTOR, cy_px=1800.0)),
    "camera lens tilted against its chip": Rig(
        replace(CAMERA, fx_px=4000.0, fy_px=4000.0, cy_px=390.0 - 4000.0 * np.tan(0.14)),
        lens_tilt_deg=float(np.degrees(0.14)),
        square_mm=10.0,
        poses=7,
    ),
    "projector close to the camera": Rig(angle_deg=2.0),
    "three poses": Rig(poses=3),
}


@pytest.mark.parametrize("name", EDGES)
def test_rigs_at_the_edge_are_calibrated(name):
    """Expected: focal lengths within five standard uncertainties, every check holds."""
    rig = EDGES[name]
    result = calibrate(rig.observe())
    assert all(check.is_plausible for check in result.checks)
    focal = {p.name: p for p in result.parameters}
    for device, lens in (("camera", rig.camera), ("projector", rig.projector)):
        value = focal[f"{device}_fx_px"]
        assert abs(value.value - lens.fx_px) < 5.0 * value.sigma
        assert value.sigma < 0.1 * lens.fx_px
