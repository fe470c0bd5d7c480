"""Field, lens and distance of [optics]: the rig follows, or one line states the reason."""

import tomllib

import numpy as np
import pytest

from twin.assets import asset_path
from twin.config import ConfigError, digest, load_experiment, to_toml, vary
from twin.config.quantities import split_quantities
from twin.config.rig import lenses_meeting, shipped_lenses
from twin.optics.rig import ThinLens, true_calibration

BASE = "examples/slab_balls"
HF50, TELE = "lenses/fujinon_hf50xa_5m", "lenses/falenses_btl_0_72x"


def lens(name):
    """Return the plain values of a lens file."""
    values, _ = split_quantities(tomllib.loads(asset_path("scenes", name).read_text("utf-8")))
    return {key: value for key, value in values.items() if key != "description"}


def requested(**keys):
    """Return the example with keys of [optics]; a double underscore starts another table."""
    paths = {f"optics.{key}": value for key, value in keys.items() if "__" not in key}
    paths |= {key.replace("__", "."): value for key, value in keys.items() if "__" in key}
    return load_experiment(BASE, paths)


def field_mm(experiment):
    """Return width and height of the camera's image of the plane of focus, by its pinhole."""
    camera = true_calibration(experiment).camera
    corners = camera.seen_corners() * experiment.camera.pose.standoff_mm
    return np.ptp(corners, axis=0)


def test_a_field_alone_moves_the_camera_with_its_own_lens():
    experiment = requested(field_mm=[12.0, 9.0])
    assert experiment.camera.focal_length_mm == 50.0
    width_mm, height_mm = field_mm(experiment)
    assert width_mm == pytest.approx(12.0, rel=1e-9)  # the sensor is wider than 12 : 9
    assert height_mm == pytest.approx(12.0 * 1464 / 1936, rel=1e-9)


def test_field_and_distance_determine_the_focal_length():
    experiment = requested(field_mm=[30.0, 24.0], working_distance_mm=150.0)
    assert experiment.camera.pose.standoff_mm == 150.0
    assert field_mm(experiment)[1] == pytest.approx(24.0, rel=1e-9)


def test_lens_and_distance_determine_the_field():
    data = lens(HF50) | {"principal_plane_mm": 20.0}
    experiment = requested(working_distance_mm=250.0, lens=data)
    assert experiment.camera.pose.standoff_mm == 270.0
    assert field_mm(experiment)[0] == pytest.approx(8.712 * (270.0 - 50.0) / 50.0, rel=1e-9)


def test_a_ring_brings_a_lens_nearer():
    """A ring of 20 mm adds 20 / 50 to the largest magnification, 50 / (200 - 50)."""
    data = lens(HF50)
    nearest = requested(field_mm=[8.712 / (0.4 + 1 / 3), 1.0], lens=data, extension_mm=20.0)
    assert nearest.camera.pose.standoff_mm == pytest.approx(50.0 * (1.0 + 1.0 / (0.4 + 1 / 3)))
    with pytest.raises(ConfigError, match=r"use optics.extension_mm = 20\.1 or a larger field"):
        requested(field_mm=[8.70 / (0.4 + 1 / 3), 1.0], lens=data, extension_mm=20.0)


def test_depth_sets_the_aperture_and_the_near_end_is_blurred_by_one_pixel():
    experiment = requested(depth_mm=1.5, camera__depth_of_field=True)
    rig = true_calibration(experiment)
    pupil = ThinLens.of(experiment.camera, rig.T_world_from_cam)
    spread_mm = 2 * pupil.radius_mm * (1.0 / (214.0 - 0.75) - 1.0 / 214.0)
    assert spread_mm * rig.camera.fx_px == pytest.approx(1.0, rel=1e-9)  # px


