"""Paths of the twin's data files: the TOML files and meshes of `scenes` and `materials`.

The two collections are folders of data files, not Python packages. A file is searched in this
order: in the folder named by the environment variable ``TWIN_ASSETS``, in the installed package,
in the checkout that contains the package. The first folder with the file is used. A user's folder
may therefore replace or add single files.
"""

from __future__ import annotations

import difflib
import os
import re
from collections.abc import Iterable
from importlib.resources import files
from pathlib import Path
from typing import Literal, get_args

from reconstruction.errors import InputError, require_instance
from reconstruction.reading import is_regular, shown

Collection = Literal["scenes", "materials"]
FOLDER_VARIABLE = "TWIN_ASSETS"


_LONGEST_NAME = 255


class AssetError(InputError):
    """Error of a data file that does not exist, or that has a forbidden name."""


def asset_path(collection: Collection, name: str) -> Path:
    """Return the path of one data file of a collection, searched by its name.

    Parameters
    ----------
    collection : {"scenes", "materials"}; kind of data
    name : name inside the collection, for example ``elastomers/silicone_c``; the suffix ``.toml``
        may be omitted. Or the path of a file, absolute or beginning with ``./``

    Returns
    -------
    An existing file

    Raises
    ------
    AssetError : if there is no such file; the message contains the most similar names
    """
    _check_name(collection, name)
    folders = [Path()] if _is_path(name) else asset_folders(collection)
    for folder in folders:
        path = _existing(folder / name)
        if path is not None:
            return path
    raise AssetError(_missing_words(collection, name))


def scene_file(name: str | Path) -> Path:
    """Return the path of a TOML file, given as a path or as the name of a shipped file in `scenes`.

    Raises
    ------
    InputError : `name` is neither a string nor a `Path`
    AssetError : there is neither a file at this path nor a shipped file of this name
    """
    require_instance("path", name, (str, Path), "give a TOML file, or the name of a shipped one")
    file = Path(name)
    return file if is_regular(file) else asset_path("scenes", str(name))


def mesh_path(name: str) -> Path:
    """Return the path of a mesh file that an experiment names.

    A name that starts with ``scenes/`` may be a shipped file. Any other name is returned as a path,
    even if there is no such file.

    Raises
    ------
    AssetError : the name starts with ``scenes/``, and there is no such file
    """
    path = Path(name)
    if not is_regular(path) and name.startswith("scenes/"):
        return asset_path("scenes", name.removeprefix("scenes/"))
    return path


def list_assets(collection: Collection) -> list[str]:
    """List the names of all TOML files of a collection, in the form that `asset_path` takes.

    Parameters
    ----------
    collection : {"scenes", "materials"}; kind of data

    Returns
    -------
    Sorted names without ``.toml``
    """
    return sorted(
        {
            path.relative_to(folder).as_posix().removesuffix(".toml")
            for folder in asset_folders(collection)
            for path in folder.rglob("*.toml")
        }
    )


def likely_material(word: str, table: str, tables: Iterable[str] = ()) -> str:
    """Return the name of the data file in `materials` that a word probably means; "" if none.

    The word is compared with the names of the files, then with the words of their first comment and
    description. For example "steel" in `specimen.material` gives "materials/metals/steel".

    Parameters
    ----------
    table : dotted path of the table that takes the material. If a folder of materials has the name
        of this table, as `coatings` of `coating`, only its files are compared
    tables : names of tables with a folder of their own, which no other table uses
    """
    by_folder = {name: _tables_of(name.partition("/")[0]) for name in list_assets("materials")}
    own = [name for name, of in by_folder.items() if of & {*table.split(".")}]
    shared = [name for name, of in by_folder.items() if not of & {*tables}]
    named = {Path(name).name: name for name in own or shared}
    plain = Path(word).name.removesuffix(".toml").strip().lower().replace(" ", "_")
    close = difflib.get_close_matches(plain, named, n=1, cutoff=0.7)
    mentioned = [name for name in named.values() if plain in _words_about(name)]
    likely = [named[name] for name in close] or mentioned
    return f"materials/{likely[0]}" if likely and plain else ""


def _tables_of(folder: str) -> set[str]:
    return {folder, folder.removesuffix("s")}


def _words_about(material: str) -> set[str]:
    """Return the words of a material's first comment and description, in lower case."""
    text = asset_path("materials", material).read_text(encoding="utf-8").lower()
    return set(re.findall(r"[a-z0-9]+", text.partition("\n\n")[0]))


def asset_folders(collection: Collection) -> list[Path]:
    """List the folders that may contain a collection, in the order of their precedence.

    Parameters
    ----------
    collection : {"scenes", "materials"}; kind of data

    Returns
    -------
    Existing folders

    Raises
    ------
    AssetError : there is no such collection
    """
    if collection not in get_args(Collection):
        raise AssetError(f"{collection}: no such collection, there are scenes and materials")
    package = Path(str(files("twin")))
    own = os.environ.get(FOLDER_VARIABLE)
    candidates = [Path(own).expanduser() / collection] if own else []
    candidates += [package / "_assets" / collection, package.parent / collection]
    return [folder for folder in candidates if folder.is_dir()]


def _is_path(name: str) -> bool:
    return name.startswith("./") or Path(name).is_absolute()


def _existing(path: Path) -> Path | None:
    """Return `path`, or `path` with ``.toml`` appended; None if neither file exists.

    The suffix is also appended to a name that contains a point, such as ``sheet_0.2``.
    """
    with_suffix = path.with_name(path.name + ".toml")
    spellings = (path, with_suffix) if path.suffix else (with_suffix,)
    return next((spelling for spelling in spellings if is_regular(spelling)), None)


def _check_name(collection: Collection, name: str) -> None:
    climbs = ".." in Path(name).parts and not Path(name).is_absolute()
    if climbs or not Path(name).name:
        raise AssetError(
            f"{name!r}: not a name in {collection}: give one without '..', or an absolute path"
        )


def _missing_words(collection: Collection, name: str) -> str:
    if _is_path(name) or len(name) > _LONGEST_NAME:
        return f"{shown(name)}: no such file"
    known = list_assets(collection)
    material = likely_material(name, "") if collection == "materials" else ""
    if material:
        return f"materials/{name}: not found; did you mean {material}?"
    stem = Path(name.removesuffix(".toml")).name
    same = [entry for entry in known if Path(entry).name == stem]
    own = [str(path) for path in Path(name).parent.glob("*.toml")]
    wanted = name.removesuffix(".toml")
    close = difflib.get_close_matches(wanted, [*known, *own], n=2, cutoff=0.5)
    nearest = difflib.get_close_matches(wanted, known, n=1, cutoff=0.0)
    likely = ", ".join(dict.fromkeys(same or close))
    advice = f"did you mean {likely}?" if likely else f"the nearest name is {', '.join(nearest)}"
    return f"{name}: not found, neither as a file nor in {collection}; {advice}"
