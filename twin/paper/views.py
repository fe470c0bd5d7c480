"""The set-up and its principle, drawn from the experiment: rendered views with labels over them."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Polygon
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from reconstruction.rig.pinhole import Pinhole
from twin.config import Experiment
from twin.mechanics import PressedElastomer
from twin.optics.rig import true_calibration
from twin.optics.view import ViewCamera, picture
from twin.paper.concept import draw_principle
from twin.paper.sheet import bare, label_panel, sheet
from twin.paper.view_things import (
    device_things,
    frame_things,
    holder_things,
    sheet_things,
    specimen_things,
)
from twin.report.canvas import FIT, INK, MEASURED, axes_at
from twin.report.rig import triangulation_angle_deg
from twin.report.section import trace_through_apexes

_SAMPLES, _BOUNCES = 12, 3
_RIG = ViewCamera((-420.0, -1150.0, 520.0), (35.0, 0.0, 108.0), 412.0, 520, 640)
_SHEET = ViewCamera((-26.0, -80.0, 62.0), (0.0, 0.0, -2.0), 56.0, 560, 420)
_CUT = ViewCamera((-14.0, -95.0, 30.0), (0.0, 0.0, -5.5), 42.0, 640, 400)


def draw_setup(stem: Path, experiment: Experiment, pressed: PressedElastomer) -> None:
    """Draw the whole rig, and the pressed sheet in its frame, as `stem`.png and .pdf.

    Raises
    ------
    InputError
        The files cannot be written.
    MissingBackend
        No usable Dr.Jit backend.
    """
    near = [*sheet_things(experiment, pressed), *specimen_things(experiment, pressed)]
    near += holder_things(experiment)
    rig = [*near, *frame_things(experiment, pressed), *device_things(experiment)]
    with sheet(stem, 7.16, 4.1) as figure:
        left, right = axes_at(figure, 0.03, 0.05, 3.25, 4.0), axes_at(figure, 3.4, 0.7, 3.7, 2.78)
        left.imshow(picture(rig, _RIG, _SAMPLES, bounces=_BOUNCES))
        right.imshow(picture(near, _SHEET, _SAMPLES, bounces=_BOUNCES))
        _cover(left, experiment)
        _name_parts(left, experiment)
        _name_sheet(right)
        for letter, axes in zip("ab", (left, right), strict=True):
            bare(axes)
            label_panel(axes, letter)
            axes.spines[:].set_visible(False)


def draw_concept(stem: Path, experiment: Experiment, pressed: PressedElastomer) -> None:
    """Draw the principle in section, and the cut-open sheet rendered, as `stem`.png and .pdf.

    Raises
    ------
    InputError
        The files cannot be written.
    MissingBackend
        No usable Dr.Jit backend.
    """
    cut_mm = float(trace_through_apexes(experiment).points(np.zeros(1))[0, 1])
    things = [
        *sheet_things(experiment, pressed, cut_mm),
        *specimen_things(experiment, pressed),
        *holder_things(experiment, cut_mm),
    ]
    with sheet(stem, 7.16, 3.2) as figure:
        left, right = axes_at(figure, 0.05, 0.05, 3.45, 3.1), axes_at(figure, 3.6, 0.45, 3.5, 2.19)
        draw_principle(left, experiment, pressed)
        right.imshow(picture(things, _CUT, _SAMPLES, bounces=_BOUNCES))
        bare(right)
        right.spines[:].set_visible(False)
        for letter, axes in zip("ab", (left, right), strict=True):
            label_panel(axes, letter)


def _cover(axes: Axes, experiment: Experiment) -> None:
    """Draw what camera and projector cover, as pyramids from pinhole to the undeformed face."""
    rig = true_calibration(experiment)
    for device, pose, colour in (
        (rig.camera, rig.T_world_from_cam, MEASURED),
        (rig.projector, rig.T_world_from_proj, FIT),
    ):
        corners = _RIG.project(_on_face(device, pose))
        tip = _RIG.project(pose[:3, 3])
        outline = np.vstack([tip, corners])
        hull: Any = ConvexHull(outline)
        axes.add_patch(Polygon(outline[hull.vertices], facecolor=colour, alpha=0.16, lw=0))
        for corner in corners:
            axes.plot(*np.stack([tip, corner]).T, color=colour, lw=0.5, alpha=0.8)
        axes.add_patch(Polygon(corners, fill=False, edgecolor=colour, lw=0.8))


def _on_face(device: Pinhole, pose: NDArray[np.float64]) -> NDArray[np.float64]:
    """World points where the corners of a device's image meet z = 0, (4, xyz)."""
    rays = np.column_stack([device.seen_corners(), np.ones(4)]) @ pose[:3, :3].T
    return np.asarray(pose[:3, 3] - (pose[2, 3] / rays[:, 2])[:, None] * rays)


def _name_parts(axes: Axes, experiment: Experiment) -> None:
    rig = true_calibration(experiment)
    camera, projector = rig.T_world_from_cam[:3, 3], rig.T_world_from_proj[:3, 3]
    angle = triangulation_angle_deg(experiment)
    labels: dict[str, tuple[Any, tuple[float, float]]] = {
        f"camera, {np.linalg.norm(camera):.0f} mm": (np.add(camera, (0, 0, 60)), (-62, 6)),
        f"projector, {np.linalg.norm(projector):.0f} mm,\n{angle:.0f}° from the camera": (
            np.add(projector, (34, 0, 30)),
            (-6, -46),
        ),
        "coated silicone\nin its frame": ((-18, 0, 0), (-66, 18)),
        "specimen on\nz stage": ((0, -12, -25), (34, -14)),
    }
    for text, (at, offset) in labels.items():
        _label(axes, text, _RIG.project(np.asarray(at, np.float64)), offset)


def _name_sheet(axes: Axes) -> None:
    for text, at, offset in (
        ("fringes on the coat", (6.0, 3.0, 0.3), (30, 34)),
        ("frame", (-16.0, -4.0, 0.3), (-22, 28)),
    ):
        _label(axes, text, _SHEET.project(np.array(at)), offset)


def _label(axes: Axes, text: str, at_px: Any, offset_pt: tuple[float, float]) -> None:
    axes.annotate(
        text,
        at_px,
        xytext=offset_pt,
        textcoords="offset points",
        fontsize=6.5,
        ha="center",
        va="center",
        color=INK,
        arrowprops={"arrowstyle": "-", "color": INK, "lw": 0.5},
        bbox={"facecolor": "white", "alpha": 0.8, "edgecolor": "none", "pad": 1.0},
    )
