"""Draw set-up and principle of an experiment: a section, and rendered views with labels."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Circle, FancyArrowPatch, Polygon, Rectangle
from scipy.spatial import ConvexHull

from twin.config import Experiment
from twin.mechanics import PressedElastomer
from twin.optics.picture import picture
from twin.optics.rig import true_calibration
from twin.optics.view import SceneView
from twin.paper.rig_scene import (
    device_things,
    frame_things,
    holder_things,
    sheet_things,
    specimen_things,
)
from twin.report.canvas import (
    FAINT,
    FIT,
    INK,
    MEASURED,
    NOMINAL,
    axes_at,
    label_panel,
    no_ticks,
    printing,
)
from twin.report.scene import field_corners
from twin.report.section import (
    face_profile,
    slab_span,
    specimen_profile,
    touched_profile,
    trace_through_apexes,
)
from twin.specimens import shape_of

_SAMPLES, _BOUNCES = 12, 3
_RIG = SceneView((-420.0, -1150.0, 520.0), (35.0, 0.0, 108.0), 412.0, 520, 640)
_SHEET = SceneView((-26.0, -80.0, 62.0), (0.0, 0.0, -2.0), 56.0, 560, 420)
_CUT = SceneView((-14.0, -95.0, 30.0), (0.0, 0.0, -5.5), 42.0, 640, 400)


def draw_setup(stem: Path, experiment: Experiment, pressed: PressedElastomer) -> None:
    """Draw the whole rig and the pressed sheet in its frame; write `stem`.png and `stem`.pdf.

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
    with printing(stem, 7.16, 4.1) as figure:
        left, right = axes_at(figure, 0.03, 0.05, 3.25, 4.0), axes_at(figure, 3.4, 0.7, 3.7, 2.78)
        left.imshow(picture(rig, _RIG, _SAMPLES, bounces=_BOUNCES))
        right.imshow(picture(near, _SHEET, _SAMPLES, bounces=_BOUNCES))
        _cover(left, experiment)
        _name_parts(left, experiment)
        _name_sheet(right)
        for letter, axes in zip("ab", (left, right), strict=True):
            no_ticks(axes)
            label_panel(axes, letter)
            axes.spines[:].set_visible(False)


def draw_concept(stem: Path, experiment: Experiment, pressed: PressedElastomer) -> None:
    """Draw a section of the principle and a rendered cut-open sheet.

    Write `stem`.png and `stem`.pdf.

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
    with printing(stem, 7.16, 3.2) as figure:
        left, right = axes_at(figure, 0.05, 0.05, 3.45, 3.1), axes_at(figure, 3.6, 0.45, 3.5, 2.19)
        draw_principle(left, experiment, pressed)
        right.imshow(picture(things, _CUT, _SAMPLES, bounces=_BOUNCES))
        no_ticks(right)
        right.spines[:].set_visible(False)
        for letter, axes in zip("ab", (left, right), strict=True):
            label_panel(axes, letter)


def _cover(axes: Axes, experiment: Experiment) -> None:
    """Draw the fields of view as pyramids from the pinholes to the undeformed face."""
    rig = true_calibration(experiment)
    for device, pose, colour in (
        (rig.camera, rig.T_world_from_cam, MEASURED),
        (rig.projector, rig.T_world_from_proj, FIT),
    ):
        corners = _RIG.project(field_corners(device, pose))
        tip = _RIG.project(pose[:3, 3])
        outline = np.vstack([tip, corners])
        hull: Any = ConvexHull(outline)
        axes.add_patch(Polygon(outline[hull.vertices], facecolor=colour, alpha=0.16, lw=0))
        for corner in corners:
            axes.plot(*np.stack([tip, corner]).T, color=colour, lw=0.5, alpha=0.8)
        axes.add_patch(Polygon(corners, fill=False, edgecolor=colour, lw=0.8))


def _name_parts(axes: Axes, experiment: Experiment) -> None:
    rig = true_calibration(experiment)
    camera, projector = rig.T_world_from_cam[:3, 3], rig.T_world_from_proj[:3, 3]
    angle = rig.triangulation_angle_deg
    labels: dict[str, tuple[Any, tuple[float, float]]] = {
        f"camera,\n{np.linalg.norm(camera):.0f} mm": (np.add(camera, (0, 0, 60)), (-48, 10)),
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


_SECTION_SAMPLES, _STRIPES = 401, 14
_SILICONE, _BODY, _COAT = "#cfe3f1", "#d9cdb8", "#7a7f87"
_SHOWN_DISTANCE = 21.0
"""Distance of camera and projector from the sheet in the drawing, mm. The true distance is about
10 x larger."""


def draw_principle(axes: Axes, experiment: Experiment, pressed: PressedElastomer) -> None:
    """Draw a section with specimen, sheet and coat to scale.

    Camera and projector are drawn in their true directions, at a reduced distance.
    """
    span = slab_span(experiment, trace_through_apexes(experiment))
    _devices(axes, experiment, span)
    lowest = _section(axes, experiment, pressed, span)
    _labels(axes, experiment, pressed, span, lowest)
    axes.set(
        xlim=(span[0] - 6, span[1] + 7), ylim=(lowest - 6, _SHOWN_DISTANCE + 6), aspect="equal"
    )
    axes.axis("off")


def _section(
    axes: Axes, experiment: Experiment, pressed: PressedElastomer, span: tuple[float, float]
) -> float:
    """Draw the sheet and the specimen in section; return the specimen's lowest z, mm."""
    trace = trace_through_apexes(experiment)
    s_mm = np.linspace(*span, _SECTION_SAMPLES)
    coated = face_profile(pressed, trace, s_mm)
    touched = touched_profile(experiment, pressed, trace, s_mm)
    lowest = _specimen(axes, experiment, pressed, s_mm)
    axes.fill_between(s_mm, touched, coated, color=_SILICONE, lw=0, zorder=3)
    axes.plot(s_mm, touched, color=INK, lw=0.6, zorder=4)
    axes.plot(s_mm, coated, color=_COAT, lw=2.2, zorder=5)
    thickness = experiment.elastomer.thickness_mm
    for end, outwards in zip(span, (-1.0, 1.0), strict=True):
        left = min(end, end + outwards * 3.0)
        rim = Rectangle((left, -thickness - 1.0), 3.0, thickness + 1.4, color="#b8bec6", zorder=2)
        axes.add_patch(rim)
    axes.add_patch(Rectangle((-9, lowest - 1.5), 18, 1.5, color="#b8bec6", zorder=2))
    return lowest


