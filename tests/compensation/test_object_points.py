"""Points of the object under a sheet that the twin pressed, against the true surface of the object.

Error over stated sigma, signed distance over the sigma of the point, root mean square.
"""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.interpolate import RectBivariateSpline

from benchmarks.coat_compensation import stairs_mesh
from reconstruction.arrays import FloatArray, Reason
from reconstruction.evaluate.fit import rms
from reconstruction.triangulation import PointMap
from tests.compensation.test_command import coat_map
from twin.config.coatings import Texture
from twin.config.elastomer import Elastomer, Mechanics, Press
from twin.config.sensor_layer import MeasuredLoad, SensorLayer
from twin.config.sigma import LayerSigma
from twin.config.specimen_base import Specimen
from twin.mechanics import PressedElastomer
from twin.mechanics.choice import press_with
from twin.mechanics.texture import textured
from twin.pipeline.compensation import compensate_points
from twin.results.compensated import object_points
from twin.specimens import shape_of
from twin.specimens.kinds.mesh import MeshFile
from twin.specimens.kinds.rod import Rod
from twin.specimens.true_surface import TrueSurface

THICKNESS_MM, AIR_KPA, SPAN_MM = 0.15, 2.5, 9.0
NOISE_MM, PITCH_MM, TEXTURE = 3e-4, 0.06, Texture(rms_um=5.0, correlation_mm=0.15)
SHEET = Elastomer(
    thickness_mm=THICKNESS_MM,
    length_x_mm=SPAN_MM,
    length_y_mm=SPAN_MM,
    young_modulus_kpa=413.0,
    poisson_ratio=0.49,
)
CYLINDER = Rod(diameter_mm=6.0, length_mm=5.0, tilt_deg=6.0)


@cache
def pressed(specimen: Specimen, travel_mm: float) -> tuple[Press, PressedElastomer]:
    """Press through 0.15 mm at 2.5 kPa."""
    load = Press(
        control="depth", depth_mm=travel_mm, back_pressure_kpa=AIR_KPA, cell_mm=0.15,
        relief_pitch_mm=0.05,
    )  # fmt: skip
    return load, press_with(Mechanics(model="sheet"), specimen, SHEET, load)


def coat_of(load: Press, pressing: PressedElastomer, texture: Texture | None) -> PointMap:
    """Return the coat as measured by a camera above it, with white noise."""
    if texture:
        pressing = textured(pressing, SHEET, load, texture, seed=3)
    places = np.arange(-SPAN_MM / 2 + PITCH_MM / 2, SPAN_MM / 2, PITCH_MM)
    face = RectBivariateSpline(pressing.face_y_mm, pressing.face_x_mm, pressing.face_z_mm)
    z = face(places, places) + np.random.default_rng(2).normal(
        scale=NOISE_MM, size=(len(places),) * 2
    )
    x, y = np.meshgrid(places, places)
    points = np.stack((x, y, z), axis=-1).astype(np.float32)
    sigma = np.zeros_like(points)
    sigma[..., 2] = NOISE_MM
    return PointMap(points, sigma, np.full(z.shape, Reason.VALID, np.uint8), np.eye(4))


def errors_mm(
    specimen: Specimen, travel_mm: float, texture: Texture | None, stated: bool = True
) -> tuple[FloatArray, FloatArray]:
    """Return the distance of the object's points from the true object, and their sigma.

    If the texture is not stated, it is estimated from the coat.
    """
    load, pressing = pressed(specimen, travel_mm)
    coat = coat_of(load, pressing, texture)
    rms_mm = (1e-3 * texture.rms_um if texture else 0.0) if stated else None
    layer = SensorLayer(
        elastomer=SHEET,
        press=MeasuredLoad(back_pressure_kpa=AIR_KPA),
        sigma=LayerSigma(texture_mm=rms_mm),
    )
    points = object_points(coat, compensate_points(coat, layer), layer.sigma.texture_mm)
    measured_mm = points.points_world_mm[points.valid].astype(np.float64)
    true = TrueSurface(shape_of(specimen), pressing.depth_mm + SHEET.touched_plane_mm)
    sigma = np.linalg.norm(points.sigma_xyz_mm[points.valid].astype(np.float64), axis=-1)
    return true.distance_mm(measured_mm), sigma


