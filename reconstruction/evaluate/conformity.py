"""Decision whether a value is within its tolerance, by ISO 14253-1 with guard band U.

Conformity is proved if the value is inside the tolerance by at least the expanded uncertainty U,
non-conformity if it is outside by as much; in between neither is proved.
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
    """Allowed values, limits included; no limit: infinite."""

    lower: float = -inf
    upper: float = inf

    def margin(self, value: float, expanded: float) -> float:
        """Return the distance to the nearer limit, positive inside, less U; 0 or more: within."""
        return min(value - self.lower, self.upper - value) - expanded

    def verdict(self, value: float, expanded: float) -> Decision:
        """Return the decision; `expanded` is U, in the unit of the value."""
        if self.margin(value, expanded) >= 0:
            return WITHIN
        outside = max(self.lower - value, value - self.upper)
        return NOT_WITHIN if outside >= expanded and outside > 0 else CANNOT_TELL


@dataclass(frozen=True)
class CombinedUncertainty:
    """Standard uncertainties of one value, in its unit, and the coverage factor k.

    Attributes
    ----------
    noise : of the points, propagated through the fit
    repeatability : of setting up and measuring again
    calibration : of the reference that the sensor was calibrated with
    elastomer : of the thickness that is subtracted between coat and object
    """

    noise: float
    repeatability: float = 0.0
    calibration: float = 0.0
    coverage_factor: float = 2.0
    elastomer: float = 0.0

    @property
    def standard(self) -> float:
        """Combined standard uncertainty."""
        return hypot(self.noise, self.repeatability, self.calibration, self.elastomer)

    @property
    def expanded(self) -> float:
        """U = k u."""
        return self.coverage_factor * self.standard
