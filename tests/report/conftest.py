"""A small finished measurement made without a renderer: analytic rays and pattern levels."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator

from reconstruction.capture.folder import Capture
from reconstruction.pipeline import reconstruct
from twin.camera import expose
from twin.config import Experiment, load_experiment
from twin.mechanics import PressedElastomer
from twin.optics.light import pattern_set
from twin.optics.rig import true_calibration
from twin.optics.stack import RadianceStack, Truth
from twin.pipeline.captures import options_of
from twin.pipeline.fringes import evaluate
from twin.pipeline.press import press_specimen
from twin.results.folder import write_measurement
from twin.results.record import Recording

# mW / (mm^2 sr) of a white field; the automatic exposure takes care of the rest.
WHITE_RADIANCE = 1e-3


@pytest.fixture(scope="session")
def experiment() -> Experiment:
    """The shipped experiment with a camera of 242 x 183 large pixels and coarse meshes."""
    return load_experiment(
        "examples/slab_balls",
        {
            "camera.width_px": 968,
            "camera.height_px": 732,
            "camera.pixel_pitch_um": 9.0,
            "camera.binning": 4,
            "press.solver_pitch_mm": 0.2,
            "press.relief_pitch_mm": 0.05,
        },
    )


@pytest.fixture(scope="session")
def pressed(experiment: Experiment) -> PressedElastomer:
    return press_specimen(experiment)


@pytest.fixture(scope="session")
def finished(
    experiment: Experiment, pressed: PressedElastomer, tmp_path_factory: pytest.TempPathFactory
) -> Path:
    """Folder of the finished measurement, without a report. Not to be changed by tests."""
    folder = tmp_path_factory.mktemp("finished") / "result"
    folder.mkdir()
    recording = record_analytically(experiment, pressed)
    reconstruction = reconstruct(recording.capture, options_of(experiment.decode))
    done = evaluate(experiment, pressed, recording, reconstruction)
    write_measurement(folder, "measure", replace(done, seconds={"press": 1.5}))
    return folder


def record_analytically(experiment: Experiment, pressed: PressedElastomer) -> Recording:
    truth = meet_face(experiment, pressed)
    patterns = pattern_set(experiment.projector, experiment.patterns)
    levels = []
    for frame in patterns.frames:
        profile = patterns.profile(frame) / 255.0
        at = truth.row_px if frame.axis == "row" else truth.column_px
        levels.append(np.interp(at, np.arange(profile.size), profile) * truth.lit)
    radiance = (WHITE_RADIANCE * np.stack(levels)).astype(np.float32)
    white = patterns.index("white").start
    exposed = expose(experiment, radiance, white, 0)
    capture = Capture(
        exposed.stack,
        patterns,
        exposed.sensor,
        true_calibration(experiment),
        experiment.camera.bit_depth,
    )
    return Recording(RadianceStack(radiance, truth), capture, exposed.exposure_ms)


def meet_face(experiment: Experiment, pressed: PressedElastomer) -> Truth:
    """Intersection of each pixel centre's ray with the coated face, by fixed-point iteration."""
    rig = true_calibration(experiment)
    camera, centre = rig.camera, rig.T_world_from_cam[:3, 3]
    row, col = np.mgrid[: camera.height_px, : camera.width_px]
    rays = camera.unproject(np.stack([col, row], axis=-1).astype(float))
    rays = (
        np.concatenate([rays, np.ones((*row.shape, 1))], axis=-1) @ rig.T_world_from_cam[:3, :3].T
    )
    face = RegularGridInterpolator(
        (pressed.face_y_mm, pressed.face_x_mm),
        pressed.face_z_mm,
        bounds_error=False,
        fill_value=0.0,
    )
    height = np.zeros(row.shape)
    for _ in range(12):
        points = centre + ((height - centre[2]) / rays[..., 2])[..., None] * rays
        height = face(points[..., 1::-1])
    from_projector = (points - rig.T_world_from_proj[:3, 3]) @ rig.T_world_from_proj[:3, :3]
    pixels = rig.projector.project(from_projector)
    inside = np.all(
        (pixels > -0.5) & (pixels < [rig.projector.width_px - 0.5, rig.projector.height_px - 0.5]),
        axis=-1,
    )
    half = np.array([experiment.elastomer.length_x_mm, experiment.elastomer.length_y_mm]) / 2
    lit = inside & np.all(np.abs(points[..., :2]) < half, axis=-1)
    upwards = np.zeros(points.shape, np.float32)  # no report looks at the normals
    upwards[..., 2] = 1.0
    return Truth(
        points_world_mm=points.astype(np.float32),
        normals_world=upwards,
        depth_mm=(centre[2] - points[..., 2]).astype(np.float32),
        column_px=pixels[..., 0].astype(np.float32),
        row_px=pixels[..., 1].astype(np.float32),
        lit=lit,
        measured=np.ones_like(lit),
    )
