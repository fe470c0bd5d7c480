"""Fuse registered patches: one height map on one grid, with standard deviations.

Every patch gives one height per cell: the mean over its points in the cell, weights 1 / sigma_z^2,
each point moved along its tangent plane to the centre of the cell. Two contributions make its
standard deviation:

- noise, the weighted mean of the sigma of these points. It is not divided by the root of their
  number, because the filter of the decoder correlates neighbouring points;
- the pose, from the covariance of the patch's pose, the point and the normal.

The patches of a cell are averaged with weights 1 / (noise^2 + pose^2). Noise is independent between
patches. Errors of poses are correlated between patches, and their contributions are added without
squares, which is an upper bound. The Birge ratio of the patches, at least 1, multiplies the noise.

Left out are points at the edge of the measured area or beside a jump in height, those that are
steeper than 75 degrees, and patches that differ by more than 5 standard deviations from the median
of three or more patches of the cell. If two patches differ that much, the cell has no height.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from reconstruction.arrays import BoolImage, FloatArray, IntArray
from reconstruction.cells import SquareCells
from reconstruction.errors import InputError
from reconstruction.merging import without_jump
from reconstruction.netcdf import Labelled, LabelledArrays
from reconstruction.scan.registration import GATE, MEDIAN_TO_SIGMA, twist_of
from reconstruction.triangulation import PointMap
from reconstruction.triangulation.normals import surface_normals

LEAST_COSINE = 0.26
"""Least z of a normal, 75 degrees, at which a point is moved to the centre of its cell."""


@dataclass(frozen=True, eq=False)
class PartPoints:
    """Points of one patch in the frame of the part.

    Parameters
    ----------
    points_mm, normals : (n, xyz)
    noise_mm, pose_mm : (n,) standard deviations of z by noise and by the pose
    """

    points_mm: FloatArray
    normals: FloatArray
    noise_mm: FloatArray
    pose_mm: FloatArray


@dataclass(frozen=True, eq=False)
class ScanMap:
    """Fused height map of a part; row 0 is at the largest y.

    Parameters
    ----------
    x_mm, y_mm : (col,) and (row,) centres of the cells, frame of the part
    z_mm : (row, col) height; 0 where there is none
    noise_mm, pose_mm : (row, col) standard deviations of the height by noise and by the poses
    patches : (row, col) int, number of patches that were averaged; 0: no height
    left_out : (row, col) int, number of patches that were left out
    birge_ratio : of the patches' heights, at least 1
    pitch_mm : edge length of a cell
    """

    x_mm: FloatArray
    y_mm: FloatArray
    z_mm: FloatArray
    noise_mm: FloatArray
    pose_mm: FloatArray
    patches: IntArray
    left_out: IntArray
    birge_ratio: float
    pitch_mm: float

    @property
    def valid(self) -> BoolImage:
        """Cells with a height, (row, col)."""
        return self.patches > 0

    @property
    def sigma_mm(self) -> FloatArray:
        """Standard deviation of the height, (row, col), by noise and poses."""
        return np.hypot(self.noise_mm, self.pose_mm)

    @property
    def points_mm(self) -> FloatArray:
        """Centres of the cells that have a height, (n, xyz)."""
        x, y = np.meshgrid(self.x_mm, self.y_mm)
        return np.stack([x, y, self.z_mm], axis=-1)[self.valid]


def part_points(points: PointMap, T: FloatArray, pose_covariance: FloatArray) -> PartPoints:
    """Return the points of a patch in the frame of the part, without edge points.

    Parameters
    ----------
    points : points in the frame of the sensor
    T : (4, 4) pose T_part_from_sensor, mm
    pose_covariance : (6, 6) covariance of the motion of the pose, mm and rad, see `registration`
    """
    normals = surface_normals(points.points_world_mm, points.valid)
    inner = cv2.erode(without_jump(points).astype(np.uint8), np.ones((3, 3), np.uint8))
    kept = (inner > 0) & (points.sigma_z_mm > 0.0) & (normals @ T[2, :3] > LEAST_COSINE)
    own, n = points.points_world_mm[kept].astype(np.float64), normals[kept].astype(np.float64)
    turned = n @ T[:3, :3].T
    twist = twist_of(n, own)
    pose = np.sqrt(np.einsum("nk,kl,nl->n", twist, pose_covariance, twist)) / turned[:, 2]
    noise = points.sigma_z_mm[kept].astype(np.float64)
    return PartPoints(own @ T[:3, :3].T + T[:3, 3], turned, noise, pose)


def fuse(patches: Sequence[PartPoints], pitch_mm: float) -> ScanMap:
    """Average registered patches in the square cells of one grid.

    Raises
    ------
    InputError : no patch has a point that is not at an edge, or the pitch makes too many cells
    """
    every = np.concatenate([patch.points_mm for patch in patches])
    if not len(every):
        raise InputError("scan: no patch has a point away from its edges; look at the patches")
    cells = SquareCells.of(every, pitch_mm)
    owners = np.repeat(
        np.arange(len(patches), dtype=np.int64), [len(patch.points_mm) for patch in patches]
    )
    normals, noise_mm, pose_mm = (
        np.concatenate(list(each)) for each in zip(*map(_columns, patches), strict=True)
    )
    return _fused(cells, owners, every, (normals, noise_mm, pose_mm))


def _columns(patch: PartPoints) -> tuple[FloatArray, FloatArray, FloatArray]:
    return patch.normals, patch.noise_mm, patch.pose_mm


def _fused(
    cells: SquareCells,
    owners: IntArray,
    points_mm: FloatArray,
    columns: tuple[FloatArray, FloatArray, FloatArray],
) -> ScanMap:
    """Average points (n,) of patches `owners` in their cells; `columns` as of `_columns`."""
    normals, noise_mm, pose_mm = columns
    shape = (len(cells.y_mm), len(cells.x_mm))
    row, col = np.divmod(cells.number, shape[1])
    centres = np.column_stack([cells.x_mm[col], cells.y_mm[row]])
    tilt = np.einsum("nk,nk->n", normals[:, :2], points_mm[:, :2] - centres) / normals[:, 2]
    key, at = np.unique(
        cells.number.astype(np.int64) * (int(owners.max()) + 1) + owners, return_inverse=True
    )
    cell, weight = key // (int(owners.max()) + 1), 1.0 / noise_mm**2
    z = _mean(at, points_mm[:, 2] + tilt, weight)
    noise, pose = _mean(at, noise_mm, weight), _mean(at, pose_mm, weight)
    kept, birge = _agreeing(cell, z, np.hypot(noise, pose))
    size = shape[0] * shape[1]
    share = np.where(kept, 1.0 / (noise**2 + pose**2), 0.0)
    total = np.bincount(cell, share, size)
    share = np.divide(share, total[cell], out=np.zeros_like(share), where=total[cell] > 0.0)

    def summed(values: FloatArray) -> FloatArray:
        return np.asarray(np.bincount(cell, values, size), np.float64).reshape(shape)

    return ScanMap(
        cells.x_mm,
        cells.y_mm,
        summed(share * z),
        birge * np.sqrt(summed((share * noise) ** 2)),
        summed(share * pose),
        np.bincount(cell[kept], minlength=size).reshape(shape).astype(np.int64),
        np.bincount(cell[~kept], minlength=size).reshape(shape).astype(np.int64),
        birge,
        cells.pitch_mm,
    )


def _mean(at: IntArray, values: FloatArray, weight: FloatArray) -> FloatArray:
    return np.asarray(np.bincount(at, weight * values) / np.bincount(at, weight))


def _agreeing(cell: IntArray, z: FloatArray, sigma: FloatArray) -> tuple[BoolImage, float]:
    """Return the heights (n,) that agree with the others of their cell, and the Birge ratio.

    `cell` is sorted. The distance from the median of m patches is compared with sigma sqrt(1 - 1/m)
    of the mean, that of two patches from their middle likewise.
    """
    _, first, count = np.unique(cell, return_index=True, return_counts=True)
    order = np.lexsort((z, cell))
    low, high = first + (count - 1) // 2, first + count // 2
    median = 0.5 * (z[order][low] + z[order][high])
    several = np.repeat(count, count)
    spread = sigma * np.sqrt(1.0 - 1.0 / np.maximum(several, 2))
    over = np.abs(z - np.repeat(median, count)) / spread
    shared = over[several > 1]
    ratio = MEDIAN_TO_SIGMA * float(np.median(shared)) if len(shared) else 1.0
    birge = max(1.0, ratio)
    return (several == 1) | (over <= GATE * birge), birge


def map_arrays(fused: ScanMap) -> LabelledArrays:
    """Return a fused map as labelled arrays over y and x, for netCDF."""
    cells = ("y", "x")

    def layer(values: NDArray[Any], name: str, units: str = "mm") -> Labelled:
        return (cells, values, {"units": units, "long_name": name})

    return LabelledArrays(
        {
            "z_mm": layer(fused.z_mm.astype(np.float32), "height, frame of the part"),
            "sigma_mm": layer(fused.sigma_mm.astype(np.float32), "standard deviation of z"),
            "noise_mm": layer(fused.noise_mm.astype(np.float32), "part of it by noise"),
            "pose_mm": layer(fused.pose_mm.astype(np.float32), "part of it by the poses"),
            "patches": layer(fused.patches.astype(np.int32), "patches averaged; 0: none", "1"),
            "left_out": layer(fused.left_out.astype(np.int32), "patches left out", "1"),
        },
        coords={
            "x": ("x", fused.x_mm, {"units": "mm", "long_name": "x of the cell"}),
            "y": ("y", fused.y_mm, {"units": "mm", "long_name": "y of the cell"}),
        },
        attrs={"Conventions": "CF-1.8"},
    )
