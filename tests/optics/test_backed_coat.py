"""Objects behind a translucent coat: limits of the closed form, and a contact in an image."""

import numpy as np
import pytest
from pydantic import ValidationError

from twin.config import load_experiment
from twin.optics.backed_coat import ink_albedo, seen_face
from twin.optics.coatings.flakes import Flakes
from twin.optics.rig import world_from_device
from twin.optics.surfaces.conductor import Conductor
from twin.optics.surfaces.dielectric import Dielectric
from twin.pipeline import press_specimen
from twin.pipeline.colour_images import cropped_pinhole

INK = {"flake_fraction": 0.0, "flake_roughness": 0.4, "flake_ior": 0.9, "flake_extinction": 6.3}
WHITE = 0.9


def ink(albedo, transmittance):
    return Flakes.model_validate({"base_albedo": albedo, "transmittance": transmittance} | INK)


@pytest.mark.parametrize("albedo", [0.1, 0.5, 0.8])
@pytest.mark.parametrize("passed", [0.05, 0.1, 0.2])
def test_light_to_and_fro_is_summed_up(albedo, passed):
    """Expected: R + T r T + T r R r T + ..., 200 passes; at most R + T; 1e-12."""
    passes = sum(passed**2 * WHITE * (albedo * WHITE) ** k for k in range(200))
    touched = ink(albedo, passed).albedo_over(WHITE)
    assert touched == pytest.approx(albedo + passes, rel=1e-12)
    assert touched <= albedo + passed


def test_behind_an_opaque_ink_or_without_object_nothing_is_added():
    assert ink(0.5, 0.0).albedo_over(WHITE) is None
    assert ink(0.5, 0.3).albedo_over(0.0) == 0.5


def test_an_ink_that_makes_light_is_refused():
    with pytest.raises(ValidationError, match=r"transmittance: found 0\.6, allowed at most 0\.5"):
        ink(0.5, 0.6)


def test_a_white_object_behind_an_ink_without_loss_makes_it_white():
    """Expected: R + T = 1 on a ground of r = 1 is 1."""
    assert ink(0.7, 0.3).albedo_over(1 - 1e-9) == pytest.approx(1.0, abs=1e-8)


def test_metals_and_glass_reflect_by_fresnel():
    """Expected: 1 - 4 n / ((n + 1)^2 + k^2); of glass both faces, 2 R / (1 + R), R = 0.04."""
    steel = Conductor(ior=2.7, extinction=3.4, roughness=0.1)
    assert steel.normal_reflectance == pytest.approx(1 - 4 * 2.7 / (3.7**2 + 3.4**2))
    glass = Dielectric(ior=1.5, roughness=0.0)
    assert glass.normal_reflectance == pytest.approx(2 * 0.04 / 1.04)


def test_a_contact_is_brighter_by_the_reflectance_of_the_object(mi):
    """Setup: a pressed ball in the light of the lamps, with an opaque coat and a thin one.

    Expected: radiance in the ratio of the albedos within the contact, the same beyond it; to 1e-5
    two cells of the solver off its edge.
    """
    from twin.optics.colour_trace import ColourScene

    thin = load_experiment("examples/gelsight_ball")
    opaque = load_experiment("examples/gelsight_ball", {"coating.transmittance": 0.0})
    pressed = press_specimen(thin)
    pinhole = cropped_pinhole(thin)
    view = pinhole, world_from_device(thin.camera.pose, pinhole)
    images = []
    for case in (thin, opaque):
        face = seen_face(case, pressed)
        scene = ColourScene(case, face)
        images.append(scene.render(*view))
    points = scene.truth(*view).points_world_mm
    cell_mm = pressed.x_mm[1] - pressed.x_mm[0]
    contact_mm = np.sqrt(pressed.contact.sum() * cell_mm**2 / np.pi)
    r_mm = np.hypot(points[..., 0], points[..., 1])
    ratio = (images[0] / images[1])[..., 1]
    steel = thin.photometric.presses.material
    expected = thin.coating.albedo_over(steel.normal_reflectance) / 0.5
    assert expected == pytest.approx(1.055, abs=0.002)
    np.testing.assert_allclose(ratio[r_mm < contact_mm - 2 * cell_mm], expected, rtol=1e-5)
    np.testing.assert_allclose(ratio[r_mm > contact_mm + 2 * cell_mm], 1.0, rtol=1e-5)
    assert ink_albedo(opaque, pressed) is None


def test_a_specimen_of_another_material_has_its_own_reflectance():
    dark = load_experiment(
        "examples/gelsight_ball", {"specimen.material": {"kind": "diffuse", "albedo": 0.0}}
    )
    assert np.ptp(ink_albedo(dark, press_specimen(dark))) == 0.0


def test_faces_with_and_without_the_attribute_do_not_mix(mi):
    from twin.mechanics import face_mesh
    from twin.optics.colour_trace import ColourScene

    case = load_experiment("examples/gelsight_ball")
    pressed = press_specimen(case)
    scene = ColourScene(case, seen_face(case, pressed))
    with pytest.raises(ValueError, match="use seen_face"):
        scene.put(face_mesh(pressed))
