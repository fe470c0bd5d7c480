"""Lamps at the sides of the gel: closed forms of their light, and its direction in the image."""

import numpy as np
import pytest

from reconstruction.rig.pinhole import Pinhole
from twin.config import ConfigError, load_experiment
from twin.config.lamps import Lamp, Markers
from twin.config.layers import Layer, OuterFace, outer_face
from twin.optics.lamps import Emitters, drifted_flux, emitters_of, reflected_within, sky_seen

GEL_MM, N_GEL, ABSORPTION = 12.0, 1.41, 0.02
OUTER = OuterFace(GEL_MM, N_GEL)
ALBEDO = 0.5
STANDOFF_MM = 40.0
PINHOLE = Pinhole(64, 48, 100.0, 100.0, 31.5, 23.5)
T_WORLD_FROM_CAM = np.array(
    [[1.0, 0, 0, 0], [0, -1.0, 0, 0], [0, 0, -1.0, STANDOFF_MM], [0, 0, 0, 1.0]]
)


def lamp(**changes):
    plain = {
        "channel": "red", "x_mm": 14.0, "y_mm": 2.0, "height_mm": 4.0, "length_mm": 0.0,
        "along_deg": 90.0, "aim_azimuth_deg": 180.0, "aim_down_deg": 15.0, "exponent": 0.0,
        "flux_mw": 2.0, "wavelength_nm": 630.0, "emitters": 1,
    }  # fmt: skip
    return Lamp.model_validate(plain | changes)


MATTE = {"type": "diffuse", "reflectance": {"type": "spectrum", "value": ALBEDO}}


@pytest.fixture(scope="module")
def look(mi):
    """Return a function that renders a matte face in a deep gel, and the truth behind it."""
    from twin.config.layers import Medium
    from twin.optics.colour_trace import LampRig, trace_channels, trace_face
    from twin.optics.devices import Device
    from twin.optics.layers import LayerStack
    from twin.optics.scene import CoatedScene

    gel = LayerStack((Medium(GEL_MM, N_GEL, ABSORPTION),))

    def render(face, *lamps, layers=gel, outer=OUTER, samples=1, **rest):
        rows = {str(number): lamp_ for number, lamp_ in enumerate(lamps)}
        emitters = emitters_of(rows, face=None if layers is None else outer)
        camera = Device(PINHOLE, T_WORLD_FROM_CAM)
        rig = LampRig(camera, emitters, layers, **rest)
        scene = CoatedScene(face, MATTE)
        return trace_channels(scene, rig, samples), trace_face(scene, rig).points_world_mm

    return render


def seen_share(points_mm):
    """Ratio of radiance in air and in the gel, and path length in the gel: Fresnel, Snell, Beer."""
    row, col = np.mgrid[:48, :64]
    tangent = np.hypot((col - 31.5) / 100, (row - 23.5) / 100)
    outside = np.arctan(tangent)
    inside = np.arcsin(np.sin(outside) / N_GEL)
    a, b = np.cos(outside), np.cos(inside)
    s = 4 * N_GEL * a * b / (a + N_GEL * b) ** 2
    p = 4 * N_GEL * a * b / (N_GEL * a + b) ** 2
    way_mm = (GEL_MM - points_mm[..., 2]) / b
    return (s + p) / 2 / N_GEL**2 * np.exp(-ABSORPTION * way_mm)


def fresnel_within(cosine):
    """Fresnel's reflectance from the gel against air, by the sine law of the refracted angle."""
    inside = np.arccos(cosine)
    sine = N_GEL * np.sin(inside)
    outside = np.arcsin(np.minimum(sine, 1.0))
    s = np.sin(inside - outside) / np.sin(inside + outside)
    p = np.tan(inside - outside) / np.tan(inside + outside)
    return np.where(sine < 1.0, (s**2 + p**2) / 2, 1.0)


def test_flat_coat_under_one_led_is_lambert_in_closed_form(look, plane):
    """Setup: one LED with a cosine-power lobe in an absorbing gel that ends in air, matte coat.

    Expected: L = rho / pi I0 cos^m cos(incidence) exp(-a r) / r^2 T exp(-a s) / n^2 with
    I0 = (m + 1) flux / 2 pi, and as much from its image, by Fresnel; float32 rays: 2e-4.
    """
    rendered, points = look(plane, lamp(exponent=3.0))
    expected = ALBEDO * radiance_of_white(points)
    np.testing.assert_allclose(rendered[..., 0], expected, rtol=2e-4)
    assert rendered[..., 1:].max() == 0.0


