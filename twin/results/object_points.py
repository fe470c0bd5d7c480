"""Measured points of the object: masks of points over it and in contact, and the points' noise.

Under a thin sheet, the points are the cells of the compensated coat: the local thickness is
subtracted, and the contact is determined from the coat. Under a slab no local thickness is known.

Every n-th row and column of the image is evaluated, at most 40,000 points; distances to the object
are computed for 2,500 of them. More points would not improve a fit, because neighbouring points
share their errors.
"""

from dataclasses import dataclass, replace
from math import ceil, sqrt

import numpy as np
from numpy.typing import NDArray

from reconstruction.arrays import BoolImage, FloatArray, IntArray, at_pixels
from reconstruction.cells import box_of
from reconstruction.evaluate.estimates import FittedDimension, shared_by
from twin.config.models import Experiment
from twin.mechanics import PressedElastomer
from twin.optics.stack import Truth
from twin.results.features import Feature, gratings_of
from twin.results.under_sheet import ObjectUnderSheet
from twin.shape import Shape
from twin.specimens import shape_of
from twin.specimens.true_surface import TrueSurface

_MOST_POINTS = 40_000
_MOST_ALIGNED = 2_500
_RASTER_CELLS = 400
_LEAST_RASTER_MM = 0.005


@dataclass(frozen=True, eq=False)
class Heights:
    """True heights of the upper side of a specimen on a regular grid of world x and y.

    Attributes
    ----------
    x_mm, y_mm : (col,), (row,) positions of the cell centres, ascending
    z_mm : (row, col) world z of the upper side; -inf where there is no specimen
    pitch_mm : distance of neighbouring cells, mm
    """

    x_mm: FloatArray
    y_mm: FloatArray
    z_mm: FloatArray
    pitch_mm: float

    @classmethod
    def over(cls, surface: TrueSurface, xy_mm: FloatArray) -> "Heights":
        """Return the heights of a surface over the bounding rectangle of points (n, xy), mm."""
        low, high = box_of(xy_mm)
        pitch = max(float((high - low).max()) / _RASTER_CELLS, _LEAST_RASTER_MM)
        x, y = (np.arange(a, b + pitch, pitch) for a, b in zip(low, high, strict=True))
        return cls(x, y, surface.heights_mm(x, y), pitch)

    @property
    def ends_mm(self) -> tuple[FloatArray, FloatArray]:
        """Lower and upper corner (xy) of the rectangle that the cells cover, mm."""
        half = self.pitch_mm / 2
        low = np.array([self.x_mm[0], self.y_mm[0]]) - half
        return low, np.array([self.x_mm[-1], self.y_mm[-1]]) + half

    def across(self, upright: FloatArray) -> "Heights":
        """Return the heights along a unit vector (xyz) instead of z, for a tilted specimen."""
        aside = upright[0] * self.x_mm + upright[1] * self.y_mm[:, None]
        return replace(self, z_mm=aside + upright[2] * self.z_mm)

    def cells_of(self, xy_mm: FloatArray) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Return rows (n,) and columns (n,) of the cells nearest to points (n, xy), mm."""
        places = [
            np.clip(np.rint((xy_mm[:, axis] - of[0]) / self.pitch_mm), 0, len(of) - 1)
            for axis, of in ((1, self.y_mm), (0, self.x_mm))
        ]
        return places[0].astype(np.intp), places[1].astype(np.intp)


@dataclass(frozen=True, eq=False)
class ObjectPoints:
    """Measured points with their masks, or the points of the true face at the same pixels.

    Attributes
    ----------
    points_mm : (n, xyz) points in the world frame, mm
    sigma_mm : (n,) standard uncertainty along z, mm; None if the method predicts none
    touching : (n,) bool: the elastomer touches the specimen there, or the bare specimen is visible
    over : (n,) bool: the point is above the specimen, touching or not
    together : number of points that share one error
    pixels : (n,) flat index of the camera pixel, or of the cell under a sheet; None if not known
    points_each : number of measured points that each point represents
    under : the object under a sheet, if its local thickness is subtracted; else None
    """

    points_mm: FloatArray
    sigma_mm: FloatArray | None
    touching: BoolImage
    over: BoolImage
    together: float
    pixels: IntArray | None = None
    points_each: float = 1.0
    under: ObjectUnderSheet | None = None

    def part(self, selected: BoolImage) -> "ObjectPoints":
        """Return the points that a mask (n,) selects."""
        sigma, pixels = self.sigma_mm, self.pixels
        return replace(
            self,
            points_mm=at_pixels(self.points_mm, selected),
            sigma_mm=None if sigma is None else at_pixels(sigma, selected),
            touching=at_pixels(self.touching, selected),
            over=at_pixels(self.over, selected),
            pixels=None if pixels is None else at_pixels(pixels, selected),
        )

    def thinned(self) -> "ObjectPoints":
        """Return every n-th point, at most 2,500: distances of these to a mesh take about 1 s."""
        nth = max(1, -(-len(self.points_mm) // _MOST_ALIGNED))
        selected = np.zeros(len(self.points_mm), bool)
        selected[::nth] = True
        return replace(self.part(selected), together=max(1.0, self.together / nth))

    def noise_mm(self, estimate: FittedDimension) -> float:
        """Return the standard uncertainty, mm, of a fitted value, from the noise of the points.

        If the points have no sigma, the standard deviation of the residuals is used as one error
        common to all points. The reason: the errors of a method that integrates slopes extend over
        the whole field.
        """
        if self.under is not None and self.pixels is not None:
            return self.under.noise_of(estimate, self.pixels).sigma_mm
        if self.sigma_mm is not None:
            return estimate.noise_mm(self.sigma_mm, self.together)
        spread = np.std(estimate.residuals_mm[estimate.used])
        count = len(self.points_mm)
        return estimate.noise_mm(np.full(count, spread), float(count))


@dataclass(frozen=True, eq=False)
class ObjectView:
    """Measured points of an object, together with its true surface.

    Attributes
    ----------
    shape : geometry of the specimen
    surface : true surface in its true position. Under an elastomer of unknown local thickness, the
        surface is offset outwards by the nominal thickness
    measured : measured points of the object
    coat, true_face : measured points of the visible surface (coat or specimen), and its true
        points at the same pixels
    coverage : share of the specimen's pixels that have a point in contact; None: not visible
    heights : true heights of the specimen over the points
    pixel_mm : distance of neighbouring points, mm
    gratings : parts of the specimen with a grating
    covered : True if the elastomer is between object and coat
    """

    shape: Shape
    surface: TrueSurface
    measured: ObjectPoints
    coat: ObjectPoints
    true_face: ObjectPoints
    coverage: float | None
    heights: Heights
    pixel_mm: float
    gratings: tuple[Feature, ...]
    covered: bool = False


def is_covered(experiment: Experiment) -> bool:
    """Return True if the elastomer is between the object and the visible coat."""
    return experiment.method.presses and experiment.elastomer.layout == "opposite_face"


def surface_of(
    experiment: Experiment, pressed: PressedElastomer | None, grown: bool = True
) -> TrueSurface:
    """Return the true surface of the specimen after the press, or on its stage without a press.

    Parameters
    ----------
    grown : True: offset the surface outwards by the nominal thickness of the layer between object
        and visible surface
    """
    shape = shape_of(experiment.specimen)
    if pressed is None:
        return TrueSurface(shape, 0.0)
    slab = experiment.elastomer
    skin_mm = slab.thickness_mm if grown and is_covered(experiment) else 0.0
    return TrueSurface(shape, pressed.depth_mm + slab.touched_plane_mm, skin_mm)


def seen_object(
    experiment: Experiment,
    points: tuple[NDArray[np.floating], BoolImage, NDArray[np.floating] | None],
    truth: Truth,
    pressed: PressedElastomer | None,
    under: ObjectUnderSheet | None = None,
) -> ObjectView | None:
    """Select the measured points of the object.

    None if there are fewer than two points, or if all pixels that show the object have the same
    world x or y.

    Parameters
    ----------
    points : world_mm (row, col, xyz), valid (row, col), sigma_z_mm (row, col) or None
    under : the object under a thin sheet, reconstructed from these points; None without a sheet
    """
    world_mm, valid, sigma_mm = points
    visible = truth.lit if experiment.method.fringes and pressed is not None else truth.measured
    surface = surface_of(experiment, pressed, grown=under is None)
    nth = _nth(int(visible.sum()))
    every = (slice(None, None, nth), slice(None, None, nth))
    target, true_mm = visible[every], truth.points_world_mm[every].astype(np.float64)
    measured_target = target & valid[every]
    xy = np.ascontiguousarray(at_pixels(true_mm[..., :2], target).T)
    if measured_target.sum() < 2 or not np.ptp(xy, axis=1).all():
        return None
    heights = Heights.over(surface, xy.T)
    touching, over = _places(xy.T, target, heights, pressed)
    whole = int((target & over).sum())
    blur_px = experiment.decode.filter_sigma_px if experiment.decode.filter_taps else 0.0
    pixels = np.arange(visible.size).reshape(visible.shape)[every]
    touching, over, pixels, true_face = (
        at_pixels(values, measured_target) for values in (touching, over, pixels, true_mm)
    )
    on = (touching, over, shared_by(blur_px, nth), pixels, float(nth**2))
    sigma = None if sigma_mm is None else at_pixels(sigma_mm[every], measured_target)
    sigma = None if sigma is None else sigma.astype(np.float64)
    world = at_pixels(world_mm[every], measured_target).astype(np.float64)
    coat = ObjectPoints(world, sigma, *on)
    measured, known = coat, touching
    if under is not None:
        measured, known = _cells_of(under, heights), under.touches(coat.points_mm[:, :2])
    return ObjectView(
        shape=surface.shape,
        surface=surface,
        measured=measured,
        coat=coat,
        true_face=ObjectPoints(true_face, np.zeros(len(true_face)), *on),
        coverage=float((known & over).sum()) / whole if whole else None,
        heights=heights,
        pixel_mm=_pitch(true_mm, target),
        gratings=gratings_of(experiment.specimen),
        covered=is_covered(experiment),
    )


def _cells_of(under: ObjectUnderSheet, heights: Heights) -> ObjectPoints:
    """Return the object's points under a sheet, one per cell of the measured relief."""
    measured = under.sheet.relief.measured
    points = under.sheet.object_mm[measured]
    xy, (low, high) = points[:, :2], heights.ends_mm
    over = np.isfinite(heights.z_mm[heights.cells_of(xy)])
    over &= np.all((xy >= low) & (xy <= high), axis=1)
    return ObjectPoints(
        points_mm=points,
        sigma_mm=None,
        touching=under.core[measured],
        over=over,
        together=1.0,
        pixels=np.flatnonzero(measured),
        under=under,
    )


