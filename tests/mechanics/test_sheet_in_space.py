"""The sheet in space, neither round nor in plane strain: against solids, and its own cells."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import CloughTocher2DInterpolator

from reconstruction.evaluate.fit import fit_sphere
from tests.mechanics.sheets import YOUNG_KPA, build_sheet, pressed
from tests.mechanics.solids_in_space import CASES, SpaceCase, seen_at, wrapped
from twin.mechanics.sheet.faces import sample
from twin.mechanics.sheet.result import contact_force_n
from twin.specimens.kinds.ball import Ball

SOLIDS = json.loads((Path(__file__).parent / "reference/solid_in_space.json").read_text())


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_a_short_bar_is_the_solids(case: SpaceCase) -> None:
    """The solids' two meshes differ by 1.1 um and 0.3 %: `coarser_um`, `coarser_force`.

    The sheet has no shear, which matters where it bends sharply: at the bar's corners of 0.5 mm
    (h = 0.5 at 0.5 mm of travel), and at a clamp only 2.5 mm away that pulls at 22 degrees.
    """
    for solid, limit_um in zip(SOLIDS[case.name], case.limits_um, strict=True):
        sheet, state = wrapped(case, solid["travel_mm"], 0.15)
        upper = sample(sheet, state, 0.05).upper_mm.reshape(-1, 3)
        quarter = upper[(upper[:, :2] > -0.3).all(axis=1)]
        face = CloughTocher2DInterpolator(quarter[:, :2], quarter[:, 2] - case.thickness_mm / 2)
        error_um = 1e3 * np.abs(face(*seen_at()) - solid["upper_z_mm"])
        assert error_um.max() < limit_um
        result = contact_force_n(sheet, state) / (1e-3 * YOUNG_KPA)
        assert result == pytest.approx(solid["force"], rel=case.force_limit)


def test_half_the_cells_move_the_face_by_less_than_a_micrometre() -> None:
    """Where it touches, and the radius fitted to 1.5 mm, under a pressure that wraps it tightly.

    Nearer to the rim: docs/sheet.md.
    """
    coarse, fine = (
        pressed(
            Ball(),
            build_sheet(thickness_mm=0.2, length_x_mm=14.0, length_y_mm=14.0),
            depth_mm=1.0,
            back_pressure_kpa=3.0,
            cell_mm=cell,
        )
        for cell in (0.15, 0.075)
    )
    x, y = np.meshgrid(fine.face_x_mm, fine.face_y_mm)
    at_x, at_y = np.meshgrid(fine.x_mm, fine.y_mm)
    contact_mm = np.hypot(at_x, at_y)[fine.contact].max()
    assert contact_mm > 2.5
    moved_um = 1e3 * np.abs(coarse.face_z_mm - fine.face_z_mm)
    assert moved_um[np.hypot(x, y) < contact_mm].max() < 1.0
    near = np.hypot(x, y) < 1.5
    radii = [fit_sphere(np.stack((x, y, press.face_z_mm), -1)[near]) for press in (coarse, fine)]
    assert radii[0].radius_mm == pytest.approx(radii[1].radius_mm, rel=0.01)
