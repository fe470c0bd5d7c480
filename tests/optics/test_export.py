"""An exported scene, loaded by stock Mitsuba from its files, renders the twin's images."""

import numpy as np
import pytest

from twin.config import load_experiment
from twin.optics.export import export_stock, inexpressible
from twin.optics.light import pattern_set
from twin.pipeline import render

SMALL = {
    "projector.width_px": 320,
    "projector.height_px": 180,
    "camera.width_px": 96,
    "camera.height_px": 72,
    "camera.pixel_pitch_um": {"value": 90.0, "source": "test"},
    "render.samples": 64,
    "patterns.steps": 3,
}


@pytest.mark.parametrize("emitter", ["projector", "spot"])
def test_exported_scene_renders_the_same_frame(mi, plane, tmp_path, emitter):
    """One phase frame at 256 samples: every lit pixel within 3 %, their mean within 0.1 %."""
    experiment = load_experiment("examples/slab_balls", SMALL | {"render.stock_emitter": emitter})
    left_out = export_stock(experiment, plane, tmp_path)
    assert left_out == inexpressible(experiment)
    patterns = pattern_set(experiment.projector, experiment.patterns)
    assert {file.stem for file in (tmp_path / "textures").iterdir()} == {
        frame.name for frame in patterns.frames
    }
    index = patterns.index("phase", "column").start + 1
    scene = mi.load_file(
        str(tmp_path / "scene.xml"), frame=patterns.frames[index].name, optimize=False
    )
    stock = np.asarray(mi.render(scene, spp=256))[:, :, 0]
    ours = render(experiment, plane).frames[index]
    bright = ours > 0.2 * ours.max()
    assert bright.sum() > 1000
    np.testing.assert_allclose(stock[bright], ours[bright], rtol=0.03)
    assert stock[bright].mean() == pytest.approx(ours[bright].mean(), rel=1e-3)


def test_gaps_of_the_export_are_listed():
    distorted = load_experiment(
        "examples/slab_balls", {"camera.distortion": [-0.1, 0.0, 0.0, 0.0, 0.0]}
    )
    assert "camera.distortion" in inexpressible(distorted)[0]


def test_exported_specimen_renders_as_ours(mi, tmp_path):
    """Rough metal balls on the stage: stock's path tracer finds the same mean within 1 %."""
    from twin.pipeline import render_bare

    rough = {"specimen.material.roughness": {"value": 0.4, "source": "test"}}
    settings = SMALL | rough | {"modality": "direct_fpp", "render.bounces": 2}
    experiment = load_experiment("examples/slab_balls", settings)
    export_stock(experiment, None, tmp_path)
    frames = pattern_set(experiment.projector, experiment.patterns).frames
    scene = mi.load_file(str(tmp_path / "scene.xml"), frame=frames[1].name, optimize=False)
    stock = np.asarray(mi.render(scene, spp=256))[:, :, 0]
    ours = render_bare(experiment).frames[1]
    assert stock.mean() == pytest.approx(ours.mean(), rel=0.01)


@pytest.mark.parametrize(("kind", "warned"), [("diffuse", False), ("dielectric", True)])
def test_only_clear_and_polished_bodies_are_warned_of(kind, warned):
    """Stock integrators render all light from a matte body."""
    material = {
        "diffuse": {"kind": "diffuse", "albedo": 0.5},
        "dielectric": {"kind": "dielectric", "ior": 1.5},
    }
    specimen = {"kind": "ball", "diameter_mm": 8.0, "material": material[kind]}
    bare = load_experiment("paper/brick", {"modality": "direct_fpp", "specimen": specimen})
    assert any("smooth bodies" in line for line in inexpressible(bare)) == warned
