"""RMS of the deviations of the points from the true object after an alignment."""

from reconstruction.arrays import Alignment, FloatArray
from reconstruction.errors import FitError
from reconstruction.evaluate.deviation import Deviations, deviations, normals_of
from twin.config.measurands import ObjectMeasurand
from twin.results.features import Feature
from twin.results.measurands import MEASURANDS, FittedValue, MeasurandKind, fitted
from twin.results.object_points import ObjectPoints, ObjectView


class RmsDeviation(MeasurandKind):
    """Measurand: the RMS, um, of the distances of the points from the true object."""

    name = "deviation"
    summary = "RMS after `alignment`"
    unit = "um"

    def fit(
        self,
        request: ObjectMeasurand,
        feature: Feature,
        observed: ObjectView,
        points: ObjectPoints,
    ) -> FittedValue:
        """Return the RMS of the deviations along the normals of the object's surface."""
        used, aligned, upward = aligned_points(request, observed, points, request.alignment)
        return fitted(used, aligned.rms(upward))


def aligned_points(
    request: ObjectMeasurand, observed: ObjectView, points: ObjectPoints, alignment: Alignment
) -> tuple[ObjectPoints, Deviations, FloatArray]:
    """Return points of the object, their aligned deviations, and z (n,) of the unit normals.

    Raises
    ------
    FitError : there is no point on the object in the ranges of the request
    """
    used = points.part(points.touching if request.over == "contact" else points.over).thinned()
    if not len(used.points_mm):
        raise FitError("deviation: no point on the object in the given ranges")
    distance = observed.surface.distance_mm
    normals = normals_of(used.points_mm, distance)
    return used, deviations(used.points_mm, distance, alignment, normals), normals[:, 2]


MEASURANDS.register(RmsDeviation())
