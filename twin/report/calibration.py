"""Figures of a calibration: residuals by feature and by pose, parameter correlations and errors."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from reconstruction.arrays import FloatArray
from twin.pipeline.board_calibration import BoardCalibration
from twin.report.canvas import (
    FAINT,
    FIT,
    MEASURED,
    TRUE_FACE,
    add_colorbar,
    axes_at,
    diverging,
    drawing,
    legend_above,
    plain_log,
    plain_spines,
    round_up,
)

RESIDUALS_FILE = "residuals.png"
POSES_FILE = "pose_residuals.png"
CORRELATIONS_FILE = "correlations.png"
PARAMETERS_FILE = "parameters.png"
# An arrow of the typical residual is this share of the image width.
ARROW_SHARE = 0.02


def draw_calibration(folder: Path, done: BoardCalibration) -> None:
    """Draw the figures of a calibration as PNG: residuals by feature and by pose, correlations.

    If the true rig is known, also draw the errors of the parameters.

    Raises
    ------
    InputError : a picture cannot be written
    """
    draw_residuals(folder / RESIDUALS_FILE, done)
    draw_poses(folder / POSES_FILE, done)
    draw_correlations(folder / CORRELATIONS_FILE, done)
    if done.truth is not None:
        draw_errors(folder / PARAMETERS_FILE, done, done.truth)


def draw_residuals(path: Path, done: BoardCalibration) -> None:
    """Draw the reprojection residual (px) of every feature used, as arrows on both images."""
    result = done.result.adjustment
    used = np.concatenate(result.used)
    measured = np.concatenate(result.measured_px)[used]
    residuals = np.concatenate(result.residuals_px)[used]
    width, height = done.observations[0].camera_size_px
    with drawing(path, 10.2, 4.2) as figure:
        for left, first, device in ((0.7, 0, "camera"), (5.7, 2, "projector")):
            axes = axes_at(figure, left, 0.5, 4.2, 3.1)
            mine = slice(first, first + 2)
            _draw_arrows(axes, measured[:, mine], residuals[:, mine], device)
            if device == "camera":
                axes.set_xlim(-0.5, width - 0.5)
                axes.set_ylim(height - 0.5, -0.5)


def _draw_arrows(axes: Axes, places_px: FloatArray, residuals_px: FloatArray, device: str) -> None:
    typical_px = round_up(float(np.sqrt(np.mean(np.sum(residuals_px**2, axis=1)))))
    extent_px = float(np.ptp(places_px[:, 0]))
    arrows = axes.quiver(
        *places_px.T,
        *residuals_px.T,
        color=MEASURED,
        angles="xy",
        scale_units="xy",
        scale=typical_px / (ARROW_SHARE * extent_px),
        width=0.002,
    )
    axes.quiverkey(arrows, 0.86, 1.05, typical_px, f"{typical_px:g} px", labelpos="W")
    axes.set_aspect("equal")
    axes.set_title(f"{device}: reprojection residual, measured − projected")
    axes.set_xlabel("column (px)")
    axes.set_ylabel("row (px)")
    if device == "projector":
        axes.invert_yaxis()


def draw_poses(path: Path, done: BoardCalibration) -> None:
    """Draw the RMS residuals (px) of every pose: camera, projector and epipolar."""
    poses = done.result.poses
    place = np.arange(len(poses))
    with drawing(path, 7.0, 3.4) as figure:
        axes = axes_at(figure, 0.75, 0.5, 6.0, 2.1)
        series = (
            ("camera", MEASURED, [pose.camera_px for pose in poses]),
            ("projector", FIT, [pose.projector_px for pose in poses]),
            ("epipolar", TRUE_FACE, [pose.epipolar_px for pose in poses]),
        )
        for name, colour, values in series:
            axes.plot(place, values, "o", color=colour, markersize=5, label=name)
        axes.set_xticks(place, [pose.name for pose in poses], rotation=45, ha="right")
        axes.set_ylabel("RMS residual (px)")
        axes.set_yscale("log")
        plain_log(axes.yaxis)
        plain_spines(axes)
        legend_above(axes, 3)


def draw_correlations(path: Path, done: BoardCalibration) -> None:
    """Draw the matrix of correlations between the errors of the estimated rig parameters."""
    result = done.result.adjustment
    names = [parameter.name for parameter in done.result.parameters[:-1]]  # without the baseline
    sigma = np.array([parameter.sigma for parameter in done.result.parameters[:-1]])
    free = np.flatnonzero(sigma > 0.0)
    shown = result.covariance[np.ix_(free, free)] / np.outer(sigma[free], sigma[free])
    labels = [names[k] for k in free]
    with drawing(path, 7.2, 6.2) as figure:
        axes = axes_at(figure, 1.4, 0.4, 4.6, 4.6)
        image = axes.imshow(shown, cmap=diverging(), vmin=-1.0, vmax=1.0)
        axes.set_xticks(range(len(free)), labels, rotation=90)
        axes.set_yticks(range(len(free)), labels)
        axes.set_title("correlation of the parameters' errors")
        add_colorbar(axes, image, "correlation")


def draw_errors(path: Path, done: BoardCalibration, truth: dict[str, float]) -> None:
    """Draw the error of each estimated parameter, divided by its expanded uncertainty (k = 2).

    Errors in the band from -1 to 1 are within the expanded uncertainty. `truth` has the true values
    by the parameter's name.
    """
    free = [parameter for parameter in done.result.parameters if parameter.sigma > 0.0]
    place = np.arange(len(free))[::-1]
    errors = [(p.value - truth[p.name]) / p.expanded for p in free]
    limit = max(1.5, 1.1 * float(np.max(np.abs(errors))))
    with drawing(path, 7.6, 1.0 + 0.24 * len(free)) as figure:
        axes = axes_at(figure, 2.9, 0.45, 4.4, 0.24 * len(free))
        axes.axvspan(-1.0, 1.0, color="#e8f0f7")
        axes.axvline(0.0, color=FAINT, linewidth=0.8)
        axes.plot(errors, place, "o", color=MEASURED, markersize=4)
        axes.set_xlim(-limit, limit)
        labels = [f"{p.name} = {p.value:.6g} ± {p.expanded:.1g}" for p in free]
        axes.set_yticks(place, labels)
        axes.set_xlabel("error / expanded uncertainty (k = 2)")
        axes.set_title("parameters against the true rig")
        axes.spines[["top", "right"]].set_visible(False)