def radiance_of_white(points):
    """Radiance of a flat white coat under `lamp(exponent=3.0)` and its mirror image."""

    def irradiance(height_mm, down_deg):
        way = np.array([14.0, 2.0, height_mm]) - points
        r, down = np.linalg.norm(way, axis=-1), np.deg2rad(down_deg)
        ahead = np.maximum(way @ [np.cos(down), 0.0, np.sin(down)], 0.0) / r
        light = 4 / (2 * np.pi) * 2.0 * ahead**3 * way[..., 2] / r**3 * np.exp(-ABSORPTION * r)
        return light, way[..., 2] / r

    (straight, _), (image, cosine) = irradiance(4.0, 15.0), irradiance(2 * GEL_MM - 4.0, -15.0)
    both = straight + image * fresnel_within(cosine)
    assert image[24, 0] * fresnel_within(cosine)[24, 0] > 0.1 * straight[24, 0]
    return both * seen_share(points) / np.pi


def test_the_albedo_of_a_flat_coat_is_its_radiance_over_that_of_white(mi, look, plane):
    """Expected: the closed form of the test above, at every pixel; with dots 0.2 of it on a dot."""
    from twin.config.layers import Medium
    from twin.optics.albedo import albedo_of
    from twin.optics.colour_trace import LampRig
    from twin.optics.devices import Device
    from twin.optics.layers import LayerStack
    from twin.optics.printed_dots import PrintedDots
    from twin.optics.scene import CoatedScene

    gel = LayerStack((Medium(GEL_MM, N_GEL, ABSORPTION),))
    led, scene = lamp(exponent=3.0), CoatedScene(plane, MATTE)
    emitters = emitters_of({"0": led}, face=OUTER)
    markers = Markers(pitch_x_mm=2.0, pitch_y_mm=2.0, radius_mm=0.5, relative_albedo=0.2)
    for dots in (None, PrintedDots(markers)):
        rendered, points = look(plane, led, dots=dots)
        rig = LampRig(Device(PINHOLE, T_WORLD_FROM_CAM), emitters, gel, dots)
        albedo = albedo_of(scene, rig)
        np.testing.assert_allclose(rendered[..., 0] / albedo, radiance_of_white(points), rtol=2e-4)
        off = points[..., :2] - 2.0 * np.rint(points[..., :2] / 2.0)
        inside = np.hypot(off[..., 0], off[..., 1]) < 0.5 if dots else np.zeros(albedo.shape, bool)
        np.testing.assert_allclose(albedo, np.where(inside, 0.2 * ALBEDO, ALBEDO), rtol=1e-5)
        assert inside.any() == (dots is not None)


def test_bump_in_air_equals_stock_mitsuba(mi, look, bump):
    """Setup: no gel, one even LED; stock `point` emitter of the same intensity, 256 paths a pixel.

    Expected: the same image. The bump is steeper than the light, so shadows are in it; pixels on
    their edge are random in stock: at most 1 % of the pixels may differ by over 2 %.
    """
    from twin.optics.materials import coated_mesh
    from twin.optics.rig import perspective_sensor

    led = lamp(height_mm=3.0)
    image = look(bump, led, layers=None, samples=64)[0][..., 0]
    light = {"type": "point", "position": [14.0, 2.0, 3.0]}
    light["intensity"] = {"type": "spectrum", "value": led.flux_mw / (2 * np.pi)}
    scene = {"type": "scene", "coated_face": coated_mesh(bump, MATTE), "light": light}
    scene["sensor"] = perspective_sensor(PINHOLE, T_WORLD_FROM_CAM, 256)
    scene["integrator"] = {"type": "direct", "emitter_samples": 1, "bsdf_samples": 0}
    stock = np.asarray(mi.render(mi.load_dict(scene, optimize=False)))[..., 0]
    differs = np.abs(image - stock) > 0.02 * stock + 1e-7
    assert differs.mean() <= 0.01
    assert image.sum() == pytest.approx(stock.sum(), rel=2e-3)
    assert (stock < 1e-7).any()


