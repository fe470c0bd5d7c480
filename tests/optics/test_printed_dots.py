"""Dots printed on a coat move with its material; the tracker measures them in rendered images."""

import numpy as np
import pytest
from scipy.spatial import KDTree

from reconstruction.markers import find_pattern, track
from reconstruction.rig.pinhole import Pinhole
from twin.config import load_experiment
from twin.config.lamps import Lamp, Markers
from twin.mechanics.relief import MATERIAL_MM
from twin.optics.lamps import emitters_of

GEL_MM, N_GEL, STANDOFF_MM = 5.0, 1.41, 30.0
SIDE = 120
PINHOLE = Pinhole(SIDE, SIDE, 330.0, 330.0, (SIDE - 1) / 2, (SIDE - 1) / 2)
T_WORLD_FROM_CAM = np.array(
    [[1.0, 0, 0, 0], [0, -1.0, 0, 0], [0, 0, -1.0, STANDOFF_MM], [0, 0, 0, 1.0]]
)
DOTS = Markers(pitch_x_mm=1.8, pitch_y_mm=1.7, radius_mm=0.4, relative_albedo=0.2)


def bump(x, y):
    return 0.4 * np.exp(-(x**2 + y**2) / 6.0)


def shift(x, y):
    """Material coordinates minus place, mm: the material moved outwards, and by a slip."""
    near = np.exp(-(x**2 + y**2) / 10.0)
    return -0.06 * x * near - 0.15 * near, -0.06 * y * near + 0.10 * near


@pytest.fixture(scope="module")
def rendered(mi, grid_face):
    """Return images, (row, col), of the flat and of the pressed coat, and places of the dots."""
    from twin.config.layers import Medium
    from twin.optics.colour_trace import LampRig, trace_channels
    from twin.optics.devices import Device
    from twin.optics.layers import LayerStack
    from twin.optics.printed_dots import PrintedDots
    from twin.optics.scene import CoatedScene

    camera = Device(PINHOLE, T_WORLD_FROM_CAM)
    gel = LayerStack((Medium(GEL_MM, N_GEL, 0.0),))
    lamps = [
        Lamp.model_validate({
            "channel": "red", "x_mm": 25 * np.cos(a), "y_mm": 25 * np.sin(a), "height_mm": 9.0,
            "length_mm": 0.0, "along_deg": 90.0, "aim_azimuth_deg": np.rad2deg(a) - 180.0,
            "aim_down_deg": 15.0, "exponent": 0.0, "flux_mw": 2.0, "wavelength_nm": 630.0,
            "emitters": 1,
        })
        for a in (0.5, 2.6, 4.7)
    ]  # fmt: skip
    emitters = emitters_of({str(k): lamp for k, lamp in enumerate(lamps)})

    def image(height, moved):
        # The attributes of the face, as `seen_face` returns it.
        face = grid_face(height, lambda x, y: (0 * x, 0 * y), pitch_mm=0.1)
        x, y = face.vertices[:, :2].T
        face.vertex_attributes[MATERIAL_MM] = np.stack(np.add((x, y), moved(x, y)), axis=-1)
        matte = {"type": "diffuse", "reflectance": {"type": "spectrum", "value": 0.5}}
        rig = LampRig(camera, emitters, gel, PrintedDots.on(DOTS, face))
        return trace_channels(CoatedScene(face, matte), rig, 25)[..., 0].astype(np.float64)

    def places(points_mm):
        arrival = gel.arrive(camera, 1.0, mi.Point3f(points_mm.T.astype(np.float32)))
        return np.column_stack([np.array(arrival.row_px), np.array(arrival.column_px)])

    def centres(height, moved):
        """Return the mean image place of each dot's area: of 96 points of equal area."""
        r, angle = np.meshgrid(np.sqrt((np.arange(8) + 0.5) / 8), np.arange(12) * np.pi / 6)
        area = DOTS.radius_mm * np.column_stack(
            [(r * np.cos(angle)).ravel(), (r * np.sin(angle)).ravel()]
        )
        i, j = (k.ravel() for k in np.meshgrid(np.arange(-3, 4), np.arange(-3, 4)))
        material = np.column_stack([i * DOTS.pitch_x_mm, j * DOTS.pitch_y_mm])[:, None] + area
        material = material.reshape(-1, 2)
        at = material.copy()
        for _ in range(40):
            at = material - np.column_stack(moved(*at.T))
        seen = places(np.column_stack([at, height(*at.T)]))
        return seen.reshape(-1, 96, 2).mean(axis=1)

    def rest(x, y):
        return 0 * x, 0 * y

    def plane(x, _):
        return 0 * x

    return (
        (image(plane, rest), centres(plane, rest)),
        (image(bump, shift), centres(bump, shift)),
    )


