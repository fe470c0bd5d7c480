"""Meshes split along their creases, against trimesh and against closed forms."""

import numpy as np
import pytest
import trimesh

from twin.config import load_experiment
from twin.optics.creases import CREASE_DEG, adjacent_facets, split_at_creases
from twin.specimens import bodies

KINDS = ("bar", "brick", "flat", "nut", "random_relief", "rods", "step", "t_bolt", "v_groove")
SOLIDS = {
    "icosahedron": trimesh.creation.icosahedron(),
    "box": trimesh.creation.box(),
    "cylinder": trimesh.creation.cylinder(1.0, 2.0),
    "annulus": trimesh.creation.annulus(1.0, 2.0, 1.0),
    "cone": trimesh.creation.cone(1.0, 2.0, sections=7),
    "ball": trimesh.creation.icosphere(4),
    "triangle": trimesh.Trimesh([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 1, 2)]),
}


def meshes(name: str) -> list[trimesh.Trimesh]:
    if name in SOLIDS:
        return [SOLIDS[name]]
    specimen = load_experiment("examples/slab_ball", {"specimen": {"kind": name}}).specimen
    return [part.mesh for part in bodies(specimen, 0.0)]


@pytest.mark.parametrize("name", [*SOLIDS, *KINDS])
def test_the_result_is_that_of_trimesh(name: str) -> None:
    for mesh in meshes(name):
        expected = trimesh.graph.smooth_shade(mesh.copy(), angle=np.deg2rad(CREASE_DEG))
        result = split_at_creases(mesh)
        assert np.array_equal(result.vertices, expected.vertices)
        assert np.array_equal(result.faces, expected.faces)
        assert np.array_equal(result.vertex_normals, expected.vertex_normals)


def test_a_box_has_three_vertices_at_each_corner_and_a_ball_has_one() -> None:
    """Expected: six sides of four vertices with the normals of the sides; nothing is split."""
    box = split_at_creases(trimesh.creation.box())
    assert len(box.vertices) == 24
    assert np.abs(np.abs(box.vertex_normals).max(axis=1) - 1.0).max() < 1e-12
    ball = trimesh.creation.icosphere(3)
    assert len(split_at_creases(ball).vertices) == len(ball.vertices)


@pytest.mark.parametrize("name", [*SOLIDS, "random_relief", "nut"])
def test_adjacent_facets_are_those_of_trimesh(name: str) -> None:
    for mesh in meshes(name):
        pairs = np.unique(np.sort(adjacent_facets(mesh.faces), axis=1), axis=0)
        assert np.array_equal(pairs, np.unique(mesh.face_adjacency, axis=0).reshape(-1, 2))


def test_an_edge_of_three_facets_joins_none_of_them() -> None:
    pages = np.array([(0, 1, 2), (0, 1, 3), (0, 1, 4), (0, 2, 5)])
    assert adjacent_facets(pages).tolist() == [[0, 3]]
