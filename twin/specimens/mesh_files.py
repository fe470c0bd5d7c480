"""Read closed surfaces from mesh files: STL, PLY and OBJ."""

import codecs
import io
import re
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from reconstruction.arrays import FloatArray, IntArray
from reconstruction.errors import InputError, one_line
from reconstruction.reading import is_regular, read_bytes
from twin.assets import mesh_path
from twin.specimens.stl_files import stl_candidates

if TYPE_CHECKING:
    import trimesh

_FILE_TYPES = (".stl", ".ply", ".obj")
_MOST_BYTES = 2**30
# Matches a face of an OBJ file that refers to vertex 0. trimesh would read this index as the last
# vertex, which gives a closed body of wrong shape.
_NUMBERED_FROM_0 = re.compile(rb"^[ \t]*+f[ \t]++(?:\S++[ \t]++)*?0(?:/|\s|$)", re.MULTILINE)
# Allowed size in the file's units, possibly metres. Beyond it rounding dominates distances.
_EXTENT = 1e-6, 1e6
# Allowed size of bodies that a sensor can press or image; a file in metres gives smaller sizes.
_SIZE_MM = 0.1, 1000.0
# Least volume over that of a cube of the same size, far below that of a needle: a surface with less
# volume has no interior.
_LEAST_FILL = 1e-8
# Vertices of a surface with open edges are the same if they differ by less than this number of
# steps of single precision at the largest coordinate, and by less than this share of its size: far
# from the origin single precision is coarser than the details of the body.
_ROUNDING_STEPS = 4.0
_MOST_ROUNDING = 1e-4
# Values within 2 steps of a corner: 5 in each of 3 directions. More vertices that close together
# are details of the body, and their pairs could fill the memory.
_MOST_VALUES = 125
# Formats of CAD programs and of 3D printing that people try first.
_EXPORT_FROM = (".step", ".stp", ".iges", ".igs", ".3mf", ".sldprt", ".fcstd", ".blend", ".glb")


def read_closed_mesh(key: str, name: str) -> "trimesh.Trimesh":
    """Read a closed surface, in the file's units.

    Parameters
    ----------
    key : key of the experiment that states the file, for messages
    name : path of an STL, PLY or OBJ file; `scenes/...` for shipped files

    Raises
    ------
    InputError : the file is missing or no mesh, or the mesh is empty, not watertight or without
        volume
    """
    path = _find(key, name)
    content = read_bytes(path, _MOST_BYTES).removeprefix(codecs.BOM_UTF8)
    kind = path.suffix[1:].lower()
    if kind == "obj" and b"\n" not in content:
        content = content.replace(b"\r", b"\n")
    if kind == "obj" and _NUMBERED_FROM_0.search(content):
        raise InputError(
            f"{key}: {path}: a face refers to vertex 0, but OBJ indices start at 1; export it again"
        )
    # Large numbers overflow in trimesh's derived quantities; they are reported below.
    with np.errstate(all="ignore"):
        surface = _stl(f"{key}: {path}", content) if kind == "stl" else _other(key, path, content)
        _require_closed(f"{key}: {path}", surface)
        if surface.volume < 0.0:  # every triangle has the wrong orientation
            surface.invert()
    return surface


def _other(key: str, path: Path, content: bytes) -> "trimesh.Trimesh":
    """Return the surface of a PLY or OBJ file."""
    import trimesh

    try:
        # As bytes: given a name, trimesh would also open images and materials.
        surface = trimesh.load_mesh(
            io.BytesIO(content), file_type=path.suffix[1:].lower(), process=False
        )
    except Exception as error:  # trimesh's readers raise different types
        reason = one_line(error) or type(error).__name__
        raise InputError(f"{key}: {path}: cannot be read ({reason})") from error
    _require_numbers(f"{key}: {path}", surface)
    return _welded(surface)


