"""Calibration of a rig on captures of a board: figures, and the files of `twin calibrate`.

The command `twin calibrate -o DIR` writes these files, and other programs may rely on their names:

| file | content |
|---|---|
| result.json | metrics (units in their names), digest, versions |
| calibration.yaml | the calibration, OpenCV YAML |
| parameters.csv, poses.csv, features.csv | uncertainties, residuals by pose, every feature |
| skipped_NAME.png | mean image of a pose that was not used; reason in `warnings`, result.json |
| experiment.toml | of a rendered calibration: the resolved experiment |
"""

import hashlib
import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from reconstruction.arrays import Levels
from reconstruction.calibration import (
    Calibrated,
    Observation,
)
from reconstruction.calibration.pipeline import parameters_of, pupil_diameter_mm
from reconstruction.errors import counted
from reconstruction.rig.calibration import write_calibration
from reconstruction.rig.importing import Imported
from reconstruction.rig.pinhole import Pinhole
from reconstruction.writing import write_png, write_text
from twin.config import Experiment, to_toml
from twin.optics.rig import true_calibration
from twin.output import EXPERIMENT_FILE, write_outcome
from twin.results.parts import write_rows

if TYPE_CHECKING:
    import xarray

    from reconstruction.drawing import Drawing


CALIBRATION_FILE = "calibration.yaml"
SKIPPED_PREFIX = "skipped_"
PARAMETERS_FILE, POSES_FILE, FEATURES_FILE = "parameters.csv", "poses.csv", "features.csv"
PLAUSIBILITY_FILE = "plausibility.csv"


@dataclass(frozen=True, eq=False)
class SkippedPose:
    """Board pose that was not used in a calibration.

    Attributes
    ----------
    name : name of the capture folder
    reason : why the pose was not used
    picture : (row, col) mean of the frames; None if the frames could not be read
    """

    name: str
    reason: str
    picture: Levels | None


@dataclass(frozen=True, eq=False)
class BoardCalibration:
    """Calibration of camera and projector on a board, with its observations.

    Attributes
    ----------
    result : calibration with uncertainties and residuals
    observations : decoded features of each pose that was used
    digest : hash of the inputs
    experiment : experiment of a rendered rig; None for a real rig
    skipped : poses that were not used
    """

    result: Calibrated
    observations: tuple[Observation, ...]
    digest: str
    experiment: Experiment | None = None
    skipped: tuple[SkippedPose, ...] = ()

    def __repr__(self) -> str:
        shown = ", ".join(f"{name} {value}" for name, value in self._in_short().items())
        return f"<BoardCalibration: {counted(len(self.observations), 'pose')}, {shown}>"

    def _repr_html_(self) -> str:
        from reconstruction.drawing import as_html

        return as_html("calibration on a board", self._in_short(), self.plot())

    def _in_short(self) -> dict[str, str]:
        """Return the number of features and the RMS residuals as texts, by name."""
        poses = self.result.poses
        return {
            "features": str(sum(pose.features for pose in poses)),
            "camera residuals": f"{_rms([pose.camera_px for pose in poses]):.3g} px RMS",
            "projector residuals": f"{_rms([pose.projector_px for pose in poses]):.3g} px RMS",
        }

    def plot(self) -> "Drawing":
        """Return a figure of the residuals of camera and projector, and of their RMS per pose; px.

        Returns
        -------
        A Matplotlib figure
        """
        from reconstruction.drawing import Drawing

        drawing = Drawing(3)
        camera, projector, by_pose = drawing.subplots(1, 3)
        arrays = self.to_xarray()
        for axes, device, names in (
            (camera, "camera", ("camera_x_px", "camera_y_px")),
            (projector, "projector", ("projector_column_px", "projector_row_px")),
        ):
            x_px, y_px = (arrays[f"residual_{name}"][arrays["used"] == 1] for name in names)
            axes.plot(x_px, y_px, ".", markersize=2)
            axes.set(title=f"{device} residuals", xlabel=f"{names[0]}", ylabel=f"{names[1]}")
        for device in ("camera_px", "projector_px"):
            by_pose.plot([getattr(pose, device) for pose in self.result.poses], "o", label=device)
        by_pose.set(title="RMS residuals", xlabel="pose", ylabel="RMS (px)")
        by_pose.legend()
        return drawing

    def to_xarray(self) -> "xarray.Dataset":
        """Return positions and residuals, px, pose, number and use of every feature, (feature,)."""
        import xarray

        rows = list(_feature_rows(self))
        return xarray.Dataset(
            {
                name: ("feature", np.array([row[name] for row in rows]), _units_of(name))
                for name in rows[0]
            }
        )

    @property
    def truth(self) -> dict[str, float] | None:
        """True parameters of the rendered rig by name, units in the names; None for a real rig."""
        if self.experiment is None:
            return None
        return parameters_of(true_calibration(self.experiment))