@pytest.mark.parametrize(("azimuth", "roll"), [(0.0, 0.0), (90.0, 0.0), (150.0, 70.0)])
def test_an_inclined_camera_blurs_the_worst_corner_by_one_pixel(azimuth, roll):
    """At both ends of the height range, the largest blur at a corner of the image is 1 px."""
    pose = {"polar_deg": 35.0, "azimuth_deg": azimuth, "roll_deg": roll}
    experiment = requested(
        depth_mm=1.2,
        camera__depth_of_field=True,
        camera__width_px=484,
        camera__height_px=366,
        **{f"camera__pose__{key}": value for key, value in pose.items()},
    )
    rig = true_calibration(experiment)
    pose_matrix = rig.T_world_from_cam
    pupil = ThinLens.of(experiment.camera, pose_matrix)
    corners = np.array([[x, y] for x in (-0.5, 483.5) for y in (-0.5, 365.5)])
    rays = np.column_stack([rig.camera.unproject(corners), np.ones(4)])  # length 1 along the axis
    heights_mm = np.array([[-0.6], [0.6]])
    axial_mm = (heights_mm - pose_matrix[2, 3]) / (rays @ pose_matrix[:3, :3].T)[:, 2]
    spread_mm = 2 * pupil.radius_mm * np.abs(1.0 / axial_mm - 1.0 / pupil.focus_mm)
    assert spread_mm.max() * rig.camera.fx_px == pytest.approx(1.0, rel=1e-9)  # px


def test_a_telecentric_lens_has_its_magnification_and_aperture_at_the_object():
    experiment = requested(lens=lens(TELE))
    camera, standoff_mm = experiment.camera, experiment.camera.pose.standoff_mm
    assert field_mm(experiment)[0] == pytest.approx(8.712 / 0.72, rel=1e-9)
    aperture = camera.focal_length_mm / camera.f_number / 2.0 / standoff_mm
    assert aperture == pytest.approx(0.72 / (2 * 9.8), rel=1e-9)
    assert aperture == pytest.approx(0.037, rel=1e-2)  # numerical aperture of the maker's table


@pytest.mark.parametrize(
    "request_",
    [{"angle_deg": 32.0}, {"baseline_mm": 120.0}, {"field_mm": [20, 15], "angle_deg": 9}],
)
def test_the_projector_is_at_the_angle_or_baseline(request_):
    rig = true_calibration(requested(**request_, camera__pose__polar_deg=8.0))
    baseline = rig.T_world_from_proj[:3, 3] - rig.T_world_from_cam[:3, 3]
    if "angle_deg" in request_:
        assert rig.triangulation_angle_deg == pytest.approx(request_["angle_deg"], abs=1e-9)
    else:
        assert np.linalg.norm(baseline) == pytest.approx(120.0, rel=1e-9)
    assert np.linalg.norm(rig.T_world_from_proj[:3, 3]) == pytest.approx(250.0, rel=1e-12)


UNMET = {
    "too near": ({"field_mm": [12, 9], "lens": HF50}, "nearest distance is 200 mm, with 26.14 x"),
    "long ring": ({"field_mm": [60, 45], "lens": HF50, "extension_mm": 20}, "allowed up to 7.26"),
    "three": ({"field_mm": [30, 20], "working_distance_mm": 99, "lens": HF50}, "remove one"),
    "far": ({"field_mm": [500, 400]}, "needs 3086 mm with a lens of 50 mm, allowed up to 1000 mm"),
    "in the lens": ({"working_distance_mm": 40}, "allowed more than the focal length, 50 mm"),
    "large sensor": ({"lens": HF50, "camera__width_px": 2400}, "image circle of 11 mm"),
    "wide open": ({"lens": HF50, "camera__f_number": 2.0}, "f-numbers 2.4 to 16"),
    "depth": ({"depth_mm": 20}, "depth_mm: found 20, allowed up to 7.94 at f/64"),
    "depth of a lens": ({"depth_mm": 4, "lens": HF50}, "allowed up to 2.01 at f/16"),
    "no distance": (
        {"depth_mm": 1, "lens": TELE, "camera__pose__standoff_mm": "absent"},
        "allowed up to 0.17 at working f/9.8",
    ),
    "ring without lens": ({"extension_mm": 5}, "optics.extension_mm: found 5 without a lens"),
    "camera in the lens": (
        {"angle_deg": 20, "camera__pose__standoff_mm": 40},
        "standoff_mm: found 40, allowed more than focal_length_mm, 50",
    ),
    "inclined": ({"depth_mm": 1, "camera__pose__polar_deg": 45}, "mm along the tilted axis"),
    "telecentric field": ({"field_mm": [13, 9], "lens": TELE}, "images 12.1 x 9.15 mm on this"),
    "telecentric distance": ({"working_distance_mm": 90, "lens": TELE}, "in focus at 72 mm only"),
    "telecentric ring": ({"extension_mm": 5, "lens": TELE}, "takes no ring; remove it"),
    "telecentric depth": ({"depth_mm": 1, "lens": TELE}, "allowed up to 0.17 at working f/9.8"),
    "telecentric baseline": ({"baseline_mm": 99, "lens": TELE}, "state optics.angle_deg"),
    "angle": ({"angle_deg": 120}, "no projector at azimuth 0 above the coat is 120 degrees"),
    "baseline": ({"baseline_mm": 10}, "baseline_mm: found 10, allowed 36 to 464"),
    "both": ({"baseline_mm": 99, "angle_deg": 20}, "baseline_mm: found 99 with angle_deg"),
    "moved": ({"field_mm": [12, 9], "camera__pose__standoff_mm": 300}, "found 300, allowed 118.8"),
    "focal length": ({"lens": HF50, "camera__focal_length_mm": 35}, "found 35, allowed 50"),
}


