"""Kinds of coatings against each other and against stock Mitsuba."""

import numpy as np
import pytest

from reconstruction.errors import InputError
from tests.optics.measured_tables import ALBEDO, matte_table, random_table
from tests.optics.scenes import coated_scene
from twin.config import ConfigError, digest, load_experiment, to_toml, vary
from twin.config.coatings import COATINGS, Texture
from twin.config.materials import MATERIALS
from twin.optics.coatings.flakes import Flakes
from twin.optics.coatings.matte import Matte
from twin.optics.coatings.measured import Measured


@pytest.fixture(scope="module")
def experiment():
    return load_experiment(
        "examples/slab_ball",
        {
            "projector.width_px": 320,
            "projector.height_px": 180,
            "camera.width_px": 96,
            "camera.height_px": 72,
            "camera.pixel_pitch_um": {"value": 90.0, "source": "test"},
            "patterns.steps": 3,
            "patterns.period_px": 64,
        },
    )


def flakeless():
    metal = {"flake_roughness": 0.4, "flake_ior": 0.9, "flake_extinction": 6.3}
    return Flakes(base_albedo=ALBEDO, flake_fraction=0.0, **metal)


def directions(count):
    """Pairs of unit vectors of the upper hemisphere, (2, xyz, pair)."""
    pairs = np.random.default_rng(2).normal(size=(2, 3, count))
    pairs[:, 2] = np.abs(pairs[:, 2])
    return pairs / np.linalg.norm(pairs, axis=1, keepdims=True)


def values(mi, bsdf, pairs, wavelength_nm=None):
    """BSDF times cosine, (pair,)."""
    hit = mi.SurfaceInteraction3f()
    hit.wi = mi.Vector3f(pairs[0])
    if wavelength_nm is not None:
        hit.wavelengths = mi.Spectrum(wavelength_nm)
    return np.array(bsdf.eval(mi.BSDFContext(), hit, mi.Vector3f(pairs[1])))[0]


def frames_of(experiment, face, coating):
    from twin.optics.light import light_tables, pattern_set
    from twin.optics.one_trace import trace_stack
    from twin.optics.scene import coated_rig

    coated = experiment.model_copy(update={"coating": coating})
    tables = light_tables(coated.projector, pattern_set(coated.projector, coated.patterns))
    return np.stack(trace_stack(coated_scene(coated, face), coated_rig(coated, face), tables, 4))


def test_a_matte_coat_equals_ink_without_flakes(mi, experiment, bump):
    """Reflectance albedo cos / pi in closed form, and every frame as rendered; 1e-6."""
    matte, pairs = Matte(base_albedo=ALBEDO), directions(500)
    for coating in (matte, flakeless()):
        evaluated = values(mi, mi.load_dict(coating.bsdf()), pairs)
        np.testing.assert_allclose(evaluated, ALBEDO / np.pi * pairs[1, 2], rtol=1e-6)
        assert coating.is_matte
    own, ink_frames = (frames_of(experiment, bump, kind) for kind in (matte, flakeless()))
    np.testing.assert_allclose(own, ink_frames, rtol=1e-6, atol=1e-6 * ink_frames.max())


def test_coats_of_several_kinds_in_turn_equal_fresh_scenes(mi, experiment, bump):
    """Flakes, matte, another matte, flakes on one loaded scene: each frame byte for byte."""
    from twin.pipeline import trace

    geometry = trace.load_face(experiment, bump)
    view = trace.view_of(experiment, geometry)
    tables = trace.tables_of(experiment, view)
    coats = (experiment.coating, Matte(base_albedo=0.2), Matte(base_albedo=0.7), flakeless())
    for coating in coats:
        changed = experiment.model_copy(update={"coating": coating})
        patches = trace.patches_of(changed, geometry, view)
        traced = trace.Traced(patches, None, tables)
        swept = trace.light(changed, geometry, view, traced, lambda _: None).frames
        assert np.stack(swept).tobytes() == frames_of(changed, bump, coating).tobytes()


@pytest.mark.parametrize("turns", [1, 5])
def test_a_measured_table_equals_stock_mitsubas(mi, tmp_path, turns):
    """Between two wavelengths, isotropic and anisotropic, against `measured` in a spectral variant.

    2e-6: single precision.
    """
    file, pairs = random_table(tmp_path / "table.bsdf", turns), directions(300)
    own = values(mi, mi.load_dict(Measured(file=str(file), wavelength_nm=530.0).bsdf()), pairs)
    variant = mi.variant()
    mi.set_variant(variant.replace("mono", "spectral"))
    try:
        stock = mi.load_dict({"type": "measured", "filename": str(file)})
        expected = values(mi, stock, pairs, 530.0)
        del stock
    finally:
        mi.set_variant(variant)
    assert expected.mean() > 0.05
    np.testing.assert_allclose(own, expected, atol=2e-6)


