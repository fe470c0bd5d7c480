"""Write and read pressed elastomers as netCDF-4 files; write their faces as PLY or STL meshes.

Files follow the CF conventions: every variable has `units` and `long_name`; arrays are (y, x).
A file is written under a temporary name and renamed, so that it is never incomplete.
"""

from collections.abc import Callable, Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from reconstruction.netcdf import Labelled, LabelledArrays, read_arrays, write_arrays
from reconstruction.writing import write_bytes
from twin.config.models import Elastomer, Press
from twin.files import naming_unwritable
from twin.mechanics.arrays import (
    AXES,
    FACE,
    OPTIONAL,
    SCHEMA,
    SHEAR_VARIABLES,
    SHEET_VARIABLES,
    VALIDITY,
    VARIABLES,
    labelled,
    press_arrays,
)
from twin.mechanics.errors import PressError
from twin.mechanics.models import model_of
from twin.mechanics.press import PressedElastomer, ShearFields, SheetFields
from twin.mechanics.texture import in_plane_displacement
from twin.mechanics.validity import Validity

_PLAIN = "fringe-twin press 2"
"""Second schema. In files of the first two schemas x and y are variables x_mm and y_mm, not
coordinates; the same applies to face_x and face_y."""
_GROUPED = "fringe-twin press 1"
"""First schema. Its files store the figures of `Validity` in a netCDF group `validity`."""


def write_press(path: Path, pressed: PressedElastomer) -> None:
    """Write a pressed elastomer as netCDF-4.

    Raises
    ------
    PressError
        The file cannot be written.
    """
    arrays = press_arrays(pressed)
    with naming_unwritable(path, PressError):
        write_arrays(path, arrays)


def read_press(path: Path) -> PressedElastomer:
    """Read a pressed elastomer from a file that `write_press` wrote.

    Raises
    ------
    PressError
        The file is missing, damaged or of another kind.
    """
    try:
        file = read_arrays(path)
        schema = file.attrs.get("schema")
        if schema not in (SCHEMA, _PLAIN, _GROUPED):
            raise PressError(f"{path}: not a pressed elastomer (schema '{SCHEMA}')")
        axes = {name: name.removesuffix("_mm") for name in AXES if name not in file}
        stored = [name for name in VARIABLES if name in file or name not in OPTIONAL]
        values = {name: file[axes.get(name, name)] for name in stored}
        grouped = read_arrays(path, "validity").attrs if schema == _GROUPED else {}
        figures = {VALIDITY + name: value for name, value in grouped.items()}
        validity = _validity({**file.attrs, **figures})
        model, sheet, shear = str(file.attrs["model"]), _sheet(file), _shear(file)
    except PressError:
        raise
    except FileNotFoundError as error:
        raise PressError(f"{path}: no such file") from error
    except (OSError, KeyError) as error:
        raise PressError(f"{path}: damaged or not a netCDF-4 file; press again") from error
    return PressedElastomer(
        **{**_typed(values), "validity": validity, "model": model, "sheet": sheet, "shear": shear}
    )


def write_in_plane(
    path: Path, pressed: PressedElastomer, elastomer: Elastomer, load: Press
) -> None:
    """Write the coated face's displacements u_x and u_y in its plane as netCDF-4, mm.

    They displace texture and markers; the nodes of the relief do not move.

    Raises
    ------
    PressError
        The press is not of the spectral model, or the file cannot be written.
    """
    if not model_of(pressed.model).is_linear_slab:
        raise PressError(f"in-plane displacement: the model is {pressed.model}, allowed: spectral")
    moved = in_plane_displacement(pressed, elastomer, load)

    comment = {"comment": "moves texture and markers; the relief's nodes stay where they are"}
    maps = {
        f"u_{axis}_mm": labelled(data, FACE, "mm", f"displacement of the coat along world {axis}")
        for axis, data in zip("xy", moved, strict=True)
    }
    _write(path, maps, comment)


def write_mesh(path: Path, mesh: trimesh.Trimesh) -> None:
    """Write a mesh as binary PLY with vertex normals, or as binary STL: the suffix decides.

    Raises
    ------
    PressError
        The suffix is not .ply or .stl, or the file cannot be written.
    """
    kind = path.suffix.lower()
    if kind not in (".ply", ".stl"):
        raise PressError(f"{path}: found '{path.suffix}', allowed for a mesh: .ply, .stl")
    options = {"vertex_normal": True} if kind == ".ply" else {}
    content: bytes = mesh.export(file_type=kind[1:], **options)
    with naming_unwritable(path, PressError):
        write_bytes(path, content)


def _write(path: Path, variables: Mapping[str, Labelled], attributes: Mapping[str, Any]) -> None:
    arrays = LabelledArrays(variables, attrs={"Conventions": "CF-1.11", **attributes})
    with naming_unwritable(path, PressError):
        write_arrays(path, arrays)


def _sheet(file: LabelledArrays) -> SheetFields | None:
    if "sheet_thickness_mm" not in file:
        return None
    maps = {name: file[f"sheet_{name}"] for name in SHEET_VARIABLES}
    stretch = np.stack((maps.pop("stretch_1"), maps.pop("stretch_2")), axis=-1)
    return SheetFields(stretch=stretch, **maps)


def _shear(file: LabelledArrays) -> ShearFields | None:
    if "shear_sticking" not in file:
        return None
    read: dict[str, Any] = {name: file[f"shear_{name}"] for name in SHEAR_VARIABLES}
    read |= {name: float(read[name]) for name in ("force_x_n", "force_y_n")}
    return ShearFields(**read | {"sticking": read["sticking"].astype(bool)})


def _validity(attributes: Mapping[str, Any]) -> Validity:
    figures = {f.name: float(attributes[VALIDITY + f.name]) for f in fields(Validity)[:-1]}
    return Validity(**figures, warnings=tuple(str(attributes[f"{VALIDITY}warnings"]).splitlines()))


def _typed(values: dict[str, Any]) -> dict[str, Any]:
    kinds: dict[str, Callable[[Any], Any]] = {
        "contact": lambda data: data.astype(bool),
        "iterations": int,
        "converged": bool,
    }
    scalar = {name for name, (dimensions, _, _) in VARIABLES.items() if not dimensions}
    return {
        name: kinds.get(name, float if name in scalar else np.asarray)(data)
        for name, data in values.items()
    }
