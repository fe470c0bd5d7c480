"""Values with their first and second derivatives, propagated through plain arithmetic.

An oracle writes its energy once, as the formula in the book, and gets the exact tangent.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Jet:
    """A quantity at many points, as a function of a few variables."""

    #: (point,)
    value: Any
    #: (variable, point)
    slope: Any
    #: (variable, variable, point), symmetric
    bend: Any

    def through(self, value, first, second):
        """Return f of this, from f, f' and f'' at its value, each (point,)."""
        outer = self.slope[:, None] * self.slope
        return Jet(value, first * self.slope, first * self.bend + second * outer)

    def __add__(self, other):
        if isinstance(other, Jet):
            return Jet(self.value + other.value, self.slope + other.slope, self.bend + other.bend)
        return Jet(self.value + other, self.slope, self.bend)

    def __neg__(self):
        return Jet(-self.value, -self.slope, -self.bend)

    def __sub__(self, other):
        return self + (-other)

    def __rsub__(self, other):
        return other + (-self)

    def __mul__(self, other):
        if not isinstance(other, Jet):
            return Jet(self.value * other, self.slope * other, self.bend * other)
        mixed = self.slope[:, None] * other.slope
        return Jet(
            self.value * other.value,
            self.value * other.slope + other.value * self.slope,
            self.value * other.bend + other.value * self.bend + mixed + mixed.swapaxes(0, 1),
        )

    def __pow__(self, power):
        x = self.value
        return self.through(
            x**power, power * x ** (power - 1), power * (power - 1) * x ** (power - 2)
        )

    def __truediv__(self, other):
        return self * (other**-1)

    __radd__, __rmul__ = __add__, __mul__


def variables(values):
    """Return one jet per row of values (variable, point): the independent variables."""
    count, points = values.shape
    unit, none = np.eye(count)[:, :, None], np.zeros((count, count, points))
    return [Jet(values[i], unit[i] * np.ones(points), none) for i in range(count)]
