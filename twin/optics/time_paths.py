"""Projector coordinate and weight of camera rays as polynomials of time.

The rays are traced at the moments, the extremes of a Chebyshev polynomial over the sequence:
3, 5 or 9, of which each set contains the one before. The polynomial through the moments is a sum of
Chebyshev polynomials; the coefficient of the highest one bounds the error, because the
coefficients of a smooth function decrease. Of a ray that crosses an edge they do not decrease.
Times are relative: -1 at the start of the sequence, 1 at its end.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

from reconstruction.arrays import BoolImage, FloatArray, FloatImage
from twin.optics.connection import Connection, FrameLight
from twin.optics.exposures import ExposureNodes
from twin.optics.moving_rig import LanePaths

MOMENTS = (3, 5, 9)
"""Numbers of moments, from which the renderer chooses."""

COORDINATE_PX = 0.01
"""Largest last coefficient of a projector coordinate, px; that of a further moment is smaller."""

WEIGHT_SHARE = 0.005
"""Largest last coefficient of a weight, relative to the mean weight of all lit rays."""


def moment_places(count: int) -> FloatArray:
    """Return the relative times of so many moments: -1, ..., 1."""
    return np.asarray(-np.cos(np.pi * np.arange(count) / (count - 1)))


def coefficients(values: Sequence[FloatImage]) -> FloatArray:
    """Return the Chebyshev coefficients (order, lane) of values at all moments, each (lane,)."""
    places = moment_places(len(values))
    matrix = np.linalg.inv(chebyshev.chebvander(places, len(values) - 1))
    return np.asarray(matrix @ np.asarray(values, np.float64))


def smooth_lanes(moments: Sequence[LanePaths], white: float) -> BoolImage:
    """Return True for the lanes (lane,) that are dark at all moments, or polynomials of time.

    Parameters
    ----------
    white : mean weight of all lit rays
    """
    weights = np.asarray([moment.weight for moment in moments])
    always, never = (weights > 0.0).all(axis=0), (weights == 0.0).all(axis=0)
    last = [
        np.abs(coefficients([getattr(moment, name) for moment in moments])[-1])
        for name in ("column_px", "row_px", "weight")
    ]
    close = (last[0] <= COORDINATE_PX) & (last[1] <= COORDINATE_PX)
    return np.asarray(never | (always & close & (last[2] <= WEIGHT_SHARE * white)))


@dataclass(frozen=True, eq=False)
class TimePaths:
    """Lanes whose projector coordinate and weight are polynomials of the relative time.

    Attributes
    ----------
    powers : by quantity of a connection, the coefficients of all powers of time, each (lane,)
    row : row of the image of each lane
    """

    powers: dict[str, list[Any]]
    row: Any

    @classmethod
    def through(
        cls, moments: Sequence[LanePaths], rows: NDArray[Any], *, defocused: bool
    ) -> "TimePaths":
        """Return the polynomials through lanes at all moments.

        Parameters
        ----------
        rows : row of the image of each lane
        defocused : True if the light depends on the axial distance
        """
        names = ["column_px", "row_px", "weight", *(["axial_mm"] if defocused else [])]
        to_powers = _powers_of_chebyshev(len(moments))
        powers = {
            name: [
                mi.Float(values.astype(np.float32))
                for values in to_powers @ coefficients([getattr(m, name) for m in moments])
            ]
            for name in names
        }
        return cls(powers, mi.Float(np.asarray(rows, np.float32)))

    def at(self, place: Any) -> Connection:
        """Return the connections at a relative time of each lane."""
        column, row, weight = (
            _polynomial(self.powers[name], place) for name in ("column_px", "row_px", "weight")
        )
        axial = self.powers.get("axial_mm")
        axial_mm = mi.Float(1.0) if axial is None else _polynomial(axial, place)
        return Connection(column, row, weight, weight > 0.0, axial_mm)

    def light(
        self, light: FrameLight, frame: int, nodes: ExposureNodes, row_delay: float
    ) -> FloatImage:
        """Return the radiance (lane,) of one frame, integrated over its exposure.

        Parameters
        ----------
        frame : number of the frame in the sequence
        nodes : relative times of the exposure in row 0
        row_delay : relative time from one row to the next
        """
        delay, total = dr.opaque(mi.Float, row_delay), mi.Float(0.0)
        for place, share in zip(nodes.places, nodes.shares, strict=True):
            start = dr.opaque(mi.Float, float(place))
            path = self.at(dr.fma(self.row, delay, start))
            total = dr.fma(light.value(path, frame), float(share), total)
        return np.array(total, np.float32)


def _powers_of_chebyshev(count: int) -> FloatArray:
    """Return the matrix (power, order) from Chebyshev coefficients to those of the powers."""
    matrix = np.zeros((count, count))
    for order in range(count):
        powers = chebyshev.cheb2poly(np.eye(count)[order])
        matrix[: len(powers), order] = powers
    return matrix


def _polynomial(powers: list[Any], place: Any) -> Any:
    *lower, value = powers
    for power in reversed(lower):
        value = dr.fma(value, place, power)
    return value
