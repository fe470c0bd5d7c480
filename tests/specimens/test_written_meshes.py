"""Mesh files as other programs write them: the right solid, or one line; random damage."""

import numpy as np
import pytest
import trimesh

from benchmarks.reality_meshes import is_read_rightly
from reconstruction.errors import InputError
from tests.corpus.meshes import LAYOUTS, binary, text, write_mesh
from twin.specimens.mesh_files import _same_position, read_closed_mesh

BOX = trimesh.creation.box((4.0, 3.0, 2.0))


@pytest.mark.parametrize("seed", range(len(LAYOUTS)), ids=list(LAYOUTS))
def test_a_layout_gives_its_solid_or_one_line(tmp_path, seed):
    written = write_mesh(tmp_path, seed)
    assert is_read_rightly(written.file, written.solid), written.layout


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("cut.stl", binary(BOX)[:-20], "ends within triangle 12 of 12; copy or export it again"),
        ("words.stl", text(BOX).replace("vertex 2 ", "vertex 2x ").encode(), "without three num"),
        ("dots.stl", text(BOX).replace("vertex 2 ", "vertex 1.2.3 ").encode(), "has no number"),
        ("loop.stl", text(BOX).encode()[:-60], "found 35 vertices in 12 facets, allowed: 3 for"),
        ("lines.stl", b"facet vertex 1 2 3 vertex 4 5 6", "found 2 vertices, no whole number"),
    ],
)
def test_a_file_with_a_damaged_triangle_is_rejected(tmp_path, name, content, message):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=message):
        read_closed_mesh("specimen.file", str(tmp_path / name))


def test_corners_more_than_rounding_from_each_other_are_not_merged(tmp_path):
    """Why: a hole that is wider than the numbers' last digit is a fault of the body."""
    corners = np.asarray(BOX.triangles, np.float32)
    corners[0, 0] += 1e-4
    body = trimesh.Trimesh(**trimesh.triangles.to_kwargs(corners), process=False)
    (tmp_path / "gap.stl").write_bytes(binary(body))
    with pytest.raises(InputError, match="not watertight"):
        read_closed_mesh("specimen.file", str(tmp_path / "gap.stl"))


@pytest.mark.parametrize("offset", [1e5, 1e6])
def test_open_bodies_far_from_the_origin_keep_their_shape(tmp_path, offset):
    """Why: there the last digit of single precision is as long as the body's details."""
    ball = trimesh.creation.icosphere(3, 0.5)
    body = trimesh.Trimesh(ball.vertices + np.array([offset, 0, 0]), ball.faces[1:], process=False)
    (tmp_path / "far.stl").write_text(text(body, "{:.17g}".format))
    with pytest.raises(InputError, match="3 open edges"):
        read_closed_mesh("specimen.file", str(tmp_path / "far.stl"))


def test_many_vertices_at_nearly_one_position_are_not_merged():
    """Why: all pairs of them would fill the memory."""
    dense = np.linspace(0.0, 1e-6, 300)[:, None] * [1.0, 0.0, 0.0]
    vertices = np.vstack([dense, [[10.0, 10.0, 10.0]]])
    np.testing.assert_array_equal(_same_position(vertices), np.arange(301))


def test_triangles_without_area_are_rejected(tmp_path):
    point = trimesh.Trimesh([[1, 1, 1], [5, 5, 5]], [[0, 0, 0], [1, 1, 1]], process=False)
    (tmp_path / "point.stl").write_bytes(binary(point))
    with pytest.raises(InputError, match="all triangles are lines or points"):
        read_closed_mesh("specimen.file", str(tmp_path / "point.stl"))


def test_a_file_of_a_cad_program_is_rejected_with_a_remedy(tmp_path):
    (tmp_path / "part.STEP").write_text("ISO-10303-21;")
    with pytest.raises(InputError, match=r"allowed: \.stl, \.ply, \.obj; export one of them"):
        read_closed_mesh("specimen.file", str(tmp_path / "part.STEP"))


@pytest.mark.parametrize("seed", range(len(LAYOUTS)), ids=list(LAYOUTS))
def test_random_damage_gives_a_closed_body_or_one_line(tmp_path, seed):
    rng = np.random.default_rng(seed)
    written = write_mesh(tmp_path, seed)
    intact = written.file.read_bytes()
    for _ in range(5):
        damaged = bytearray(intact[: int(rng.integers(1, len(intact) + 1))])
        for place in rng.integers(0, len(damaged), int(rng.integers(0, 6))):
            damaged[place] ^= 1 << int(rng.integers(8))
        written.file.write_bytes(bytes(damaged))
        reason = _reason(str(written.file))
        assert "\n" not in reason


def _reason(file: str) -> str:
    """Return why a file is rejected; no text for a closed body."""
    try:
        read = read_closed_mesh("specimen.file", file)
    except InputError as error:
        return str(error)
    return "" if read.is_watertight else "not watertight,\nand not rejected"
