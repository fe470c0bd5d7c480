"""Width and height of a rod's cross-section, measured in a relief as with a caliper.

A sheet draped over a rod on a plate rises from two valleys to a crest. The profile runs from valley
to valley. Its width is taken where it crosses half of the height of the crest over their level, and
between the breaks of its slope, where a sheet separates from the rod: where it bends most, or where
its slope changes fastest.
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

# The cross-section is the mean over this length of the rod, in its middle.
SECTION_LENGTH_MM = 2.0
STEP_MM = 0.05
FRACTION = 0.5
# Above the camera's pixels and the grain of the coat, below the radius of a wrapped edge.
BREAK_SIGMA_MM = 0.15
_LEAST_IN_BIN = 3


@dataclass(frozen=True, eq=False)
class RodSection:
    """Mean profile across a rod: (n,) position along world x and height, mm; gaps left out."""

    s_mm: FloatArray
    z_mm: FloatArray

    def width(self) -> BarWidth:
        """Return the width of the crest between its valleys.

        Raises
        ------
        FitError : no crest with a valley on both sides
        """
        low, high = self.valleys()
        inside = slice(low, high + 1)
        return bar_width(self.s_mm[inside], self.z_mm[inside], FRACTION)

    def break_width(self) -> BarWidth:
        """Return the width between the breaks of the slope; errors as `width`."""
        low, high = self.valleys()
        inside = slice(low, high + 1)
        return break_width(self.s_mm[inside], self.z_mm[inside], BREAK_SIGMA_MM)

    def slope_change_width(self) -> BarWidth:
        """Return the width between the fastest changes of the slope; errors as `width`."""
        low, high = self.valleys()
        inside = slice(low, high + 1)
        return slope_change_width(self.s_mm[inside], self.z_mm[inside], BREAK_SIGMA_MM)

    def valleys(self) -> tuple[int, int]:
        """Return the indices of the lowest points on both sides of the crest."""
        if self.z_mm.size < 20:
            raise FitError(f"rod section: {self.z_mm.size} positions with points, 20 needed")
        middle = np.abs(self.s_mm) < np.ptp(self.s_mm) / 4
        crest = int(np.flatnonzero(middle)[np.argmax(self.z_mm[middle])])
        return int(np.argmin(self.z_mm[:crest])), crest + int(np.argmin(self.z_mm[crest:]))


def section_of(
    points_mm: FloatArray, along_mm: float, centre_mm: tuple[float, float]
) -> RodSection:
    """Average points, (n, 3) mm, over the middle of a rod along world y.

    Parameters
    ----------
    points_mm : (n, xyz) float, world frame
    along_mm : length of rod that is averaged
    centre_mm : x and y of the rod's middle; positions count from it
    """
    x, y, z = (points_mm - (*centre_mm, 0.0)).T
    inside = np.abs(y) <= along_mm / 2
    bins = np.round(x[inside] / STEP_MM).astype(int)
    where = np.unique(bins, return_inverse=True)[1]
    counts = np.bincount(where)
    # A bin of a pixel's width contains columns on only one side of its middle.
    across, means = (np.bincount(where, coordinate[inside]) / counts for coordinate in (x, z))
    full = counts >= _LEAST_IN_BIN
    return RodSection(across[full], means[full])


def middle_of(shape: Shape) -> tuple[float, float]:
    """Return the middle of a specimen's outline in world xy, mm."""
    x_low, x_high, y_low, y_high = shape.bounds_mm()
    return (x_low + x_high) / 2, (y_low + y_high) / 2


def single_section(specimen: Specimen) -> NominalRod | NominalBar | None:
    """Return the rod or bar if it is the only one: sections of several run into each other."""
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
    """Return widths and height of the coat over a rod, from its points (n, xyz).

    They are apparent figures of the coat, as measured with a caliper. A width that its section does
    not have is None, and `rod_failure` gives the reason; without a crest that is all. Empty where
    the specimen is not a single rod.
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