def test_marched_rays_equal_the_tree(look, bump):
    """Setup: a bump steeper than the light, in the gel, by its heights and by the scene's tree.

    Expected: the same light and shadow but for rounding: 1e-4 of the brightest, on all pixels but
    those with a ray to the light that grazes the relief.
    """
    from twin.optics.scene import heights_of

    leds = lamp(height_mm=3.0), lamp(channel="blue", x_mm=-3.0, y_mm=11.0, aim_azimuth_deg=-90.0)
    heights = heights_of(bump)
    (marched, points), (plain, at) = (
        look(bump, *leds, heights=source) for source in (heights, None)
    )
    differs = np.abs(marched - plain) > 1e-4 * plain.max()
    assert (plain[..., 0] < 1e-3 * plain[..., 0].max()).mean() > 0.01  # in the shadow of the bump
    assert differs.any(axis=-1).mean() <= 1e-3
    np.testing.assert_allclose(points, at, atol=3e-5)


def test_a_replaced_face_is_traced_by_its_own_heights(mi, grid_face):
    """Expected: the image of a scene that was loaded with the face, pixel by pixel."""
    from twin.optics.colour_trace import ColourScene

    plane, bump = (
        grid_face(
            lambda x, y, top=top: top * np.exp(-(x**2 + y**2) / 4.0),
            lambda x, y: (0.0 * x, 0.0 * y),
            pitch_mm=0.25,
        )
        for top in (0.0, 0.8)
    )
    experiment = load_experiment("paper/gelsight_two_balls")
    reloaded, fresh = ColourScene(experiment, plane), ColourScene(experiment, bump)
    before = reloaded.render(PINHOLE, T_WORLD_FROM_CAM)
    reloaded.put(bump)
    image = reloaded.render(PINHOLE, T_WORLD_FROM_CAM)
    np.testing.assert_array_equal(image, fresh.render(PINHOLE, T_WORLD_FROM_CAM))
    assert np.abs(image - before).max() > 0.03 * image.max()


def test_light_falls_with_the_square_of_the_distance():
    """Setup: a narrow patch that faces an LED without aim, at 1 to 8 mm.

    Expected: 1 / r^2 exactly, with I0 = flux / 2 pi.
    """
    facing = np.array([[0.0, 0.0, 1.0]])
    for distance_mm in (1.0, 2.0, 8.0):
        led = lamp(x_mm=0.0, y_mm=0.0, height_mm=distance_mm, aim_down_deg=90.0)
        irradiance = emitters_of({"one": led}).irradiance(np.zeros((1, 3)), facing)
        assert irradiance[0, 0] == pytest.approx(2.0 / (2 * np.pi) / distance_mm**2)


@pytest.mark.parametrize("exponent", [0.0, 1.0, 17.5])
def test_the_lobe_carries_the_stated_flux(exponent):
    """Setup: irradiance on a sphere of 3 mm round a row of four LEDs at one place.

    Expected: its integral is the flux. Midpoint rule over 400 polar angles: 1e-4.
    """
    row = emitters_of({"one": lamp(exponent=exponent, emitters=4, x_mm=0.0, y_mm=0.0)})
    aim = row.aims[0]
    side = np.cross(aim, [0.0, 1.0, 0.0])
    side /= np.linalg.norm(side)
    polar = (np.arange(400) + 0.5) / 400 * np.pi
    outward = np.cos(polar)[:, None] * aim + np.sin(polar)[:, None] * side
    light = row.irradiance(row.positions_mm[0] + 3.0 * outward, -outward)[:, 0]
    ring = 2 * np.pi * 9.0 * np.sin(polar) * np.pi / 400
    assert np.sum(light * ring) == pytest.approx(2.0, rel=1e-4)


def test_the_outer_face_reflects_as_in_stock_mitsuba(mi):
    """Expected: `mi.fresnel` from inside, float32; 1 beyond the critical angle."""
    cosines = np.linspace(0.02, 1.0, 50)
    stock = np.array(mi.fresnel(mi.Float(cosines), 1.0 / N_GEL)[0])
    np.testing.assert_allclose(reflected_within(cosines, N_GEL), stock, atol=2e-6)
    assert (reflected_within(np.cos(np.deg2rad([45.5, 60.0, 89.0])), N_GEL) == 1.0).all()


