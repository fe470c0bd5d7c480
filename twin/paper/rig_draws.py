"""Rigs as a calibration would have found them, drawn from the covariance of a rendered one.

The calibration of the experiment's rig on twelve rendered board poses states a covariance. A trial
measures with a rig drawn from it: what differs from the true rig is u_cal, not an assumed number.
"""

import hashlib
from dataclasses import dataclass
from typing import Any

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.calibration.parameters import POSES, RigEstimate, pack, unpack
from reconstruction.rig.calibration import Calibration
from twin.config import Experiment
from twin.config.board import load_board
from twin.config.digest import keyed_sequence
from twin.optics.rig import true_calibration
from twin.pipeline.calibration import calibrate_rendered, calibration_metrics
from twin.pipeline.progress import Watcher, nobody

BOARD = "boards/paper_dots"


@dataclass(frozen=True, eq=False)
class RigScatter:
    """The true rig and the covariance with which a calibration finds it.

    Attributes
    ----------
    true : Calibration
    covariance : (24, 24) float
        Camera, projector and the motion between them, order of `calibration.parameters`.
    """

    true: Calibration
    covariance: FloatArray

    @property
    def digest(self) -> str:
        """Name of the covariance by its content."""
        return hashlib.blake2b(self.covariance.tobytes(), digest_size=8).hexdigest()

    def draw(self, seed: int, trial: int) -> Calibration:
        """Return the rig as one calibration found it; trial 0 is the true rig."""
        if not trial:
            return self.true
        rng = np.random.default_rng(keyed_sequence(seed, "calibration", trial))
        step = _correlated(self.covariance, rng.standard_normal(len(self.covariance)))
        true = self.true
        vector = pack(
            RigEstimate(true.camera, true.projector, true.T_proj_from_cam, np.eye(4)[None])
        )
        vector[:POSES] += step
        found = unpack(vector, true.camera, true.projector)
        # The world hangs on the camera: a calibrated world frame of its own would move every point
        # alike, which no fitted radius or width feels.
        world_from_proj = true.T_world_from_cam @ np.linalg.inv(found.T_proj_from_cam)
        return Calibration(found.camera, found.projector, true.T_world_from_cam, world_from_proj)


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


def calibrate_rig(experiment: Experiment, watch: Watcher = nobody) -> dict[str, Any]:
    """Calibrate on rendered board poses; return the figures and the covariance as nested lists.

    Raises
    ------
    InputError, MissingBackend
        As `calibrate_rendered`.
    """
    done = calibrate_rendered(experiment, load_board(BOARD), watch=watch)
    covariance = done.result.adjustment.covariance[:POSES, :POSES]
    return calibration_metrics(done) | {"covariance": covariance.tolist()}


def rig_scatter(experiment: Experiment, figures: dict[str, Any]) -> RigScatter:
    """Return what `calibrate_rig` found."""
    return RigScatter(
        true_calibration(experiment), np.array(figures["covariance"], dtype=np.float64)
    )
