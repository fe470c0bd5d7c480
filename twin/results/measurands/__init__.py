"""Measurands: the quantities that a measurement determines of the object. One kind per module.

A kind is one file of this package, of an installed package (entry points of the group
`fringe_twin.measurands`) or of the user (`--plugin`). Its figures, its uncertainty, its verdict and
its row on the page follow from the result of `fit`. Minimal example:

    class Sagitta(MeasurandKind):
        name, unit = "sagitta", "mm"
        summary = "height of a ball's apex over a ring round it"

        def nominal_mm(self, nominal): ...
        def fit(self, request, feature, observed, points): ...

    MEASURANDS.register(Sagitta())

Only points where the object is touched (or seen) take part in a fit: where an elastomer spans
freely its surface is not the object's. Where fits differ from a caliper, docs/evaluation.md says
so. Frame: world, mm; a feature's own frame by `Feature.own`.
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
"""Points that each part of a groove or of a wave needs."""

SIGMAS_ABOVE_NOISE = 3.0
"""A height below so many standard deviations of the noise is not measured."""

# Cells of a sheet's contact that a fit needs, as `reconstruction.compensation.parts_of`.
_LEAST_CELLS = 30


@dataclass(frozen=True, eq=False)
class FittedValue:
    """A fitted value, and the points that it rests on.

    Attributes
    ----------
    value : in mm; of a share the share
    noise_mm : standard uncertainty from the points
    points_mm : (n, xyz) the points that took part
    estimate : how the value follows from the heights of `of`; None where that is no fit
    of : the points that were fitted
    """

    value: float
    noise_mm: float
    points_mm: FloatArray
    estimate: FittedDimension | None = None
    of: ObjectPoints | None = None


class SectionLine(Protocol):
    """A straight line in the world's xy plane, along which a section is drawn; s, x, y in mm."""

    def points(self, s_mm: FloatArray, /) -> FloatArray:
        """Return world xy (n, 2) of positions (n,)."""
        ...

    def position(self, x_mm: FloatArray, y_mm: FloatArray, /) -> FloatArray:
        """Return the positions s of the feet of world points."""
        ...

    def offset(self, x_mm: FloatArray, y_mm: FloatArray, /) -> FloatArray:
        """Return the signed distances of world points from the line."""
        ...


Curve = tuple[FloatArray, FloatArray]
"""Positions s along a section and heights z of the world, (n,) mm."""


class MeasurandKind(QuantityKind):
    """A quantity that is fitted to points of the object.

    A kind states the attributes of `QuantityKind`, and the differences to its defaults.

    Attributes
    ----------
    coat_in_contact : True: a fit to the coat uses only points in contact; False: all points
    nominal_is_limit : `nominal_mm` is the largest allowed value
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
        """Fit the quantity to points, of the object, of the coat, or of the true face.

        Parameters
        ----------
        request : the `[[measurand]]` table
        feature : the part of the specimen, with its pose and its nominal features
        points : those between x_mm and y_mm of the request; use `points.touching` or `points.over`

        Raises
        ------
        FitError : the points do not determine it
        """
        raise NotImplementedError(f"measurand {self.name!r} has no function fit")

    def nominal_mm(self, nominal: NominalFeature) -> float | None:
        """Return the length, mm, that a nominal feature states; None if it states none."""
        return nominal.lengths_mm.get(self.name)

    def requested_mm(self, request: ObjectMeasurand, feature: Feature) -> float | None:
        """Return the nominal length, mm, of a table, or else of the specimen; None without both."""
        if request.nominal_mm is not None:
            return request.nominal_mm
        known = self.known_mm(feature)
        return known[request.number - 1] if request.number <= len(known) else None

    def known_mm(self, feature: Feature) -> list[float]:
        """Return the nominal lengths of a part, counted along x."""
        lengths = [self.nominal_mm(nominal) for nominal in feature.specimen.nominal_features()]
        return [length for length in lengths if length is not None]

    def count(self, feature: Feature) -> int | None:
        """Return how many such features a part has; None if the number is not limited."""
        return None

    def check(self, request: ObjectMeasurand, specimen: Specimen, feature: Feature) -> None:
        """Check a table before anything is measured.

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
        """Yield the measurands that a part has without a `[[measurand]]` table.

        The nominal lengths of the part are added by the caller.
        """
        yield from ()

    def theory_mm(self, value_mm: float, sheet: CompensatedSheet) -> tuple[float, ...]:
        """Return standard uncertainties, mm, that the model of the sheet causes; () if none.

        Those that the sheet's properties cause are added by the caller.
        """
        return ()

    def curves(self, points_mm: FloatArray, line: SectionLine, observed: ObjectView) -> list[Curve]:
        """Return the fitted shape along a section, to be drawn; [] where none is.

        Parameters
        ----------
        points_mm : (n, xyz) the points that took part
        """
        return []


def measurand_of(request: ObjectMeasurand) -> MeasurandKind:
    """Return the kind of a table.

    Raises
    ------
    InputError : the kind is registered, but cannot be fitted
    """
    kind = MEASURANDS[request.quantity]
    if not isinstance(kind, MeasurandKind):
        raise InputError(f"measurand {kind.name}: found no twin.results.measurands.MeasurandKind")
    return kind


def fitted(points: ObjectPoints, estimate: FittedDimension) -> FittedValue:
    """Return a fit to points with its noise."""
    used = points.points_mm[estimate.used]
    return FittedValue(estimate.value, points.noise_mm(estimate), used, estimate, points)


def enough(points: ObjectPoints, of: str) -> ObjectPoints:
    """Return points under a sheet if they are enough for a fit; those of other methods always.

    Raises
    ------
    FitError : fewer than 30 cells
    """
    cells = len(points.points_mm)
    if points.under is not None and cells < _LEAST_CELLS:
        raise FitError(f"the sheet touches {of} on {cells} cells, {_LEAST_CELLS} are needed")
    return points


def in_ranges(request: ObjectMeasurand, points: ObjectPoints) -> ObjectPoints:
    """Return the points between `x_mm` and `y_mm` of a table."""
    inside = np.ones(len(points.points_mm), bool)
    for axis, bounds in enumerate((request.x_mm, request.y_mm)):
        if bounds is not None:
            inside &= (points.points_mm[:, axis] >= bounds[0]) & (
                points.points_mm[:, axis] <= bounds[1]
            )
    return points.part(inside)


def inside(feature: Feature, points: ObjectPoints, x_mm: float, y_mm: float) -> BoolImage:
    """Return which points (n,) are within a length and a width about a feature's middle."""
    own = np.abs(feature.own(points.points_mm))
    return np.asarray((own[:, 0] <= x_mm / 2) & (own[:, 1] <= y_mm / 2))
