"""Line loads of edges on a sheet, and the bands next to them where the sheet lifts off the object.

Lengths are in mm, pressures in kPa, line loads and line tensions in kPa mm. A sharp edge carries
the sheet along a line. A line load F turns the line of tension N by the angle F / N. Bending rounds
this kink over the length l = sqrt(h^2 / 6 + B / N), with the bending stiffness B and the local
thickness h (see `bar`). The deflection at the distance s from the load is F l / (2 N) exp(-s / l)
relative to the line of tension: the load is F l / (2 N) below that line, and the sheet behind an
edge lifts off a flat face by this height. Pressure p and tension bend it back onto the face over
the length L = sqrt(F l / p), because a parabola of the curvature p / N has the height F l / (2 N)
at this length. p is the contact pressure of the sheet behind the edge.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy import ndimage

from reconstruction.arrays import BoolArray, FloatArray
from reconstruction.compensation.relief import Relief
from reconstruction.compensation.sheet_layer import SheetLayer

# A lower lift-off is neglected: errors of a coat's points are about as large.
_LEAST_LIFT_MM = 1e-3
# Half width of the window that separates faces from lines, in widths of the blur.
_WINDOW_WIDTHS = 2.0
# Longer lift-offs are limited, so that a pressure near 0 does not remove all points.
_LONGEST_MM = 3.0
# The lengths are rounded up to so many levels.
_LEVELS = 8
# Ratio of a line load's largest pressure to the pressure's noise. The largest of the noise over a
# contact exceeds 4 standard deviations.
_SIGMAS_OF_LOAD = 6.0
# No division by 0 without air, and where the sheet has no tension.
_LEAST_KPA, _LEAST_KPA_MM = 1e-6, 1e-6


@dataclass(frozen=True, eq=False)
class LineLoads:
    """Cells with a line load, and the length of the lift-off next to each; (row, col) each.

    Attributes
    ----------
    reach_mm : length over which the sheet lifts off; 0 in a cell without a line load
    pitch_mm : edge lengths of a cell along x and y
    """

    reach_mm: FloatArray
    pitch_mm: tuple[float, float]

    def lifted(self) -> BoolArray:
        """Return the cells in which the sheet may have lifted off the object, (row, col) bool."""
        levels = np.linspace(0.0, float(self.reach_mm.max()), _LEVELS + 1)
        lifted = np.zeros(self.reach_mm.shape, bool)
        for above, up_to in pairwise(levels.tolist() if levels[-1] > 0 else ()):
            away_mm = ndimage.distance_transform_edt(
                self.reach_mm <= above, sampling=self.pitch_mm[::-1]
            )
            lifted |= away_mm <= up_to
        return lifted

    def enclosed(self) -> BoolArray:
        """Return the cells with line loads on all four sides, along x and y, (row, col) bool."""
        loaded = self.reach_mm > 0
        sides = [
            np.flip(np.logical_or.accumulate(np.flip(loaded, axis), axis=axis), axis)
            if backwards
            else np.logical_or.accumulate(loaded, axis=axis)
            for axis in range(2)
            for backwards in (False, True)
        ]
        return np.asarray(np.logical_and.reduce(sides))


@dataclass(frozen=True, eq=False)
class PressureMap:
    """Contact pressure of a sheet, blurred by a filter.

    Attributes
    ----------
    pressure_kpa : (row, col)
    noise_kpa, blur_mm : standard deviations of the noise and of the blur
    tension_kpa_mm : (row, col) mean of the two principal line tensions of the sheet
    local_mm : (row, col) local thickness of the sheet
    """

    pressure_kpa: FloatArray
    noise_kpa: float
    blur_mm: float
    tension_kpa_mm: FloatArray
    local_mm: FloatArray


def line_loads(pressed: PressureMap, relief: Relief, layer: SheetLayer) -> LineLoads:
    """Return the line loads in a map of the contact pressure.

    A cell has a line load if its pressure exceeds the largest pressure nearby of a face, which is
    wider than the blur, by more than the noise. A line load F, blurred to a Gaussian of standard
    deviation s, has the largest pressure F / (sqrt(2 pi) s).
    """
    half_mm = _WINDOW_WIDTHS * pressed.blur_mm
    window = [2 * int(np.ceil(half_mm / step)) + 1 for step in relief.pitch_mm[::-1]]
    of_faces = ndimage.grey_opening(np.maximum(pressed.pressure_kpa, 0.0), window)
    of_faces = ndimage.maximum_filter(of_faces, window)
    # The blurred line itself is wider than the window: there it has the share `tail` of its peak.
    tail = np.exp(-(_WINDOW_WIDTHS**2) / 2)
    excess = (pressed.pressure_kpa - of_faces) / (1 - tail)
    excess = np.where(excess > _SIGMAS_OF_LOAD * pressed.noise_kpa, excess, 0.0)
    face_kpa = np.maximum(of_faces - tail * excess, max(layer.back_pressure_kpa, _LEAST_KPA))
    load = np.sqrt(2 * np.pi) * pressed.blur_mm * excess
    tension = np.maximum(pressed.tension_kpa_mm, _LEAST_KPA_MM)
    moment = load * _bending_mm(tension, pressed.local_mm, layer)
    reach = np.minimum(np.sqrt(moment / face_kpa), _LONGEST_MM)
    return LineLoads(np.where(moment / (2 * tension) > _LEAST_LIFT_MM, reach, 0.0), relief.pitch_mm)


def _bending_mm(tension: FloatArray, local_mm: FloatArray, layer: SheetLayer) -> FloatArray:
    """Return the length over which bending decays, mm, as for the edge of a bar (`bar`)."""
    thinning, shear = local_mm / layer.thickness_mm, layer.young_modulus_kpa / 3
    stiffness = shear * thinning**2 * local_mm**3 / 3
    return np.asarray(np.sqrt(local_mm**2 / 6 + stiffness / tension))
