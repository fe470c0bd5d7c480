"""Pressed elastomers as netCDF-4 files and their faces as PLY or STL meshes.

Files follow the CF conventions: every variable has `units` and `long_name`; arrays are (y, x).
A file is written under a temporary name and renamed: it is never half there.
"""

from collections.abc import Callable, Mapping
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from reconstruction.netcdf import Labelled, LabelledArrays, read_arrays, write_arrays
from reconstruction.writing import write_bytes
from twin.config.models import Elastomer, Press
from twin.files import naming_unwritable
from twin.mechanics.errors import PressError
from twin.mechanics.models import model_of
from twin.mechanics.press import PressedElastomer, SheetFields
from twin.mechanics.texture import in_plane_displacement
from twin.mechanics.validity import Validity

_SCHEMA = "fringe-twin press 3"
_PLAIN = "fringe-twin press 2"
"""Files of this schema and the first have no coordinates: x is the variable x_mm, and so on."""
_GROUPED = "fringe-twin press 1"
"""Files of this schema keep the figures of `Validity` in a group of that name."""
_AXES = ("x_mm", "y_mm", "face_x_mm", "face_y_mm")
_VALIDITY = "validity_"
_FACE = ("face_y", "face_x")

# field: (dimensions, units, long name)
_VARIABLES: dict[str, tuple[tuple[str, ...], str, str]] = {
    "x_mm": (("x",), "mm", "world x of the solver cell centres"),
    "y_mm": (("y",), "mm", "world y of the solver cell centres"),
    "pressure_kpa": (("y", "x"), "kPa", "pressure on the touched face: force over area in plan"),
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
    PressError
        The file cannot be written.
    """
    arrays = press_arrays(pressed)
    with naming_unwritable(path, PressError):
        write_arrays(path, arrays)


def press_arrays(pressed: PressedElastomer) -> LabelledArrays:
    """Return all fields over their coordinates x, y (solver cells) and face_x, face_y (nodes), mm.

    Figures of `Validity` are attributes.
    """
    variables = {
        name: _labelled(np.asarray(getattr(pressed, name)), *told)
        for name, told in _VARIABLES.items()
        if name not in _OPTIONAL or getattr(pressed, name) is not None
    }
    for name, data in _sheet_arrays(pressed.sheet).items():
        variables[f"sheet_{name}"] = _labelled(data, _FACE, *_SHEET_VARIABLES[name])
    axes = {name.removesuffix("_mm"): variables.pop(name) for name in _AXES}
    validity = asdict(pressed.validity) | {"warnings": "\n".join(pressed.validity.warnings)}
    told = {_VALIDITY + name: value for name, value in validity.items()}
    attributes = {"Conventions": "CF-1.11", "schema": _SCHEMA, "model": pressed.model}
    return LabelledArrays(variables, axes, attributes | told)


def read_press(path: Path) -> PressedElastomer:
    """Read what `write_press` wrote.

    Raises
    ------
    PressError
        The file is missing, damaged or something else.
    """
    try:
        file = read_arrays(path)
        schema = file.attrs.get("schema")
        if schema not in (_SCHEMA, _PLAIN, _GROUPED):
            raise PressError(f"{path}: not a pressed elastomer (schema '{_SCHEMA}')")
        axes = {name: name.removesuffix("_mm") for name in _AXES if name not in file}
        stored = [name for name in _VARIABLES if name in file or name not in _OPTIONAL]
        values = {name: file[axes.get(name, name)] for name in stored}
        grouped = read_arrays(path, "validity").attrs if schema == _GROUPED else {}
        told = {_VALIDITY + name: one for name, one in grouped.items()}
        validity = _validity({**file.attrs, **told})
        model, sheet = str(file.attrs["model"]), _sheet(file)
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
    PressError
        The press is not of the spectral model, or the file cannot be written.
    """
    if not model_of(pressed.model).is_linear_slab:
        raise PressError(f"in-plane displacement: the model is {pressed.model}, allowed: spectral")
    moved = in_plane_displacement(pressed, elastomer, load)

    told = {"comment": "moves texture and markers; the relief's nodes stay where they are"}
    maps = {
        f"u_{axis}_mm": _labelled(data, _FACE, "mm", f"displacement of the coat along world {axis}")
        for axis, data in zip("xy", moved, strict=True)
    }
    _write(path, maps, told)


def write_mesh(path: Path, mesh: trimesh.Trimesh) -> None:
    """Write a mesh as binary PLY with its vertex normals, or as binary STL, by the file's name.

    Raises
    ------
    PressError
        The file is to be neither, or cannot be written.
    """
    kind = path.suffix.lower()
    if kind not in (".ply", ".stl"):
        raise PressError(f"{path}: found '{path.suffix}', allowed for a mesh: .ply, .stl")
    options = {"vertex_normal": True} if kind == ".ply" else {}
    content: bytes = mesh.export(file_type=kind[1:], **options)
    with naming_unwritable(path, PressError):
        write_bytes(path, content)


def _labelled(
    data: NDArray[Any], dimensions: tuple[str, ...], units: str, long_name: str
) -> Labelled:
    stored = data.astype(np.int8) if data.dtype == bool else data
    return dimensions, stored, {"units": units, "long_name": long_name}


def _write(path: Path, variables: Mapping[str, Labelled], told: Mapping[str, Any]) -> None:
    arrays = LabelledArrays(variables, attrs={"Conventions": "CF-1.11", **told})
    with naming_unwritable(path, PressError):
        write_arrays(path, arrays)


def _sheet_arrays(sheet: SheetFields | None) -> dict[str, Any]:
    if sheet is None:
        return {}
    return {
        "thickness_mm": sheet.thickness_mm,
        "stretch_1": sheet.stretch[..., 0],
        "stretch_2": sheet.stretch[..., 1],
        "material_x_mm": sheet.material_x_mm,
        "material_y_mm": sheet.material_y_mm,
    }


def _sheet(file: LabelledArrays) -> SheetFields | None:
    if "sheet_thickness_mm" not in file:
        return None
    maps = {name: file[f"sheet_{name}"] for name in _SHEET_VARIABLES}
    stretch = np.stack((maps.pop("stretch_1"), maps.pop("stretch_2")), axis=-1)
    return SheetFields(stretch=stretch, **maps)


def _validity(told: Mapping[str, Any]) -> Validity:
    figures = {f.name: float(told[_VALIDITY + f.name]) for f in fields(Validity)[:-1]}
    return Validity(**figures, warnings=tuple(str(told[f"{_VALIDITY}warnings"]).splitlines()))


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
