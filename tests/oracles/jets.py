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

    def __add__(self, operand):
        if isinstance(operand, Jet):
            return Jet(
                self.value + operand.value, self.slope + operand.slope, self.bend + operand.bend
            )
        return Jet(self.value + operand, self.slope, self.bend)

    def __neg__(self):
        return Jet(-self.value, -self.slope, -self.bend)

    def __sub__(self, operand):
        return self + (-operand)

    def __rsub__(self, operand):
        return operand + (-self)

    def __mul__(self, operand):
        if not isinstance(operand, Jet):
            return Jet(self.value * operand, self.slope * operand, self.bend * operand)
        mixed = self.slope[:, None] * operand.slope
        return Jet(
            self.value * operand.value,
            self.value * operand.slope + operand.value * self.slope,
            self.value * operand.bend + operand.value * self.bend + mixed + mixed.swapaxes(0, 1),
        )

    def __pow__(self, power):
        x = self.value
        return self.through(
            x**power, power * x ** (power - 1), power * (power - 1) * x ** (power - 2)
        )

    def __truediv__(self, operand):
        return self * (operand**-1)

    __radd__, __rmul__ = __add__, __mul__


def variables(values):
    """Return one jet per row of values (variable, point): the independent variables."""
    count, points = values.shape
    unit, none = np.eye(count)[:, :, None], np.zeros((count, count, points))
    return [Jet(values[i], unit[i] * np.ones(points), none) for i in range(count)]
