"""Coverage: share of the specimen's pixels that have a point where the specimen is touched."""

from reconstruction.errors import FitError
from twin.config.measurands import ObjectMeasurand
from twin.results.features import Feature
from twin.results.measurands import MEASURANDS, FittedValue, MeasurandKind
from twin.results.object_points import ObjectPoints, ObjectView


class Coverage(MeasurandKind):
    """Measurand: the share, 0 to 1, of the specimen's pixels with a point in contact."""

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
        """Return the coverage of the whole specimen.

        Raises
        ------
        FitError : no pixel of the camera shows the specimen
        """
        if observed.coverage is None:
            raise FitError("coverage: no pixel of the camera shows the specimen")
        return FittedValue(observed.coverage, 0.0, points.points_mm[points.touching])


MEASURANDS.register(Coverage())
