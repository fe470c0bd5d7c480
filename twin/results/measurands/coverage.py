"""Share of the specimen that has a point where it is touched."""

from reconstruction.errors import FitError
from twin.config.measurands import ObjectMeasurand
from twin.results.features import Feature
from twin.results.measurands import MEASURANDS, FittedValue, MeasurandKind
from twin.results.object_points import ObjectPoints, ObjectView


class Coverage(MeasurandKind):
    """The share of the specimen that is measured."""

    name = "coverage"
    summary = "share of the specimen with a point where it is touched"
    unit = "share"

    def fit(
        self,
        request: ObjectMeasurand,
        feature: Feature,
        observed: ObjectView,
        points: ObjectPoints,
    ) -> FittedValue:
        """Return the share of the whole specimen."""
        if observed.coverage is None:
            raise FitError("coverage: no pixel of the camera shows the specimen")
        return FittedValue(observed.coverage, 0.0, points.points_mm[points.touching])


MEASURANDS.register(Coverage())
