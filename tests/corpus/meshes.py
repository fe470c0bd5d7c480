"""Mesh files as other programs write them, drawn by a seed, each with its true solid.

Layouts follow files of these programs: header, order of the elements, number format, line ends.
Variants of STL that bend the format are those that common readers accept.
"""

import re
import struct
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh

RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


@dataclass(frozen=True, eq=False)
class WrittenMesh:
    """A mesh file, and the solid that it describes.

    Attributes
    ----------
    file : path of the file
    layout : name of the layout
    solid : the true surface, corners in single precision; None: the file must be rejected
    """

    file: Path
    layout: str
    solid: trimesh.Trimesh | None


def random_solid(rng: np.random.Generator) -> trimesh.Trimesh:
    """Return a closed surface of 2 to 60 mm in a random pose, with single-precision corners."""
    kinds = (
        lambda: trimesh.creation.box(rng.uniform(2, 30, 3)),
        lambda: trimesh.creation.icosphere(2, rng.uniform(1, 20)),
        lambda: trimesh.creation.cylinder(rng.uniform(1, 9), rng.uniform(2, 40), sections=17),
        lambda: trimesh.creation.torus(rng.uniform(6, 15), rng.uniform(1, 4), 24, 12),
        lambda: trimesh.creation.cone(rng.uniform(1, 9), rng.uniform(2, 20), sections=11),
    )
    solid = kinds[rng.integers(len(kinds))]()
    solid.apply_transform(trimesh.transformations.random_rotation_matrix(rng.random(3)))
    solid.apply_translation(rng.uniform(-40, 40, 3))
    vertices = np.asarray(solid.vertices, np.float32).astype(np.float64)
    return trimesh.Trimesh(vertices, solid.faces, process=False)


def write_mesh(folder: Path, seed: int) -> WrittenMesh:
    """Write a file in one of the layouts; all layouts are used in turn."""
    rng = np.random.default_rng([52, seed])
    name = list(LAYOUTS)[seed % len(LAYOUTS)]
    solid = random_solid(rng)
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / f"{seed:03d}.{name.split()[0]}"
    file.write_bytes(LAYOUTS[name](solid, rng))
    return WrittenMesh(file, name, None if "rejected" in name else solid)


def binary(
    solid: trimesh.Trimesh,
    header: bytes = b"Exported from Blender-4.2.1 LTS",
    count: int | None = None,
    attribute: int = 0,
) -> bytes:
    """Return a binary STL file; `count` replaces the number of triangles in the header."""
    records = np.zeros(len(solid.faces), RECORD)
    records["corners"] = solid.triangles
    records["normal"] = solid.face_normals
    records["attribute"] = attribute
    stated = len(records) if count is None else count
    return header.ljust(80, b"\0") + struct.pack("<I", stated) + records.tobytes()


def text(
    solid: trimesh.Trimesh, number: Callable[[float], str] = "{:.9g}".format, indent: str = "  "
) -> str:
    """Return a text STL file; nine digits give a single-precision number back."""
    lines = ["solid part"]
    for normal, corners in zip(solid.face_normals, solid.triangles, strict=True):
        lines += [
            indent + "facet normal " + " ".join(map(number, normal)),
            indent * 2 + "outer loop",
        ]
        lines += [indent * 3 + "vertex " + " ".join(map(number, corner)) for corner in corners]
        lines += [indent * 2 + "endloop", indent + "endfacet"]
    return "\n".join([*lines, "endsolid part", ""])


def _one_step_moved(solid: trimesh.Trimesh, rng: np.random.Generator) -> bytes:
    """Return a file with corners that differ in the last binary digit."""
    corners = np.asarray(solid.triangles, np.float32)
    direction = np.where(rng.random(corners.shape) < 0.5, -np.inf, np.inf).astype(np.float32)
    moved = np.where(rng.random(corners.shape) < 0.2, np.nextafter(corners, direction), corners)
    return binary(trimesh.Trimesh(**trimesh.triangles.to_kwargs(moved), process=False))


def _two_solids(solid: trimesh.Trimesh, _: np.random.Generator) -> bytes:
    half = len(solid.faces) // 2
    parts = [solid.faces[:half], solid.faces[half:]]
    return "".join(
        text(trimesh.Trimesh(solid.vertices, faces, process=False)) for faces in parts
    ).encode()


def _obj_of_blender(solid: trimesh.Trimesh, rng: np.random.Generator) -> bytes:
    """Return an OBJ file with one texture corner per corner of a triangle, one normal per face."""
    lines = ["# Blender 4.2.1 LTS", "# www.blender.org", "mtllib part.mtl", "o Part"]
    lines += ["v " + " ".join(f"{x:.9g}" for x in vertex) for vertex in solid.vertices]
    lines += ["vn " + " ".join(f"{x:.4f}" for x in normal) for normal in solid.face_normals]
    lines += [f"vt {u:.6f} {v:.6f}" for u, v in rng.random((3 * len(solid.faces), 2))]
    lines += ["s 0", "usemtl Material"]
    for face, corners in enumerate(solid.faces + 1):
        words = (f"{v}/{3 * face + k + 1}/{face + 1}" for k, v in enumerate(corners))
        lines.append("f " + " ".join(words))
    return "\n".join([*lines, ""]).encode()


