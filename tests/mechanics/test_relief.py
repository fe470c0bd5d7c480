"""The coated face as a mesh: heights, facets and normals are the field's."""

import dataclasses
import time

import numpy as np
import pytest

from twin.mechanics import PressedElastomer, face_mesh, face_normals


def test_vertices_carry_the_field_row_by_row(reference_press: PressedElastomer) -> None:
    pressed, mesh = reference_press, face_mesh(reference_press)
    cols = pressed.face_x_mm.size
    for row, col in ((0, 0), (100, 7), (250, cols - 1)):
        expected = pressed.face_x_mm[col], pressed.face_y_mm[row], pressed.face_z_mm[row, col]
        assert tuple(mesh.vertices[row * cols + col]) == expected


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


def test_a_mesh_of_a_quarter_million_vertices_takes_well_under_a_second(
    reference_press: PressedElastomer,
) -> None:
    started = time.perf_counter()
    mesh = face_mesh(reference_press)
    # 0.07 s on an idle machine; the bound only catches a loop over vertices.
    assert time.perf_counter() - started < 1.0
    assert len(mesh.vertices) > 250_000
