"""A domed pad from CAD under a photometric sensor: undeformed, and pressed by a ball."""

import numpy as np
import pytest

from reconstruction.errors import InputError
from reconstruction.evaluate.fit import fit_sphere
from twin.config import load_experiment
from twin.mechanics import PressedElastomer
from twin.mechanics.layouts import cell_centres, face_nodes
from twin.mechanics.models.fem import FemModel
from twin.mechanics.validity import contact_validity
from twin.optics.colour_trace import ColourScene
from twin.pipeline import measure
from twin.pipeline.memory import Memory
from twin.pipeline.reference_presses import bare_face, rest_surface, undeformed
from twin.specimens import shape_of

RADIUS_MM = 16.0
"""Radius of scenes/examples/dome.stl, whose facets have edges of 1 mm."""
BLOCK_MM = 50.0
"""Radius of scenes/examples/domed_block.stl, whose facets have edges of 1.8 mm."""
PAD = {
    "mechanics.model": "fem",
    "mechanics.pad": {"file": "scenes/examples/dome.stl"},
    "elastomer.thickness_mm": 4.0,
    "elastomer.length_x_mm": 14.0,
    "elastomer.length_y_mm": 11.0,
    "layers.window.thickness_mm": 5.25,
    "press.solver_pitch_mm": 0.25,
    "photometric.width_px": 64,
    "photometric.height_px": 48,
}
# A third of the camera's pixels along each axis, of the same field and exposure.
FEW_PIXELS = {
    "photometric.presses.count": 6,
    "photometric.width_px": 160,
    "photometric.height_px": 120,
    "camera.width_px": 1092,
    "camera.height_px": 820,
    "camera.pixel_pitch_um": 3.36,
    "camera.full_well_e": 9 * 135.0,
}


@pytest.fixture(scope="module")
def experiment():
    return load_experiment("examples/gelsight_ball", PAD)


@pytest.fixture(scope="module")
def coat(experiment):
    return undeformed(experiment)


def test_the_undeformed_coat_is_the_dome(coat):
    """Expected: a cap of 16 mm within 3 um RMS, though the facets are up to 10 um inside it."""
    x_mm, y_mm = np.meshgrid(coat.face_x_mm, coat.face_y_mm)
    off_mm = coat.face_z_mm - RADIUS_MM + np.sqrt(RADIUS_MM**2 - x_mm**2 - y_mm**2)
    assert np.sqrt(np.mean(off_mm**2)) < 0.003
    assert not coat.contact.any()


def test_pixels_image_the_dome_along_their_lines_of_sight(mi, experiment, coat):
    """Expected: points and slopes of the cap; lines that spread by 1 / (index x distance)."""
    rest = rest_surface(experiment, ColourScene(experiment, bare_face(experiment, coat)), coat)
    x_mm, y_mm, z_mm = np.moveaxis(rest.points_mm.astype(float), -1, 0)
    inner = np.hypot(x_mm, y_mm) < 5.0
    depth_mm = np.sqrt(RADIUS_MM**2 - x_mm**2 - y_mm**2)
    assert np.abs(z_mm - RADIUS_MM + depth_mm)[inner].max() < 0.006
    for slope, along_mm in zip(rest.slopes, (-y_mm, x_mm), strict=True):
        assert np.abs(slope - along_mm / depth_mm)[inner].max() < 0.03
    level_mm = x_mm - z_mm * rest.sight[1]
    spread = np.polyfit(level_mm[inner], rest.sight[1][inner], 1)[0]
    layers = experiment.layers.values()
    raised_mm = sum(layer.thickness_mm * (1.0 - 1.0 / layer.ior) for layer in layers)
    distance_mm = experiment.camera.pose.standoff_mm - raised_mm
    assert spread == pytest.approx(-1.0 / (experiment.layers["gel"].ior * distance_mm), rel=0.05)


def test_a_lamp_beside_the_flank_of_a_dome_is_refused(experiment):
    low = load_experiment("examples/gelsight_ball", PAD | {"lamps.blue_1.height_mm": 2.0})
    with pytest.raises(
        InputError, match=r"lamps\.blue_1: its lower edge is at 1 mm, allowed above"
    ):
        undeformed(low)


