"""Merge the points of several cameras that see the same fringes of one projector.

Every camera is calibrated with the projector and triangulated with it. The frame of the merged
points is the world of the first view; the other views are moved into it by the projector's pose,
which all of them share: T_1_from_j = T_1_from_proj T_j_from_proj^-1.

A point p of camera i is compared with the surface of camera j at the pixel of j on which p is
projected, interpolated bilinearly between four points without a jump in height. The distance of
that surface from p along the normal n of the surface is s = n . (q - p). Both errors are along
their own camera rays, with standard deviations sigma_i and sigma_j along n.

- |s| <= 5 b sqrt(sigma_i^2 + sigma_j^2): both cameras see the same place. The point moves along its
  own ray to the mean of both surfaces with weights 1 / sigma^2.
- Otherwise, if q is nearer to camera j than p: p is hidden from j.
- Otherwise p is in front of a surface that camera j observes, which is impossible: p is left out.

b is the Birge ratio (Birge, Phys. Rev. 40, 207, 1932): 1.4826 times the median of |s| over its
standard deviation, at least 1. It exceeds 1 if the calibrations of the two cameras differ by more
than the noise, and enlarges the standard deviations of the merged points by this factor.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from reconstruction.arrays import BoolImage, FloatArray, FloatImage, at_pixels
from reconstruction.errors import InputError
from reconstruction.rig.calibration import Calibration
from reconstruction.rig.pinhole import Pinhole
from reconstruction.triangulation import PointMap
from reconstruction.triangulation.normals import LONGEST_OVER_TYPICAL

GATE = 5.0
"""Largest distance of two surfaces that are taken for the same, in standard deviations."""
LEAST_COSINE = 0.05
"""Least cosine between ray and normal, 87 degrees, at which a point is moved along the ray."""
MEDIAN_TO_SIGMA = 1.4826


@dataclass(frozen=True, eq=False)
class CameraView:
    """Points of one camera, and the rig that consists of this camera and the projector."""

    points: PointMap
    calibration: Calibration


@dataclass(frozen=True, eq=False)
class Agreement:
    """Comparison of the surfaces of two or more cameras where several of them see the same place.

    Parameters
    ----------
    offset_median_mm : median of |s|, the distance of two surfaces along the normal
    birge_ratio : b, see the module; 1 if the distances are as large as their sigma predicts
    shared_points : number of points that were compared and agree
    hidden_points : number of points hidden from all other cameras
    contradicted_points : number of points that were left out, because another camera observes a
        surface behind them
    """

    offset_median_mm: float
    birge_ratio: float
    shared_points: int
    hidden_points: int
    contradicted_points: int


@dataclass(frozen=True, eq=False)
class Merged:
    """Merged points of several cameras, in the world of the first one.

    Parameters
    ----------
    maps : points of each camera; pixels of points that another camera contradicts are not `kept`
    kept : (row, col) bool of each camera: the pixel's point is part of the merged points
    repeated : (row, col) bool of each camera: an earlier camera has a point at the same place
    agreement : comparison of the cameras
    """

    maps: tuple[PointMap, ...]
    kept: tuple[BoolImage, ...]
    repeated: tuple[BoolImage, ...]
    agreement: Agreement

    def of_all(self, images: Sequence[FloatImage]) -> FloatImage:
        """Return the values (n, ...) of one image (row, col, ...) per camera at the merged points.

        A place that several cameras see occurs once, at the pixel of the first of them.
        """
        chosen = [kept & ~again for kept, again in zip(self.kept, self.repeated, strict=True)]
        return np.concatenate([at_pixels(i, c) for i, c in zip(images, chosen, strict=True)])

    @property
    def points_mm(self) -> FloatImage:
        """Merged points, (n, xyz) float32, world frame of the first view."""
        return self.of_all([view.points_world_mm for view in self.maps])


@dataclass(frozen=True, eq=False)
class _Surface:
    """Points of one camera in the common frame; all arrays are (row, col, ...).

    Parameters
    ----------
    points : points and their standard deviations
    camera : intrinsics
    normals : unit normals towards the camera; 0 where not known
    errors_mm : (row, col, xyz) error of one standard deviation, along the ray of the camera
    spread_mm : sigma_i, component of this error along the normal
    """

    points: PointMap
    camera: Pinhole
    normals: FloatImage
    errors_mm: FloatImage
    spread_mm: FloatArray


@dataclass(frozen=True, eq=False)
class _Sight:
    """Surface observed by camera j along its rays through the points of camera i, all (row, col).

    Parameters
    ----------
    seen : camera j has a surface there
    offset_mm : s, distance of this surface from the point along the normal of the point
    spread_mm : sigma_j along this normal
    over_sigma : |s| over its standard deviation; 0 where it is not known
    is_nearer : the surface is nearer to camera j than the point
    """

    seen: BoolImage
    offset_mm: FloatArray
    spread_mm: FloatArray
    over_sigma: FloatArray
    is_nearer: BoolImage


def merge(views: Sequence[CameraView]) -> Merged:
    """Merge the points of two or more cameras.

    Raises
    ------
    InputError : there are fewer than two views, or no two cameras see the same place
    """
    if len(views) < 2:
        raise InputError(f"merge: found {len(views)} view; give two or more captures")
    surfaces = [_in_frame_of(views[0].calibration, view) for view in views]
    sights = [[_sight(of, by) for by in surfaces if by is not of] for of in surfaces]
    birge = _birge_ratio(sights)
    limit = GATE * birge
    agreed = [[sight.seen & (sight.over_sigma <= limit) for sight in row] for row in sights]
    pairs = list(zip(surfaces, sights, agreed, strict=True))
    through = [
        _any(
            [
                sight.seen & ~sight.is_nearer & ~same
                for sight, same in zip(row, agreeing, strict=True)
            ],
            surface,
        )
        for surface, row, agreeing in pairs
    ]
    valid = [surface.points.valid for surface in surfaces]
    return Merged(
        tuple(_fused(surface, row, agreeing, birge) for surface, row, agreeing in pairs),
        tuple(is_point & ~gone for is_point, gone in zip(valid, through, strict=True)),
        tuple(_any(same[:number], surfaces[number]) for number, same in enumerate(agreed)),
        _agreement(surfaces, sights, agreed, through, birge),
    )


def _in_frame_of(first: Calibration, view: CameraView) -> _Surface:
    """Move points and camera of a view into the world of `first`, by the projector of both."""
    T = first.T_world_from_proj @ np.linalg.inv(view.calibration.T_world_from_proj)
    along = view.points.points_world_mm - view.points.T_world_from_cam[:3, 3]
    errors = np.copysign(view.points.sigma_xyz_mm, along) @ T[:3, :3].T
    points = view.points.points_world_mm @ T[:3, :3].T + T[:3, 3]
    moved = PointMap(
        np.where(view.points.valid[..., np.newaxis], points, 0.0).astype(np.float32),
        np.abs(errors).astype(np.float32),
        view.points.mask_reason,
        T @ view.points.T_world_from_cam,
    )
    normals = moved.normals_world
    spread_mm = np.abs(_dot(normals, errors))
    camera = view.calibration.camera
    return _Surface(moved, camera, normals, errors.astype(np.float32), spread_mm)


def _dot(a: FloatArray | FloatImage, b: FloatArray | FloatImage) -> FloatArray:
    """Return the scalar products (row, col) of vectors (row, col, xyz)."""
    return np.asarray(np.einsum("rcx,rcx->rc", a, b, dtype=np.float64))


def _sight(of: _Surface, by: _Surface) -> _Sight:
    """Compare the points of one camera with the surface observed by another one."""
    points_mm = of.points.points_world_mm
    T = np.linalg.inv(by.points.T_world_from_cam)
    depth_mm = points_mm @ T[2, :3] + T[2, 3]
    usable = of.points.valid & np.any(of.normals != 0.0, axis=-1) & (depth_mm > 0.0)
    at_px = np.full((*usable.shape, 2), -1.0, np.float32)
    at_px[usable] = by.camera.project(points_mm[usable] @ T[:3, :3].T + T[:3, 3])
    surface_mm = _bilinear(by.points.points_world_mm, at_px)
    seen = usable & (_bilinear((~without_jump(by.points)).astype(np.float32), at_px) == 0.0)
    offset_mm = _dot(of.normals, surface_mm - points_mm)
    spread_mm = np.abs(_dot(of.normals, _bilinear(by.errors_mm, at_px)))
    both_mm, over_sigma = np.hypot(of.spread_mm, spread_mm), np.zeros_like(offset_mm)
    np.divide(np.abs(offset_mm), both_mm, out=over_sigma, where=seen & (both_mm > 0.0))
    is_nearer = surface_mm @ T[2, :3] + T[2, 3] < depth_mm
    return _Sight(seen, offset_mm, spread_mm, over_sigma, is_nearer)


def _bilinear(image: FloatImage, at_px: FloatImage) -> FloatImage:
    """Interpolate (row, col, ...) at positions (row, col, column and row); outside: 1."""
    border = (1.0,) * 4
    x, y = at_px[..., 0], at_px[..., 1]
    return np.asarray(
        cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=border)
    )


def without_jump(points: PointMap) -> BoolImage:
    """Return the pixels, (row, col), that have a point and no jump in height to a neighbour."""
    valid, whole = points.valid, points.valid.copy()
    for axis in (0, 1):
        steps = np.linalg.norm(np.diff(points.points_world_mm, axis=axis), axis=-1)
        both = np.logical_and(*_pair(valid, axis))
        longest_mm = LONGEST_OVER_TYPICAL * float(np.median(steps[both])) if both.any() else 0.0
        jump = both & (steps > longest_mm)
        for side in _pair(whole, axis):
            side &= ~jump
    return whole


def _pair(image: BoolImage, axis: int) -> tuple[BoolImage, BoolImage]:
    """Return the two views of an image that contain the neighbours along an axis."""
    turned = np.moveaxis(image, axis, 0)
    first, second = np.moveaxis(turned[:-1], 0, axis), np.moveaxis(turned[1:], 0, axis)
    return first, second


def _birge_ratio(sights: Sequence[Sequence[_Sight]]) -> float:
    over_sigma = np.concatenate([sight.over_sigma[sight.seen] for row in sights for sight in row])
    if not len(over_sigma):
        raise InputError(
            "merge: no two cameras see the same place; give captures of one scene with one "
            "projector, each with the calibration of its camera and this projector"
        )
    return max(1.0, MEDIAN_TO_SIGMA * float(np.median(over_sigma)))


def _any(masks: Sequence[BoolImage], surface: _Surface) -> BoolImage:
    return np.asarray(np.any([np.zeros_like(surface.points.valid), *masks], axis=0))


def _fused(
    surface: _Surface, row: Sequence[_Sight], agreed: Sequence[BoolImage], birge: float
) -> PointMap:
    """Move the points along their rays to the weighted mean of the surfaces that agree."""
    points = surface.points
    own = _weight(surface.spread_mm, points.valid)
    others = [_weight(sight.spread_mm, same) for sight, same in zip(row, agreed, strict=True)]
    shifts_mm = [w * sight.offset_mm for w, sight in zip(others, row, strict=True)]
    total, shift_mm = np.sum([own, *others], axis=0), np.sum(shifts_mm, axis=0)
    rays = points.points_world_mm - points.T_world_from_cam[:3, 3]
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    cosine = _dot(rays, surface.normals)
    moves = (np.abs(cosine) > LEAST_COSINE) & (total > own)
    along_mm, scale = np.zeros_like(own), np.full_like(own, birge)
    np.divide(shift_mm, total * cosine, out=along_mm, where=moves)
    scale[moves] *= np.sqrt(own[moves] / total[moves])
    return PointMap(
        (points.points_world_mm + rays * along_mm[..., np.newaxis]).astype(np.float32),
        (points.sigma_xyz_mm * scale[..., np.newaxis]).astype(np.float32),
        points.mask_reason,
        points.T_world_from_cam,
    )


def _weight(spread_mm: FloatArray, where: BoolImage) -> FloatArray:
    """Return 1 / sigma^2, (row, col) mm^-2; 0 outside `where`."""
    weight = np.zeros_like(spread_mm)
    np.divide(1.0, spread_mm**2, out=weight, where=where & (spread_mm > 0.0))
    return weight


def _agreement(
    surfaces: Sequence[_Surface],
    sights: Sequence[Sequence[_Sight]],
    agreed: Sequence[Sequence[BoolImage]],
    through: Sequence[BoolImage],
    birge: float,
) -> Agreement:
    offsets = [
        np.abs(sight.offset_mm[same])
        for row, masks in zip(sights, agreed, strict=True)
        for sight, same in zip(row, masks, strict=True)
    ]
    shared = [_any(masks, surface) for masks, surface in zip(agreed, surfaces, strict=True)]
    alone = [
        surface.points.valid & ~same & ~gone
        for surface, same, gone in zip(surfaces, shared, through, strict=True)
    ]
    return Agreement(
        offset_median_mm=float(np.median(np.concatenate(offsets))),
        birge_ratio=birge,
        shared_points=sum(int(same.sum()) for same in shared),
        hidden_points=sum(int(left.sum()) for left in alone),
        contradicted_points=sum(int(gone.sum()) for gone in through),
    )
