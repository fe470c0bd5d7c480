"""Three-dimensional view of a scene in a report, which can be turned by dragging.

The page contains the data (surfaces over grids, lines) and a short script that draws them with the
WebGL of the browser. No further file is loaded.
"""

import base64
import json
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.optics.view import SceneDescription, SceneSurface, SceneView
from twin.report.page import Section, TurnableView
from twin.report.scene import DEVIATION, measured_scene
from twin.results.record import Measurement


def view_section(measured: Measurement) -> list[Section]:
    """Return the section with the 3-D view, in a list; empty if no pixel has a point."""
    if not measured.points.valid.any():
        return []
    scene = measured_scene(measured)
    enlarged = scene.views["relief"].enlarged
    scale = next(surface.scale for surface in scene.surfaces if surface.name == DEVIATION)
    limit_um = scale.get_clim()[1] if scale is not None else None
    heights = f"enlarged {enlarged:g} times in relief and deviation, and true in the rig"
    caption = (
        "Measured surface with the rig. Drag or use the arrow keys to turn, scroll to zoom. "
        f"Heights are {heights if enlarged != 1 else 'true'}. "
        f"Deviation: blue −{limit_um:g} µm, white 0, red {limit_um:g} µm."
    )
    view = TurnableView(
        "view3d", caption, _as_json(view_data(scene)), tuple(scene.views), scene.names
    )
    return [Section("in-space", "In three dimensions", (view,))]


def view_data(scene: SceneDescription) -> dict[str, Any]:
    """Return the input of the script: surfaces, lines, and direction and size of each view."""
    lines = [
        {"name": line.name, "rgb": line.rgb, "points": _as_text(line.ends_mm)}
        for line in scene.lines
    ]
    homes = {name: _home(view) for name, view in scene.views.items()}
    return {"grids": [_grid(surface) for surface in scene.surfaces], "lines": lines, "homes": homes}


def _grid(surface: SceneSurface) -> dict[str, Any]:
    """Return a surface over a regular grid: first x and y with their steps (mm), z and colours."""
    points_mm = surface.grid_mm
    rows, cols = points_mm.shape[:2]
    first, last = points_mm[0, 0, :2], points_mm[-1, -1, :2]
    (x, y), (dx, dy) = (
        first.tolist(),
        ((last - first) / np.maximum((cols - 1, rows - 1), 1)).tolist(),
    )
    return {
        "name": surface.name,
        "nx": cols,
        "ny": rows,
        "x": [x, dx],
        "y": [y, dy],
        "z": _as_text(points_mm[..., 2].astype("<f4")),
        "rgb": _as_text(np.rint(255 * surface.rgb).astype(np.uint8)),
    }


def _home(view: SceneView) -> dict[str, Any]:
    turn, lift = view.turn_and_lift_rad
    return {
        "middle": view.target_mm,
        "radius": view.width_mm / 2,
        "enlarged": view.enlarged,
        "turn": turn,
        "lift": lift,
        "shows": view.shows,
    }


def _as_text(values: NDArray[Any]) -> str:
    return base64.b64encode(np.ascontiguousarray(values).tobytes()).decode("ascii")


def _as_json(data: dict[str, Any]) -> str:
    # The data must not contain an end tag of the script element.
    return json.dumps(data, separators=(",", ":")).replace("<", "\\u003c")