@pytest.fixture(scope="module")
def ellipsoid(tmp_path_factory: pytest.TempPathFactory) -> MeshFile:
    """Ellipsoid with principal radii of 3.4 and 2.6 mm on top."""
    body = trimesh.creation.icosphere(subdivisions=5)
    body.vertices *= [3.2, 2.8, 3.0]
    return _written(body, tmp_path_factory.mktemp("body") / "ellipsoid.stl")


@pytest.fixture(scope="module")
def stairs(tmp_path_factory: pytest.TempPathFactory) -> MeshFile:
    """Three steps of 0.3 mm along x, upright and sharp."""
    return _written(stairs_mesh(), tmp_path_factory.mktemp("body") / "stairs.stl")


def _written(body: trimesh.Trimesh, path: Path) -> MeshFile:
    body.export(path)
    return MeshFile(file=str(path))


@pytest.mark.parametrize("texture", [None, TEXTURE])
def test_texture_of_the_coat_is_in_the_sigma_of_the_object(texture: Texture | None) -> None:
    """Tilted cylinder with edges at its ends: errors agree with the sigma (30 times before)."""
    error, sigma = errors_mm(CYLINDER, 0.4, texture)
    assert len(error) > 1000
    assert 0.85 < rms(error / sigma) < 1.15


def test_a_smooth_ellipsoid_agrees_with_its_sigma(ellipsoid: MeshFile) -> None:
    """The contact squeezes the sheet by a micrometre, which is corrected."""
    error, sigma = errors_mm(ellipsoid, 0.4, None)
    assert len(error) > 1000
    assert abs(error.mean()) < 3e-4
    assert 0.85 < rms(error / sigma) < 1.15


@pytest.mark.parametrize(("texture", "largest_mm"), [(None, 4e-3), (TEXTURE, 0.02)])
def test_spans_next_to_steps_are_no_object(
    stairs: MeshFile, texture: Texture | None, largest_mm: float
) -> None:
    """The sheet spans free from edge to edge, and lifts off by up to 20 um behind an edge."""
    error, sigma = errors_mm(stairs, 0.5, texture)
    assert len(error) > 100  # of the highest tread, which carries the sheet
    assert np.abs(error).max() < largest_mm
    assert np.mean(np.abs(error) > 4 * sigma) < 0.005


def test_unknown_texture_is_taken_from_the_coat() -> None:
    """A coat with 5 um of scatter of unknown cause gives points of that uncertainty."""
    error, sigma = errors_mm(CYLINDER, 0.4, TEXTURE, stated=False)
    assert np.median(sigma) == pytest.approx(5e-3, rel=0.12)
    assert 0.85 < rms(error / sigma) < 1.15


def test_a_ball_of_the_one_dimensional_oracle() -> None:
    """Pressed by other code; white texture is stated as noise, or estimated from the coat."""
    texture_mm = 0.004
    layer = SensorLayer(
        elastomer=Elastomer(
            thickness_mm=0.2, length_x_mm=12.0, length_y_mm=12.0, outline="round",
            young_modulus_kpa=300.0, poisson_ratio=0.49,
        ),
        press=MeasuredLoad(back_pressure_kpa=2.0),
    )  # fmt: skip
    coat, random = coat_map(), np.random.default_rng(8)
    rough = random.normal(scale=np.hypot(NOISE_MM, texture_mm), size=coat.mask_reason.shape)
    points_mm = coat.points_world_mm.copy()
    points_mm[..., 2] += np.where(coat.valid, rough, 0.0)
    sigma = np.where(coat.valid[..., None], np.float32([0.0, 0.0, NOISE_MM]), np.float32(0.0))
    coat = replace(coat, points_world_mm=points_mm, sigma_xyz_mm=sigma)
    compensated = compensate_points(coat, layer)
    for stated_mm in (texture_mm, None):
        points = object_points(coat, compensated, stated_mm)
        away = points.points_world_mm[points.valid] - np.array([0.0, 0.0, 0.6 - 0.2 - 4.0])
        error = np.linalg.norm(away, axis=-1) - 4.0
        sigma = np.linalg.norm(points.sigma_xyz_mm[points.valid], axis=-1)
        assert 0.85 < rms(error / sigma) < 1.15
