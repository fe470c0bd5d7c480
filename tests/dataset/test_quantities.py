"""Quantities of samples against closed forms: pinholes, phase steps, the force of a press."""

import json

import numpy as np
import pytest

from tests.dataset.conftest import COUNT, MadeSet
from twin.dataset.quantities import SAMPLE_QUANTITIES
from twin.dataset.taking import SAMPLE_FOLDER, take_sample
from twin.pipeline import Memory
from twin.study.store import Store


@pytest.fixture(scope="module")
def samples(made: MadeSet) -> list[dict]:
    """Arrays and calibration of each sample with a result."""
    read = []
    for draw in made.draws:
        if draw.case is None:
            continue
        folder = Store(made.work).path_of(draw.case.digest) / SAMPLE_FOLDER
        arrays = {path.stem: np.load(path) for path in folder.glob("*.npy")}
        text = (folder / "calibration.json").read_text(encoding="utf-8")
        read.append(arrays | {"calibration": json.loads(text)})
    assert len(read) == COUNT - 1
    return read


def seen_from(sample: dict, device: str, pose: str) -> np.ndarray:
    """Project the surface points into a device without distortion: (row, col, x y depth)."""
    pinhole = sample["calibration"][device]
    assert not np.any(pinhole["distortion_coefficients"])
    T = np.array(sample["calibration"][pose])
    points = (sample["point_world_mm"].astype(np.float64) - T[:3, 3]) @ T[:3, :3]
    image = points @ np.array(pinhole["camera_matrix"]).T
    return np.concatenate([image[..., :2] / image[..., 2:], points[..., 2:]], axis=-1)


def test_depth_is_that_of_the_pixel_s_ray_in_the_camera_frame(samples: list[dict]) -> None:
    for sample in samples:
        rows, cols = np.indices(sample["depth_mm"].shape)
        x, y, depth = np.moveaxis(seen_from(sample, "camera", "T_world_from_cam"), -1, 0)
        shown = sample["depth_mm"] > 0
        assert np.abs(x - cols)[shown].max() < 1e-3
        assert np.abs(y - rows)[shown].max() < 1e-3
        assert np.abs(depth - sample["depth_mm"])[shown].max() < 1e-4


def test_the_phase_is_that_of_the_point_s_projector_column(
    samples: list[dict], made: MadeSet
) -> None:
    period = made.bases[0].patterns.period_px
    for sample in samples:
        lit = sample["lit"] > 0
        column = seen_from(sample, "projector", "T_world_from_proj")[..., 0]
        assert np.abs(column - sample["projector_column_px"])[lit].max() < 1e-3
        expected = 2 * np.pi * column / period
        assert np.abs(expected - sample["phase_column_rad"])[lit].max() < 1e-3
        turned = 2 * np.pi * sample["order_column"] + sample["wrapped_phase_column_rad"]
        assert np.abs(turned - sample["phase_column_rad"]).max() < 1e-4
        assert sample["wrapped_phase_column_rad"].max() < np.float32(2 * np.pi)


def test_the_wrapped_phase_is_that_of_the_noise_free_frames(samples: list[dict]) -> None:
    """Three steps: I_k = A + B cos(phase + 2 pi k / 3)."""
    for sample in samples:
        inside = (sample["lit"] > 0) & (sample["label"] == 2)
        shifts = 2 * np.pi * np.arange(3) / 3
        steps = sample["radiance"][:3].astype(np.float64)
        phase = np.arctan2(
            -np.tensordot(np.sin(shifts), steps, 1), np.tensordot(np.cos(shifts), steps, 1)
        )
        error = np.angle(np.exp(1j * (phase - sample["wrapped_phase_column_rad"])))[inside]
        assert np.median(np.abs(error)) < 0.01


def test_frames_are_the_radiance_with_the_noise_of_the_camera(samples: list[dict]) -> None:
    for sample in samples:
        light = sample["radiance"].astype(np.float64).ravel()
        slope, _ = np.polyfit(light, sample["frames"].ravel(), 1)
        assert slope > 0
        assert np.corrcoef(light, sample["frames"].ravel())[0, 1] > 0.999


def test_decoded_quantities_are_near_the_truth(samples: list[dict]) -> None:
    for sample in samples:
        good = (sample["decoded_reason"] == 0) & (sample["label"] == 2)
        assert good.mean() > 0.5
        error = (sample["decoded_depth_mm"] - sample["depth_mm"])[good]
        assert np.median(np.abs(error)) < 0.02
        phase = (sample["decoded_phase_column_rad"] - sample["phase_column_rad"])[good]
        assert np.median(np.abs(phase)) < 0.05
        wrapped = sample["decoded_wrapped_phase_column_rad"] - sample["wrapped_phase_column_rad"]
        assert np.median(np.abs(np.angle(np.exp(1j * wrapped[good])))) < 0.05
        cosine = np.sum(sample["decoded_normal_world"] * sample["normal_world"], axis=-1)
        has_normal = good & (np.linalg.norm(sample["decoded_normal_world"], axis=-1) > 0)
        assert np.median(cosine[has_normal]) > np.cos(np.deg2rad(10.0))
        scaled = error / np.maximum(sample["decoded_sigma_z_mm"][good], 1e-6)
        assert 0.2 < np.percentile(np.abs(scaled), 68.3) < 10.0


def test_pressure_over_the_pixels_is_the_force_on_the_field(made: MadeSet) -> None:
    """Expected: the sum over the solver's cells in the field; of all cells it is the force."""
    (ball,) = (draw for draw in made.draws if draw.case and draw.scene == "ball")
    taken, figures = take_sample(ball.case.experiment, Memory(), 1, decode=False)
    pressure, contact, touched = (
        SAMPLE_QUANTITIES[name].values(taken)
        for name in ("pressure_kpa", "contact", "touched_face_z_mm")
    )
    points = taken.truth.points_world_mm.astype(np.float64)
    down, right = np.gradient(points[..., :2], axis=(0, 1))
    area_mm2 = np.abs(down[..., 0] * right[..., 1] - down[..., 1] * right[..., 0])
    force_n = 1e-3 * float((pressure * area_mm2).sum())
    face = taken.face
    cells_n = 1e-3 * face.pressure_kpa * np.diff(face.x_mm[:2]) * np.diff(face.y_mm[:2])
    assert cells_n.sum() == pytest.approx(figures["force_n"], rel=1e-6)
    half_x, half_y = (np.ptp(points[..., axis]) / 2 for axis in (0, 1))
    field = (np.abs(face.y_mm) <= half_y)[:, None] & (np.abs(face.x_mm) <= half_x)[None, :]
    assert force_n == pytest.approx(cells_n[field].sum(), rel=0.03)
    # The touched face is the ball's surface in the contact, up to the height of the ball.
    inside = contact > 0
    assert 0.1 < inside.mean() < 1.0
    x, y = points[..., 0][inside], points[..., 1][inside]
    sphere = np.sqrt((ball.case.experiment.specimen.diameter_mm / 2) ** 2 - x**2 - y**2)
    assert np.ptp(touched[inside] - sphere) < 0.05
