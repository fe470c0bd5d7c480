"""A rendered rig with a diamond chip is adopted: its shape, poses, gamma and blur."""

import pytest

from benchmarks.adopt import bump, hidden_rig, write_set
from twin.adoption.adopt import Given, adopt
from twin.config import vary
from twin.pipeline.fringes import render

HIDDEN = {"projector.gamma": 1.6, "projector.blur_px": 0.6}


def test_a_rendered_diamond_chip_is_adopted(mi, tmp_path):
    """Expected: the chip as stated, the poses of the rig, gamma and blur (columns) as hidden."""
    base, _ = hidden_rig(3)
    rig = vary(base, {name: {"value": x, "source": "hidden"} for name, x in HIDDEN.items()})
    changes = {"camera.width_px": 240, "camera.height_px": 180, "projector.width_px": 912}
    rig = vary(rig, changes | {"projector.height_px": 1140, "projector.pixel_ratio": "diamond"})
    write_set(tmp_path / "capture", rig, render(rig, bump(0.6)), 0)
    adopted = adopt(Given((tmp_path / "capture",)))
    projector = adopted.experiment.projector
    assert projector.pixel_ratio == "diamond"
    assert projector.throw_ratio == pytest.approx(rig.projector.throw_ratio, rel=1e-4)
    assert projector.pose.polar_deg == pytest.approx(rig.projector.pose.polar_deg, abs=1e-3)
    assert max(adopted.placed.misfit_px) < 0.01
    for path, value in HIDDEN.items():
        field = adopted.fields[path]
        assert abs(field.value - value) < 3.0 * field.uncertainty
        assert field.uncertainty < 0.1 * value
