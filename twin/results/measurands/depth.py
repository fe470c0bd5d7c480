"""Depth of a V groove, of the waves of a grating, or of a step if there is neither."""

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.errors import FitError
from reconstruction.evaluate.estimates import GrooveFit, v_groove, wave_depth
from twin.config.measurands import ObjectMeasurand
from twin.config.nominal import NominalGrating, NominalGroove
from twin.results.features import Feature
from twin.results.measurands import (
    LEAST_IN_PART,
    MEASURANDS,
    FittedValue,
    MeasurandKind,
    fitted,
    inside,
)
from twin.results.measurands.step_height import step_of
from twin.results.object_points import ObjectPoints, ObjectView

_PARTS_OF_WAVE = 8
# Where the sheet spans a groove freely, the groove seems to be touched if its pitch is less than
# this multiple of the blur of the contact's edge.
_LEAST_PITCH_OVER_BLUR = 6.0


class Depth(MeasurandKind):
    """Measurand: the depth of a groove or of a grating, mm."""

    name = "depth"
    summary = "of a groove, of the waves of a grating"
    hidden = True
    bound_name = "crb_depth_um"

    def fit(
        self,
        request: ObjectMeasurand,
        feature: Feature,
        observed: ObjectView,
        points: ObjectPoints,
    ) -> FittedValue:
        """Fit a wave, a groove or a step, whichever the specimen has, to the touching points."""
        points = points.part(points.touching)
        for grating in feature.specimen.nominal(NominalGrating):
            return _wave(grating, feature, points)
        for nominal in feature.specimen.nominal(NominalGroove):
            near, groove = groove_of(nominal, feature, points)
            return fitted(near, groove.depth)
        return step_of(points, feature, observed, self.requested_mm(request, feature))


def _wave(grating: NominalGrating, feature: Feature, points: ObjectPoints) -> FittedValue:
    over = points.part(inside(feature, points, grating.length_x_mm, grating.length_y_mm))
    place = feature.own(over.points_mm)
    _check_wave(grating.pitch_mm, place[:, 0], points)
    return fitted(over, wave_depth(place[:, 0], place[:, 2], grating.pitch_mm))


def _check_wave(pitch_mm: float, s_mm: FloatArray, points: ObjectPoints) -> None:
    """Raise FitError if parts of the wave are not touched, or if the contact is not resolved."""
    if points.under is not None and pitch_mm < _LEAST_PITCH_OVER_BLUR * points.under.blur_mm:
        least_mm = _LEAST_PITCH_OVER_BLUR * points.under.blur_mm
        raise FitError(
            f"grooves: a pitch of {pitch_mm:g} mm is finer than the contact under a sheet is known "
            f"({least_mm:g} mm): whether it touches their roots is open"
        )
    part = np.floor(s_mm / pitch_mm * _PARTS_OF_WAVE).astype(int) % _PARTS_OF_WAVE
    touched = np.bincount(part, minlength=_PARTS_OF_WAVE) >= LEAST_IN_PART
    if not touched.all():
        raise FitError(
            f"grooves: {touched.sum()} of {_PARTS_OF_WAVE} parts of the wave from crest to root "
            "are touched"
        )


def groove_of(
    nominal: NominalGroove, feature: Feature, points: ObjectPoints
) -> tuple[ObjectPoints, GrooveFit]:
    """Fit a V groove; return the points in and next to the groove, and the fit.

    Raises
    ------
    FitError : the face on both sides of the groove and both flanks are not all touched
    """
    near, place = _over_groove(nominal, feature, points.part(points.touching))
    groove = v_groove(place[:, 0], place[:, 2], nominal.depth_mm, nominal.opening_mm)
    aside = 2 * (place[:, 0] - groove.root_mm) / groove.width.value
    parts = (aside > 1, aside < -1, (aside > 0) & (aside < 1), (aside < 0) & (aside > -1))
    if min(int(part.sum()) for part in parts) < LEAST_IN_PART:
        raise FitError("groove: its face and both flanks must be touched")
    return near, groove


def _over_groove(
    groove: NominalGroove, feature: Feature, points: ObjectPoints
) -> tuple[ObjectPoints, FloatArray]:
    """Return the points near a groove, in the world frame and in the groove's own frame.

    Near means: over the groove, or at most one opening of the groove away on either side.
    """
    wide = min(groove.length_x_mm, 3 * groove.opening_mm)
    near = points.part(inside(feature, points, wide, 0.9 * groove.length_y_mm))
    return near, feature.own(near.points_mm)


MEASURANDS.register(Depth())