def test_dots_are_tracked_in_rendered_images(rendered):
    """Setup: dots of 0.4 mm radius behind a gel, a bump of 0.4 mm and a slip of up to 0.2 mm.

    Expected: centres where the closed form and Snell's law put the area of each dot;
    displacements of up to 4 px with an RMS error below 0.05 px; with noise of three percent of
    the brightest light, error over sigma 0.7 to 1.3 for 25 dots or more.
    """
    (flat, before), (pressed, after) = rendered
    rng = np.random.default_rng(1)
    noise = 0.03 * flat.max() * rng.standard_normal((2, *flat.shape))
    tracks = track(flat + noise[0], pressed + noise[1])
    apart, number = KDTree(before).query(tracks.places_px)
    assert apart.max() < 0.1
    ok = tracks.tracked
    assert np.count_nonzero(ok) >= 25
    true = (after - before)[number][ok]
    assert 2.0 < np.hypot(*true.T).max() < 5.0
    error = tracks.moved_px[ok] - true
    assert np.sqrt(np.mean(error**2)) < 0.05
    assert 0.7 < np.sqrt(np.mean((error / tracks.sigma_px[ok]) ** 2)) < 1.3


def test_centres_without_noise(rendered):
    """Expected: centres of sharp dots within the stated error of the model: 0.01 px RMS."""
    (flat, before), _ = rendered
    centres = find_pattern(flat).dots.centres_px
    error = centres - before[KDTree(before).query(centres)[1]]
    assert np.sqrt(np.mean(error**2)) < 0.01


def test_shift_is_linear_between_the_nodes(mi):
    """Setup: a shift that is linear in x and y on a grid of unequal sides. Expected: float32."""
    from twin.optics.printed_dots import MaterialShift

    x, y = np.meshgrid(np.linspace(-3.0, 5.0, 17), np.linspace(-2.0, 2.0, 6))
    places = np.stack([x, y], axis=-1)
    moved = np.stack([0.1 * x - 0.3 * y + 0.2, 0.05 * x + 0.02 * y], axis=-1)
    points = np.random.default_rng(0).uniform((-3.0, -2.0), (5.0, 2.0), (100, 2))
    at = MaterialShift.of_grid(places, places + moved).at(mi.Point3f(*points.T, np.zeros(100)))
    px, py = points.T
    np.testing.assert_allclose(np.array(at[0]), 0.1 * px - 0.3 * py + 0.2, atol=1e-6)
    np.testing.assert_allclose(np.array(at[1]), 0.05 * px + 0.02 * py, atol=1e-6)


def test_a_pressed_sensor_moves_its_dots(mi):
    """Setup: a ball in the shipped sensor's gel, whose model computes the displacement.

    Expected: the face has material coordinates, which differ from its places; none without dots.
    """
    from twin.mechanics import material_points
    from twin.optics.backed_coat import seen_face
    from twin.pipeline.press import press_smooth

    plain = load_experiment("examples/gelsight_ball")
    photometric = plain.photometric.model_copy(update={"markers": DOTS})
    experiment = plain.model_copy(update={"photometric": photometric})
    pressed = press_smooth(experiment)
    face = seen_face(experiment, pressed)
    material = face.vertex_attributes[MATERIAL_MM]
    expected = material_points(pressed, experiment.elastomer, experiment.press)
    np.testing.assert_array_equal(material, np.stack([of.ravel() for of in expected], axis=-1))
    assert np.abs(material - face.vertices[:, :2]).max() > 0.01
    assert MATERIAL_MM not in seen_face(plain, pressed).vertex_attributes