def test_upward_light_of_an_led_is_reflected_onto_the_coat():
    """Setup: an even LED aimed straight up, 4 mm above the coat, below the outer face at 12 mm.

    Expected: all light on the coat's plane is flux times the mean of Fresnel's reflectance over the
    half-space, the integral of R over the cosine. Rings out to 89.9 degrees: 3e-3.
    """
    up = lamp(aim_down_deg=-90.0)
    emitters = emitters_of({"one": up}, face=OUTER)
    edges = (2 * GEL_MM - 4.0) * np.tan(np.deg2rad(np.linspace(0.0, 89.9, 4000)))
    radius = (edges[1:] + edges[:-1]) / 2
    points = np.column_stack([14.0 + radius, np.full_like(radius, 2.0), 0 * radius])
    light = emitters.irradiance(points, np.broadcast_to([0.0, 0, 1], points.shape))[:, 0]
    flux = np.sum(light * np.pi * np.diff(edges**2))
    cosines = (np.arange(4000) + 0.5) / 4000
    share = fresnel_within(cosines).mean()
    assert 0.7 < share < 0.8
    assert flux == pytest.approx(2.0 * share, rel=3e-3)


@pytest.mark.parametrize(
    ("layers", "face"),
    [
        ({}, None),
        ({"gel": (0.0, 4.0, 1.41), "window": (4.0, 5.0, 1.49)}, OuterFace(9.0, 1.41)),
        ({"gel": (0.0, 4.0, 1.41), "window": (6.0, 5.0, 1.49)}, OuterFace(4.0, 1.41)),
        ({"window": (6.0, 5.0, 1.49)}, None),
    ],
)
def test_light_comes_back_from_where_the_layers_that_touch_end(layers, face):
    """Expected: the top of the layers in contact with the coat's; None if the coat is in air."""
    outer = {
        name: Layer(bottom_mm=low, thickness_mm=thick, ior=ior)
        for name, (low, thick, ior) in layers.items()
    }
    assert outer_face(outer) == face


def test_a_matte_coat_equals_its_bsdf(look, bump):
    """Setup: a bump with its BSDF read once, and for every LED. Expected: the same, to float32."""
    once, every = (look(bump, lamp(exponent=3.0), matte=matte)[0] for matte in (True, False))
    np.testing.assert_allclose(once, every, rtol=1e-5, atol=1e-9)


def test_a_row_spreads_evenly_along_its_direction():
    row = emitters_of({"one": lamp(length_mm=8.0, emitters=4)})
    np.testing.assert_allclose(row.positions_mm[:, 1], [-1.0, 1.0, 3.0, 5.0])
    np.testing.assert_allclose(row.positions_mm[:, 0], 14.0)
    assert row.intensity.sum(axis=0) == pytest.approx([2.0 / (2 * np.pi), 0.0, 0.0])


def test_channels_are_linear_and_do_not_mix(look, bump):
    """Setup: only red, only green with a factor of two in flux, both.

    Expected: both = red + green, to float32: light is linear.
    """
    red, green = lamp(), lamp(channel="green", x_mm=-14.0, aim_azimuth_deg=0.0, flux_mw=1.0)
    twice = green.model_copy(update={"flux_mw": 2.0})
    both = look(bump, red, twice)[0]
    np.testing.assert_allclose(both[..., 0], look(bump, red)[0][..., 0], rtol=1e-5)
    np.testing.assert_allclose(both[..., 1], 2 * look(bump, green)[0][..., 1], rtol=1e-5)
    assert both[..., 2].max() == 0.0 < np.median(both[..., 1])


def test_fill_comes_from_beyond_the_critical_angle(look, bump):
    """Setup: fill with negligible direct light, on a bump with 25 degree flanks, in the gel.

    Expected: in the gel rho / pi E ((1 + n_z) / 2 - n_z / n^2) / (1 - 1 / n^2), within 2e-3
    (facets are shaded smoothly): nearly the value on the undeformed coat.
    """
    image, points = look(bump, lamp(flux_mw=1e-6, fill_mw_per_mm2=0.3))
    x, y = points[..., 0], points[..., 1]
    slope = points[..., 2] * np.hypot(x, y) / 2
    n_z = 1 / np.sqrt(1 + slope**2)
    sky = ((1 + n_z) / 2 - n_z / N_GEL**2) / (1 - 1 / N_GEL**2)
    expected = ALBEDO / np.pi * 0.3 * sky * seen_share(points)
    np.testing.assert_allclose(image[..., 0], expected, rtol=2e-3)


