"""Check whether a calibration can be that of a real rig, by limits that hold for every real rig.

With a wrong pixel size, a mirrored image or a wrong unit a calibration often still converges, but
its numbers are far outside these limits. An inaccurate but valid calibration is inside.

| quantity | plausible range | reason for the limits |
|---|---|---|
| diagonal field of view | 0.1 to 170 degrees | below: parallel rays; above: no pinhole lens |
| image centre to principal point | up to 80 degrees | it is 63 at 100 % offset, throw ratio 0.25 |
| pixel ratio fy / fx | 0.1 to 10 | real devices have 1/2, 1 or 2 |
| baseline | 1 mm to 20 m | lenses in contact to the size of a hall: a wrong unit of length |
| triangulation angle | 0.5 to 150 degrees | below: no depth; above: no surface visible to both |
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from reconstruction.errors import InputError
from reconstruction.pixel_shape import PIXEL_RATIOS
from reconstruction.rig.calibration import Calibration
from reconstruction.rig.pinhole import Pinhole

FIELDS_OF_VIEW_DEG = (0.1, 170.0)
MOST_AXIS_OFFSET_DEG = 80.0
TRIANGULATION_ANGLES_DEG = (0.5, 150.0)
BASELINES_MM = (1.0, 2e4)
# Largest number of failed checks in a message: a meaningless calibration fails nearly all checks.
MOST_NAMED = 3


@dataclass(frozen=True)
class Check:
    """Value of one quantity of a calibration, and the range in which the value is plausible.

    Parameters
    ----------
    name : name of the quantity; it ends with the unit
    value, low, high : value and ends of the plausible range, in that unit
    """

    name: str
    value: float
    low: float
    high: float

    @property
    def is_plausible(self) -> bool:
        """Whether the value is inside the range; False for NaN."""
        return bool(self.low <= self.value <= self.high)

    def __str__(self) -> str:
        if self.low in (0.0, -math.inf):
            return f"{self.name} is {self.value:.3g}, plausible up to {self.high:.3g}"
        if math.isinf(self.high):
            return f"{self.name} is {self.value:.3g}, plausible from {self.low:.3g}"
        return f"{self.name} is {self.value:.3g}, plausible {self.low:.3g} to {self.high:.3g}"


def lens_checks(name: str, device: Pinhole) -> tuple[Check, ...]:
    """Return the checks of the intrinsics of the camera or projector called `name`."""
    half_diagonal = math.hypot(device.width_px / device.fx_px, device.height_px / device.fy_px) / 2
    across = (device.cx_px - (device.width_px - 1) / 2) / device.fx_px
    down = (device.cy_px - (device.height_px - 1) / 2) / device.fy_px
    offset_deg = math.degrees(math.atan(math.hypot(across, down)))
    field_deg = 2 * math.degrees(math.atan(half_diagonal))
    return (
        Check(f"{name}_field_of_view_deg", field_deg, *FIELDS_OF_VIEW_DEG),
        Check(f"{name}_axis_offset_deg", offset_deg, 0.0, MOST_AXIS_OFFSET_DEG),
        Check(f"{name}_pixel_ratio", device.fy_px / device.fx_px, *PIXEL_RATIOS),
    )


def rig_checks(calibration: Calibration) -> tuple[Check, ...]:
    """Return the checks of both devices' intrinsics and of the triangulation angle."""
    angle_deg = calibration.triangulation_angle_deg
    return (
        *lens_checks("camera", calibration.camera),
        *lens_checks("projector", calibration.projector),
        Check("triangulation_angle_deg", angle_deg, *TRIANGULATION_ANGLES_DEG),
    )


def implausible(checks: Iterable[Check]) -> str:
    """Return the failed checks, at most three, as one line of text; "" if no check fails."""
    failed = [str(check) for check in checks if not check.is_plausible]
    return ", ".join(failed[:MOST_NAMED])


def require_plausible(checks: Sequence[Check], remedy: str) -> None:
    """Raise InputError if a check fails; the message has the failed checks and `remedy`."""
    failed = implausible(checks)
    if failed:
        raise InputError(f"the calibration is implausible: {failed}; {remedy}")
