"""The principle in section: true geometry at the sheet, devices brought near to fit the page."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Circle, FancyArrowPatch, Polygon, Rectangle

from twin.config import Experiment
from twin.mechanics import PressedElastomer
from twin.optics.rig import true_calibration
from twin.report.canvas import FAINT, FIT, INK, MEASURED, NOMINAL
from twin.report.section import (
    face_profile,
    slab_span,
    specimen_profile,
    touched_profile,
    trace_through_apexes,
)
from twin.specimens import shape_of

_SAMPLES, _STRIPES = 401, 14
_SILICONE, _BODY, _COAT = "#cfe3f1", "#d9cdb8", "#7a7f87"
_SHOWN_DISTANCE = 21.0
"""Millimetres of the drawing from the sheet to the devices; they stand ten times as far."""


def draw_principle(axes: Axes, experiment: Experiment, pressed: PressedElastomer) -> None:
    """Draw specimen, sheet and coat to scale, camera and projector in their true directions."""
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
    """Draw the sheet and what presses into it; returns the specimen's lowest z."""
    trace = trace_through_apexes(experiment)
    s_mm = np.linspace(*span, _SAMPLES)
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
        # A projector beside the section's plane still leans to one side in the drawing.
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
    """Shade the light between a device and the sheet; fringes as stripes."""
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
    told = f"z stage lifts {pressed.depth_mm:g} mm\nafter first touch"
    axes.text(1.0, lowest - 3.6, told, fontsize=7, va="center")
    axes.plot([left - 5, right + 6], [9.0, 9.0], color=FAINT, lw=0.6, ls=(0, (4, 3)), zorder=0)
    axes.text(left - 5.5, 9.3, "distances above\nnot to scale", fontsize=5.5, color=FAINT)
