"""Width and height of a rod's cross-section in a measured relief, as with a caliper.

A sheet draped over a rod on a plate rises from two valleys to a crest. The profile extends from
valley to valley. One width is taken where the profile crosses 50 % of the height of the crest above
the valleys. Two further widths are taken between the breaks of the slope on both sides, where the
sheet separates from the rod: at the largest curvature, and at the fastest change of the slope.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from reconstruction.arrays import FloatArray
from reconstruction.errors import FitError
from reconstruction.evaluate import BarWidth, bar_width, break_width, slope_change_width
from twin.config.models import Experiment
from twin.config.nominal import NominalBar, NominalRod
from twin.config.specimen_base import Specimen
from twin.shape import Shape
from twin.specimens import shape_of

# The cross-section is the mean over this length of the rod, at the middle of the rod.
SECTION_LENGTH_MM = 2.0
STEP_MM = 0.05
FRACTION = 0.5
# Larger than camera pixels and the grain of the coat, smaller than the radius of a wrapped edge.
BREAK_SIGMA_MM = 0.15
_LEAST_IN_BIN = 3


@dataclass(frozen=True, eq=False)
class RodSection:
    """Mean profile across a rod: positions s along world x (n,), mm, and heights z (n,), mm.

    Positions without enough points are left out.
    """

    s_mm: FloatArray
    z_mm: FloatArray

    def width(self) -> BarWidth:
        """Return the width of the crest at 50 % of its height above the valleys.

        Raises
        ------
        FitError : fewer than 20 positions have points, or no crest with a valley on both sides
        """
        low, high = self.valleys()
        inside = slice(low, high + 1)
        return bar_width(self.s_mm[inside], self.z_mm[inside], FRACTION)

    def break_width(self) -> BarWidth:
        """Return the width between the points of largest curvature.

        Raises
        ------
        FitError : for the reasons of `width`
        """
        low, high = self.valleys()
        inside = slice(low, high + 1)
        return break_width(self.s_mm[inside], self.z_mm[inside], BREAK_SIGMA_MM)

    def slope_change_width(self) -> BarWidth:
        """Return the width between the points where the slope changes fastest.

        Raises
        ------
        FitError : for the reasons of `width`
        """
        low, high = self.valleys()
        inside = slice(low, high + 1)
        return slope_change_width(self.s_mm[inside], self.z_mm[inside], BREAK_SIGMA_MM)

    def valleys(self) -> tuple[int, int]:
        """Return the indices of the lowest positions on both sides of the crest.

        Raises
        ------
        FitError : fewer than 20 positions have points
        """
        if self.z_mm.size < 20:
            raise FitError(f"rod section: {self.z_mm.size} positions with points, 20 needed")
        middle = np.abs(self.s_mm) < np.ptp(self.s_mm) / 4
        crest = int(np.flatnonzero(middle)[np.argmax(self.z_mm[middle])])
        return int(np.argmin(self.z_mm[:crest])), crest + int(np.argmin(self.z_mm[crest:]))


def section_of(
    points_mm: FloatArray, along_mm: float, centre_mm: tuple[float, float]
) -> RodSection:
    """Return the mean profile across a rod, from points over the middle of the rod.

    The rod is along world y.

    Parameters
    ----------
    points_mm : (n, xyz) float, world frame, mm
    along_mm : length of the rod over which points are averaged, mm
    centre_mm : world x and y of the middle of the rod, mm, from which positions are measured
    """
    x, y, z = (points_mm - (*centre_mm, 0.0)).T
    inside = np.abs(y) <= along_mm / 2
    bins = np.round(x[inside] / STEP_MM).astype(int)
    where = np.unique(bins, return_inverse=True)[1]
    counts = np.bincount(where)
    # The mean x of the points is used: in a bin as narrow as a pixel, all points may be on one
    # side of the bin's middle.
    across, means = (np.bincount(where, coordinate[inside]) / counts for coordinate in (x, z))
    full = counts >= _LEAST_IN_BIN
    return RodSection(across[full], means[full])


def middle_of(shape: Shape) -> tuple[float, float]:
    """Return the middle of a specimen's outline in world xy, mm."""
    x_low, x_high, y_low, y_high = shape.bounds_mm()
    return (x_low + x_high) / 2, (y_low + y_high) / 2


def single_section(specimen: Specimen) -> NominalRod | NominalBar | None:
    """Return the rod along y or the bar of a specimen if there is exactly one, else None.

    The sections of several rods or bars would overlap.
    """
    across = [
        feature
        for feature in specimen.nominal_features()
        if isinstance(feature, NominalBar)
        or (isinstance(feature, NominalRod) and feature.along == "y")
    ]
    return across[0] if len(across) == 1 else None


def rod_figures(
    experiment: Experiment, points_mm: NDArray[np.floating[Any]], prefix: str = ""
) -> dict[str, float | str | None]:
    """Return widths and height of the coat over a rod, mm, from its points (n, xyz), mm.

    They are figures of the coat, not of the rod, as measured with a caliper. A width that the
    section does not have is None, and `rod_failure` gives the reason. If the section has no crest,
    only `rod_failure` is returned. Empty if the specimen is not a single rod or bar. `prefix` is
    put before each name.
    """
    if single_section(experiment.specimen) is None:
        return {}
    centre = middle_of(shape_of(experiment.specimen))
    section = section_of(points_mm.astype(np.float64), SECTION_LENGTH_MM, centre)
    try:
        crest = section.width()
    except FitError as error:
        return {f"{prefix}rod_failure": str(error)}
    figures: dict[str, float | str | None] = {f"{prefix}rod_width_mm": crest.width_mm}
    for name, width in (
        ("break", section.break_width),
        ("slope_change", section.slope_change_width),
    ):
        figures[f"{prefix}rod_{name}_width_mm"] = None
        try:
            figures[f"{prefix}rod_{name}_width_mm"] = width().width_mm
        except FitError as error:
            figures[f"{prefix}rod_failure"] = str(error)
    return figures | {f"{prefix}rod_height_mm": crest.height_mm}
