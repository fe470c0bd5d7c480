"""Mesh files of anybody: a body is read, anything else is told in one line, nothing else opened."""

import os
import struct
import warnings

import numpy as np
import pytest
import trimesh

from reconstruction.errors import InputError
from twin.specimens.meshes import read_closed_mesh

BOX = np.asarray(trimesh.creation.box((4.0, 3.0, 2.0)).triangles)
TETRAHEDRON = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
PLY = """ply
format ascii 1.0
element vertex 3
property float x
property float y
property float z
element face 1
property list uchar int vertex_indices
end_header
{vertex}
1 0 0
0 1 0
3 0 1 {index}
"""


def with_corner(value: float) -> np.ndarray:
    found = BOX.copy()
    found[0, 0, 0] = value
    return found


def stl(triangles: np.ndarray) -> bytes:
    rows = [struct.pack("<12fH", 0, 0, 1, *one.ravel(), 0) for one in triangles]
    return bytes(80) + struct.pack("<I", len(rows)) + b"".join(rows)


def half_turned() -> np.ndarray:
    found = BOX.copy()
    found[:6] = found[:6, ::-1]
    return found


@pytest.fixture(autouse=True)
def no_warnings():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


@pytest.mark.parametrize(
    ("name", "content", "told"),
    [
        ("nan.stl", stl(with_corner(np.nan)), "vertices that are no numbers"),
        ("inf.stl", stl(with_corner(np.inf)), "vertices that are no numbers"),
        ("nan.ply", PLY.format(vertex="nan 0 0", index=2).encode(), "vertices that are no numbers"),
        ("far.ply", PLY.format(vertex="0 0 0", index=99).encode(), "name vertices that it lacks"),
        ("back.ply", PLY.format(vertex="0 0 0", index=-7).encode(), "name vertices that it lacks"),
        ("flat.stl", stl(BOX * (1, 1, 0)), "not watertight .edges of more than two triangles"),
        ("large.stl", stl(BOX * 1e30), r"found a size of 4e\+30 .* allowed 1e-06 to 1e\+06"),
        ("small.stl", stl(BOX * 1e-30), "found a size of 4e-30"),
        ("turned.stl", stl(half_turned()), "face both inwards and outwards"),
        ("many.stl", bytes(80) + struct.pack("<I", 2**32 - 1) + bytes(100), "holds no triangles"),
        ("empty.stl", b"", "cannot be read|holds no triangles"),
    ],
)
def test_what_is_no_body_is_told_in_one_line(tmp_path, name, content, told):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=told) as caught:
        read_closed_mesh("specimen.file", str(tmp_path / name))
    assert str(caught.value).startswith(f"specimen.file: {tmp_path / name}: ")
    assert "\n" not in str(caught.value)


def test_two_sheets_with_nothing_between_enclose_no_volume(tmp_path):
    """A pillow of four triangles, closed but as flat as a sheet but for rounding."""
    rim = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
    low, high = np.array([0.5, 0.5, 0.0]), np.array([0.5, 0.5, 2e-8])
    sides = [(rim[i], rim[(i + 1) % 4]) for i in range(4)]
    flat = np.array([(a, b, high) for a, b in sides] + [(b, a, low) for a, b in sides])
    surface = trimesh.Trimesh(**trimesh.triangles.to_kwargs(flat))
    text = "".join(f"v {x!r} {y!r} {z!r}\n" for x, y, z in surface.vertices.tolist())
    text += "".join(f"f {a} {b} {c}\n" for a, b, c in (surface.faces + 1).tolist())
    (tmp_path / "flat.obj").write_text(text)
    with pytest.raises(InputError, match="encloses no volume; give a body"):
        read_closed_mesh("specimen.file", str(tmp_path / "flat.obj"))


@pytest.mark.parametrize("triangles", [BOX, BOX[:, ::-1]], ids=["outwards", "inwards"])
def test_a_body_is_read_whichever_way_it_faces(tmp_path, triangles):
    (tmp_path / "box.stl").write_bytes(stl(triangles))
    surface = read_closed_mesh("specimen.file", str(tmp_path / "box.stl"))
    assert surface.volume == pytest.approx(24.0, rel=1e-6)
    assert surface.vertices.shape == (8, 3)


def test_what_a_mesh_names_is_not_opened(tmp_path):
    """A library of materials that is a pipe, from which reading would never end."""
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "x.obj").write_text(f"mtllib pipe\nusemtl a\n{TETRAHEDRON}")
    surface = read_closed_mesh("specimen.file", str(tmp_path / "x.obj"))
    assert surface.volume == pytest.approx(1 / 6)
