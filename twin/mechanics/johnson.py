"""Johnson's unbounded system of distributions: any skewness, any tails above a log-normal's.

X = (sinh(a Z + b) - mean) / spread of a standard normal Z: monotone, mean 0, variance 1 (Johnson,
Biometrika 36, 149 (1949); on rough surfaces Hu and Tonder, Int. J. Machine Tools and Manufacture
32, 83 (1992)). With w = exp(a^2) all moments are closed forms,

    mean = w^(1/2) sinh b,  spread^2 = (w - 1) (w cosh 2b + 1) / 2,

and so is the correlation of two X whose Z have the correlation r:

    ((w^(1 + r) cosh 2b - w^(1 - r)) / 2 - mean^2) / spread^2
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from reconstruction.arrays import FloatArray

# Steps off the ends of the bracket, where cosh 2b is infinite and where rounding puts it below 1.
_OFF_END = 1e-9


@dataclass(frozen=True)
class Johnson:
    """One distribution of mean 0 and variance 1; a = 0 is the normal one."""

    a: float = 0.0
    b: float = 0.0

    def of_normal(self, normal: FloatArray) -> FloatArray:
        """Turn standard normal numbers (...) into numbers of this distribution."""
        if self.a == 0.0:
            return normal
        found: FloatArray = (np.sinh(self.a * normal + self.b) - self._mean) / self._spread
        return found

    def correlation(self, of_normals: float) -> float:
        """Return the correlation of two numbers made from normal ones of a given correlation."""
        if self.a == 0.0:
            return of_normals
        w = self._w
        product = (w ** (1 + of_normals) * np.cosh(2 * self.b) - w ** (1 - of_normals)) / 2
        return float((product - self._mean**2) / self._spread**2)

    def correlation_of_normals(self, wanted: float) -> float:
        """Return the correlation that normal numbers need; the inverse of `correlation`."""
        return float(brentq(lambda r: self.correlation(r) - wanted, 0.0, 1.0, xtol=1e-14))

    @property
    def _w(self) -> float:
        return float(np.exp(self.a**2))

    @property
    def _mean(self) -> float:
        return float(np.exp(self.a**2 / 2) * np.sinh(self.b))

    @property
    def _spread(self) -> float:
        w = self._w
        return float(np.sqrt((w - 1) * (w * np.cosh(2 * self.b) + 1) / 2))


def johnson_of(skewness: float, excess_kurtosis: float) -> Johnson:
    """Return the distribution with the given third and fourth standardised moments.

    Parameters
    ----------
    skewness, excess_kurtosis : both 0, or tails above those of the log-normal distribution of that
        skewness

    Notes
    -----
    For a given w the kurtosis is a quadratic equation in cosh 2b; its root gives a skewness that
    falls from the log-normal's to 0 as w grows to the symmetric distribution's: one bracketed root
    (after Tuenter, Journal of Statistical Computation and Simulation 70, 325 (2001)).
    """
    if excess_kurtosis == 0.0:
        return Johnson()
    kurtosis = excess_kurtosis + 3
    symmetric_w = np.sqrt(np.sqrt(2 * kurtosis - 2) - 1)
    if skewness == 0.0:
        return Johnson(a=float(np.sqrt(np.log(symmetric_w))))
    w = brentq(
        lambda w: _skewness(w, _cosh_2b(w, kurtosis)) - abs(skewness),
        _log_normal_w(kurtosis) * (1 + _OFF_END),
        symmetric_w * (1 + _OFF_END),
        xtol=1e-14,
    )
    b = np.arccosh(_cosh_2b(w, kurtosis)) / 2
    return Johnson(a=float(np.sqrt(np.log(w))), b=float(np.copysign(b, skewness)))


def _log_normal_w(kurtosis: float) -> float:
    """Return the w of the log-normal distribution of that kurtosis, the limit of large b."""
    return float(brentq(lambda w: _log_normal_kurtosis(w) - kurtosis, 1.0, kurtosis, xtol=1e-14))


def _log_normal_kurtosis(w: float) -> float:
    return w**4 + 2 * w**3 + 3 * w**2 - 3


def _cosh_2b(w: float, kurtosis: float) -> float:
    """Solve the fourth moment for cosh 2b at a given w."""
    longest = _log_normal_kurtosis(w)
    square = 2 * w**2 * (longest - kurtosis)
    half = 2 * w * (w * (w + 2) - kurtosis)
    rest = 3 * (2 * w + 1) - w**2 * longest - 2 * kurtosis
    return max(1.0, float((np.sqrt(half**2 - square * rest) - half) / square))


def _skewness(w: float, cosh_2b: float) -> float:
    b = np.arccosh(cosh_2b) / 2
    third = np.sqrt(w) * (w - 1) ** 2 * (w * (w + 2) * np.sinh(3 * b) + 3 * np.sinh(b)) / 4
    return float(third / ((w - 1) * (w * cosh_2b + 1) / 2) ** 1.5)