def _stl(where: str, content: bytes) -> "trimesh.Trimesh":
    """Return the first closed surface among the candidates of an STL file, or the first of all."""
    import trimesh

    first = None
    for corners in stl_candidates(where, content):
        surface = trimesh.Trimesh(
            corners.reshape(-1, 3), np.arange(corners.size // 3).reshape(-1, 3), process=False
        )
        _require_numbers(where, surface)
        surface = _welded(surface)
        if surface.is_watertight:
            return surface
        first = first or surface
    assert first is not None  # there is at least one candidate
    return first


def read_body_mm(key: str, name: str, scale_key: str, mm_per_unit: float) -> "trimesh.Trimesh":
    """Read a closed surface and scale it to mm.

    Parameters
    ----------
    key, name : as for `read_closed_mesh`
    scale_key : key of the scale, for messages
    mm_per_unit : length of one unit of the file, mm

    Raises
    ------
    InputError : as `read_closed_mesh`, or the longest side is not within 0.1 to 1000 mm
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
    """Return the surface with vertices at the same position merged.

    Files store a vertex several times if its triangles differ in normal, texture or material.
    """
    import trimesh

    joined = trimesh.Trimesh(surface.vertices, surface.faces, process=False)
    joined.merge_vertices()
    if not joined.is_watertight:
        joined.faces = _same_position(joined.vertices)[joined.faces]
        joined.remove_unreferenced_vertices()
    a, b, c = joined.faces.T
    joined.update_faces((a != b) & (b != c) & (c != a))  # removes triangles that became lines
    return joined


def _same_position(vertices: FloatArray) -> IntArray:
    """Return for each vertex the first one of those that differ from it by rounding only.

    Files often have numbers of single precision: the same corner, computed for two triangles, then
    differs in the last digit.
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import KDTree

    count = len(vertices)
    step = float(np.finfo(np.float32).eps * np.abs(vertices).max())
    distance = min(_ROUNDING_STEPS * step, _MOST_ROUNDING * float(np.ptp(vertices, axis=0).max()))
    tree = KDTree(vertices)
    if tree.count_neighbors(tree, distance) > _MOST_VALUES * count:
        return np.arange(count)
    pairs = tree.query_pairs(distance, output_type="ndarray")
    links = coo_matrix((np.ones(len(pairs)), pairs.T), shape=(count, count))
    _, group = connected_components(links, directed=False)
    _, first = np.unique(group, return_index=True)
    return np.asarray(first[group])


def _require_numbers(where: str, surface: object) -> None:
    """Raise InputError if a file has no triangles with finite vertices of plausible size."""
    import trimesh

    if not isinstance(surface, trimesh.Trimesh) or not len(surface.faces):
        raise InputError(f"{where}: found no triangles; give a closed surface")
    if not np.isfinite(surface.vertices).all():
        raise InputError(f"{where}: found vertices that are no numbers; export it again")
    if surface.faces.min() < 0 or surface.faces.max() >= len(surface.vertices):
        raise InputError(
            f"{where}: found triangles that refer to missing vertices; export it again"
        )
    size, (least, most) = float(surface.extents.max()), _EXTENT
    if not least <= size <= most:
        raise InputError(
            f"{where}: found a size of {size:.3g} in the file's units, allowed {least:g} to "
            f"{most:g}"
        )


def _require_closed(where: str, surface: "trimesh.Trimesh") -> None:
    """Raise InputError if a surface is not closed, not oriented or without volume."""
    if not len(surface.faces):
        raise InputError(f"{where}: all triangles are lines or points; export it again")
    if not surface.is_watertight:
        import trimesh

        open_edges = len(trimesh.grouping.group_rows(surface.edges_sorted, require_count=1))
        fault = f"{open_edges} open edges" if open_edges else "edges of more than two triangles"
        raise InputError(
            f"{where}: not watertight ({fault}); close it, for example "
            "with pytetwild or the repair tool of your mesh editor"
        )
    if not surface.is_winding_consistent:
        raise InputError(
            f"{where}: its triangles face both inwards and outwards; unify their normals with "
            "a mesh editor"
        )
    if not abs(surface.volume) > _LEAST_FILL * float(surface.extents.max()) ** 3:
        raise InputError(f"{where}: encloses no volume; give a body with an interior")


def _find(key: str, name: str) -> Path:
    path = mesh_path(name)
    if not is_regular(path):
        fault = "not a file" if path.exists() else "no such file"
        raise InputError(f"{key}: {name}: {fault}")
    if path.suffix.lower() not in _FILE_TYPES:
        remedy = "; export one of them" if path.suffix.lower() in _EXPORT_FROM else ""
        raise InputError(f"{key}: {name}: not a mesh, allowed: {', '.join(_FILE_TYPES)}{remedy}")
    return path
