"""Closed surfaces from mesh files: STL, PLY and OBJ."""

import codecs
import io
import re
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from reconstruction.errors import InputError, one_line
from reconstruction.reading import is_regular, read_bytes
from twin.assets import mesh_path

if TYPE_CHECKING:
    import trimesh

_FILE_TYPES = (".stl", ".ply", ".obj")
_MOST_BYTES = 2**30
# trimesh would take it for the last vertex: a body of another form, closed all the same.
_NUMBERED_FROM_0 = re.compile(rb"^[ \t]*+f[ \t]++(?:\S++[ \t]++)*?0(?:/|\s|$)", re.MULTILINE)
# In the file's own units, which may be metres. Beyond them distances are lost in rounding.
_EXTENT = 1e-6, 1e6
# Bodies that a sensor can press or image; less is a part that fits whose file is in metres.
_SIZE_MM = 0.1, 1000.0
# Volume over that of a cube of its size, far below a needle's: less has no inside.
_LEAST_FILL = 1e-8


def read_closed_mesh(key: str, name: str) -> "trimesh.Trimesh":
    """Read a closed surface.

    Parameters
    ----------
    key : key of the experiment file that names it, for messages
    name : path of an STL, PLY or OBJ file; `scenes/...` finds shipped ones too

    Raises
    ------
    InputError : the file is missing, no mesh, empty, not watertight or without an inside
    """
    import trimesh

    path = _find(key, name)
    content = read_bytes(path, _MOST_BYTES).removeprefix(codecs.BOM_UTF8)
    kind = path.suffix[1:].lower()
    if kind == "obj" and _NUMBERED_FROM_0.search(content):
        raise InputError(
            f"{key}: {path}: a face names vertex 0, but an OBJ counts from 1; export it again"
        )
    # Numbers of any size overflow in what trimesh derives; they are told below.
    with np.errstate(all="ignore"):
        try:
            # Not by its name: a mesh may name pictures and materials, which would be opened, too.
            surface = trimesh.load_mesh(io.BytesIO(content), file_type=kind, process=False)
        except Exception as error:  # each of trimesh's readers raises its own
            reason = one_line(error) or type(error).__name__
            raise InputError(f"{key}: {path}: cannot be read ({reason})") from error
        _require_numbers(f"{key}: {path}", surface)
        surface = _welded(surface)
        _require_closed(f"{key}: {path}", surface)
        if surface.volume < 0.0:  # every triangle seen from the wrong side
            surface.invert()
    return surface


def read_body_mm(key: str, name: str, scale_key: str, mm_per_unit: float) -> "trimesh.Trimesh":
    """Read a closed surface and scale it to mm.

    Parameters
    ----------
    key, name : as for `read_closed_mesh`
    scale_key, mm_per_unit : key that scales it, for messages; mm, length of one unit of the file

    Raises
    ------
    InputError : as `read_closed_mesh`, or the body is implausibly small or large
    """
    surface = read_closed_mesh(key, name)
    size_mm, (least, most) = float(surface.extents.max()) * mm_per_unit, _SIZE_MM
    if not least <= size_mm <= most:
        sizes = " x ".join(f"{side * mm_per_unit:.3g}" for side in surface.extents)
        raise InputError(
            f"{key}: {name}: {sizes} mm at {scale_key} = {mm_per_unit:g} mm per unit of the file, "
            f"allowed {least:g} to {most:g} mm for its longest side; set {scale_key} to the file's "
            "unit in mm: 1000 for metres, 25.4 for inches, 0.001 for micrometres"
        )
    surface.apply_scale(mm_per_unit)
    return surface


def _welded(surface: "trimesh.Trimesh") -> "trimesh.Trimesh":
    """Join vertices at the same position, which files split by normal, texture and material."""
    import trimesh

    joined = trimesh.Trimesh(surface.vertices, surface.faces, process=False)
    joined.merge_vertices()
    a, b, c = joined.faces.T
    joined.update_faces((a != b) & (b != c) & (c != a))  # slivers that joining made lines
    return joined


def _require_numbers(where: str, surface: object) -> None:
    """Refuse what is no surface in space."""
    import trimesh

    if not isinstance(surface, trimesh.Trimesh) or not len(surface.faces):
        raise InputError(f"{where}: holds no triangles")
    if not np.isfinite(surface.vertices).all():
        raise InputError(f"{where}: holds vertices that are no numbers; export it again")
    if surface.faces.min() < 0 or surface.faces.max() >= len(surface.vertices):
        raise InputError(f"{where}: its triangles name vertices that it lacks; export it again")
    size, (least, most) = float(surface.extents.max()), _EXTENT
    if not least <= size <= most:
        raise InputError(
            f"{where}: found a size of {size:.3g} in the file's units, allowed {least:g} to "
            f"{most:g}"
        )


def _require_closed(where: str, surface: "trimesh.Trimesh") -> None:
    """Refuse what encloses no body."""
    if not surface.is_watertight:
        import trimesh

        open_edges = len(trimesh.grouping.group_rows(surface.edges_sorted, require_count=1))
        found = f"{open_edges} open edges" if open_edges else "edges of more than two triangles"
        raise InputError(
            f"{where}: not watertight ({found}); close it, for example "
            "with pytetwild or the repair tool of your mesh editor"
        )
    if not surface.is_winding_consistent:
        raise InputError(
            f"{where}: its triangles face both inwards and outwards; let your mesh editor make "
            "their normals agree"
        )
    if not abs(surface.volume) > _LEAST_FILL * float(surface.extents.max()) ** 3:
        raise InputError(f"{where}: encloses no volume; give a body that has an inside")


def _find(key: str, name: str) -> Path:
    path = mesh_path(name)
    if not is_regular(path):
        found = "not a file" if path.exists() else "no such file"
        raise InputError(f"{key}: {name}: {found}")
    if path.suffix.lower() not in _FILE_TYPES:
        raise InputError(f"{key}: {name}: not a mesh, allowed: {', '.join(_FILE_TYPES)}")
    return path
