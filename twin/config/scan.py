"""Plan of a scan as data: positions of the sensor over a large part, and the errors of the stage.

Shipped plans are in `scenes/scans`; `docs/scan.md` explains every key. A plan has either a `base`
experiment, whose patches are rendered at a grid or a list of positions, or measured patches.

The frame of the part is the world of the base experiment. In a patch at (x, y) the sensor has moved
by (x, y) over the part, and the turntable has turned the part by `rotation_deg` about the vertical
line through (turntable.x_mm, turntable.y_mm) in the frame of the sensor.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Self

import numpy as np
from pydantic import Field, model_validator
from scipy.spatial.transform import Rotation

from reconstruction.arrays import FloatArray
from reconstruction.reading import is_regular
from reconstruction.scan.registration import MOST_PATCHES, StagePrior
from twin.assets import scene_file
from twin.config.base import Angle, Model
from twin.config.bounds import Length, Place
from twin.config.loading import load_experiment, read_toml
from twin.config.models import Experiment
from twin.config.schema import validated

Micrometres = Annotated[float, Field(ge=0, le=5000)]
Milliradians = Annotated[float, Field(ge=0, le=100)]


class ScanStage(Model):
    """Errors of the stage, as standard deviations; 0 keeps a coordinate at its nominal value."""

    sigma_um: Micrometres = Field(default=20.0, description="of x and of y at one position")
    sigma_z_um: Micrometres = Field(default=0.0, description="of z; of measured patches only")
    angle_sigma_mrad: Milliradians = Field(default=0.5, description="of the rotation about z")
    tilt_sigma_mrad: Milliradians = Field(
        default=0.0, description="of the rotations about x and y; of measured patches only"
    )
    drift_um: Micrometres = Field(
        default=0.0, description="of x and of y from the first to the last patch, uniform between"
    )

    @property
    def prior(self) -> StagePrior:
        """The same standard deviations in mm and rad."""
        xy, z, drift = 1e-3 * self.sigma_um, 1e-3 * self.sigma_z_um, 1e-3 * self.drift_um
        tilt, angle = 1e-3 * self.tilt_sigma_mrad, 1e-3 * self.angle_sigma_mrad
        return StagePrior((xy, xy, z), (tilt, tilt, angle), (drift, drift, 0.0))


class ScanGrid(Model):
    """Positions in rows along x, each row from left to right, centred on the origin."""

    columns: Annotated[int, Field(ge=1, le=MOST_PATCHES)]
    rows: Annotated[int, Field(ge=1, le=MOST_PATCHES)] = 1
    step_x_mm: Length
    step_y_mm: Length = 10.0


class ScanPosition(Model):
    """Nominal position of one patch."""

    x_mm: Place = 0.0
    y_mm: Place = 0.0
    rotation_deg: Angle = Field(default=0.0, description="angle of the turntable")


class MeasuredPatch(ScanPosition):
    """A measured patch: a result folder of `twin measure` or `twin reconstruct`, and its place."""

    result: str = Field(min_length=1, description="folder; ./ is the folder of the plan")


class Turntable(Model):
    """Vertical axis of the turntable, in the frame of the sensor."""

    x_mm: Place = 0.0
    y_mm: Place = 0.0


class ScanMapSettings(Model):
    """Grid of the fused height map."""

    pitch_mm: Length | None = Field(
        default=None, description="absent: 1.5 x the distance of neighbouring points"
    )


class ScanPlan(Model):
    """Plan of a scan."""

    name: Annotated[str, Field(min_length=1, max_length=64)] = "scan"
    description: str = ""
    base: str | None = Field(default=None, description="experiment of one patch, direct_fpp")
    seed: Annotated[int, Field(ge=0, lt=2**32)] = Field(
        default=0, description="of the true errors of the stage in rendered patches"
    )
    stage: ScanStage = ScanStage()
    turntable: Turntable = Turntable()
    map: ScanMapSettings = ScanMapSettings()
    grid: ScanGrid | None = None
    position: tuple[ScanPosition, ...] = ()
    patch: tuple[MeasuredPatch, ...] = ()

    @model_validator(mode="after")
    def _one_kind_of_patches(self) -> Self:
        if (self.grid is not None) + bool(self.position) + bool(self.patch) != 1:
            raise ValueError("takes one of [grid], [[position]] or [[patch]]")
        if bool(self.patch) == (self.base is not None):
            raise ValueError(
                "base: needed with [grid] and [[position]], not allowed with [[patch]]"
            )
        count = len(self.positions)
        if not 2 <= count <= MOST_PATCHES:
            raise ValueError(f"found {count} patches, allowed 2 to {MOST_PATCHES}")
        unused = [n for n in ("sigma_z_um", "tilt_sigma_mrad") if getattr(self.stage, n)]
        if unused and self.base is not None:
            raise ValueError(f"stage.{unused[0]}: only for measured patches; remove it")
        return self

    @property
    def positions(self) -> tuple[ScanPosition, ...]:
        """Nominal positions of all patches, in the order of the path."""
        if self.grid is None:
            return self.position or self.patch
        x, y = (
            step * (np.arange(count) - (count - 1) / 2)
            for step, count in (
                (self.grid.step_x_mm, self.grid.columns),
                (self.grid.step_y_mm, self.grid.rows),
            )
        )
        return tuple(ScanPosition(x_mm=float(a), y_mm=float(b)) for b in y for a in x)

    def nominal_poses(self) -> FloatArray:
        """Return the nominal poses T_part_from_sensor, (patch, 4, 4), mm."""
        centre = np.array([self.turntable.x_mm, self.turntable.y_mm, 0.0])
        poses = np.tile(np.eye(4), (len(self.positions), 1, 1))
        for T, at in zip(poses, self.positions, strict=True):
            back = Rotation.from_euler("z", -at.rotation_deg, degrees=True).as_matrix()
            T[:3, :3] = back
            T[:3, 3] = centre - back @ centre + [at.x_mm, at.y_mm, 0.0]
        return poses


@dataclass(frozen=True)
class LoadedScan:
    """A plan, with its base experiment or the folders of its measured patches."""

    plan: ScanPlan
    base: Experiment | None
    results: tuple[Path, ...]


def load_scan(path: str | Path) -> LoadedScan:
    """Load the plan of a scan, from a file or the name of a shipped plan ("scans/plate").

    Raises
    ------
    ConfigError : with one line per problem: key, found, allowed, remedy
    """
    file = scene_file(path)
    plan = validated(ScanPlan, read_toml(file), f"{path}: ")
    results = tuple(file.parent / patch.result for patch in plan.patch)
    if plan.base is None:
        return LoadedScan(plan, None, results)
    local = file.parent / plan.base
    return LoadedScan(plan, load_experiment(local if is_regular(local) else plan.base), results)
