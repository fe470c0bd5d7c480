"""Best focus and pupil of a projector from blurs at several distances."""

import numpy as np
import pytest

from benchmarks.adopt import bump, hidden_rig, write_set
from reconstruction.characterise import UncertainValue
from twin.adoption.adopt import Given, adopt
from twin.adoption.defocus import CaptureBlur, defocus_fields, defocus_of
from twin.config import vary
from twin.optics.light import Defocus
from twin.pipeline.fringes import render

TRUE = Defocus(blur_px=0.7, growth_px_mm=4000.0, focus_mm=215.0)
PLACES_MM = (190.0, 205.0, 222.0, 240.0)


def blurs(places_mm=PLACES_MM, relative=0.0, seed=0):
    rng = np.random.default_rng(seed)
    blurs = [
        float(np.sqrt(TRUE.variance_px2(z))) * (1.0 + relative * rng.normal()) for z in places_mm
    ]
    return [
        CaptureBlur(1.0 / z, 0.0, UncertainValue(blur, 0.0))
        for z, blur in zip(places_mm, blurs, strict=True)
    ]


@pytest.mark.parametrize("places_mm", [PLACES_MM, PLACES_MM[:3]])
def test_three_heights_determine_the_thin_lens(places_mm):
    defocus = defocus_of(blurs(places_mm))
    assert defocus.blur_px.value == pytest.approx(0.7, rel=1e-6)
    assert defocus.growth_px_mm.value == pytest.approx(4000.0, rel=1e-6)
    assert defocus.focus_mm.value == pytest.approx(215.0, rel=1e-6)
    pupil = defocus_fields(defocus, 1600.0, 3)["projector.aperture_mm"]
    assert pupil.value == pytest.approx(10.0, rel=1e-6)


def test_a_tilted_surface_has_many_distances():
    """Each spans 20 mm: its RMS blur is larger than the blur at its middle."""
    tilted = []
    for middle_mm in PLACES_MM[:3]:
        z_mm = np.linspace(middle_mm - 10.0, middle_mm + 10.0, 201)
        blur = UncertainValue(float(np.sqrt(TRUE.variance_px2(z_mm).mean())), 1e-4)
        tilted.append(CaptureBlur(float((1.0 / z_mm).mean()), float((1.0 / z_mm).std()), blur))
    defocus = defocus_of(tilted)
    assert defocus.focus_mm.value == pytest.approx(215.0, rel=1e-6)
    assert defocus.blur_px.value == pytest.approx(0.7, rel=1e-6)


def test_uncertainties_are_the_spread():
    """400 sets of four blurs with errors of 2 %, the assumed variation over one surface.

    Expected: standard deviations within 15 %.
    """
    fits = [defocus_of(blurs(relative=0.02, seed=seed)) for seed in range(400)]
    assert all(fits)
    for name, true in (("blur_px", 0.7), ("growth_px_mm", 4000.0), ("focus_mm", 215.0)):
        values = np.array([getattr(fit, name).value for fit in fits])
        stated = np.median([getattr(fit, name).uncertainty for fit in fits])
        assert values.std() == pytest.approx(stated, rel=0.15)
        assert abs(values.mean() - true) < 4.0 * stated / np.sqrt(len(values)) + 0.1 * stated


@pytest.mark.parametrize(
    "blurs_without_defocus",
    [
        blurs(PLACES_MM[:2]),
        blurs((210.0, 210.1, 240.0)),  # two heights
        blurs((300.0, 304.0, 308.0)),  # focus far outside
        [CaptureBlur(1.0 / z, 0.0, UncertainValue(0.7, 0.01)) for z in PLACES_MM],
    ],
    ids=["two", "near", "beside", "even"],
)
def test_no_defocus_is_reported_without_any(blurs_without_defocus):
    assert defocus_of(blurs_without_defocus) is None


def test_rendered_surfaces_at_three_heights_give_pupil_and_focus(mi, tmp_path):
    """True: a pupil of 12 mm, best focus 3 mm beyond the middle of three bumps.

    Expected: both within twice their uncertainty, which is below 10 % and 1 mm.
    """
    base, _ = hidden_rig(3)
    hidden = {"projector.aperture_mm": 12.0, "projector.gamma": 1.0, "projector.blur_px": 0.6}
    rig = vary(base, {name: {"value": x, "source": "hidden"} for name, x in hidden.items()})
    rig = vary(rig, {"camera.width_px": 360, "camera.height_px": 270})
    focus_mm = Defocus.of(rig.projector).focus_mm + 3.0
    rig = vary(rig, {"projector.focus_mm": {"value": focus_mm, "source": "hidden"}})
    folders = []
    for number, height_mm in enumerate((0.0, -14.0, 14.0)):
        face = bump(0.6)
        face.apply_translation((0.0, 0.0, height_mm))
        folders.append(tmp_path / f"height_{number}")
        write_set(folders[-1], rig, render(rig, face), number)
    fields = adopt(Given(tuple(folders))).fields
    pupil, focus = fields["projector.aperture_mm"], fields["projector.focus_mm"]
    assert pupil.uncertainty < 1.2
    assert focus.uncertainty < 1.0
    assert abs(pupil.value - 12.0) < 2.0 * pupil.uncertainty
    assert abs(focus.value - focus_mm) < 2.0 * focus.uncertainty
    assert (
        abs(fields["projector.blur_px"].value - 0.6) < 2.0 * fields["projector.blur_px"].uncertainty
    )
