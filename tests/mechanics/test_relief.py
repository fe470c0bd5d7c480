"""The coated face as a mesh: heights, facets and normals are the field's."""

import dataclasses
import weakref

import numpy as np
import pytest

from tests.work import lines_run
from twin.config.models import Elastomer, Press
from twin.mechanics import PressedElastomer, face_mesh, face_normals, press, slab_mesh
from twin.mechanics.relief import face_grid
from twin.specimens.kinds.ball import Ball


def test_vertices_carry_the_field_row_by_row(reference_press: PressedElastomer) -> None:
    pressed, mesh = reference_press, face_mesh(reference_press)
    cols = pressed.face_x_mm.size
    for row, col in ((0, 0), (100, 7), (250, cols - 1)):
        expected = pressed.face_x_mm[col], pressed.face_y_mm[row], pressed.face_z_mm[row, col]
        assert tuple(mesh.vertices[row * cols + col]) == expected


def test_the_face_for_the_renderer_is_the_mesh_in_single_precision(
    reference_press: PressedElastomer,
) -> None:
    """Expected: the arrays of the mesh, rounded; freed with the last reference, without cycles."""
    face, mesh = face_grid(reference_press), face_mesh(reference_press)
    for name in ("vertices", "vertex_normals"):
        expected = np.asarray(getattr(mesh, name), np.float32)
        np.testing.assert_array_equal(getattr(face, name), expected)
    np.testing.assert_array_equal(face.faces, mesh.faces)
    alive = weakref.ref(face)
    del face
    assert alive() is None


def test_facets_face_up_and_cover_the_slab_once(reference_press: PressedElastomer) -> None:
    mesh = face_mesh(reference_press)
    corners = mesh.triangles
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert across[:, 2].min() > 0
    assert across[:, 2].sum() / 2 == pytest.approx(20 * 20, rel=1e-12)


def test_normals_are_those_of_a_known_sine(reference_press: PressedElastomer) -> None:
    x, y = reference_press.face_x_mm, reference_press.face_y_mm
    k, m = 3 * np.pi / 20, 2 * np.pi / 20
    phase_x, phase_y = k * (x + 10), m * (y[:, None] + 10)
    known = dataclasses.replace(reference_press, face_z_mm=np.sin(phase_x) * np.sin(phase_y))
    expected = np.stack(
        (
            -k * np.cos(phase_x) * np.sin(phase_y),
            -m * np.sin(phase_x) * np.cos(phase_y),
            np.ones((y.size, x.size)),
        ),
        axis=-1,
    )
    expected /= np.linalg.norm(expected, axis=-1, keepdims=True)
    # Fourth order in 0.04 mm, up to the rim: the extension there is exact for a sine.
    np.testing.assert_allclose(face_normals(known), expected, atol=1e-7)


def test_mesh_normals_agree_with_finite_differences(reference_press: PressedElastomer) -> None:
    pressed, mesh = reference_press, face_mesh(reference_press)
    slope_y, slope_x = np.gradient(pressed.face_z_mm, pressed.face_y_mm, pressed.face_x_mm)
    plain = np.stack((-slope_x, -slope_y, np.ones_like(slope_x)), axis=-1)
    plain /= np.linalg.norm(plain, axis=-1, keepdims=True)
    normals = mesh.vertex_normals.reshape(*pressed.face_z_mm.shape, 3)
    assert np.abs(normals - plain)[1:-1, 1:-1].max() < 1e-3
    np.testing.assert_allclose(np.linalg.norm(normals, axis=-1), 1, atol=1e-12)


def test_the_relief_has_no_ripples(reference_press: PressedElastomer) -> None:
    # 0.4 um at most between the mesh and its own smooth continuation over three nodes.
    z = reference_press.face_z_mm
    third = np.abs(np.diff(z, n=3, axis=1))
    assert third.max() < 4e-4


def test_the_mesh_is_made_without_a_loop_over_its_vertices(
    reference_press: PressedElastomer,
) -> None:
    """Some 600 lines of Python, for any number of vertices."""
    assert reference_press.face_z_mm.size > 250_000
    assert lines_run(lambda: face_mesh(reference_press)) < 5_000


@pytest.mark.parametrize("layout", ["opposite_face", "contact_face"])
def test_the_slab_is_one_watertight_body(layout: str) -> None:
    slab = Elastomer.model_validate(
        {
            "thickness_mm": 3.0,
            "length_x_mm": 20.0,
            "length_y_mm": 18.0,
            "young_modulus_kpa": 300.0,
            "poisson_ratio": 0.4999,
            "layout": layout,
        }
    )
    load = Press(control="depth", depth_mm=0.5, solver_pitch_mm=0.16, relief_pitch_mm=0.05)
    pressed = press(Ball(), slab, load)
    body = slab_mesh(pressed, slab)
    assert body.is_watertight
    assert body.is_winding_consistent
    assert body.body_count == 1
    # Incompressible; in the pad some gel is pushed out of the view sideways.
    assert body.volume == pytest.approx(3.0 * 20.0 * 18.0, rel=2e-3)
    np.testing.assert_allclose(body.bounds[:, :2], [[-10, -9], [10, 9]], atol=1e-12)
    face = face_mesh(pressed)
    np.testing.assert_array_equal(body.vertices[: len(face.vertices)], face.vertices)
    if layout == "opposite_face":
        assert body.bounds[0, 2] == pytest.approx(-3, abs=0.02)
    else:
        assert body.bounds[1, 2] == 3


def test_a_coated_face_at_25_um_has_no_ripples() -> None:
    slab = Elastomer(thickness_mm=4, length_x_mm=20, length_y_mm=20, shore_a=10, poisson_ratio=0.49)
    fine, coarse = (
        press(Ball(), slab, Press(control="depth", depth_mm=1.0, relief_pitch_mm=pitch))
        for pitch in (0.025, 0.04)
    )
    assert np.diff(fine.face_x_mm).max() <= 0.025 + 1e-12
    # Third differences decrease with the pitch cubed: (25 / 40)^3 of those at 40 um.
    at_25, at_40 = (np.abs(np.diff(p.face_z_mm, n=3, axis=1)).max() for p in (fine, coarse))
    assert at_25 < 1.1 * at_40 * (0.025 / 0.04) ** 3