def test_a_measured_matte_table_is_matte(mi, tmp_path, experiment, bump):
    """Expected: albedo at every angle (white furnace, 1 %), and the frames of a matte coat.

    1 %: of the white frame; the table's 64 x 64 values are interpolated.
    """
    table = Measured(file=str(matte_table(tmp_path / "matte.bsdf")), wavelength_nm=550.0)
    hit, angles = mi.SurfaceInteraction3f(), np.repeat(np.deg2rad([0.0, 30.0, 60.0, 80.0]), 4096)
    hit.wi = mi.Vector3f(np.sin(angles), 0 * angles, np.cos(angles))
    points = mi.Point2f(np.random.default_rng(3).random((2, angles.size)))
    bsdf = mi.load_dict(table.bsdf())
    _, weight = bsdf.sample(mi.BSDFContext(), hit, mi.Float(0.5), points)
    reflectance = np.array(weight[0]).reshape(4, -1).mean(axis=1)
    np.testing.assert_allclose(reflectance, 2 * ALBEDO, rtol=0.01)
    own, matte = (
        frames_of(experiment, bump, kind) for kind in (table, Matte(base_albedo=2 * ALBEDO))
    )
    np.testing.assert_allclose(own, matte, atol=0.01 * matte.max())


def test_another_wavelength_or_file_is_another_bsdf(mi, tmp_path, experiment, bump):
    from twin.optics.scene import CoatedScene

    file = str(matte_table(tmp_path / "matte.bsdf"))
    scene = CoatedScene(bump, Measured(file=file, wavelength_nm=500.0).bsdf())
    (face,) = scene.shapes()
    pairs, evaluated = directions(50), []
    for wavelength_nm in (500.0, 600.0):
        scene.set_coating(Measured(file=file, wavelength_nm=wavelength_nm))
        evaluated.append(values(mi, face.bsdf(), pairs))
    np.testing.assert_allclose(evaluated[1], 3 * evaluated[0], rtol=1e-5)


@pytest.mark.parametrize(
    ("content", "message"),
    [(b"", "no tensor file"), (b"tensor_file\0\1\0\xff\xff\xff\xff", "found no spectral table")],
)
def test_a_damaged_table_is_refused_in_one_line(mi, tmp_path, content, message):
    file = tmp_path / "table.bsdf"
    file.write_bytes(content)
    with pytest.raises(InputError, match=message) as caught:
        Measured(file=str(file), wavelength_nm=550.0).bsdf()
    assert "\n" not in str(caught.value)


def test_a_table_does_not_reach_beyond_its_wavelengths_or_into_a_layer(mi, tmp_path):
    file = str(matte_table(tmp_path / "matte.bsdf"))
    with pytest.raises(InputError, match="allowed 500 to 600"):
        Measured(file=file, wavelength_nm=700.0).bsdf()
    with pytest.raises(InputError, match="remove the layers"):
        Measured(file=file, wavelength_nm=550.0).in_medium(1.4)


def test_a_measured_table_is_not_exported(mi, tmp_path, experiment, bump):
    from twin.optics.export import export_stock

    table = Measured(file=str(matte_table(tmp_path / "matte.bsdf")), wavelength_nm=550.0)
    with pytest.raises(InputError, match="spectral variant"):
        export_stock(experiment.model_copy(update={"coating": table}), bump, tmp_path)


def test_every_kind_is_documented():
    """Its numbers have descriptions, and the numbers that its class variables name exist."""
    for kinds in (COATINGS, MATERIALS):
        for name, kind in kinds.items():
            assert kind.__doc__, name
    for kind in COATINGS:
        named = {*kind.differentiable, *kind.determined_by, kind.albedo_field} - {""}
        assert named <= kind.model_fields.keys()


def test_another_kind_keeps_the_keys_that_it_has_too(experiment):
    textured = vary(experiment, {"coating.texture": {"rms_um": 2.0, "correlation_mm": 0.2}})
    matte = vary(textured, {"coating.kind": "matte"}).coating
    texture = Texture(rms_um=2.0, correlation_mm=0.2)
    assert matte == Matte(base_albedo=experiment.coating.base_albedo, texture=texture)
    assert vary(experiment, {"coating": {"kind": "matte", "base_albedo": 0.3}}).coating == Matte(
        base_albedo=0.3
    )


def test_a_table_without_kind_has_flakes_and_says_so_nowhere(experiment, tmp_path):
    named = vary(experiment, {"coating.kind": "flakes"})
    assert named == experiment
    assert digest(named) == digest(experiment)
    assert 'kind = "flakes"' not in to_toml(named)
    matte = vary(experiment, {"coating.kind": "matte"})
    assert digest(matte) != digest(experiment)
    file = tmp_path / "matte.toml"
    file.write_text(to_toml(matte), encoding="utf-8")
    assert load_experiment(file) == matte


def test_an_unknown_kind_is_one_line_with_those_that_are_known(experiment):
    with pytest.raises(ConfigError, match="'flakes', 'matte', 'measured'") as caught:
        vary(experiment, {"coating": {"kind": "mate", "base_albedo": 0.3}})
    assert "\n" not in str(caught.value)
