"""Rigs as a calibration would have found them, drawn from the covariance of a rendered one.

The calibration of a rig on rendered board poses states a covariance. A trial measures with a rig
drawn from it: what differs from the true rig is what a new calibration adds, not an assumed number.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.calibration.parameters import POSES, RigEstimate, pack, unpack
from reconstruction.pipeline import Reconstruction
from reconstruction.rig.calibration import Calibration
from reconstruction.triangulation import triangulate
from twin.config import Experiment, digest
from twin.config.board import load_board
from twin.config.digest import keyed_sequence
from twin.output import read_json, replace_json, versions
from twin.pipeline.calibration import calibrate_rendered, calibration_metrics
from twin.pipeline.fringes import options_of
from twin.pipeline.progress import ProgressCallback, no_progress
from twin.results.record import Measurement
from twin.results.score import metrics, score

CALIBRATION_FILE = "calibration.json"


@dataclass(frozen=True)
class RigCovariance:
    """How well a calibration knows a rig; compared and hashed by content.

    Attributes
    ----------
    rows : (24, 24), camera, projector and the motion between them, order of
        `reconstruction.calibration.parameters`
    """

    rows: tuple[tuple[float, ...], ...]

    @classmethod
    def of(cls, rows: Sequence[Sequence[float]] | FloatArray) -> "RigCovariance":
        """Take a covariance, (24, 24)."""
        return cls(tuple(tuple(map(float, row)) for row in rows))

    def draw(self, true: Calibration, seed: int, trial: int) -> Calibration:
        """Return a rig as one calibration found it; trial 0 is the true rig."""
        if not trial:
            return true
        covariance = np.array(self.rows, np.float64)
        rng = np.random.default_rng(keyed_sequence(seed, "calibration", trial))
        step = _correlated(covariance, rng.standard_normal(len(covariance)))
        vector = pack(
            RigEstimate(true.camera, true.projector, true.T_proj_from_cam, np.eye(4)[None])
        )
        vector[:POSES] += step
        found = unpack(vector, true.camera, true.projector)
        # The world hangs on the camera: a calibrated world frame of its own would move every point
        # alike, which no fitted radius or width feels.
        world_from_proj = true.T_world_from_cam @ np.linalg.inv(found.T_proj_from_cam)
        return Calibration(
            found.camera, found.projector, true.T_world_from_cam, world_from_proj, true.layers
        )


def _correlated(covariance: FloatArray, normal: FloatArray) -> FloatArray:
    """Turn independent standard normal numbers into a draw from a covariance, (n,) float."""
    # Through the correlation: radians and pixels differ by nine orders of magnitude in variance.
    sigma = np.sqrt(np.diag(covariance))
    free = sigma > 0
    correlation = covariance[np.ix_(free, free)] / np.outer(sigma[free], sigma[free])
    values, vectors = np.linalg.eigh(correlation)
    step = np.zeros_like(sigma)
    step[free] = sigma[free] * (vectors @ (np.sqrt(np.maximum(values, 0.0)) * normal[free]))
    return step


def calibrated(
    folder: Path, experiment: Experiment, board: str, watch: ProgressCallback = no_progress
) -> RigCovariance:
    """Return how well a calibration on rendered board poses knows the experiment's rig.

    Kept in the folder, with its figures, and taken from there where rig, board and versions are the
    same.

    Raises
    ------
    InputError, MissingBackend
        As `calibrate_rendered`.
    """
    shown, path = load_board(board), folder / CALIBRATION_FILE
    mark: dict[str, Any] = {
        "digest": f"{digest(experiment)} {shown.model_dump_json()}",
        "versions": versions(),
    }
    kept = read_json(path) if path.is_file() else {}
    if {name: kept.get(name) for name in mark} == mark:
        return RigCovariance.of(kept["covariance"])
    done = calibrate_rendered(experiment, shown, watch=watch)
    rows = done.result.adjustment.covariance[:POSES, :POSES].tolist()
    replace_json(path, mark | {"figures": calibration_metrics(done), "covariance": rows})
    return RigCovariance.of(rows)


def seen_with(done: Measurement, rig: Calibration) -> Measurement:
    """Return a measurement with fringes as it is when its images are triangulated with a rig."""
    images, options = done.fringes, options_of(done.experiment.decode)
    decoded = images.reconstruction.decoded
    maps = Reconstruction(decoded, triangulate(decoded, rig, options.use, options.tolerance))
    scored = score(done.experiment, maps, done.truth)
    return replace(
        done,
        images=replace(images, reconstruction=maps),
        score=scored,
        figures=done.figures | metrics(scored),
    )