@pytest.mark.parametrize(("keys", "message"), UNMET.values(), ids=UNMET)
def test_what_cannot_be_met_is_one_line(keys, message):
    keys = {key: lens(value) if key == "lens" else value for key, value in keys.items()}
    with pytest.raises(ConfigError) as failure:
        requested(**keys)
    assert message in str(failure.value)
    assert "\n" not in str(failure.value)


def test_a_lens_that_does_not_meet_a_request_is_named_with_those_that_do():
    with pytest.raises(ConfigError, match="it is met by scenes/lenses/falenses_btl_0_72x, "):
        requested(field_mm=[12, 9], lens=lens(HF50))
    with pytest.raises(ConfigError, match="no lens of scenes/lenses meets it"):
        requested(field_mm=[12, 9], working_distance_mm=500, lens=lens(TELE))


@pytest.mark.parametrize("name", shipped_lenses())
def test_every_lens_meets_its_own_largest_field(name, tmp_path):
    data = shipped_lenses()[name]
    near = data.magnification if data.kind == "telecentric" else data.largest_magnification(0.0)
    field = [8.712 / near * 0.999, 6.588 / near * 0.999]
    larger = [side * 1.002 for side in field]
    file = tmp_path / "mine.toml"
    words = f'name = "mine"\nuse = "scenes/{BASE}"\n[optics]\nfield_mm = {{}}\n'
    words += f'[optics.lens]\nuse = "{name}"\n'
    fits, misses = (larger, field) if data.kind == "fixed_focal" else (field, larger)
    file.write_text(words.format(fits))
    assert name in lenses_meeting(load_experiment(file).model_dump())
    file.write_text(words.format(misses))
    with pytest.raises(ConfigError, match=f"optics.field_mm: .*{data.model}"):
        load_experiment(file)


def test_a_resolved_experiment_has_the_keys_their_source_and_the_request(tmp_path):
    experiment = requested(field_mm=[20, 15], angle_deg=30.0)
    file = tmp_path / "resolved.toml"
    file.write_text(to_toml(experiment))
    again = load_experiment(file)
    assert again == experiment
    source = again.provenance["camera.pose.standoff_mm"].source
    assert source == "derived: field 20 x 15 mm with a lens of 50 mm"


def test_the_rig_follows_a_changed_request_and_keeps_its_numbers_without_one():
    experiment = requested(field_mm=[20, 15])
    wider = vary(experiment, {"optics.field_mm": [24, 18]})
    assert field_mm(wider)[1] == pytest.approx(18.1489, rel=1e-5)
    plain = vary(wider, {"optics": "absent"})
    assert plain.camera == wider.camera
    assert digest(plain) == digest(wider)
    assert vary(plain, {"camera.pose.standoff_mm": 300.0}).camera.pose.standoff_mm == 300.0


def test_a_link_to_a_derived_key_has_the_derived_value(tmp_path):
    file = tmp_path / "linked.toml"
    file.write_text(
        f'name = "linked"\nuse = "scenes/{BASE}"\n[optics]\nworking_distance_mm = 180\n'
        '[projector.pose]\nstandoff_mm = "= camera.pose.standoff_mm"\n'
    )
    assert load_experiment(file).projector.pose.standoff_mm == 180.0


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"fieldmm": [1, 2]}, "unknown key 'fieldmm' in \\[optics\\]; did you mean 'field_mm'?"),
        ({"field_mm": 12}, "optics.field_mm: found 12"),
        ({"lens": {"kind": "zoom"}}, "optics.lens.kind: found 'zoom', allowed"),
        ({"lens": lens(HF50) | {"f_numbers": [16, 2]}}, "the smaller one first"),
    ],
)
def test_a_wrong_key_is_one_line(keys, message):
    with pytest.raises(ConfigError, match=message) as failure:
        requested(**keys)
    assert "\n" not in str(failure.value)