def as_springs(self, case, progress=None):
    """Press in closed form in place of the elements: the dome, or the ball where that is higher."""
    load, (ball,) = case.load, case.shape.spheres()
    sizes = case.elastomer.length_x_mm, case.elastomer.length_y_mm
    cells, nodes = ([grid(size, load) for size in sizes] for grid in (cell_centres, face_nodes))
    rest, touched = (self.rest_face_mm(case, *at) for at in (nodes, cells))
    coat, overlap = (raised(ball, load.depth_mm, *np.meshgrid(*at)) for at in (nodes, cells))
    contact = overlap > touched
    return PressedElastomer(
        *cells,
        pressure_kpa=contact * 1.0,
        contact=contact,
        touched_face_mm=np.maximum(touched, overlap),
        force_n=1.0,
        depth_mm=load.depth_mm,
        young_modulus_kpa=100.0,
        face_x_mm=nodes[0],
        face_y_mm=nodes[1],
        face_z_mm=np.maximum(rest, coat),
        validity=contact_validity(case.shape, case.elastomer, (*cells, contact), 0.1, 0.1),
        iterations=1,
        converged=True,
    )


def centre_mm(ball, depth_mm, dome_mm=BLOCK_MM):
    """Return the centre of a ball that is `depth_mm` beyond its first touch of a dome."""
    apart = dome_mm + ball.radius_mm
    z_mm = dome_mm - np.sqrt(apart**2 - ball.x_mm**2 - ball.y_mm**2) + depth_mm
    return np.array([ball.x_mm, ball.y_mm, z_mm])


def raised(ball, depth_mm, x_mm, y_mm):
    x, y, z = centre_mm(ball, depth_mm)
    inside = ball.radius_mm**2 - (x_mm - x) ** 2 - (y_mm - y) ** 2
    return np.where(inside > 0.0, z + np.sqrt(np.maximum(inside, 0.0)), -np.inf)


@pytest.fixture(scope="module")
def memory():
    return Memory()


@pytest.mark.usefixtures("mi")
@pytest.mark.parametrize(
    ("place_mm", "rms_mm", "radius_rel"), [((0.0, 0.0), 0.01, 0.06), ((5.0, 3.0), 0.03, 0.3)]
)
def test_a_ball_on_a_dome_by_coloured_lamps(monkeypatch, memory, place_mm, rms_mm, radius_rel):
    """Setup: the shipped sensor with 1/9 of its pixels, 6 reference presses, closed-form coats.

    Expected: heights within 10 um RMS of dome and ball over the field of the sensor, and the radius
    of the ball within 6 %; on the flank, near which few references are, within 30 um and 30 %.
    """
    monkeypatch.setattr(FemModel, "press", as_springs)
    place = dict(zip(("specimen.x_mm", "specimen.y_mm"), place_mm, strict=True))
    case = load_experiment("examples/domed_gelsight", FEW_PIXELS | place)
    points = measure(case, memory=memory).points
    x_mm, y_mm, z_mm = points.world_mm[points.valid].astype(float).T
    (ball,) = shape_of(case.specimen).spheres()
    dome_mm = BLOCK_MM - np.sqrt(BLOCK_MM**2 - x_mm**2 - y_mm**2)
    off_mm = z_mm - np.maximum(dome_mm, raised(ball, case.press.depth_mm, x_mm, y_mm))
    size = case.photometric
    field = (np.abs(x_mm) < size.field_x_mm / 2) & (np.abs(y_mm) < size.field_y_mm / 2)
    assert np.mean(field) > 0.8
    assert np.sqrt(np.mean(off_mm[field] ** 2)) < rms_mm
    middle = np.array(place_mm) * BLOCK_MM / (BLOCK_MM + ball.radius_mm)
    inner = np.hypot(x_mm - middle[0], y_mm - middle[1]) < 0.9
    measured = fit_sphere(np.column_stack([x_mm, y_mm, z_mm])[inner])
    assert measured.radius_mm == pytest.approx(ball.radius_mm, rel=radius_rel)
