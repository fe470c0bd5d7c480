"""Stored result of a scan, from which its page is drawn without another registration."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.errors import InputError
from reconstruction.netcdf import read_arrays
from reconstruction.reading import is_regular, read_json
from reconstruction.scan.fusion import ScanMap
from reconstruction.scan.registration import FreeDirection, Overlap, Registration
from twin.config.base import Model
from twin.config.scan import ScanPlan
from twin.config.schema import validated
from twin.output import RESULT_FILE

COMMAND, MAP_FILE = "scan", "scan.nc"

Motions = tuple[tuple[float, float, float, float, float, float], ...]
Vector = tuple[float, float, float]


class StoredRegistration(Model):
    """Estimated motions of the patches, mm and rad, and the comparison of their overlaps."""

    motion: Motions
    sigma: Motions
    drift_mm: Vector
    drift_sigma_mm: Vector
    overlaps: tuple[Overlap, ...]
    free: tuple[FreeDirection, ...]
    true_motion: Motions | None

    @classmethod
    def of(cls, registered: Registration, true_motion: FloatArray | None) -> "StoredRegistration":
        """Return the part of a registration that is stored."""
        return cls.model_validate(
            {
                "motion": registered.motion.tolist(),
                "sigma": registered.sigma.tolist(),
                "drift_mm": registered.drift_mm.tolist(),
                "drift_sigma_mm": registered.drift_sigma_mm.tolist(),
                "overlaps": registered.overlaps,
                "free": registered.free,
                "true_motion": None if true_motion is None else true_motion.tolist(),
            }
        )


@dataclass(frozen=True, eq=False)
class ScanRecord:
    """A finished scan.

    Attributes
    ----------
    plan : the plan
    figures : figures of result.json
    registration : motions and overlaps of the patches
    fused : height map of the part, heights in single precision
    """

    plan: ScanPlan
    figures: dict[str, Any]
    registration: StoredRegistration
    fused: ScanMap


def is_scan(folder: Path) -> bool:
    """Return True if a folder contains a finished scan."""
    path = folder / RESULT_FILE
    return is_regular(path) and read_json(path).get("command") == COMMAND


def read_scan(folder: Path) -> ScanRecord:
    """Read the result folder of a scan.

    Raises
    ------
    InputError : a file is missing or damaged, or was written by a version that stored no plan
    """
    path = folder / RESULT_FILE
    result = read_json(path)
    if not isinstance(result.get("metrics"), dict) or "registration" not in result:
        raise InputError(
            f"{path}: found no 'metrics' or no 'registration', which an earlier version did not "
            "write; run twin scan again, which measures no finished patch again"
        )
    before = f"{path}: "
    registration = validated(StoredRegistration, result["registration"], before)
    plan = validated(ScanPlan, result.get("plan"), before)
    if not len(registration.motion) == len(registration.sigma) == len(plan.positions):
        raise InputError(
            f"{path}: found {len(registration.motion)} motions and {len(registration.sigma)} "
            f"sigmas, allowed {len(plan.positions)}, one of each patch; run twin scan again"
        )
    return ScanRecord(plan, result["metrics"], registration, _map_of(folder, result["metrics"]))


def _map_of(folder: Path, figures: dict[str, Any]) -> ScanMap:
    path = folder / MAP_FILE
    try:
        stored = read_arrays(path)
        z_mm, noise_mm, pose_mm = (
            np.asarray(stored[name], np.float64) for name in ("z_mm", "noise_mm", "pose_mm")
        )
        patches, left_out = (np.asarray(stored[name], int) for name in ("patches", "left_out"))
        x_mm, y_mm = (np.asarray(stored[name], np.float64) for name in ("x", "y"))
        ratio, pitch_mm = float(figures["map_birge_ratio"]), float(figures["pitch_mm"])
    except (OSError, KeyError, TypeError, ValueError) as error:
        raise InputError(f"{path}: cannot be read ({error}); run twin scan again") from error
    return ScanMap(x_mm, y_mm, z_mm, noise_mm, pose_mm, patches, left_out, ratio, pitch_mm)