def _nth(count: int) -> int:
    return max(1, ceil(sqrt(count / _MOST_POINTS)))


def _places(
    xy: FloatArray, target: BoolImage, heights: Heights, pressed: PressedElastomer | None
) -> tuple[BoolImage, BoolImage]:
    """Return masks (row, col) of the pixels in contact with the specimen, and of those over it.

    Parameters
    ----------
    xy : (n, xy) true positions at the pixels of `target`, mm
    """
    touching, over = np.zeros(target.shape, bool), np.zeros(target.shape, bool)
    if pressed is None:
        return target, target
    over[target] = np.isfinite(heights.z_mm[heights.cells_of(xy)])
    row = _nearest(pressed.y_mm, xy[:, 1])
    touching[target] = pressed.contact[row, _nearest(pressed.x_mm, xy[:, 0])]
    return touching, over


def _nearest(places: FloatArray, target: FloatArray) -> NDArray[np.intp]:
    """Return the index (n,) of the evenly spaced position nearest to each target (n,)."""
    step = (places[-1] - places[0]) / max(len(places) - 1, 1)
    nearest = np.clip(np.rint((target - places[0]) / step), 0, len(places) - 1)
    return np.asarray(nearest, np.intp)


def _pitch(true_mm: FloatArray, target: BoolImage) -> float:
    both = target[:, 1:] & target[:, :-1]
    steps = at_pixels((true_mm[:, 1:] - true_mm[:, :-1])[..., :2], both)
    return float(np.median(np.hypot(steps[:, 0], steps[:, 1]))) if len(steps) else 0.0
