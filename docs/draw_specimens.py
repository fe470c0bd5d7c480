"""Draw docs/specimens.png: every kind of specimen, seen obliquely and lit from the side.

.venv/bin/python docs/draw_specimens.py
"""

import sys
from pathlib import Path

import numpy as np
import trimesh
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from twin.config.specimen_base import Specimen
from twin.specimens import shape_of
from twin.specimens.kinds.ball import Ball
from twin.specimens.kinds.bar import Bar
from twin.specimens.kinds.bars import Bars
from twin.specimens.kinds.bear import Bear
from twin.specimens.kinds.brick import Brick
from twin.specimens.kinds.fingerprint import Fingerprint
from twin.specimens.kinds.flat import Flat
from twin.specimens.kinds.grating import Grating
from twin.specimens.kinds.group import Group
from twin.specimens.kinds.nut import Nut
from twin.specimens.kinds.random_group import RandomGroup
from twin.specimens.kinds.random_relief import RandomRelief
from twin.specimens.kinds.rod import Rod
from twin.specimens.kinds.rods import Rods
from twin.specimens.kinds.step import Step
from twin.specimens.kinds.t_bolt import TBolt
from twin.specimens.kinds.two_balls import TwoBalls
from twin.specimens.kinds.v_groove import VGroove
from twin.specimens.meshes import upper_side

PICTURE = Path(__file__).with_name("specimens.png")
SPECIMENS: list[tuple[str, Specimen, bool]] = [
    ("ball", Ball(), False),
    ("two_balls", TwoBalls(), False),
    ("rod", Rod(), False),
    ("flat", Flat(), False),
    ("nut", Nut(), False),
    ("t_bolt", TBolt(yaw_deg=20), False),
    ("brick", Brick(yaw_deg=20), False),
    ("brick from below", Brick(yaw_deg=20), True),
    ("bear", Bear(), False),
    ("rods", Rods(), False),
    ("bar", Bar(yaw_deg=30), False),
    ("bars", Bars(), False),
    ("fingerprint", Fingerprint(), False),
    ("step", Step(height_mm=1.5, yaw_deg=30), False),
    ("v_groove", VGroove(depth_mm=2.0, yaw_deg=30), False),
    ("grating", Grating(groove_mm=0.8, yaw_deg=30), False),
    ("random_relief", RandomRelief(rms_um=400.0, longest_mm=8.0), False),
    ("random_group", RandomGroup(count=9), False),
    ("group", Group(parts={"nut": Nut(x_mm=-6.0), "ball": Ball(x_mm=6.0)}), False),
]
TILT_DEG = 40.0
LIGHT = np.array([-0.5, 0.45, 0.74]) / np.linalg.norm([-0.5, 0.45, 0.74])
STEP_MM = 0.04


def main() -> None:
    """Shade every specimen from its height map along the view."""
    columns = 5
    rows = -(-len(SPECIMENS) // columns)
    figure = Figure(figsize=(2.6 * columns, 2.6 * rows), facecolor="white", layout="constrained")
    panels = figure.subplots(rows, columns).ravel()
    for axes, (name, specimen, below) in zip(panels, SPECIMENS, strict=False):
        shade(axes, oblique(shape_of(specimen).mesh(0.0), below))
        axes.set_title(name, fontsize=11)
    for axes in panels:
        axes.set_axis_off()
    figure.savefig(PICTURE, dpi=80, metadata={"Software": None})
    sys.stdout.write(f"wrote {PICTURE}\n")


def oblique(mesh: trimesh.Trimesh, below: bool) -> trimesh.Trimesh:
    """Tilt a specimen's far side up, so that its top and its front are seen from above."""
    turn_deg = 180.0 + TILT_DEG if below else -TILT_DEG
    mesh.apply_translation(-mesh.bounds.mean(axis=0))
    mesh.apply_transform(trimesh.transformations.rotation_matrix(np.deg2rad(turn_deg), (1, 0, 0)))
    return mesh


def shade(axes: Axes, mesh: trimesh.Trimesh) -> None:
    """Draw one body with Lambert's law, 26 mm across, y up."""
    grid = np.arange(-13.0, 13.0, STEP_MM)
    z = upper_side(np.asarray(mesh.triangles), grid, grid)
    solid = np.isfinite(z)
    slope_y, slope_x = np.gradient(np.where(solid, z, np.nan), STEP_MM)
    normal = np.stack((-slope_x, -slope_y, np.ones_like(z)), axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    light = 0.25 + 0.75 * np.clip(normal @ LIGHT, 0, 1)
    axes.imshow(np.where(solid, light, 1.05), cmap="gray", vmin=0, vmax=1.05, origin="lower")


if __name__ == "__main__":
    main()
