"""Lateral resolution: the finest pitch of gratings that is measured with 50 % of its depth."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from reconstruction.errors import FitError, InputError
from twin.config.measurands import ObjectMeasurand
from twin.config.nominal import NominalGrating
from twin.config.specimen_base import Specimen
from twin.results.features import Feature, gratings_of
from twin.results.measurands import (
    MEASURANDS,
    SIGMAS_ABOVE_NOISE,
    FittedValue,
    MeasurandKind,
    in_ranges,
)
from twin.results.measurands.depth import Depth
from twin.results.object_points import ObjectPoints, ObjectView

KEPT_SHARE = 0.5
"""Share of its depth with which a grating is resolved (lateral period limit, ISO 25178-600)."""


class GratingResolution(MeasurandKind):
    """Measurand: the finest resolved pitch of the specimen's gratings, mm."""

    name = "resolution"
    summary = "finest pitch of the gratings that keeps half its depth"
    nominal_is_limit = True

    def fit(
        self,
        request: ObjectMeasurand,
        feature: Feature,
        observed: ObjectView,
        points: ObjectPoints,
    ) -> FittedValue:
        """Return the finest resolved pitch for which all coarser gratings are resolved, too.

        A grating is resolved if the depth on the measured coat is at least 50 % of the nominal
        depth. This depth must also be at least three standard deviations of its noise.

        Raises
        ------
        FitError : the coarsest grating is not resolved, or the depth of a grating cannot be fitted
        """
        finest = None
        # The relief of the coat itself is used, because a grating that gel or sheet does not touch
        # must count as not resolved.
        shown = points if points.under is None else in_ranges(request, observed.coat)
        points = replace(shown, touching=np.ones(len(shown.points_mm), bool))
        gratings = [(part.specimen.nominal(NominalGrating)[0], part) for part in observed.gratings]
        for grating, part in sorted(gratings, key=lambda pair: pair[0].pitch_mm, reverse=True):
            depth = Depth().fit(request, part, observed, points)
            remaining_share = depth.value / grating.depth_mm
            if remaining_share < KEPT_SHARE or depth.value < SIGMAS_ABOVE_NOISE * depth.noise_mm:
                break
            finest = FittedValue(grating.pitch_mm, 0.0, depth.points_mm)
        if finest is None:
            raise FitError("resolution: none of the gratings keeps half its depth above the noise")
        return finest

    def check(self, request: ObjectMeasurand, specimen: Specimen, feature: Feature) -> None:
        """Check that the specimen has a grating.

        Raises
        ------
        InputError : the specimen has no grating
        """
        if not gratings_of(specimen):
            raise InputError(
                f"measurand {request.name}: resolution is that of gratings, found "
                f"{feature.specimen.kind}; use kind = 'grating', or a group of several pitches"
            )

    def defaults(self, feature: Feature) -> Iterator[ObjectMeasurand]:
        """Yield one resolution with the same name for every grating: a group has only one."""
        if feature.specimen.nominal(NominalGrating):
            yield ObjectMeasurand(name=self.name, quantity=self.name)


MEASURANDS.register(GratingResolution())
