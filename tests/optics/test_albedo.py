"""Albedo of every pixel: matte and metal closed forms, mixtures, radiance of the white frame."""

import numpy as np
import pytest
from scipy.integrate import quad

from reconstruction.arrays import FloatImage
from twin.config import load_experiment
from twin.dataset.quantities import SAMPLE_QUANTITIES
from twin.dataset.taking import take_sample
from twin.optics.bsdfs import fresnel_at_normal
from twin.optics.stack import Truth
from twin.pipeline import Memory
from twin.pipeline.lit_frames import albedo, loaded, viewed
from twin.pipeline.press import press

SMALL = {
    "camera.binning": 4,
    "camera.width_px": 320,
    "camera.height_px": 240,
    "patterns.steps": 3,
    "patterns.code": "gray",
}
# Turned: rays that meet the edges between facets exactly are lost.
FLAT = {"specimen": {"kind": "flat", "diameter_mm": 8.0, "yaw_deg": 1.3, "x_mm": 0.11}}


def albedo_and_truth(base: str, changes: dict) -> tuple[FloatImage, Truth]:
    """Return the albedo of all pixels and the true surface, without rendering frames."""
    experiment, memory = load_experiment(base, SMALL | changes), Memory()
    pressed = press(experiment, memory) if experiment.method.presses else None
    view = viewed(experiment, loaded(experiment, pressed, memory), memory).value
    return albedo(experiment, pressed, memory), view.truth


def of_material(**material) -> float:
    """Return the albedo of a bare disc of a material; all its pixels have the same."""
    specimen = {"specimen": FLAT["specimen"] | {"material": material}}
    values, truth = albedo_and_truth("examples/gauges", specimen)
    (value,) = np.unique(values[truth.measured & (truth.normals_world[..., 2] > 0.999)])
    return float(value)


def test_the_white_frame_of_a_matte_disc_is_its_albedo_times_the_irradiance() -> None:
    """L = albedo E cos / pi; E = flux fx fy / (width height) d / z^3 by the pinhole projector.

    The calibration has distances, focal lengths and the pose; the shadow of the edge is left out.
    """
    changes = {"specimen": FLAT["specimen"] | {"material": {"kind": "diffuse", "albedo": 0.37}}}
    experiment = load_experiment("examples/gauges", SMALL | changes)
    taken, _ = take_sample(experiment, Memory(), 1, decode=False, with_albedo=True)
    truth, white = taken.truth, SAMPLE_QUANTITIES["white"].values(taken)
    reflectance = SAMPLE_QUANTITIES["albedo"].values(taken)
    projector, T = (
        taken.fringes.capture.calibration.projector,
        taken.fringes.capture.calibration.T_world_from_proj,
    )
    flux_mw = taken.experiment.projector.flux_mw
    to_light = T[:3, 3] - truth.points_world_mm.astype(np.float64)
    distance = np.linalg.norm(to_light, axis=-1)
    axial = -to_light @ T[:3, 2]
    cosine = np.sum(to_light * truth.normals_world, axis=-1) / distance
    at_1mm = (
        flux_mw * projector.fx_px * projector.fy_px / (projector.width_px * projector.height_px)
    )
    expected = reflectance * at_1mm * distance / axial**3 * cosine / np.pi
    inside = truth.measured & truth.lit & (truth.normals_world[..., 2] > 0.999)
    across = np.hypot(*np.moveaxis(truth.points_world_mm[..., :2], -1, 0))
    inside &= across < 3.0
    assert inside.sum() > 200
    np.testing.assert_allclose(white[inside], expected[inside], rtol=2e-4)
    np.testing.assert_allclose(reflectance[inside], 0.37, rtol=1e-5)


def test_metals_have_their_fresnel_reflectance() -> None:
    """A mirror exactly; a rough metal by the energy of single reflections, in closed form below.

    At normal incidence the visible normals of GGX have the density 2 a^2 t / (a^2 + t^2)^2 over
    t = tan(angle); light leaves at twice the angle, below the surface from t = 1 on. Of the rest
    the share 1 / (1 + Lambda) passes, Lambda = (sqrt(1 + a^2 tan^2(2 angle)) - 1) / 2.
    """
    n, k, a = 2.9, 3.1, 0.2
    plane = {"kind": "conductor", "ior": n, "extinction": k}
    assert of_material(**plane, roughness=0.0) == pytest.approx(fresnel_at_normal(n, k), rel=1e-5)

    def passed(t: float) -> float:
        out = np.tan(2.0 * np.arctan(t))
        shadow = (np.sqrt(1.0 + (a * out) ** 2) - 1.0) / 2.0
        return 2.0 * a**2 * t / (a**2 + t**2) ** 2 / (1.0 + shadow)

    share = quad(passed, 0.0, 1.0)[0]
    # The Fresnel reflectance at up to 45 deg differs little from that at normal incidence.
    expected = fresnel_at_normal(n, k) * share
    assert of_material(**plane, roughness=a) == pytest.approx(expected, rel=0.01)


def test_clear_bodies_have_one_face_and_a_pigment_its_albedo_below_a_gloss() -> None:
    glass = of_material(kind="dielectric", ior=1.5)
    assert glass == pytest.approx(((1.5 - 1.0) / 2.5) ** 2, rel=0.1)  # 256 points, 10 of them
    plastic = of_material(kind="plastic", albedo=0.5, ior=1.5, roughness=0.1)
    assert 0.3 < plastic < 0.6


def test_a_coat_is_the_mean_of_ink_and_flakes() -> None:
    """Expected: linear in the share of flakes; the ink's albedo without flakes.

    The pixels of a pressed coat have one value, also where it is inclined.
    """
    values = []
    for share in (0.0, 0.15, 0.3):
        coat = {"coating.flake_fraction": share, "coating.base_albedo": 0.4}
        seen, truth = albedo_and_truth("examples/slab_ball", coat)
        (value,) = np.unique(seen[truth.measured])
        values.append(float(value))
    assert values[0] == pytest.approx(0.4, rel=1e-5)
    assert values[1] == pytest.approx((values[0] + values[2]) / 2.0, rel=0.01)
    assert values[2] > values[0]


def test_the_stage_has_its_albedo_and_a_pixel_without_surface_has_none() -> None:
    seen, truth = albedo_and_truth("examples/gauges", {"stage.size_mm": 30.0})
    stage = ~truth.measured & (truth.depth_mm > 0)
    assert stage.any()
    assert np.allclose(seen[stage], 0.35, rtol=1e-5)
    assert np.all(seen[truth.depth_mm == 0] == 0)
