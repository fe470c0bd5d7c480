"""Untrusted mesh files: bodies are read, other content gives one line, no other file is opened."""

import os
import struct
import warnings

import numpy as np
import pytest
import trimesh

from reconstruction.errors import InputError
from twin.specimens import shape_of
from twin.specimens.kinds.group import Group
from twin.specimens.kinds.mesh import MeshFile
from twin.specimens.mesh_files import read_closed_mesh

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
    corners = BOX.copy()
    corners[0, 0, 0] = value
    return corners


def stl(triangles: np.ndarray) -> bytes:
    rows = [struct.pack("<12fH", 0, 0, 1, *triangle.ravel(), 0) for triangle in triangles]
    return bytes(80) + struct.pack("<I", len(rows)) + b"".join(rows)


def half_turned() -> np.ndarray:
    corners = BOX.copy()
    corners[:6] = corners[:6, ::-1]
    return corners


@pytest.fixture(autouse=True)
def no_warnings():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("nan.stl", stl(with_corner(np.nan)), "vertices that are no numbers"),
        ("inf.stl", stl(with_corner(np.inf)), "vertices that are no numbers"),
        ("nan.ply", PLY.format(vertex="nan 0 0", index=2).encode(), "vertices that are no numbers"),
        ("far.ply", PLY.format(vertex="0 0 0", index=99).encode(), "refer to missing vertices"),
        ("back.ply", PLY.format(vertex="0 0 0", index=-7).encode(), "refer to missing vertices"),
        ("flat.stl", stl(BOX * (1, 1, 0)), "encloses no volume"),
        (
            "corner.stl",
            stl(np.concatenate((BOX, BOX + np.array((4, 3, 0))))),
            "not watertight .edges of more than two triangles",
        ),
        ("large.stl", stl(BOX * 1e30), r"found a size of 4e\+30 .* allowed 1e-06 to 1e\+06"),
        ("small.stl", stl(BOX * 1e-30), "found a size of 4e-30"),
        ("turned.stl", stl(half_turned()), "face both inwards and outwards"),
        ("many.stl", bytes(80) + struct.pack("<I", 2**32 - 1) + bytes(100), "found a size of 0"),
        ("empty.stl", b"", "cannot be read|found no triangles"),
        ("two.obj", b"v 0 0 0\nv 1 0 0\nf 1 2\n", "found no triangles"),
        (
            "from_0.obj",
            TETRAHEDRON.translate(str.maketrans("1234", "0123")).replace("v 0", "v 1").encode(),
            "a face refers to vertex 0, but OBJ indices start at 1",
        ),
    ],
)
def test_invalid_bodies_give_one_line(tmp_path, name, content, message):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=message) as caught:
        read_closed_mesh("specimen.file", str(tmp_path / name))
    assert str(caught.value).startswith(f"specimen.file: {tmp_path / name}: ")
    assert "\n" not in str(caught.value)


def test_two_sheets_with_nothing_between_enclose_no_volume(tmp_path):
    """A pillow of four triangles, closed, and flat except for rounding."""
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


def test_a_byte_order_mark_hides_no_vertex(tmp_path):
    (tmp_path / "x.obj").write_text(TETRAHEDRON, encoding="utf-8-sig")
    assert read_closed_mesh("specimen.file", str(tmp_path / "x.obj")).volume == pytest.approx(1 / 6)


def test_files_named_in_a_mesh_are_not_opened(tmp_path):
    """A library of materials that is a pipe, which would block a reader."""
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "x.obj").write_text(f"mtllib pipe\nusemtl a\n{TETRAHEDRON}")
    surface = read_closed_mesh("specimen.file", str(tmp_path / "x.obj"))
    assert surface.volume == pytest.approx(1 / 6)


#: a cube of 4 with corners split by texture and normal, in two materials, and its exporter's order
CORNERS = [(x, y, z) for x in (-2, 2) for y in (-2, 2) for z in (-2, 2)]
QUADS = [(1, 2, 4, 3), (5, 7, 8, 6), (1, 5, 6, 2), (3, 4, 8, 7), (1, 3, 7, 5), (2, 6, 8, 4)]


def split_cube(corner: str) -> str:
    """Return an OBJ with corners of faces in the format `corner`: {v}, {t} and {n} are numbers."""
    lines = ["mtllib absent.mtl", "o Cube"]
    lines += [f"v {x} {y} {z}" for x, y, z in CORNERS]
    lines += [f"vt {n / 24} {n % 5 / 5}" for n in range(24)]
    lines += ["vn -1 0 0", "vn 1 0 0", "vn 0 -1 0", "vn 0 1 0", "vn 0 0 -1", "vn 0 0 1"]
    for n, quad in enumerate(QUADS):
        lines.append(f"usemtl side_{n % 2}")
        names = [corner.format(v=v, t=4 * n + k + 1, n=n + 1) for k, v in enumerate(quad)]
        lines.append("f " + " ".join(names))
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize("corner", ["{v}", "{v}/{t}", "{v}//{n}", "{v}/{t}/{n}"])
def test_a_closed_box_is_closed_whatever_splits_its_vertices(tmp_path, corner):
    (tmp_path / "Würfel 4 mm.obj").write_text(split_cube(corner), encoding="utf-8")
    surface = read_closed_mesh("specimen.file", str(tmp_path / "Würfel 4 mm.obj"))
    assert surface.volume == pytest.approx(64.0)
    assert surface.vertices.shape == (8, 3)


def test_a_sliver_that_joining_makes_a_line_opens_no_edge(tmp_path):
    """An edge of the box split at its own end, as exporters of coarse numbers do."""
    sliver = np.array([[BOX[0, 0], BOX[0, 1], BOX[0, 1]]])
    (tmp_path / "sliver.stl").write_bytes(stl(np.concatenate((BOX, sliver))))
    surface = read_closed_mesh("specimen.file", str(tmp_path / "sliver.stl"))
    assert surface.volume == pytest.approx(24.0)


@pytest.mark.parametrize(
    ("mm_per_unit", "shown"), [(1e-3, "0.004 x 0.003 x 0.002 mm"), (1e3, "4e.03 x 3e.03 x 2e.03")]
)
def test_a_file_in_another_unit_is_detected_by_its_size(tmp_path, mm_per_unit, shown):
    """A box of 4 mm in metres, and in micrometres."""
    (tmp_path / "box.stl").write_bytes(stl(BOX * mm_per_unit))
    specimen = MeshFile(file=str(tmp_path / "box.stl"))
    with pytest.raises(InputError, match=rf"box\.stl: {shown}.*allowed 0\.1 to 1000 mm.*metres"):
        shape_of(specimen)
    scaled = MeshFile(file=specimen.file, scale=1 / mm_per_unit)
    assert shape_of(scaled).bounds_mm() == pytest.approx((-2.0, 2.0, -1.5, 1.5))


def test_a_body_that_may_be_in_inches_gets_a_warning(tmp_path):
    """A box of 4 mm in inches is 0.16 mm long: small, but it may be meant."""
    (tmp_path / "box.stl").write_bytes(stl(BOX / 25.4))
    small = MeshFile(file=str(tmp_path / "box.stl"))
    (warning,) = Group(parts={"box": small}).warnings()
    assert "is 0.16 mm" in warning
    assert "in inches, 25.4" in warning
    assert not MeshFile(file=small.file, scale=25.4).warnings()
