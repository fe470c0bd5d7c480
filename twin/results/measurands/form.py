"""Form deviation: width of the band with 95 % of the deviations after a rigid alignment."""

from twin.config.measurands import ObjectMeasurand
from twin.results.features import Feature
from twin.results.measurands import MEASURANDS, FittedValue, MeasurandKind, fitted
from twin.results.measurands.deviation import aligned_points
from twin.results.object_points import ObjectPoints, ObjectView


class Form(MeasurandKind):
    """Measurand: the width, um, of the band that contains 95 % of the deviations."""

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
        """Return the width of the band along the normals of the object's surface."""
        used, aligned, upward = aligned_points(request, observed, points, "rigid")
        return fitted(used, aligned.form(upward))


MEASURANDS.register(Form())
