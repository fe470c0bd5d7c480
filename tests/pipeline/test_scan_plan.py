"""Plans of scans: poses of a turntable, and the place of the specimen in each rendered patch."""

import numpy as np
import pytest

from reconstruction.errors import InputError
from twin.config.scan import load_scan
from twin.pipeline.scan import experiments_of

PLAN = """base = "scans/relief_plate"
[stage]
sigma_um = 0.0
angle_sigma_mrad = 0.0
[turntable]
x_mm = 3.0
y_mm = -1.0
[[position]]
[[position]]
x_mm = 2.0
y_mm = 1.0
rotation_deg = 90.0
"""


def test_the_specimen_is_where_the_inverse_pose_puts_it(tmp_path):
    """A quarter turn about (3, -1) by hand: (x, y) - (2, 1) - c becomes (-y, x) + c."""
    (tmp_path / "plan.toml").write_text(PLAN)
    loaded = load_scan(tmp_path / "plan.toml")
    first, second = (e.specimen for e in experiments_of(loaded))
    assert (first.x_mm, first.y_mm, first.yaw_deg) == (0.0, 0.0, 0.0)
    np.testing.assert_allclose((second.x_mm, second.y_mm), (3.0, -6.0), atol=1e-12)
    assert second.yaw_deg == pytest.approx(90.0)


def test_a_plan_needs_one_kind_of_patches(tmp_path):
    (tmp_path / "plan.toml").write_text(PLAN + "[grid]\ncolumns = 2\nstep_x_mm = 5.0\n")
    with pytest.raises(InputError, match="takes one of"):
        load_scan(tmp_path / "plan.toml")
