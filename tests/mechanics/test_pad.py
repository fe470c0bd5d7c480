"""The contact-face layout: the pad against the Fredholm solution, its frame and its margins."""

import numpy as np
import pytest

from tests.oracles import fredholm
from twin.config.models import Elastomer, Press
from twin.mechanics import press
from twin.specimens import height_above_lowest
from twin.specimens.kinds.ball import Ball
from twin.specimens.kinds.flat import Flat
from twin.specimens.kinds.rod import Rod


def pad(nu: float, thickness_mm: float = 4.0) -> Elastomer:
    return Elastomer(
        thickness_mm=thickness_mm,
        length_x_mm=20,
        length_y_mm=20,
        young_modulus_kpa=1000.0,
        poisson_ratio=nu,
        layout="contact_face",
    )


@pytest.mark.parametrize("chi", [0.1, 0.4, 1.0])
@pytest.mark.parametrize("nu", [0.45, 0.49, 0.4999])
def test_a_ball_on_a_pad_is_the_fredholm_solution(chi: float, nu: float) -> None:
    """R 4: force 0.3 %, of the whole press with its window and its grid."""
    radius = 4.0
    thickness = {0.1: 4.0, 0.4: 4.0, 1.0: 1.5}[chi]  # chi = sqrt(R d) / h
    depth = (chi * thickness) ** 2 / radius
    pitch = 0.02 if chi < 0.2 else 0.06
    load = Press(control="depth", depth_mm=depth, solver_pitch_mm=pitch)
    pressed = press(Ball(), pad(nu, thickness), load)
    expected = fredholm.press_ball(radius, depth, thickness, nu).force_over_modulus_mm2
    assert pressed.force_n == pytest.approx(expected, rel=3e-3)


def test_published_incompressible_layer() -> None:
    """Ball R 4 on h 4, d 0.6, nu 0.49: F / E = 2.7360 (measured on our prototype)."""
    pressed = press(Ball(), pad(0.49), Press(control="depth", depth_mm=0.6))
    assert pressed.force_n == pytest.approx(2.7360, rel=3e-3)


SPECIMENS = [Ball(), Rod(diameter_mm=3, length_mm=8, yaw_deg=30), Flat(edge_radius_mm=0.3)]


@pytest.mark.parametrize("specimen", SPECIMENS, ids=lambda s: s.kind)
def test_the_coat_lies_on_the_specimen_and_nowhere_below_it(
    specimen: Ball | Rod | Flat,
) -> None:
    pressed = press(specimen, pad(0.49, 3.0), Press(control="depth", depth_mm=0.4))
    indented = 0.4 - height_above_lowest(specimen, pressed.face_x_mm, pressed.face_y_mm)
    assert (pressed.face_z_mm - indented).min() >= 0
    deep = pressed.face_z_mm - indented < 1e-4
    node = np.diff(pressed.face_x_mm)[0] * np.diff(pressed.face_y_mm)[0]
    cell = np.diff(pressed.x_mm)[0] * np.diff(pressed.y_mm)[0]
    assert deep.sum() * node == pytest.approx(pressed.contact.sum() * cell, rel=0.1)
    # Away from the specimen an incompressible gel piles up: it cannot sink.
    assert -0.12 < pressed.face_z_mm.min() < 0


def test_coated_and_touched_face_are_one_at_the_cells() -> None:
    pressed = press(Ball(x_mm=1, y_mm=-2), pad(0.49), Press(control="depth", depth_mm=0.5))
    row, col = np.unravel_index(pressed.face_z_mm.argmax(), pressed.face_z_mm.shape)
    assert pressed.face_x_mm[col] == pytest.approx(1, abs=0.03)
    assert pressed.face_y_mm[row] == pytest.approx(-2, abs=0.03)
    assert pressed.face_z_mm.max() == pytest.approx(0.5, abs=1e-3)
    assert pressed.touched_face_mm.max() == pytest.approx(0.5, abs=1e-3)
    assert (pressed.face_x_mm[0], pressed.face_x_mm[-1]) == (-10, 10)
    # The window reaches three thicknesses beyond the specimen.
    assert pressed.y_mm[0] == pytest.approx(-(6 + 12), abs=0.1)


def test_a_punch_edge_does_not_ring() -> None:
    """Modified Akima: beyond two cells from the edge the face follows a finer solution."""
    specimen = Flat(diameter_mm=6, edge_radius_mm=0.0)
    coarse, fine = (
        press(
            specimen,
            pad(0.49, 3.0),
            Press(control="depth", depth_mm=0.4, solver_pitch_mm=pitch, relief_pitch_mm=0.025),
        )
        for pitch in (0.08, 0.02)
    )
    assert coarse.face_z_mm.max() <= 0.4 + 1e-6  # no overshoot on the punch
    r = np.hypot(coarse.face_x_mm, coarse.face_y_mm[:, None])
    away = np.abs(r - 3) > 0.25
    assert np.abs(coarse.face_z_mm - fine.face_z_mm)[away].max() < 6e-3
    outside = (r > 3.2) & (r < 6)
    ringing = np.abs(np.diff(coarse.face_z_mm - fine.face_z_mm, n=2, axis=1))
    assert ringing[outside[:, 1:-1]].max() < 1e-3


def test_refinement_follows_the_finest_solution() -> None:
    faces = [
        press(
            Ball(),
            pad(0.49),
            Press(control="depth", depth_mm=0.6, solver_pitch_mm=pitch, relief_pitch_mm=0.025),
        ).face_z_mm
        for pitch in (0.08, 0.02)
    ]
    error = np.abs(faces[0] - faces[1])
    assert error.max() < 1.5e-3  # at the contact's edge, where the curvature is infinite
    assert np.sqrt(np.mean(error**2)) < 5e-5


def test_a_pad_that_ends_near_the_contact_is_flagged() -> None:
    near = press(Ball(x_mm=5), pad(0.49), Press(control="depth", depth_mm=0.3))
    assert any("pad's side" in text for text in near.validity.warnings)
    far = press(Ball(), pad(0.49, 2.0), Press(control="depth", depth_mm=0.3))
    assert far.validity.warnings == ()
