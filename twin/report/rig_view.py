"""Side view of the rig: camera, projector, their fields of view, elastomer and specimen.

It is projected onto the vertical plane through camera and projector. Its horizontal coordinate s,
mm, is 0 at the world origin.
"""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Circle, Polygon
from scipy.spatial import ConvexHull

from reconstruction.arrays import FloatArray
from reconstruction.rig.pinhole import Pinhole
from twin.config.models import Experiment
from twin.optics.rig import true_calibration
from twin.report.canvas import FIT, INK, MEASURED, NOMINAL, axes_at, chart, drawing
from twin.report.page import Figure
from twin.results.record import Measurement
from twin.specimens import shape_of


# Shortest duration that is written in seconds.
def rig_figure(measured: Measurement) -> Figure:
    """Return the figure with the side view of the rig."""
    return Figure(
        "rig",
        "Side view of the rig",
        "Camera, projector and their fields of view, projected onto the vertical plane through "
        "both devices; lengths in mm, to scale. The elastomer should be inside both fields.",
        "side view of camera, projector and elastomer",
        lambda path: draw_rig(path, measured.experiment),
    )


def draw_rig(path: Path, experiment: Experiment) -> None:
    """Draw the side view of the rig as PNG."""
    rig = true_calibration(experiment)
    camera, projector = rig.T_world_from_cam[:3, 3], rig.T_world_from_proj[:3, 3]
    across = _horizontal(projector - camera)
    with drawing(path, 5.0, 4.8) as figure:
        axes = axes_at(figure, 0.6, 0.35, 4.1, 3.9)
        for name, device, pose, colour in (
            ("camera", rig.camera, rig.T_world_from_cam, MEASURED),
            ("projector", rig.projector, rig.T_world_from_proj, FIT),
        ):
            _fan(axes, device, pose, across, colour)
            _device(axes, name, pose[:3, 3], across, colour)
        _slab_and_specimen(axes, experiment, across)
        angle_deg = rig.triangulation_angle_deg
        chart(
            axes,
            f"Side view to scale; {angle_deg:.1f}° between the devices",
            "along the baseline (mm)",
            "z (mm)",
            aspect="equal",
        )
        axes.margins(x=0.09, y=0.16)


def _horizontal(baseline_mm: FloatArray) -> FloatArray:
    length = float(np.hypot(*baseline_mm[:2]))
    return np.array([*baseline_mm[:2] / length, 0.0]) if length > 1e-9 else np.array([1.0, 0, 0])


def _flat(points_world_mm: FloatArray, across: FloatArray) -> FloatArray:
    """Return the coordinates (n, 2) in the side view, s and z, of world points (n, xyz), mm."""
    return np.stack([points_world_mm @ across, points_world_mm[:, 2]], axis=1)


def _fan(axes: Axes, device: Pinhole, pose: FloatArray, across: FloatArray, colour: str) -> None:
    """Draw a device's field of view as an area from its pinhole to the undeformed face z = 0."""
    rays = np.column_stack([device.seen_corners(), np.ones(4)]) @ pose[:3, :3].T
    # A grazing ray intersects the plane far away; the drawing ends at 2 x the standoff.
    reach = np.where(rays[:, 2] < 0, pose[2, 3] / np.maximum(-rays[:, 2], 1e-9), np.inf)
    reach = np.minimum(reach, 2 * float(np.linalg.norm(pose[:3, 3])))
    ends = pose[:3, 3] + reach[:, None] * rays
    outline = _flat(np.vstack([pose[:3, 3], ends]), across)
    hull: Any = ConvexHull(outline)
    axes.add_patch(Polygon(outline[hull.vertices], facecolor=colour, alpha=0.13, edgecolor="none"))
    centre = _flat(np.stack([pose[:3, 3], np.zeros(3)]), across)
    axes.plot(centre[:, 0], centre[:, 1], color=colour, lw=0.9, ls="--")


def _device(axes: Axes, name: str, centre_mm: FloatArray, across: FloatArray, colour: str) -> None:
    s, z = _flat(centre_mm[None], across)[0]
    axes.plot([s], [z], marker="s", ms=9, color=colour)
    axes.annotate(
        f"{name}\ndistance {np.linalg.norm(centre_mm):.0f} mm",
        (s, z),
        xytext=(0, 9),
        textcoords="offset points",
        ha="center",
        va="bottom",
        color=colour,
    )


def _slab_and_specimen(axes: Axes, experiment: Experiment, across: FloatArray) -> None:
    slab = experiment.elastomer
    half = (abs(across[0]) * slab.length_x_mm + abs(across[1]) * slab.length_y_mm) / 2
    corners = [(-half, -slab.thickness_mm), (half, -slab.thickness_mm), (half, 0), (-half, 0)]
    axes.add_patch(Polygon(corners, facecolor="#9cc4de", edgecolor=INK, lw=0.7))
    for ball in shape_of(experiment.specimen).spheres():
        s, z = _flat(np.array([[ball.x_mm, ball.y_mm, ball.z_mm]]), across)[0]
        centre = (s, z - slab.thickness_mm)
        axes.add_patch(Circle(centre, ball.radius_mm, facecolor="#d9cdb8", edgecolor=NOMINAL))
    axes.annotate(
        "elastomer over specimen",
        (half, -slab.thickness_mm / 2),
        xytext=(8, -4),
        textcoords="offset points",
        va="top",
    )
