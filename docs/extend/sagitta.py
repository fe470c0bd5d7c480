"""A measurand as a plug-in: the sagitta of a ball, its apex over a ring round it."""

import math

import numpy as np

from reconstruction.errors import FitError
from reconstruction.evaluate.estimates import fit_linear
from twin.config.nominal import NominalBall
from twin.results.measurands import MEASURANDS, MeasurandKind, fitted

RING_MM = 1.0


class Sagitta(MeasurandKind):
    """The height of a ball's apex over a ring of 1 mm radius."""

    name, unit = "sagitta", "mm"
    summary = f"of a ball, over a ring of {RING_MM:g} mm radius"
    hidden = True  # an elastomer over the ball has another curvature
    bound_name = "crb_sagitta_um"

    def nominal_mm(self, nominal):
        """Return R - sqrt(R^2 - r^2); None if the feature is no ball larger than the ring."""
        if not isinstance(nominal, NominalBall) or nominal.radius_mm <= RING_MM:
            return None
        return nominal.radius_mm - math.sqrt(nominal.radius_mm**2 - RING_MM**2)

    def count(self, feature):
        """Return the number of balls."""
        return len(feature.balls)

    def fit(self, request, feature, observed, points):
        """Fit z = c + a x + b y - sagitta (distance / ring)^2 to the points inside the ring."""
        ball = feature.balls[request.number - 1]
        place = (points.points_mm[:, :2] - [ball.x_mm, ball.y_mm]) / RING_MM
        inside = points.touching & (np.sum(place**2, axis=1) <= 1.0)
        if inside.sum() < 20:
            raise FitError(f"sagitta: {inside.sum()} points inside the ring, 20 needed")
        cap, place = points.part(inside), place[inside]
        design = np.column_stack([-np.sum(place**2, axis=1), np.ones(len(place)), place])
        return fitted(cap, fit_linear(design, cap.points_mm[:, 2]))


SAGITTA = MEASURANDS.register(Sagitta())
