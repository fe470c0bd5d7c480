"""Commented starter templates: experiments and a study; each runs without changes."""

import difflib
import tomllib
from dataclasses import dataclass

from reconstruction.errors import InputError
from twin.assets import asset_path, list_assets

FOLDER = "templates/"
_FIRST = ("gel", "part", "sheet", "gelsight", "rig", "study")


@dataclass(frozen=True)
class StarterTemplate:
    """Starter template for a new experiment or study file: name and description."""

    name: str
    description: str


def templates() -> list[StarterTemplate]:
    """Return all starter templates; those of $TWIN_ASSETS are last."""
    names = _template_names()
    order = [*(name for name in _FIRST if name in names), *sorted(set(names) - set(_FIRST))]
    return [
        StarterTemplate(name, str(tomllib.loads(read_template(name)).get("description", "")))
        for name in order
    ]


def _template_names() -> list[str]:
    return [name.removeprefix(FOLDER) for name in list_assets("scenes") if name.startswith(FOLDER)]


def read_template(name: str) -> str:
    """Return the text of the starter template with a given name.

    Raises
    ------
    InputError : there is no such template
    """
    known = _template_names()
    if name not in known:
        close = difflib.get_close_matches(name, known, n=1)
        hint = f"; did you mean {close[0]}?" if close else ""
        raise InputError(f"--template {name}: allowed {', '.join(sorted(known))}{hint}")
    return asset_path("scenes", FOLDER + name).read_text(encoding="utf-8")
