"""A compliant rim: closed forms of a sheet that relaxes and of a strip that is inflated."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq

from tests.mechanics.sheets import (
    EXACT,
    NOTHING,
    YOUNG_KPA,
    build_sheet,
    laws,
    line,
    pressed,
    round_sheet,
)
from twin.mechanics import PressError
from twin.mechanics.sheet.energy import Sheet
from twin.mechanics.sheet.equilibrium import settle
from twin.mechanics.sheet.faces import sample
from twin.mechanics.sheet.grid import Frame, sheet_grid
from twin.mechanics.sheet.path import Loads, advance, mounted
from twin.mechanics.sheet.rim import rim_springs
from twin.mechanics.sheet.splines import SplineLine
from twin.specimens.kinds.ball import Ball

MU_KPA = YOUNG_KPA / 3
SMALL = {"length_x_mm": 9.0, "length_y_mm": 9.0}


def test_a_stretched_sheet_is_at_rest_on_its_springs() -> None:
    sheet = round_sheet(
        laws(0.3), NOTHING, line(4.0, 2.0, 0.5), pre_stretch=1.25, rim_compliance_mm2_per_n=20.0
    )
    result = settle(sheet, mounted(sheet.grid), EXACT)
    assert np.abs(result.control_mm - sheet.grid.mounted_mm).max() < 1e-5


def test_a_round_sheet_relaxes_until_its_springs_bear_its_tension() -> None:
    """Uniform: mu h (1 - l^-6) l / s = (R - R l / s) / c per length of the mounted edge, R = 5."""
    h, s, c = 0.3, 1.25, 20.0
    sheet = round_sheet(
        laws(h), NOTHING, line(4.0, 2.0, 0.5), pre_stretch=s, rim_compliance_mm2_per_n=c
    )
    sheet.rim = tuple(
        replace(spring, tension=np.zeros_like(spring.tension)) for spring in sheet.rim
    )
    result = settle(sheet, mounted(sheet.grid), EXACT)

    def left(stretch: float) -> float:
        pulls_n_mm = 1e-3 * MU_KPA * h * (1 - stretch**-6) * stretch / s
        return pulls_n_mm - (5.0 - 5.0 * stretch / s) / c

    expected = brentq(left, 1.0, s)
    inside = np.s_[2:-2, 2:-2]  # the disc's map is singular in the square's corners
    assert expected < 1.2
    np.testing.assert_allclose(sample(sheet, result, 0.2).stretch[inside], expected, rtol=2e-5)


def test_an_inflated_strip_pulls_its_rim_in() -> None:
    """Arc of half angle a over a chord 2 (b - u): l = (b - u) a / (b sin a), N = mu h (l - l^-3).

    N = p (b - u) / sin a, and u = c N cos a, per unit length of a strip of width 2 b in plane
    strain.
    """
    h, b, c, pressure_kpa = 0.05, 10.0, 100.0, 0.3

    def drawn_in(angle: float) -> float:
        chord = 1e-3 * pressure_kpa * c * np.cos(angle) / np.sin(angle)
        return b * chord / (1 + chord)

    def left(angle: float) -> float:
        chord = b - drawn_in(angle)
        stretch = chord * angle / (b * np.sin(angle))
        return MU_KPA * h * (stretch - stretch**-3) - pressure_kpa * chord / np.sin(angle)

    angle = brentq(left, 0.3, 2.0)
    chord = b - drawn_in(angle)
    sheet = _strip_on_springs(h, c)
    start = mounted(sheet.grid)
    result, _ = advance(sheet, start, start, Loads(0.0, pressure_kpa), EXACT)
    place = sheet.grid.evaluate(result.control_mm, np.array([0.0, b]), np.zeros(1))[0][:, 0]
    assert drawn_in(angle) > 0.1
    assert place[1, 0] == pytest.approx(chord, abs=2e-3)
    assert -place[0, 2] == pytest.approx(chord * np.tan(angle / 2), rel=1e-3)


def _strip_on_springs(thickness_mm: float, compliance: float) -> Sheet:
    """Return a strip along y, vastly long, on springs only along its west and east edges."""
    frame = Frame(20.0, 3000.0, rim="simple", rim_compliance_mm2_per_n=compliance)
    grid = sheet_grid(frame, line(10.0, 8.0, 0.5), SplineLine(np.linspace(-1500.0, 1500.0, 4)))
    free = np.zeros_like(grid.free)
    free[:, :, 0] = True
    free[:, 1:-1, 2] = True
    law = laws(thickness_mm)
    sheet = Sheet(replace(grid, free=free), law, NOTHING, -thickness_mm / 2)
    sheet.rim = rim_springs(grid, law, edges=((1, 0), (1, -1)))
    return sheet


def test_a_hardly_yielding_rim_is_a_rigid_one() -> None:
    load = {"depth_mm": 0.5, "back_pressure_kpa": 2.0}
    rigid = pressed(Ball(), build_sheet(**SMALL), **load)
    stiff = pressed(Ball(), build_sheet(rim_compliance_mm2_per_n=1e-3, **SMALL), **load)
    assert np.abs(stiff.face_z_mm - rigid.face_z_mm).max() < 1e-3
    assert stiff.force_n == pytest.approx(rigid.force_n, rel=2e-3)


def test_a_yielding_rim_leaves_the_sheet_thicker_over_a_ball() -> None:
    load = {"depth_mm": 1.0, "back_pressure_kpa": 5.0}
    rigid = pressed(Ball(), build_sheet(**SMALL), **load)
    soft = pressed(Ball(), build_sheet(rim_compliance_mm2_per_n=10.0, **SMALL), **load)
    touching = rigid.face_z_mm > 0.95 * rigid.face_z_mm.max()
    assert touching.sum() > 20
    assert (soft.sheet.thickness_mm > rigid.sheet.thickness_mm)[touching].all()
    # No step where the sheet has left its frame.
    steepest = np.abs(np.diff(rigid.face_z_mm, axis=1)).max()
    assert np.abs(np.diff(soft.face_z_mm, axis=1)).max() < 1.1 * steepest


def test_a_round_rim_that_gives_is_refused() -> None:
    soft = build_sheet(rim_compliance_mm2_per_n=1.0, outline="round")
    with pytest.raises(PressError, match="rectangular"):
        pressed(Ball(), soft, depth_mm=0.5)
