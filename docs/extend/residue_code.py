"""A pattern code from outside: two whole-number periods, numbered by their residues.

x = p0 (n0 + t0) = p1 (n1 + t1), t phases in turns: p0 t0 - p1 t1 = p1 n1 - p0 n0 is whole, and
determines n0 over p0 p1 pixels (Gushov and Solodkin, Opt. Lasers Eng. 14, 311 (1991)).
"""

import math

import numpy as np
from scipy.special import erfc

from reconstruction.codes import CODES, PatternCode
from reconstruction.errors import InputError


class ResidueCode(PatternCode):
    """Fringe orders from the residues of two whole periods."""

    name = "residue"
    title = "residues of two periods"
    summary = "further_periods_px: one whole number without common divisor with period_px"
    takes_further_periods = True

    def check(self, fringes):
        """Raise an error for periods that do not number the whole image."""
        whole = [int(period) for period in fringes.periods_px]
        if len(whole) != 2 or list(fringes.periods_px) != whole or math.gcd(*whole) != 1:
            raise InputError("patterns residue: give two whole periods without common divisor")
        if fringes.length_px > (most_px := whole[0] * whole[1] - max(whole)):
            raise InputError(f"patterns residue: these periods number {most_px} px only")

    def unwrap(self, wrapped):
        """Return the coordinate (row, col) px; NaN where the residue has no order."""
        p0, p1 = map(int, wrapped.fringes.periods_px)
        place = np.rint(self.residues(wrapped)).astype(int) + p1
        return wrapped.coordinate_px(self.table(p0, p1)[np.clip(place, 0, p0 + p1)])

    def order_error(self, wrapped, coordinate_px):
        """Return the probability (row, col) of a wrong order, from the noise of the residue."""
        residue, (p0, p1) = self.residues(wrapped), wrapped.fringes.periods_px
        sigma = np.hypot(p0 * wrapped.sigma_rad[0], p1 * wrapped.sigma_rad[1]) / (2.0 * np.pi)
        margin = 0.5 - np.abs(residue - np.rint(residue))
        return erfc(margin / np.maximum(np.sqrt(2.0) * sigma, 1e-12))

    @staticmethod
    def residues(wrapped):
        """Return p0 t0 - p1 t1 (row, col) px."""
        p0, p1 = wrapped.fringes.periods_px
        return p0 * wrapped.turns[0] - p1 * wrapped.turns[1]

    @staticmethod
    def table(p0, p1):
        """Return the order n0 by residue + p1; the image begins half a pixel before 0."""
        orders = np.full(p0 + p1 + 1, np.nan)
        for x in range(p0 * p1 - 1, -2, -1):
            orders[x // p1 * p1 - x // p0 * p0 + p1] = x // p0
        return orders


RESIDUE = CODES.register(ResidueCode())