@pytest.mark.parametrize("tilt_deg", [0.0, 15.0, 30.0, 44.0])
@pytest.mark.parametrize("n", [None, 1.41, 1.5])
def test_the_sky_seen_is_the_integral_over_it(tilt_deg, n):
    """Expected: radiance 1 from all directions beyond the critical angle, summed over 400 x 800.

    Over that of an untilted facet, to 1e-3 (midpoint rule across the cap's edge).
    """
    cap = 0.0 if n is None else 1.0 / n**2
    theta = (np.arange(400) + 0.5) / 400 * np.pi / 2
    phi = (np.arange(800) + 0.5) / 800 * 2 * np.pi
    t, p = np.meshgrid(theta, phi, indexing="ij")
    shines = np.sin(t) > np.sqrt(cap)

    def light(tilt):
        facing = np.sin(tilt) * np.sin(t) * np.cos(p) + np.cos(tilt) * np.cos(t)
        return np.sum(np.maximum(facing, 0.0) * shines * np.sin(t))

    tilt = np.deg2rad(tilt_deg)
    assert sky_seen(np.cos(tilt), cap) == pytest.approx(light(tilt) / light(0.0), rel=2e-3)


def test_a_tapered_row_is_darker_at_its_ends():
    """Expected: the row's flux as stated, the LEDs' by a parabola, (1 - taper) at the ends."""
    row = lamp(length_mm=8.0, emitters=8, taper=0.8)
    each = emitters_of({"one": row}).intensity[:, 0]
    step = (np.arange(8) + 0.5) / 8 - 0.5
    parabola = 1 + 0.8 * (0.5 - 6 * step**2)
    assert each.sum() == pytest.approx(2.0 / (2 * np.pi))
    np.testing.assert_allclose(each / each.sum(), parabola / parabola.sum())


def test_a_tall_row_shines_from_all_heights_in_every_stretch():
    """Expected: eight even heights over 4 mm about 5 mm; low and high LEDs in both halves."""
    places = emitters_of(
        {"one": lamp(height_mm=5.0, tall_mm=4.0, length_mm=8.0, emitters=8)}
    ).positions_mm
    np.testing.assert_allclose(np.sort(places[:, 2]), 5.0 + 4.0 * ((np.arange(8) + 0.5) / 8 - 0.5))
    high = places[:, 2] > 5.0
    assert high[::2].all() != high[1::2].all()
    assert places[:, 2].mean() == pytest.approx(5.0)


def test_a_ridge_casts_a_shadow_as_long_as_rays_are_straight(look, grid_face):
    """Setup: a ridge 0.5 mm high along y, an LED 14 mm to its right, 2.6 mm above the coat.

    Expected: dark from the ridge to x = -14 * 0.5 / 2.1 = -3.33 mm, lit beyond; the ridge is a
    Gaussian of sigma 0.1 mm, the pixel 0.35 mm: 0.4 mm are left out.
    """

    def height(x, _):
        return 0.5 * np.exp(-(x**2) / 0.02)

    face = grid_face(height, lambda x, y: (-x / 0.01 * height(x, y), 0 * y))
    image, points = look(face, lamp(y_mm=0.0, height_mm=2.6), outer=None)
    middle, x = image[24, :, 0], points[24, :, 0]
    assert middle[(x > -2.9) & (x < -0.6)].max() == 0.0
    assert middle[x < -3.7].min() > 0.0
    assert middle[x > 0.6].min() > 0.0


def test_dots_darken_the_coat_where_they_are_printed(look, plane):
    """Setup: dots with 0.1 x the coat's albedo. Expected: this factor inside, 1 outside."""
    from twin.optics.printed_dots import PrintedDots

    dots = PrintedDots(Markers(pitch_x_mm=4.0, pitch_y_mm=3.0, radius_mm=1.2, relative_albedo=0.1))
    (image, points), bare = look(plane, lamp(), dots=dots), look(plane, lamp())[0]
    x, y = (points[..., i] - p * np.round(points[..., i] / p) for i, p in ((0, 4.0), (1, 3.0)))
    r = np.hypot(x, y)
    ratio = image[..., 0] / bare[..., 0]
    np.testing.assert_allclose(ratio[r < 1.19], 0.1, rtol=1e-4)
    np.testing.assert_allclose(ratio[r > 1.21], 1.0, rtol=1e-4)


