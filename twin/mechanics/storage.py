"""Pressed elastomers as netCDF-4 files and their faces as PLY or STL meshes.

Files follow the CF conventions: every variable has `units` and `long_name`; arrays are (y, x).
A file is written under a temporary name and renamed: it is never half there.
"""

from collections.abc import Callable
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import h5netcdf
import numpy as np
import trimesh

from reconstruction.machine import writing_netcdf
from twin.config.models import Elastomer, Press
from twin.mechanics.errors import PressError
from twin.mechanics.press import PressedElastomer, SheetFields
from twin.mechanics.texture import in_plane_displacement
from twin.mechanics.validity import Validity
from twin.output import replacing

_SCHEMA = "fringe-twin press 1"
_FACE = ("face_y", "face_x")

# field: (dimensions, units, long name)
_VARIABLES: dict[str, tuple[tuple[str, ...], str, str]] = {
    "x_mm": (("x",), "mm", "world x of the solver cell centres"),
    "y_mm": (("y",), "mm", "world y of the solver cell centres"),
    "pressure_kpa": (("y", "x"), "kPa", "pressure on the touched face"),
    "contact": (("y", "x"), "1", "1 where the specimen touches"),
    "touched_face_mm": (("y", "x"), "mm", "world z of the touched face"),
    "face_x_mm": (("face_x",), "mm", "world x of the coated face's nodes"),
    "face_y_mm": (("face_y",), "mm", "world y of the coated face's nodes"),
    "face_z_mm": (_FACE, "mm", "world z of the coated face"),
    "force_n": ((), "N", "contact force"),
    "depth_mm": ((), "mm", "travel after first touch"),
    "young_modulus_kpa": ((), "kPa", "Young's modulus of the elastomer"),
    "iterations": ((), "1", "passes of the contact solver"),
    "converged": ((), "1", "1 when the contact solver converged"),
    "texture_mm": (_FACE, "mm", "what the coat's texture adds to face_z_mm"),
}
_OPTIONAL = {"texture_mm"}

# field of SheetFields: units, long name; stored where there are some, on the coated face's nodes
_SHEET_VARIABLES: dict[str, tuple[str, str]] = {
    "thickness_mm": ("mm", "local thickness, along the coated face's normal"),
    "stretch_1": ("1", "larger principal stretch"),
    "stretch_2": ("1", "smaller principal stretch"),
    "material_x_mm": ("mm", "x on the mounted sheet of what lies here"),
    "material_y_mm": ("mm", "y on the mounted sheet of what lies here"),
}


def write_press(path: Path, pressed: PressedElastomer) -> None:
    """Write a pressed elastomer as netCDF-4.

    Raises
    ------
    PressError : the file cannot be written
    """
    with replacing(path, PressError) as part, writing_netcdf(part) as file:
        _fill(file, pressed)


def read_press(path: Path) -> PressedElastomer:
    """Read what `write_press` wrote.

    Raises
    ------
    PressError : the file is missing, damaged or something else
    """
    try:
        with h5netcdf.File(path, "r") as file:
            if file.attrs.get("schema") != _SCHEMA:
                raise PressError(f"{path}: not a pressed elastomer (schema '{_SCHEMA}')")
            stored = [name for name in _VARIABLES if name in file or name not in _OPTIONAL]
            values = {name: file[name][...] for name in stored}
            validity, model = _read_validity(file), str(file.attrs["model"])
            sheet = _read_sheet(file)
    except PressError:
        raise
    except FileNotFoundError as error:
        raise PressError(f"{path}: no such file") from error
    except (OSError, KeyError) as error:
        raise PressError(f"{path}: damaged or not a netCDF-4 file; press again") from error
    return PressedElastomer(
        **{**_typed(values), "validity": validity, "model": model, "sheet": sheet}
    )