def _obj_counted_backwards(solid: trimesh.Trimesh, _: np.random.Generator) -> bytes:
    lines = ["# v x y z r g b, as MeshLab writes coloured vertices"]
    lines += ["v " + " ".join(f"{x:.9g}" for x in v) + " 0.5 0.25 1" for v in solid.vertices]
    count = len(solid.vertices)
    lines += ["f " + " ".join(str(v - count) for v in face) for face in solid.faces]
    return "\r\n".join([*lines, ""]).encode()


def _ply(solid: trimesh.Trimesh, order: str, real: str, further: str) -> bytes:
    """Return a PLY file with a further property per vertex and one per face."""
    head = ["ply", f"format {order} 1.0", "comment VCGLIB generated"]
    head += [f"element vertex {len(solid.vertices)}"]
    head += [f"property {real} {axis}" for axis in "xyz"] + [f"property uchar {further}"]
    head += [f"element face {len(solid.faces)}", "property list uchar int vertex_indices"]
    head += ["property float quality", "end_header", ""]
    start = "\n".join(head).encode()
    if order == "ascii":
        rows = [" ".join(f"{x:.9g}" for x in vertex) + " 7" for vertex in solid.vertices]
        rows += ["3 " + " ".join(map(str, face)) + " 0.5" for face in solid.faces]
        return start + "\n".join([*rows, ""]).encode()
    sign = "<" if order == "binary_little_endian" else ">"
    width = "f4" if real == "float" else "f8"
    vertices = np.zeros(len(solid.vertices), [("p", f"{sign}{width}", 3), ("c", "u1")])
    vertices["p"] = solid.vertices
    faces = np.zeros(
        len(solid.faces), [("n", "u1"), ("v", f"{sign}i4", 3), ("quality", f"{sign}f4")]
    )
    faces["n"], faces["v"] = 3, solid.faces
    return start + vertices.tobytes() + faces.tobytes()


def _open(solid: trimesh.Trimesh) -> trimesh.Trimesh:
    return trimesh.Trimesh(solid.vertices, solid.faces[1:], process=False)


def _comma(value: float) -> str:
    return f"{value:.9g}".replace(".", ",")


def _fortran(value: float) -> str:
    return f"{value:.9e}".replace("e", "D")


# The first word is the suffix of the file.
LAYOUTS: dict[str, Callable[[trimesh.Trimesh, np.random.Generator], bytes]] = {
    "stl Blender": lambda solid, _: binary(solid),
    "stl header starts with solid": lambda solid, _: binary(solid, b"solid part, exported"),
    "stl Magics with colours": lambda solid, _: binary(
        solid, b"COLOR=\xb4\xb4\xb4\xff", None, 4097
    ),
    "stl count 0": lambda solid, _: binary(solid, count=0),
    "stl count too small": lambda solid, _: binary(solid, count=len(solid.faces) - 3),
    "stl count too large": lambda solid, _: binary(solid, count=len(solid.faces) + 3),
    "stl bytes at the end": lambda solid, rng: binary(solid) + rng.bytes(int(rng.integers(1, 99))),
    "stl a record of zeros at the end": lambda solid, _: binary(solid) + bytes(50),
    "stl corners differ by one step": _one_step_moved,
    "stl OpenSCAD": lambda solid, _: text(solid).encode(),
    "stl SolidWorks": lambda solid, _: text(solid, "{:.8e}".format, "   ").encode(),
    "stl Windows lines": lambda solid, _: text(solid).replace("\n", "\r\n").encode(),
    "stl old Macintosh lines": lambda solid, _: text(solid).replace("\n", "\r").encode(),
    "stl one line": lambda solid, _: text(solid).replace("\n", " ").encode(),
    "stl upper case": lambda solid, _: text(solid).upper().encode(),
    "stl without endsolid": lambda solid, _: text(solid).replace("endsolid part\n", "").encode(),
    "stl decimal commas": lambda solid, _: text(solid, _comma).encode(),
    "stl Fortran exponents": lambda solid, _: text(solid, _fortran).encode(),
    "stl two solids": _two_solids,
    "stl byte order mark": lambda solid, _: b"\xef\xbb\xbf" + text(solid).encode(),
    "stl UTF-16": lambda solid, _: text(solid).encode("utf-16"),
    "stl zeros at the end": lambda solid, _: text(solid).encode() + bytes(100),
    "stl named like a vertex": lambda solid, _: text(solid).replace("part", "vertex 12").encode(),
    "obj Blender": _obj_of_blender,
    "obj old Macintosh lines": lambda solid, rng: _obj_of_blender(solid, rng).replace(b"\n", b"\r"),
    "obj MeshLab, counted backwards": _obj_counted_backwards,
    "ply MeshLab text": lambda solid, _: _ply(solid, "ascii", "float", "red"),
    "ply MeshLab": lambda solid, _: _ply(solid, "binary_little_endian", "float", "red"),
    "ply big-endian, double": lambda solid, _: _ply(solid, "binary_big_endian", "double", "flags"),
    "stl facets of four, rejected": lambda solid, _: re.sub(
        r"(\s+vertex [^\n]+)(\s+endloop)", r"\1\1\2", text(solid)
    ).encode(),
    "stl open, rejected": lambda solid, _: binary(_open(solid)),
    "stl cut, rejected": lambda solid, _: binary(solid)[:-20],
    "stl text cut, rejected": lambda solid, _: text(solid).encode()[: -len(text(solid)) // 3],
    "obj open, rejected": lambda solid, rng: _obj_of_blender(_open(solid), rng),
    "ply cut, rejected": lambda solid, _: _ply(solid, "ascii", "float", "red")[:-90],
}
