"""Radius of a ball or of a rod, fitted to the points in contact."""

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.compensation import CompensatedSheet
from reconstruction.errors import FitError
from reconstruction.evaluate import fit_ball
from reconstruction.evaluate.estimates import ball_radius, cylinder_radius
from twin.config.measurands import ObjectMeasurand
from twin.config.nominal import NominalRod
from twin.results.features import Feature
from twin.results.measurands import (
    MEASURANDS,
    Curve,
    FittedValue,
    MeasurandKind,
    SectionLine,
    enough,
    fitted,
)
from twin.results.object_points import ObjectPoints, ObjectView

# Share of the radius of a ball or rod within which points are fitted: farther from the apex the
# wall is too steep to be visible from above.
_CAP_SHARE = 0.9


class Radius(MeasurandKind):
    """Measurand: the radius of a ball or of a rod, mm."""

    name = "radius"
    summary = "of a ball or rod"
    hidden = True
    bound_name = "crb_radius_um"
    coat_in_contact = True

    def fit(
        self,
        request: ObjectMeasurand,
        feature: Feature,
        observed: ObjectView,
        points: ObjectPoints,
    ) -> FittedValue:
        """Fit a sphere, or a cylinder along the axis of the rod, to the points in contact."""
        if feature.balls:
            cap = _cap_of_ball(request, feature, points)
            return fitted(cap, ball_radius(cap.points_mm)[0])
        cap, axis = _top_of_rod(request, feature, points)
        return fitted(cap, cylinder_radius(cap.points_mm, axis)[0])

    def count(self, feature: Feature) -> int:
        """Return the number of balls and rods of a part."""
        return max(len(self.known_mm(feature)), len(feature.balls))

    def theory_mm(self, value_mm: float, sheet: CompensatedSheet) -> tuple[float, ...]:
        """Return the standard uncertainty of a radius, mm, from the theory of thin sheets."""
        return (sheet.theory_mm(value_mm),)

    def curves(self, points_mm: FloatArray, line: SectionLine, observed: ObjectView) -> list[Curve]:
        """Return the arc of the fitted ball along the section; empty without a ball."""
        return _arc(points_mm, line) if observed.shape.spheres() else []


def _cap_of_ball(request: ObjectMeasurand, feature: Feature, points: ObjectPoints) -> ObjectPoints:
    balls = feature.balls
    if request.number > len(balls):
        raise FitError(f"number: found {request.number}, the specimen has {len(balls)} balls")
    x, y = points.points_mm[:, 0], points.points_mm[:, 1]
    squared = [(x - ball.x_mm) ** 2 + (y - ball.y_mm) ** 2 for ball in balls]
    own = squared[request.number - 1]
    near = own <= np.min(squared, axis=0)
    near &= own <= (_CAP_SHARE * balls[request.number - 1].radius_mm) ** 2
    return enough(points.part(near & points.touching), f"ball {request.number}")


def _top_of_rod(
    request: ObjectMeasurand, feature: Feature, points: ObjectPoints
) -> tuple[ObjectPoints, FloatArray]:
    """Return the touching points on a rod's top, away from its ends, and its axis (xyz)."""
    rods, own = feature.specimen.nominal(NominalRod), feature.own(points.points_mm)
    if request.number > len(rods):
        raise FitError(f"radius {request.number}: the specimen has no such ball or rod")
    rod = rods[request.number - 1]
    axis, across = (0, 1) if rod.along == "x" else (1, 0)
    top = (np.abs(own[:, across] - rod.middle_mm) <= _CAP_SHARE * rod.radius_mm) & points.touching
    end_mm = rod.length_mm / 2 - rod.edge_radius_mm - 0.25 * rod.radius_mm
    top &= np.abs(own[:, axis]) <= end_mm
    cap = enough(points.part(top), f"rod {request.number}")
    return cap, feature.world_from_own.rotation[:, axis]


def _arc(points_mm: FloatArray, line: SectionLine) -> list[Curve]:
    try:
        ball = fit_ball(points_mm)
    except FitError:
        return []
    middle = float(line.position(ball.centre_mm[0], ball.centre_mm[1]))
    aside = float(line.offset(ball.centre_mm[0], ball.centre_mm[1]))
    reach = float(np.ptp(line.position(points_mm[:, 0], points_mm[:, 1]))) / 2
    s = np.linspace(-reach, reach, 200)
    up = np.maximum(ball.radius_mm**2 - s**2 - aside**2, 0.0)
    return [(middle + s, ball.centre_mm[2] + np.sqrt(up))]


MEASURANDS.register(Radius())
