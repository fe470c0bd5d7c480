"""Quantities of samples against closed forms: pinholes, phase steps, the force of a press."""

import json
from dataclasses import replace

import numpy as np
import pytest

from reconstruction.pipeline import reconstruct
from reconstruction.reading import read_json
from tests.dataset.conftest import COUNT, MadeSet
from twin.camera.sensor import electrons_per_ms, gain_dn_per_e, noise_model
from twin.dataset.quantities import SAMPLE_QUANTITIES
from twin.dataset.taking import SAMPLE_FOLDER, take_sample
from twin.pipeline import Memory
from twin.pipeline.captures import options_of
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


def cases_with_samples(made: MadeSet, samples: list[dict]) -> list[tuple]:
    return list(zip([draw.case for draw in made.draws if draw.case], samples, strict=True))


def test_frames_are_the_radiance_with_the_noise_of_the_camera(
    samples: list[dict], made: MadeSet
) -> None:
    """EMVA 1288: mean K (light + dark) + black level; variance of shot, read, fixed pattern, steps.

    Expected: normalised deviations have mean 0 and variance 1. The mean of 4800 pixels with one
    fixed pattern each has a standard deviation below 0.015.
    """
    for case, sample in cases_with_samples(made, samples):
        camera, projector = case.experiment.camera, case.experiment.projector
        exposure_ms = read_json(Store(made.work).path_of(case.digest) / "result.json")["metrics"][
            "exposure_ms"
        ]
        per_radiance = exposure_ms * electrons_per_ms(camera, projector.wavelength_nm)
        light_e = per_radiance * sample["radiance"].astype(np.float64)
        dark_e = camera.dark_current_e_per_s * camera.binning**2 * exposure_ms * 1e-3
        sensor, gain = noise_model(camera), gain_dn_per_e(camera)
        fixed_e2 = (camera.prnu_percent / 100 * light_e) ** 2 + sensor.dsnu_e**2
        noise_e2 = light_e + dark_e + sensor.read_noise_e**2
        sigma_dn = np.sqrt(gain**2 * (noise_e2 + fixed_e2) + 1 / 12)
        mean_dn = gain * (light_e + dark_e) + camera.black_level_dn
        within = (mean_dn > 5 * sigma_dn) & (mean_dn < sensor.saturation_dn - 5 * sigma_dn)
        deviation = ((sample["frames"] - mean_dn) / sigma_dn)[within]
        assert within.mean() > 0.5
        assert abs(deviation.mean()) < 0.06
        assert np.mean(deviation**2) == pytest.approx(1.0, abs=0.05)


def test_decoded_quantities_are_those_of_the_frames_of_the_sample(
    samples: list[dict], made: MadeSet
) -> None:
    """Expected: the decoder gives the same numbers for the frames that were read from the disk."""
    for case, sample in cases_with_samples(made, samples):
        taken, _ = take_sample(case.experiment, Memory(), case.conditions.trial, decode=False)
        capture = replace(taken.fringes.capture, stack=sample["frames"])
        maps = reconstruct(capture, options_of(case.experiment.decode))
        points, column = maps.point_map, maps.decoded.column
        valid = points.mask_reason == 0
        assert np.array_equal(sample["decoded_reason"] == 0, valid)
        assert np.array_equal(sample["decoded_depth_mm"], points.points_cam_mm[..., 2])
        assert np.array_equal(sample["decoded_normal_world"], points.normals_world)
        assert np.array_equal(sample["decoded_sigma_z_mm"], points.sigma_z_mm)
        phase = 2 * np.pi * column.coordinate_px / case.experiment.patterns.period_px
        np.testing.assert_allclose(
            sample["decoded_phase_column_rad"][valid], phase[valid], rtol=3e-7
        )
        assert np.array_equal(sample["decoded_wrapped_phase_column_rad"], column.phase_rad)


def test_sigma_is_that_of_two_samples_with_other_noise(samples: list[dict], made: MadeSet) -> None:
    """Expected: the difference of two heights over sqrt(2) sigma is a standard normal number."""
    case, sample = cases_with_samples(made, samples)[0]
    taken, _ = take_sample(case.experiment, Memory(), 77, decode=True)
    other = taken.maps.point_map
    both = (sample["decoded_reason"] == 0) & (other.mask_reason == 0) & (sample["label"] == 2)
    T = np.array(sample["calibration"]["T_world_from_cam"])
    assert T[2, 2] == pytest.approx(-1.0)  # the camera looks down: heights are minus depths
    difference = (sample["decoded_depth_mm"] - other.points_cam_mm[..., 2])[both]
    normalised = difference / (np.sqrt(2.0) * sample["decoded_sigma_z_mm"][both])
    assert both.sum() > 1000
    assert np.percentile(np.abs(normalised), 68.27) == pytest.approx(1.0, abs=0.1)


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
