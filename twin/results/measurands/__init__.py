"""Measurands: quantities of the object that a measurement determines, one kind per module.

A kind is defined in one file of this package, of an installed package (entry points of the group
`fringe_twin.measurands`) or of the user (`--plugin`). The figures of a measurand, its uncertainty,
verdict and row on the report page follow from the result of `fit`. Minimal example:

    class Sagitta(MeasurandKind):
        name, unit = "sagitta", "mm"
        summary = "height of a ball's apex over a ring round it"

        def nominal_mm(self, nominal): ...
        def fit(self, request, feature, observed, points): ...

    MEASURANDS.register(Sagitta())

Only points where the elastomer touches the object, or where the bare object is visible, take part
in a fit. Where the elastomer spans freely, its surface is not that of the object.
docs/evaluation.md states where fits differ from a caliper. Points are in the world frame, mm;
`Feature.own` transforms them to the own frame of a feature.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from reconstruction.arrays import BoolImage, FloatArray
from reconstruction.compensation import CompensatedSheet
from reconstruction.errors import FitError, InputError
from reconstruction.evaluate.estimates import FittedDimension
from twin.config.measurands import MEASURANDS, ObjectMeasurand, QuantityKind
from twin.config.nominal import NominalFeature
from twin.config.specimen_base import Specimen
from twin.results.features import Feature
from twin.results.object_points import ObjectPoints, ObjectView

__all__ = [
    "LEAST_IN_PART",
    "MEASURANDS",
    "SIGMAS_ABOVE_NOISE",
    "Curve",
    "FittedValue",
    "MeasurandKind",
    "SectionLine",
    "enough",
    "fitted",
    "in_ranges",
    "inside",
    "measurand_of",
]

LEAST_IN_PART = 3
"""Least number of points in each part of a groove or of a wave."""

SIGMAS_ABOVE_NOISE = 3.0
"""A height of fewer standard deviations of the noise is taken as not measured."""

# Least number of cells of a sheet's contact for a fit, as in
# `reconstruction.compensation.parts_of`.
_LEAST_CELLS = 30


@dataclass(frozen=True, eq=False)
class FittedValue:
    """A fitted value of a measurand, and the points from which it was fitted.

    Attributes
    ----------
    value : fitted value, mm; for a share, the share 0 to 1
    noise_mm : standard uncertainty of the value by noise and texture of the points, mm
    points_mm : (n, xyz) the points that took part
    estimate : fit of the value with its derivatives by the heights of `of`; None if the value is
        not fitted to points
    of : all points that were given to the fit; None if the value is not fitted to points
    layer_mm : standard uncertainty, mm, by the uncertain values and the model of a sheet, if the
        fit itself determines it
    """

    value: float
    noise_mm: float
    points_mm: FloatArray
    estimate: FittedDimension | None = None
    of: ObjectPoints | None = None
    layer_mm: float = 0.0


class SectionLine(Protocol):
    """A straight line in the world's xy plane, along which a section is drawn; s, x, y in mm."""

    def points(self, s_mm: FloatArray, /) -> FloatArray:
        """Return world x and y (n, 2), mm, at positions s (n,), mm, along the line."""
        ...

    def position(self, x_mm: FloatArray, y_mm: FloatArray, /) -> FloatArray:
        """Return the positions s, mm, along the line of the perpendicular feet of world points."""
        ...

    def offset(self, x_mm: FloatArray, y_mm: FloatArray, /) -> FloatArray:
        """Return the signed perpendicular distances, mm, of world points from the line."""
        ...


Curve = tuple[FloatArray, FloatArray]
"""Positions s along a section and heights z in the world frame, each (n,), mm."""


