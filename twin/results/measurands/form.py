"""Form deviation: band of 95 % of the distances from the true object after a rigid alignment."""

from twin.config.measurands import ObjectMeasurand
from twin.results.features import Feature
from twin.results.measurands import MEASURANDS, FittedValue, MeasurandKind, fitted
from twin.results.measurands.deviation import aligned_points
from twin.results.object_points import ObjectPoints, ObjectView


class Form(MeasurandKind):
    """The width of the band that contains 95 % of the deviations."""

    name = "form"
    summary = "band of 95 % of the deviations after a rigid alignment"
    unit = "um"

    def fit(
        self,
        request: ObjectMeasurand,
        feature: Feature,
        observed: ObjectView,
        points: ObjectPoints,
    ) -> FittedValue:
        """Return the band along the normal of the object's surface."""
        used, aligned, upward = aligned_points(request, observed, points, "rigid")
        return fitted(used, aligned.form(upward))


MEASURANDS.register(Form())