def test_shipped_lamps_stand_on_their_sides(look, bump):
    """Setup: the shipped sensor's lamps over a bump towards the camera.

    Expected: as on real units red lights the flank that faces the image's top, green the one to
    the right, blue the one to the bottom.
    """
    lamps = load_experiment("examples/gelsight_ball").lamps
    image, points = look(bump, *lamps.values())
    x, y = points[..., 0], points[..., 1]

    def flank(along, across):
        return (along > 0.8) & (along < 2.0) & (np.abs(across) < 1.0)

    top, right = flank(y, x), flank(x, y)
    bottom, left = flank(-y, x), flank(-x, y)
    assert image[top, 0].mean() > 1.5 * image[bottom, 0].mean()
    assert image[right, 1].mean() > 1.5 * image[left, 1].mean()
    assert image[bottom, 2].mean() > 1.5 * image[top, 2].mean()


def test_emitters_are_limited_to_half_spaces():
    """No light behind an LED, and none on a facet that faces away."""
    emitters = Emitters(
        np.array([[0.0, 0, 2]]),
        np.array([[1.0, 0, 0]]),
        np.ones(1),
        np.ones((1, 3)),
        np.zeros(3),
        np.zeros(1, bool),
    )
    up = np.array([[0.0, 0, 1]])
    assert emitters.irradiance(np.array([[-1.0, 0, 0]]), up).max() == 0.0
    assert emitters.irradiance(np.array([[1.0, 0, 0]]), -up).max() == 0.0
    assert emitters.irradiance(np.array([[1.0, 0, 0]]), up).min() > 0.0


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({f"lamps.red_{n}.channel": "green" for n in (1, 2, 3)}, "no lamp has channel red"),
        ({"lamps.red_1.height_mm": 9.5}, "allowed below 9.25"),
        ({"layers.window.bottom_mm": 4.5}, "red_1.tall_mm: found 2, allowed below 0"),
        ({"lamps.red_1.tall_mm": 9.0}, "tall_mm: found 9, allowed below"),
        ({"elastomer.layout": "opposite_face"}, "contact_face"),
        ({"photometric.presses.shallowest": 0.4}, "must not exceed"),
    ],
)
def test_inconsistent_lamps_are_rejected(changes, message):
    with pytest.raises(ConfigError, match=message):
        load_experiment("examples/gelsight_ball", changes)


def test_flux_of_leds_scales_their_light():
    """Light is linear in the flux of each LED; a row's fill follows the mean of its LEDs."""
    row = lamp(emitters=4, length_mm=8.0, fill_mw_per_mm2=0.3)
    points, up = np.array([[0.0, 1.0, 0.0], [3.0, -2.0, 0.0]]), np.array([[0.0, 0.0, 1.0]] * 2)

    def light(*flux):
        return emitters_of({"one": row}, np.array(flux)).irradiance(points, up)[:, 0]

    usual = emitters_of({"one": row}).irradiance(points, up)[:, 0]
    np.testing.assert_allclose(light(1.0, 1.0, 1.0, 1.0), usual, rtol=1e-12)
    np.testing.assert_allclose(light(1.02, 1.02, 1.02, 1.02), 1.02 * usual, rtol=1e-12)
    total = sum(light(*unit) for unit in np.eye(4))
    np.testing.assert_allclose(total, usual, rtol=1e-12)


def test_drift_of_lamps_has_the_stated_spread():
    """Expected: the row's flux by its own SD; of LEDs that share it, each by theirs about that."""
    rows = {
        "a": lamp(emitters=8, drift_percent=2.0, led_drift_percent=1.0),
        "b": lamp(emitters=8, channel="blue"),
    }
    rng = np.random.default_rng(3)
    drawn = np.array([drifted_flux(rows, rng) for _ in range(4000)])
    assert (drawn[:, 8:] == 1.0).all()
    row_factor = drawn[:, :8].mean(axis=1)
    # 4000 draws determine an SD to 1.1 %.
    assert row_factor.std() == pytest.approx(0.02, rel=0.05)
    assert (drawn[:, :8] - row_factor[:, None]).std() == pytest.approx(0.01, rel=0.03)
    assert drifted_flux({"b": rows["b"]}, rng) is None