def write_in_plane(
    path: Path, pressed: PressedElastomer, elastomer: Elastomer, load: Press
) -> None:
    """Write the coated face's displacement in its own plane as netCDF-4, for texture only.

    Raises
    ------
    PressError : the press is not of the spectral model, or the file cannot be written
    """
    if pressed.model != "spectral":
        raise PressError(f"in-plane displacement: the model is {pressed.model}, allowed: spectral")
    moved = in_plane_displacement(pressed, elastomer, load)

    with replacing(path, PressError) as part, writing_netcdf(part) as file:
        file.attrs["comment"] = "moves texture and markers; the relief's nodes stay where they are"
        file.dimensions = {"face_y": pressed.face_y_mm.size, "face_x": pressed.face_x_mm.size}
        for axis, data in zip("xy", moved, strict=True):
            told = f"displacement of the coat along world {axis}"
            _write(file, f"u_{axis}_mm", _FACE, data, ("mm", told))


def write_mesh(path: Path, mesh: trimesh.Trimesh) -> None:
    """Write a mesh as binary PLY with its vertex normals, or as binary STL, by the file's name.

    Raises
    ------
    PressError : the file is to be neither, or cannot be written
    """
    kind = path.suffix.lower()
    if kind not in (".ply", ".stl"):
        raise PressError(f"{path}: found '{path.suffix}', allowed for a mesh: .ply, .stl")
    options = {"vertex_normal": True} if kind == ".ply" else {}
    content: bytes = mesh.export(file_type=kind[1:], **options)
    with replacing(path, PressError) as part:
        part.write_bytes(content)


def _fill(file: Any, pressed: PressedElastomer) -> None:
    file.attrs["Conventions"] = "CF-1.11"
    file.attrs["schema"] = _SCHEMA
    file.attrs["model"] = pressed.model
    file.dimensions = {
        "x": pressed.x_mm.size,
        "y": pressed.y_mm.size,
        "face_x": pressed.face_x_mm.size,
        "face_y": pressed.face_y_mm.size,
    }
    for name, (dimensions, units, long_name) in _VARIABLES.items():
        if name in _OPTIONAL and getattr(pressed, name) is None:
            continue
        data = np.asarray(getattr(pressed, name))
        stored = data.astype(np.int8) if data.dtype == bool else data
        _write(file, name, dimensions, stored, (units, long_name))
    for name, data in _sheet_arrays(pressed.sheet).items():
        _write(file, f"sheet_{name}", _FACE, data, _SHEET_VARIABLES[name])
    file.create_group("validity").attrs.update(
        {**asdict(pressed.validity), "warnings": "\n".join(pressed.validity.warnings)}
    )


def _write(
    file: Any, name: str, dimensions: tuple[str, ...], data: Any, told: tuple[str, str]
) -> None:
    """Write a variable with its units and long name, maps compressed."""
    packing = {"compression": "gzip", "compression_opts": 1} if data.ndim == 2 else {}
    variable = file.create_variable(name, dimensions, data.dtype, data=data, **packing)
    variable.attrs["units"], variable.attrs["long_name"] = told


def _sheet_arrays(sheet: SheetFields | None) -> dict[str, Any]:
    if sheet is None:
        return {}
    larger, smaller = np.moveaxis(sheet.stretch, -1, 0)
    places = (sheet.material_x_mm, sheet.material_y_mm)
    return dict(zip(_SHEET_VARIABLES, (sheet.thickness_mm, larger, smaller, *places), strict=True))


def _read_sheet(file: Any) -> SheetFields | None:
    if "sheet_thickness_mm" not in file.variables:
        return None
    thickness, *stretch, x, y = (file[f"sheet_{name}"][...] for name in _SHEET_VARIABLES)
    return SheetFields(thickness, np.stack(stretch, axis=-1), x, y)


def _read_validity(file: Any) -> Validity:
    attributes = dict(file["validity"].attrs)
    warnings = tuple(str(attributes.pop("warnings")).splitlines())
    figures = {f.name: float(attributes[f.name]) for f in fields(Validity) if f.name != "warnings"}
    return Validity(warnings=warnings, **figures)


def _typed(values: dict[str, Any]) -> dict[str, Any]:
    kinds: dict[str, Callable[[Any], Any]] = {
        "contact": lambda data: data.astype(bool),
        "iterations": int,
        "converged": bool,
    }
    scalar = {name for name, (dimensions, _, _) in _VARIABLES.items() if not dimensions}
    return {
        name: kinds.get(name, float if name in scalar else np.asarray)(data)
        for name, data in values.items()
    }
