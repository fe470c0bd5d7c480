"""Pictures of the best designs of a study: camera image, heights and errors, on one scale each."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize

from twin.report.camera_view import NO_POINT
from twin.report.canvas import (
    add_colorbar,
    axes_at,
    diverging,
    drawing,
    height_scale,
    round_up,
    sequential,
    symmetric_limit,
)
from twin.report.html import Plate
from twin.report.relief import shaded
from twin.report.world_map import WorldMap
from twin.study.pictures import CasePicture

MOST_DESIGNS = 6
_WIDTH_IN, _SIDE_IN, _BAR_IN, _RELIEF_SHARE = 3.0, 0.02, 0.95, 0.2

Row = Mapping[str, Any]


@dataclass(frozen=True)
class Scales:
    """What all designs of a page share.

    Attributes
    ----------
    z_mm : round ends of the true heights of all
    error_um : round limit that 99 % of all errors stay below
    enlarged : by how much shading enlarges z
    """

    z_mm: tuple[float, float]
    error_um: float
    enlarged: float

    @classmethod
    def of(cls, pictures: Iterable[CasePicture]) -> "Scales":
        """Return scales that hold for all pictures, of which there is at least one."""
        found = list(pictures)
        z_mm = height_scale(np.concatenate([picture.true_z_mm for picture in found]))
        errors_um = np.concatenate([picture.error_um[picture.scored] for picture in found])
        width_mm = max(float(picture.width_mm) for picture in found)
        enlarged = max(1.0, round_up(_RELIEF_SHARE * width_mm / (z_mm[1] - z_mm[0])))
        return cls(z_mm, symmetric_limit(errors_um), enlarged)


def designs_of(rows: Sequence[Row], axes: Sequence[str]) -> list[Row]:
    """Return the first rows of different designs, as many as the page shows in pictures."""
    found: dict[str, Row] = {}
    for row in rows:
        found.setdefault(repr([row[axis] for axis in axes if axis != "seed"]), row)
    return list(found.values())[:MOST_DESIGNS]


def design_plates(number: int, name: str, picture: CasePicture, scales: Scales) -> list[Plate]:
    """Return the three pictures of one design; `name` says which it is."""
    colours = picture.seen.ndim == 3
    seen = "the sensor's image" if colours else "fringes: black is 0, white is saturation"
    shown = (
        ("seen", seen, partial(_show_seen, picture=picture)),
        ("heights", "measured heights, white: no point",
         partial(_show_heights, picture=picture, scales=scales)),
        ("error", "error against the true surface, gray: no point",
         partial(_show_error, picture=picture, scales=scales)),
    )  # fmt: skip
    return [
        Plate(
            f"design_{number}_{kind}",
            partial(_draw, picture=picture, show=show, bar=kind != "seen"),
            f"{name}: {caption}",
            caption,
        )
        for kind, caption, show in shown
    ]


def _draw(path: Path, picture: CasePicture, show: Any, bar: bool) -> None:
    rows, cols = picture.measured.shape
    inside_in = _WIDTH_IN - 2 * _SIDE_IN
    height_in = inside_in * rows / cols
    below_in = _BAR_IN if bar else _SIDE_IN
    with drawing(path, _WIDTH_IN, _SIDE_IN + height_in + below_in) as figure:
        axes = axes_at(figure, _SIDE_IN, _SIDE_IN, inside_in, height_in)
        show(axes)
        axes.set(xticks=[], yticks=[])


def _show_seen(axes: Axes, picture: CasePicture) -> None:
    axes.imshow(picture.seen, cmap="gray", vmin=0, vmax=255)


def _show_heights(axes: Axes, picture: CasePicture, scales: Scales) -> None:
    norm = Normalize(*scales.z_mm)
    z_mm = np.ma.masked_array(picture.z_mm.astype(np.float64), ~picture.measured)
    rows, cols = z_mm.shape
    if z_mm.count():
        pitch_mm = float(picture.width_mm) / cols
        x_mm, y_mm = pitch_mm * np.arange(cols), pitch_mm * np.arange(rows)
        relief = WorldMap(z_mm[::-1], x_mm, y_mm, pitch_mm)  # whose rows grow upwards
        axes.imshow(shaded(relief, norm, scales.enlarged)[::-1])
    else:
        axes.imshow(np.ones((rows, cols, 3)))
    add_colorbar(axes, ScalarMappable(norm, sequential()), "z (mm)", extend="both", side="below")


def _show_error(axes: Axes, picture: CasePicture, scales: Scales) -> None:
    error_um = np.ma.masked_array(picture.error_um, ~picture.scored)
    colours, limit_um = diverging().with_extremes(bad=NO_POINT), scales.error_um
    shown = axes.imshow(error_um, cmap=colours, vmin=-limit_um, vmax=limit_um)
    add_colorbar(axes, shown, "z error (µm)", extend="both", side="below")


@dataclass(frozen=True)
class Design:
    """One of the best designs, as the page shows it; `names` are those of its pictures."""

    number: int
    digest: str
    settings: list[tuple[str, str]]
    figures: list[tuple[str, str]]
    names: list[str]
    failure: str
