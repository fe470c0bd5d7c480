"""Commented files to begin with: experiments and a study, each of which works as it is."""

import difflib
import tomllib
from dataclasses import dataclass

from reconstruction.errors import InputError
from twin.assets import asset_path, list_assets

FOLDER = "templates/"
_FIRST = ("gel", "part", "sheet", "gelsight", "rig", "study")


@dataclass(frozen=True)
class StarterTemplate:
    """A file to begin with."""

    name: str
    description: str


def templates() -> list[StarterTemplate]:
    """Return what there is, the most usual first, own ones of $TWIN_ASSETS last."""
    found = [name.removeprefix(FOLDER) for name in list_assets("scenes") if name.startswith(FOLDER)]
    order = [*(name for name in _FIRST if name in found), *sorted(set(found) - set(_FIRST))]
    return [
        StarterTemplate(name, str(tomllib.loads(read_template(name)).get("description", "")))
        for name in order
    ]


def read_template(name: str) -> str:
    """Return the text of a template.

    Raises
    ------
    InputError : there is no such template
    """
    known = [one.removeprefix(FOLDER) for one in list_assets("scenes") if one.startswith(FOLDER)]
    if name not in known:
        close = difflib.get_close_matches(name, known, n=1)
        hint = f"; did you mean {close[0]}?" if close else ""
        raise InputError(f"--template {name}: allowed {', '.join(sorted(known))}{hint}")
    return asset_path("scenes", FOLDER + name).read_text(encoding="utf-8")