class MeasurandKind(QuantityKind):
    """Kind of a measurand: a quantity that is fitted to points of the object.

    A subclass sets the attributes of `QuantityKind`, implements `fit`, and overrides those other
    methods that have no suitable default.

    Attributes
    ----------
    coat_in_contact : True: a fit to the coat uses only points in contact; False: all points
    nominal_is_limit : True: the nominal value is the largest allowed value
    """

    coat_in_contact: bool = False
    nominal_is_limit: bool = False

    def fit(
        self,
        request: ObjectMeasurand,
        feature: Feature,
        observed: ObjectView,
        points: ObjectPoints,
    ) -> FittedValue:
        """Fit the quantity to given points: of the object, of the coat, or of the true face.

        Parameters
        ----------
        request : the `[[measurand]]` table that requests the quantity
        feature : the part of the specimen, with its pose and its nominal features
        observed : the measured object with its true surface
        points : points within the ranges x_mm and y_mm of the request; select with
            `points.touching` or `points.over`

        Raises
        ------
        FitError : the points do not determine it
        """
        raise NotImplementedError(f"measurand {self.name!r} has no function fit")

    def nominal_mm(self, nominal: NominalFeature) -> float | None:
        """Return this quantity of a nominal feature, mm; None if the feature does not have it."""
        return nominal.lengths_mm.get(self.name)

    def requested_mm(self, request: ObjectMeasurand, feature: Feature) -> float | None:
        """Return the nominal length, mm: the table's, else the specimen's; None if neither."""
        if request.nominal_mm is not None:
            return request.nominal_mm
        known = self.known_mm(feature)
        return known[request.number - 1] if request.number <= len(known) else None

    def known_mm(self, feature: Feature) -> list[float]:
        """Return the nominal values of this quantity, mm, of all features of a part, along x."""
        lengths = [self.nominal_mm(nominal) for nominal in feature.specimen.nominal_features()]
        return [length for length in lengths if length is not None]

    def count(self, feature: Feature) -> int | None:
        """Return the number of features of a part that have this quantity; None if not limited."""
        return None

    def check(self, request: ObjectMeasurand, specimen: Specimen, feature: Feature) -> None:
        """Check a `[[measurand]]` table before anything is measured.

        Raises
        ------
        InputError : the specimen has no such feature
        """
        count, kind = self.count(feature), feature.specimen.kind
        if count is not None and request.number > count:
            raise InputError(
                f"measurand {request.name}: {self.name} number {request.number}: the specimen "
                f"({kind}) has {count or 'none'}; ask for another quantity, number or part"
            )

    def defaults(self, feature: Feature) -> Iterator[ObjectMeasurand]:
        """Yield the measurands that a part has by default, without a `[[measurand]]` table.

        The caller adds those of the nominal lengths of the part.
        """
        yield from ()

    def theory_mm(self, value_mm: float, sheet: CompensatedSheet) -> tuple[float, ...]:
        """Return standard uncertainties of a value, mm, from the model of the sheet; () if none.

        The caller adds those from the uncertain properties of the sheet.
        """
        return ()

    def curves(self, points_mm: FloatArray, line: SectionLine, observed: ObjectView) -> list[Curve]:
        """Return curves of the fitted shape along a section for a plot; empty if there are none.

        Parameters
        ----------
        points_mm : (n, xyz) the points that took part
        """
        return []


def measurand_of(request: ObjectMeasurand) -> MeasurandKind:
    """Return the kind of measurand that a table requests.

    Raises
    ------
    InputError : the kind is registered, but cannot be fitted
    """
    kind = MEASURANDS[request.quantity]
    if not isinstance(kind, MeasurandKind):
        raise InputError(f"measurand {kind.name}: found no twin.results.measurands.MeasurandKind")
    return kind


def fitted(points: ObjectPoints, estimate: FittedDimension) -> FittedValue:
    """Return a fit to points as a `FittedValue` with its noise."""
    used = points.points_mm[estimate.used]
    return FittedValue(estimate.value, points.noise_mm(estimate), used, estimate, points)


def enough(points: ObjectPoints, of: str) -> ObjectPoints:
    """Return the points; raise FitError if they are under a sheet and too few for a fit.

    Raises
    ------
    FitError : the points are under a sheet, and are fewer than 30 cells
    """
    cells = len(points.points_mm)
    if points.under is not None and cells < _LEAST_CELLS:
        raise FitError(f"the sheet touches {of} on {cells} cells, {_LEAST_CELLS} are needed")
    return points


def in_ranges(request: ObjectMeasurand, points: ObjectPoints) -> ObjectPoints:
    """Return the points within the ranges `x_mm` and `y_mm` of a table."""
    inside = np.ones(len(points.points_mm), bool)
    for axis, bounds in enumerate((request.x_mm, request.y_mm)):
        if bounds is not None:
            inside &= (points.points_mm[:, axis] >= bounds[0]) & (
                points.points_mm[:, axis] <= bounds[1]
            )
    return points.part(inside)


def inside(feature: Feature, points: ObjectPoints, x_mm: float, y_mm: float) -> BoolImage:
    """Return a mask (n,) of the points in a rectangle x_mm x y_mm about a feature's middle.

    The sides of the rectangle are along the axes of the feature's own frame.
    """
    own = np.abs(feature.own(points.points_mm))
    return np.asarray((own[:, 0] <= x_mm / 2) & (own[:, 1] <= y_mm / 2))