def calibration_metrics(done: BoardCalibration) -> dict[str, Any]:
    """Return the figures of a calibration for result.json, by name.

    A name with `_expanded` is the expanded uncertainty of a parameter (k = 2), one with `_error`
    the estimated minus the true value.
    """
    result = done.result
    figures: dict[str, Any] = {
        "poses": len(result.poses),
        "poses_skipped": len(done.skipped),
        "features": sum(pose.features for pose in result.poses),
        "features_left_out": sum(pose.left_out for pose in result.poses),
        "camera_reprojection_rms_px": _rms([pose.camera_px for pose in result.poses]),
        "projector_reprojection_rms_px": _rms([pose.projector_px for pose in result.poses]),
        "epipolar_rms_px": _rms([pose.epipolar_px for pose in result.poses]),
        "camera_pupil_diameter_mm": pupil_diameter_mm(result.adjustment) or None,  # 0: not seen
        "camera_pixel_ratio": _pixel_ratio(result.calibration.camera),
        "projector_pixel_ratio": _pixel_ratio(result.calibration.projector),
    }
    truth = done.truth
    for parameter in result.parameters:
        figures[parameter.name] = parameter.value
        figures[f"{parameter.name}_expanded"] = parameter.expanded
        if truth is not None:
            figures[f"{parameter.name}_error"] = parameter.value - truth[parameter.name]
    left_out = [f"left out: {skipped.reason}" for skipped in done.skipped]
    figures["warnings"] = [*left_out, *result.doubts]
    return figures


def _pixel_ratio(device: Pinhole) -> float:
    """Return the ratio of a pixel's width to its height, estimated or as given for the fit."""
    return device.fy_px / device.fx_px


def _rms(values: Sequence[float]) -> float:
    return math.sqrt(sum(value**2 for value in values) / len(values))


def write_board_calibration(folder: Path, done: BoardCalibration) -> dict[str, Any]:
    """Write the files of a calibration to a folder; return the numbers in result.json by name.

    The files are calibration.yaml, result.json, and tables of parameters, poses, features and
    plausibility checks. Images of skipped poses, and the experiment if there is one, are added.
    """
    figures = calibration_metrics(done)
    write_calibration(folder / CALIBRATION_FILE, done.result.calibration)
    write_rows(folder / PARAMETERS_FILE, list(parameter_rows(done)), 10)
    write_rows(folder / POSES_FILE, [asdict(pose) for pose in done.result.poses], 10)
    write_rows(folder / FEATURES_FILE, list(_feature_rows(done)), 10)
    rows = [asdict(check) for check in done.result.checks]
    write_rows(folder / PLAUSIBILITY_FILE, [_finite(row) for row in rows], 10)
    for skipped in done.skipped:
        if skipped.picture is not None:
            write_png(folder / f"{SKIPPED_PREFIX}{skipped.name}.png", skipped.picture)
    if done.experiment is not None:
        text = to_toml(done.experiment)
        write_text(folder / EXPERIMENT_FILE, text)
    write_outcome(folder, "calibrate", figures, digest=done.digest)
    return figures


def _finite(row: dict[str, Any]) -> dict[str, Any]:
    return {name: "" if value in (math.inf, -math.inf) else value for name, value in row.items()}


def write_imported(folder: Path, imported: Imported) -> dict[str, Any]:
    """Write calibration.yaml and result.json of an imported calibration; return the figures."""
    calibration = imported.calibration
    T_proj_from_cam = calibration.T_proj_from_cam
    figures: dict[str, Any] = {
        "baseline_mm": float(np.linalg.norm(T_proj_from_cam[:3, 3])),
        "triangulation_angle_deg": calibration.triangulation_angle_deg,
        "standoff_mm": float(calibration.T_world_from_cam[2, 3]),
    }
    for name, refit_px in zip(("camera", "projector"), imported.refit_px, strict=True):
        device = getattr(calibration, name)
        figures |= {f"{name}_width_px": device.width_px, f"{name}_height_px": device.height_px}
        figures |= {f"{name}_fx_px": device.fx_px, f"{name}_refit_px": refit_px}
    if imported.pose.epipolar_px is not None:
        figures["epipolar_px"] = imported.pose.epipolar_px
    write_calibration(folder / CALIBRATION_FILE, calibration)
    content = (folder / CALIBRATION_FILE).read_bytes()
    named = hashlib.blake2b(content, digest_size=8).hexdigest()
    write_outcome(folder, "import-calibration", figures, digest=named)
    return figures


def parameter_rows(done: BoardCalibration) -> Iterator[dict[str, Any]]:
    """Yield one row per parameter: value, standard and expanded uncertainty.

    For a rendered rig each row also has the true value and the error.
    """
    truth = done.truth
    for parameter in done.result.parameters:
        row: dict[str, Any] = {
            "parameter": parameter.name,
            "value": parameter.value,
            "sigma": parameter.sigma,
            "expanded": parameter.expanded,
        }
        if truth is not None:
            row |= {
                "truth": truth[parameter.name],
                "error": parameter.value - truth[parameter.name],
            }
        yield row


def _units_of(name: str) -> dict[str, str]:
    return {"units": "px"} if name.endswith("_px") else {}


def _feature_rows(done: BoardCalibration) -> Iterator[dict[str, Any]]:
    adjustment = done.result.adjustment
    for k, observation in enumerate(done.observations):
        for n, identity in enumerate(observation.ids):
            numbers = [*adjustment.measured_px[k][n], *adjustment.residuals_px[k][n]]
            names = ("camera_x_px", "camera_y_px", "projector_column_px", "projector_row_px")
            residuals = tuple(f"residual_{name}" for name in names)
            yield {
                "pose": observation.name,
                "id": int(identity),
                "used": int(adjustment.used[k][n]),
            } | {
                name: float(number) for name, number in zip(names + residuals, numbers, strict=True)
            }
