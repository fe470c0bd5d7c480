"""Decide whether a value is within its tolerance, by ISO 14253-1 with guard band U.

U is the expanded uncertainty. Conformity is proved if the value is inside the tolerance by at least
U. Non-conformity is proved if the value is outside by at least U. Otherwise neither is proved.
"""

from dataclasses import dataclass
from math import hypot, inf
from typing import Literal

Decision = Literal["within tolerance", "not within tolerance", "cannot tell"]
WITHIN: Decision = "within tolerance"
NOT_WITHIN: Decision = "not within tolerance"
CANNOT_TELL: Decision = "cannot tell"


@dataclass(frozen=True)
class Tolerance:
    """Range of allowed values, from `lower` to `upper`, both included; infinite: no limit."""

    lower: float = -inf
    upper: float = inf

    def margin(self, value: float, expanded: float) -> float:
        """Return the distance of a value from the nearer limit, positive inside, minus U.

        Conformity is proved if the result is 0 or more.

        Parameters
        ----------
        value, expanded : measured value, and its expanded uncertainty U in the same unit
        """
        return min(value - self.lower, self.upper - value) - expanded

    def verdict(self, value: float, expanded: float) -> Decision:
        """Return the decision for a value with the expanded uncertainty U = `expanded`."""
        if self.margin(value, expanded) >= 0:
            return WITHIN
        outside = max(self.lower - value, value - self.upper)
        return NOT_WITHIN if outside >= expanded and outside > 0 else CANNOT_TELL


@dataclass(frozen=True)
class CombinedUncertainty:
    """Contributions to the standard uncertainty of one value, in its unit, and coverage factor k.

    Attributes
    ----------
    noise : contribution of the noise of the points, propagated through the fit
    repeatability : contribution of setting up and measuring again
    calibration : contribution of the reference with which the sensor was calibrated
    coverage_factor : k, the ratio of expanded to standard uncertainty
    elastomer : contribution of the thickness that is subtracted between coat and object
    """

    noise: float
    repeatability: float = 0.0
    calibration: float = 0.0
    coverage_factor: float = 2.0
    elastomer: float = 0.0

    @property
    def standard(self) -> float:
        """Combined standard uncertainty, the root sum of squares of all contributions."""
        return hypot(self.noise, self.repeatability, self.calibration, self.elastomer)

    @property
    def expanded(self) -> float:
        """Expanded uncertainty U = k u, with the combined standard uncertainty u."""
        return self.coverage_factor * self.standard