def _specimen(axes: Axes, experiment: Experiment, pressed: PressedElastomer, s_mm: Any) -> float:
    trace, shape = trace_through_apexes(experiment), shape_of(experiment.specimen)
    raised = experiment.elastomer.touched_plane_mm + pressed.depth_mm
    style: Any = {"facecolor": _BODY, "edgecolor": NOMINAL, "lw": 0.7}
    for ball in shape.spheres():
        centre = float(trace.position(ball.x_mm, ball.y_mm)), ball.z_mm + raised
        axes.add_patch(Circle(centre, ball.radius_mm, zorder=2.5, **style))
    if shape.spheres():
        return min(ball.z_mm - ball.radius_mm for ball in shape.spheres()) + raised
    body = specimen_profile(experiment, pressed, trace, s_mm)
    here = np.isfinite(body)
    lowest = float(shape.mesh(raised).bounds[0, 2])
    axes.fill_between(s_mm, lowest, np.where(here, body, lowest), where=here, zorder=2.5, **style)
    return lowest


def _devices(axes: Axes, experiment: Experiment, span: tuple[float, float]) -> None:
    rig, direction = true_calibration(experiment), trace_through_apexes(experiment).direction
    for name, pose, colour, stripes in (
        ("camera", rig.T_world_from_cam, MEASURED, 0),
        ("projector", rig.T_world_from_proj, FIT, _STRIPES),
    ):
        at_mm = pose[:3, 3] / np.linalg.norm(pose[:3, 3])
        # An offset perpendicular to the section's plane is drawn as an offset in this plane.
        along = float(at_mm[:2] @ direction) or float(np.hypot(*at_mm[:2]))
        tip = _SHOWN_DISTANCE * np.array([along, at_mm[2]])
        _fan(axes, tip, span, colour, stripes)
        axes.plot(*tip, marker="s", ms=11, color=colour, zorder=6)
        far = f"{name}\n{np.linalg.norm(pose[:3, 3]):.0f} mm away"
        aside = 26 if stripes else -26
        axes.annotate(
            far,
            tuple(tip),
            (aside, 8),
            textcoords="offset points",
            ha="center",
            color=colour,
            fontsize=7,
        )


def _fan(axes: Axes, tip: Any, span: tuple[float, float], colour: str, stripes: int) -> None:
    """Draw the light between a device and the sheet as one triangle, or as `stripes` triangles."""
    edges = np.linspace(*span, 2 * max(stripes, 1) + 1)
    wedges = zip(edges[:-1:2], edges[1::2], strict=True) if stripes else [span]
    for left, right in wedges:
        corners = [tuple(tip), (left, 0.0), (right, 0.0)]
        axes.add_patch(Polygon(corners, facecolor=colour, alpha=0.16, lw=0, zorder=1))


def _labels(
    axes: Axes,
    experiment: Experiment,
    pressed: PressedElastomer,
    span: tuple[float, float],
    lowest: float,
) -> None:
    left, right = span
    thickness = experiment.elastomer.thickness_mm
    for text, at, place in (
        ("coat", (left + 2.0, 0.0), (left - 2.5, 5.0)),
        ("clear silicone", (right - 2.0, -0.6 * thickness), (right + 1.0, -thickness - 4.5)),
        ("specimen", (-2.0, 0.6 * lowest), (left - 0.5, 0.75 * lowest)),
    ):
        axes.annotate(
            text, at, place, fontsize=7, ha="center", va="center", zorder=7,
            arrowprops={"arrowstyle": "-", "color": INK, "lw": 0.5},
        )  # fmt: skip
    lift = FancyArrowPatch(
        (0, lowest - 5.5), (0, lowest - 1.7), mutation_scale=9, color=INK, lw=1.0
    )
    axes.add_patch(lift)
    travel = f"z stage lifts {pressed.depth_mm:g} mm\nafter first touch"
    axes.text(1.0, lowest - 3.6, travel, fontsize=7, va="center")
    axes.plot([left - 5, right + 6], [9.0, 9.0], color=FAINT, lw=0.6, ls=(0, (4, 3)), zorder=0)
    axes.text(left - 5.5, 9.3, "distances above\nnot to scale", fontsize=5.5, color=FAINT)
