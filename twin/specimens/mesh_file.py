"""Closed triangle meshes from files, for specimens and for pads."""

from pathlib import Path

import trimesh

from reconstruction.errors import InputError
from twin.assets import asset_path

_FILE_TYPES = (".stl", ".ply", ".obj")


def read_closed_mesh(key: str, name: str) -> trimesh.Trimesh:
    """Read a closed surface.

    Parameters
    ----------
    key : str
        Key of the experiment file that names it, for messages.
    name : str
        Path of an STL, PLY or OBJ file; `scenes/...` finds shipped ones too.

    Raises
    ------
    InputError
        The file is missing, no mesh, empty or not watertight.
    """
    path = _find(key, name)
    try:
        surface = trimesh.load_mesh(path)
    except Exception as error:  # each of trimesh's readers raises its own
        raise InputError(f"{key}: {path}: cannot be read ({error})") from error
    if not isinstance(surface, trimesh.Trimesh) or surface.is_empty:
        raise InputError(f"{key}: {path}: holds no triangles")
    if not surface.is_watertight:
        edges = len(trimesh.grouping.group_rows(surface.edges_sorted, require_count=1))
        raise InputError(
            f"{key}: {path}: not watertight ({edges} open edges); close it, for example "
            "with pytetwild or the repair tool of your mesh editor"
        )
    return surface


def _find(key: str, name: str) -> Path:
    path = Path(name)
    if not path.is_file() and name.startswith("scenes/"):
        path = asset_path("scenes", name.removeprefix("scenes/"))
    if not path.is_file():
        raise InputError(f"{key}: {name}: no such file")
    if path.suffix.lower() not in _FILE_TYPES:
        raise InputError(f"{key}: {name}: not a mesh, allowed: {', '.join(_FILE_TYPES)}")
    return path
