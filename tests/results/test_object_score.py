"""The object scored from points of known surfaces: no press, no light."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from reconstruction.errors import InputError
from twin.config import load_experiment
from twin.config.base import ConfigError
from twin.optics.stack import Truth
from twin.results.features import bars_of, feature_of, features_of
from twin.results.measurands.step_height import levels
from twin.results.object_fits import fit
from twin.results.object_points import Heights
from twin.results.object_score import score_object
from twin.results.quantities import measurands_of, nominal_mm
from twin.specimens import shape_of
from twin.specimens.true_surface import TrueSurface

BASE = "examples/gel_on_window"
DEPTH_MM = 0.5
COLS, ROWS, HALF_MM = 241, 181, (6.0, 4.5)


def experiment(specimen, **more):
    settings = {"specimen": specimen, "decode.filter_taps": 0} | more
    return load_experiment(BASE, settings)


def score_of(case, error_mm=0.0, sigma_mm=None, skin_mm=0.0, touched=np.isfinite):
    """Score the specimen's own upper side, as a coat in contact with all of it would show it.

    `touched`: of world x, where the coat touches it.
    """
    x = np.linspace(-HALF_MM[0], HALF_MM[0], COLS)
    y = np.linspace(HALF_MM[1], -HALF_MM[1], ROWS)
    surface = TrueSurface(shape_of(case.specimen), DEPTH_MM + case.elastomer.touched_plane_mm)
    z = surface.heights_mm(x, y)
    on = np.isfinite(z)
    z = np.where(on, z, -5.0) + skin_mm
    points = np.stack([*np.meshgrid(x, y), z], axis=-1)
    truth = Truth(points, np.zeros_like(points), z, z, z, on, on)
    pressed = SimpleNamespace(
        depth_mm=DEPTH_MM, x_mm=x, y_mm=y[::-1], contact=(on & touched(x))[::-1], face_z_mm=z
    )
    measured = points + np.stack([0 * z, 0 * z, 0 * z + error_mm], axis=-1)
    sigma = None if sigma_mm is None else np.full(z.shape, sigma_mm, np.float32)
    return score_object(case, (measured, on, sigma), truth, pressed)


STEP = {"kind": "step", "height_mm": 0.1, "edge_radius_mm": 0.02}
BAR_ON_PLATE = {
    "kind": "group",
    "parts": {
        "bar": {"kind": "bar", "width_mm": 3.0, "height_mm": 0.8},
        "plate": {"kind": "flat", "diameter_mm": 12.0, "z_mm": -0.8},
    },
}
KNOWN = [
    ({"kind": "ball"}, "radius_1", 4.0),
    ({"kind": "two_balls", "diameter_mm": 5.0, "separation_mm": 5.2}, "radius_2", 2.5),
    ({"kind": "rod", "yaw_deg": 30.0}, "radius_1", 2.4),
    ({"kind": "rods", "diameters_mm": [2.0, 3.0]}, "radius_2", 1.5),
    (STEP, "step_height", 0.1),
    ({"kind": "v_groove", "angle_deg": 150.0, "yaw_deg": 20.0}, "depth", 0.5),
    ({"kind": "v_groove", "angle_deg": 150.0}, "width", 3.7321),
    ({"kind": "grating", "pitch_mm": 1.5, "groove_mm": 0.1, "x_mm": 0.4}, "depth", 0.1),
    ({"kind": "bars", "widths_mm": [2.0, 3.0], "gap_mm": 2.0}, "width_2", 3.0),
    ({"kind": "bars", "widths_mm": [4.0], "height_mm": 0.8}, "step_height", 0.8),
    (BAR_ON_PLATE, "bar_width_1", 3.0),
    # Tilted specimens are measured across their own planes: 5 degrees are 0.4 % of a height.
    (STEP | {"tilt_deg": 5.0, "yaw_deg": 30.0}, "step_height", 0.1),
    ({"kind": "bars", "widths_mm": [4.0], "height_mm": 0.8, "tilt_deg": 5.0}, "step_height", 0.8),
    ({"kind": "v_groove", "angle_deg": 150.0, "tilt_deg": 5.0}, "depth", 0.5),
    ({"kind": "grating", "pitch_mm": 1.5, "groove_mm": 0.1, "tilt_deg": 5.0}, "depth", 0.1),
]


@pytest.mark.parametrize(("specimen", "name", "true_mm"), KNOWN)
def test_known_dimensions_are_found(specimen, name, true_mm):
    """Setup: each specimen's own upper side at 241 x 181 places of 50 um, without error.

    Expected: the drawing's dimension within its facets and a cell of the section.
    """
    figures = score_of(experiment(specimen), sigma_mm=1e-6).figures
    loose = {"width_2": 0.06, "bar_width_1": 0.075, "width": 2e-3, "depth": 1e-3}.get(name, 1e-3)
    assert figures[f"object_{name}_mm"] == pytest.approx(true_mm, abs=loose)
    assert figures[f"object_{name}_error_um"] == pytest.approx(
        1e3 * (figures[f"object_{name}_mm"] - true_mm), abs=0.2
    )
    # Height fields and solid agree: the deviation from the solid is that of its facets.
    assert figures["object_rms_um"] < 1.0
    assert figures["object_coverage_share"] == 1.0


@pytest.mark.parametrize("specimen", [KNOWN[at][0] for at in (0, 2, 4, 5, 7)])
def test_the_stated_interval_covers_the_truth(specimen):
    """Setup: 20 times the same surface with independent normal noise of 3 um.

    Expected: within U (k = 2) of the surface's own value in at least 16 of 20 (binomial 95 %:
    0.3 %), and not by an interval that is far too wide. A section's width is known to its cells.
    """
    case, rng = experiment(specimen), np.random.default_rng(2)
    score = score_of(case, 0.0, 3e-3)
    for quantity in (
        quantity for quantity in score.quantities if quantity.measurand.quantity != "resolution"
    ):
        feature = feature_of(features_of(case.specimen), quantity.measurand)
        clean, ratios = score.observed.measured, []
        for _ in range(20):
            noise = np.outer(rng.normal(0, 3e-3, len(clean.points_mm)), [0, 0, 1])
            noisy = replace(clean, points_mm=clean.points_mm + noise)
            value = fit(quantity.measurand, feature, score.observed, noisy)
            ratios.append((value.value - quantity.value) / (2 * value.noise_mm))
        assert (np.abs(ratios) <= 1).sum() >= 16
        assert np.std(ratios) > 0.3 or quantity.measurand.quantity == "width"


def test_a_value_gets_its_verdict_from_limits_and_uncertainty():
    """A step read 8 um too high, known to 3 um: within 15, undecided at 10, not within 5."""
    x_mm = np.linspace(-HALF_MM[0], HALF_MM[0], COLS)
    requests = [
        {"name": f"within_{limit}", "quantity": "step_height", "plus_minus_um": limit,
         "calibration_um": 1.5}
        for limit in (15, 10, 5)
    ]  # fmt: skip
    score = score_of(experiment(STEP, measurand=requests), np.where(x_mm > 0, 8e-3, 0), 1e-6)
    decided = [quantity.decision for quantity in score.quantities if quantity.tolerance is not None]
    assert decided == ["within tolerance", "cannot tell", "not within tolerance"]
    assert score.figures["object_within_15_margin_um"] == pytest.approx(15 - 8 - 3, abs=0.05)
    assert score.figures["measurands_judged"] == 3
    assert score.figures["measurands_within"] == 1
    assert score.figures["least_margin_um"] == pytest.approx(5 - 8 - 3, abs=0.05)


def test_a_constant_error_is_taken_off_by_the_stated_alignment():
    case = experiment(STEP)
    x_mm = np.linspace(-HALF_MM[0], HALF_MM[0], COLS)
    figures = score_of(case, 0.02 + 0.001 * x_mm, 1e-6).figures
    assert figures["object_bias_um"] == pytest.approx(20.0, rel=0.01)
    tilt_um = np.std(x_mm)
    assert figures["object_rms_um"] == pytest.approx(np.hypot(20.0, tilt_um), rel=0.02)
    assert figures["object_offset_rms_um"] == pytest.approx(tilt_um, rel=0.02)
    assert figures["object_offset_tilt_rms_um"] < 0.2
    assert figures["true_face_object_rms_um"] < 0.1


def test_a_skin_of_nominal_thickness_is_taken_off_deviations():
    """The far face of a slab of 1.3 mm is as much above the object, along the normal."""
    slab = {"elastomer.layout": "opposite_face", "layers": {}}
    slab["elastomer.thickness_mm"] = {"value": 1.3, "source": "test"}
    case = experiment(STEP, **slab)
    figures = score_of(case, 0.0, 1e-6, skin_mm=1.3).figures
    # Next to the riser the parallel surface is round, the raised one is not.
    assert abs(figures["object_bias_um"]) < 5.0
    assert figures["object_form_um"] < 1e3 * 0.1


def test_resolution_is_the_finest_pitch_that_keeps_half_its_depth():
    """Setup: three gratings side by side, flattened to 100, 70 and 40 % of their depth.

    Expected: the second finest; with all of the depth kept, the finest.
    """
    parts = {
        name: {"kind": "grating", "pitch_mm": pitch, "groove_mm": 0.1, "length_x_mm": 3.6,
               "length_y_mm": 8.0, "x_mm": x}
        for name, pitch, x in (("coarse", 1.8, -4.0), ("middle", 0.9, 0.0), ("fine", 0.45, 4.0))
    }  # fmt: skip
    requests = [{"name": "resolution", "quantity": "resolution", "nominal_mm": 0.5}]
    case = experiment({"kind": "group", "parts": parts}, measurand=requests)
    x_mm = np.linspace(-HALF_MM[0], HALF_MM[0], COLS)
    share = np.select([x_mm < -2, x_mm < 2], [1.0, 0.7], 0.4)
    surface = TrueSurface(shape_of(case.specimen), DEPTH_MM)
    z = surface.heights_mm(x_mm, np.zeros(1))[0]
    middle = DEPTH_MM - 0.05
    flattened = (share - 1) * (np.where(np.isfinite(z), z, middle) - middle)
    figures = score_of(case, flattened, 1e-4).figures
    assert figures["object_resolution_mm"] == 0.9
    assert figures["object_resolution_verdict"] == "not within tolerance"
    assert figures["object_fine_depth_mm"] == pytest.approx(0.04, rel=0.05)
    assert score_of(case, 0.0, 1e-4).figures["object_resolution_mm"] == 0.45


def test_levels_leave_out_the_edges():
    """A ridge 1.2 mm wide on a plate: a third of its width is left out at each edge."""
    x, y = np.arange(-3, 3, 0.02), np.arange(-2, 2, 0.02)
    z = np.where(np.abs(x) <= 0.6, 0.2, 0.0) * np.ones((len(y), 1))
    upper, lower = levels(Heights(x, y, z, 0.02))
    inside, outside = np.abs(x[upper.any(axis=0)]), np.abs(x[lower.any(axis=0)])
    assert inside.max() == pytest.approx(0.2, abs=0.03)
    assert outside.min() == pytest.approx(1.0, abs=0.03)
    assert outside.max() == pytest.approx(1.8, abs=0.03)


def test_limits_that_make_no_sense_are_refused():
    for wrong, message in (
        ({"quantity": "form", "plus_minus_um": 3.0}, "give upper_um"),
        ({"quantity": "radius", "plus_minus_um": 3.0, "upper_um": 1.0}, "remove one"),
        ({"quantity": "coverage", "upper_um": 1.0}, "give at_least"),
        ({"quantity": "width", "lower_um": 2.0, "upper_um": 1.0}, "allowed up to upper_um"),
    ):
        with pytest.raises(ConfigError, match=message):
            experiment(STEP, measurand=[{"name": "one"} | wrong])
    twice = [{"name": "one", "quantity": "form"}] * 2
    with pytest.raises(ConfigError, match="each needs its own"):
        experiment(STEP, measurand=twice)
    with pytest.raises(InputError, match="part: found 'nut', allowed: none"):
        score_of(experiment(STEP, measurand=[{"name": "a", "quantity": "form", "part": "nut"}]))


def test_an_experiment_without_measurands_keeps_its_digest():
    from twin.config import digest

    plain = experiment(STEP)
    requested = experiment(STEP, measurand=[{"name": "flat", "quantity": "form"}])
    assert "measurand" not in plain.model_dump()
    assert digest(plain) != digest(requested)
    assert [measurand.name for measurand in measurands_of(requested)] == ["step_height", "flat"]
    own = experiment(STEP, measurand=[{"name": "riser", "quantity": "step_height"}])
    assert [measurand.name for measurand in measurands_of(own)] == ["riser"]


def test_a_single_bar_has_a_width():
    bar = experiment({"kind": "bar", "width_mm": 3.0})
    (width,) = measurands_of(bar)
    assert (width.name, width.quantity, width.number) == ("width_1", "width", 1)
    assert nominal_mm(features_of(bar.specimen)[0], width) == 3.0


@pytest.mark.parametrize("error_mm", [0.0, 0.003])
def test_a_bar_without_ground_has_no_width(error_mm):
    """A bare bar shows only its top: the section has no walls that a width could be between."""
    noise = error_mm * np.random.default_rng(1).standard_normal((181, 241))
    bar = experiment({"kind": "bar", "width_mm": 3.0})
    figures = score_of(bar, noise if error_mm else 0.0, max(error_mm, 1e-6)).figures
    assert figures["object_width_1_mm"] is None
    assert "no ground next to" in figures["object_width_1_why"]


def test_a_single_bar_has_a_place_on_the_stage():
    (place,) = bars_of(experiment({"kind": "bar", "x_mm": 1.0, "yaw_deg": 30.0}).specimen)
    assert (place.x_mm, place.y_mm, place.width_mm) == (1.0, 0.0, 4.81)
    assert place.along_deg == pytest.approx(30.0)


@pytest.mark.parametrize(("stated", "expected_um"), [({}, 0.0), ({"calibration_um": 1.5}, 1.5)])
def test_the_calibration_of_photometric_stereo_is_not_known_unless_stated(stated, expected_um):
    step = [{"name": "step", "quantity": "step_height"} | stated]
    changes = {"specimen": STEP, "modality": "photometric_stereo", "measurand": step}
    quantity = score_of(load_experiment("examples/gelsight_ball", changes)).quantity("step")
    assert quantity.value == pytest.approx(0.1, abs=1e-6)
    assert quantity.uncertainty.calibration == expected_um
    assert ("state calibration_um" in quantity.condition) == (not stated)
    fringes = score_of(experiment(STEP, measurand=step)).quantity("step")
    assert fringes.uncertainty.calibration == (expected_um or pytest.approx(2.7e-3))
    assert fringes.condition == ""
