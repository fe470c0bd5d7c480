"""Young's modulus from hardness, as a range.

Durometers and formulas differ by factors of 1.5 to 2. S is the hardness on the scale of each
formula.

Sources
-------
Gent, A. N. (1958): On the relation between indentation hardness and Young's modulus. Rubber
Chemistry and Technology 31(4), 896-906, the linear relation
E [MPa] = 0.0981 (56 + 7.62336 S) / (0.137505 (254 - 2.54 S)), trusted for 20 < S < 80.

Qi, H. J., Joyce, K., Boyce, M. C. (2003): Durometer hardness and the stress-strain behavior of
elastomeric materials. Rubber Chemistry and Technology 76(2), 419-435:
log10 E [MPa] = 0.0235 S - 0.6403, 20 < S < 80. The base is 10; calculators that use exp are wrong.

BS 903-A26 (1995): IRHD hardness, which is close to Shore A above about 40,
S = 100 erf(3.186e-4 sqrt(E [Pa])).

Shore 00 (ASTM D2240): a hemispherical tip of 1.19 mm radius under a spring of
0.203 + 0.00908 S newton indents by 2.54 (1 - S / 100) mm. The modulus of a half-space with that
indentation follows from Sneddon, I. N. (1965), Int. J. Engng. Sci. 3, 47-57, for a sphere. The
spring constants are from the literature.

The rubbers of tactile sensors (S <= 20) are below the ranges of Gent and Qi. There the 100 % moduli
in data sheets of cast silicones are lower than Gent's relation by factors of up to 1.6.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import brentq
from scipy.special import erfinv

from twin.config.models import Elastomer
from twin.mechanics.errors import PressError

if TYPE_CHECKING:
    from twin.mechanics.press import PressedElastomer

VALID_SHORE_A = (20.0, 80.0)
# Uncertainty of a durometer's reading (ISO 48-4 practice), in addition to that of the formulas.
_READING_POINTS = 5.0
_SOFT_LOW_FACTOR = 1.6
_LARGEST_SHORE = 95.0
BS_903_FROM = 40.0
_TIP_RADIUS_MM = 1.19
# Errors of a real press: relative error of the force gauge, and of the depth after first touch.
_FORCE_SHARE, _DEPTH_ERROR_MM = 0.02, 0.01
# Model error of a ball press: frictionless linear slab against neo-Hookean ones, bonded and free
# (shared notes, mechanics.md, section 6), +1 to +4 %.
_MODEL_SHARE = 0.04


@dataclass(frozen=True)
class ModulusEstimate:
    """Estimate of Young's modulus with its range, kPa."""

    low_kpa: float
    best_kpa: float
    high_kpa: float
    #: origin of the numbers, one line
    source: str
    #: True if the hardness is outside the valid range of the formulas (Shore A 20 to 80)
    extrapolated: bool


def gent_modulus_kpa(shore_a: float) -> float:
    """Return Young's modulus, kPa, from Shore A hardness by Gent 1958.

    >>> round(gent_modulus_kpa(10.0))
    413
    """
    return 1e3 * 0.0981 * (56 + 7.62336 * shore_a) / (0.137505 * (254 - 2.54 * shore_a))


def qi_modulus_kpa(shore_a: float) -> float:
    """Return Young's modulus, kPa, from Shore A hardness by Qi, Joyce and Boyce 2003.

    >>> round(qi_modulus_kpa(10.0))
    393
    """
    return 1e3 * float(10 ** (0.0235 * shore_a - 0.6403))


def bs_903_modulus_kpa(shore_a: float) -> float:
    """Return Young's modulus, kPa, from a Shore A hardness of 40 to 95 by BS 903.

    Raises
    ------
    PressError : the hardness is outside this range; for softer rubber the relation is far below
        every measurement
    """
    if not BS_903_FROM <= shore_a <= _LARGEST_SHORE:
        raise PressError(f"BS 903: found Shore A {shore_a:g}, allowed: 40 to 95")
    return 1e-3 * float(erfinv(shore_a / 100) / 3.186e-4) ** 2


def sneddon_modulus_kpa(shore_00: float) -> float:
    """Return Young's modulus, kPa, of an incompressible rubber from its Shore 00 hardness.

    >>> round(sneddon_modulus_kpa(30.0))
    121
    """
    depth_mm = 2.54 * (1 - shore_00 / 100)
    tip = _TIP_RADIUS_MM

    def missing(a: float) -> float:
        return float(a * np.arctanh(a / tip)) - depth_mm

    a = float(brentq(missing, 1e-9 * tip, tip * (1 - 1e-12)))
    area_mm2 = (a**2 + tip**2) * float(np.arctanh(a / tip)) - a * tip
    return 1e3 * (0.203 + 0.00908 * shore_00) / area_mm2 * 3 / 4  # E* = 4 E / 3


def estimate_modulus(shore_a: float) -> ModulusEstimate:
    """Estimate Young's modulus from Shore A hardness.

    The best value is that of Gent. The range contains the results of all valid formulas for a
    hardness 5 points lower and higher; below Shore A 20 its lower end is divided by 1.6.

    Raises
    ------
    PressError : the hardness is outside 0 to 95 (at 100 Gent's relation diverges)
    """
    _check_shore("shore_a", shore_a)
    soft, hard = _reading(shore_a)
    low = min(gent_modulus_kpa(soft), qi_modulus_kpa(soft))
    high = max(gent_modulus_kpa(hard), qi_modulus_kpa(hard))
    if soft >= BS_903_FROM:
        low, high = min(low, bs_903_modulus_kpa(soft)), max(high, bs_903_modulus_kpa(hard))
    return ModulusEstimate(
        low_kpa=low / (_SOFT_LOW_FACTOR if shore_a < VALID_SHORE_A[0] else 1.0),
        best_kpa=gent_modulus_kpa(shore_a),
        high_kpa=high,
        source="Shore A by Gent 1958; range: Gent 1958, Qi et al. 2003 and, from 40 A, BS 903, "
        "at +-5 points",
        extrapolated=not VALID_SHORE_A[0] <= shore_a <= VALID_SHORE_A[1],
    )


def estimate_modulus_00(shore_00: float) -> ModulusEstimate:
    """Estimate Young's modulus from Shore 00 hardness by Sneddon's sphere.

    The ends of the range are the moduli for a hardness 5 points lower and higher. The lower end is
    also divided by 1.6, because of the 100 % moduli in data sheets of soft silicones.

    Raises
    ------
    PressError : the hardness is outside 0 to 95
    """
    _check_shore("shore_00", shore_00)
    soft, hard = _reading(shore_00)
    return ModulusEstimate(
        low_kpa=sneddon_modulus_kpa(soft) / _SOFT_LOW_FACTOR,
        best_kpa=sneddon_modulus_kpa(shore_00),
        high_kpa=sneddon_modulus_kpa(hard),
        source="Shore 00 by Sneddon's sphere at +-5 points",
        extrapolated=False,
    )


def young_modulus(elastomer: Elastomer) -> ModulusEstimate:
    """Return an elastomer's configured Young's modulus, or an estimate from its hardness."""
    given = elastomer.young_modulus_kpa
    if given is not None:
        return ModulusEstimate(given, given, given, "given as young_modulus_kpa", False)
    if elastomer.shore_00 is not None:
        return estimate_modulus_00(elastomer.shore_00)
    assert elastomer.shore_a is not None  # the model's own validator
    return estimate_modulus(elastomer.shore_a)


def calibrate_modulus(measured_force_n: float, pressed: "PressedElastomer") -> ModulusEstimate:
    """Return Young's modulus from the measured force of one real press to a known depth.

    Parameters
    ----------
    measured_force_n : force of the real press, > 0
    pressed : computed press to the same depth, with any modulus. It has no back pressure, gravity
        or film, so that its force is proportional to the modulus.

    Returns
    -------
    Modulus; its range is the sum of the relative errors of force gauge (2 %), model (4 %) and
    depth (0.01 mm including first touch; the force increases at least as depth^1.5, assumed as
    depth^2)

    Raises
    ------
    PressError : the force is not positive
    """
    if not measured_force_n > 0:
        raise PressError(f"measured force: found {measured_force_n:g} N, allowed: more than 0")
    best = pressed.young_modulus_kpa * measured_force_n / pressed.force_n
    share = _FORCE_SHARE + 2 * _DEPTH_ERROR_MM / pressed.depth_mm + _MODEL_SHARE
    return ModulusEstimate(
        low_kpa=best * max(0.0, 1 - share),
        best_kpa=best,
        high_kpa=best * (1 + share),
        source=f"{measured_force_n:g} N measured at {pressed.depth_mm:g} mm",
        extrapolated=False,
    )


def _check_shore(key: str, shore: float) -> None:
    if not 0 <= shore <= _LARGEST_SHORE:
        raise PressError(f"elastomer.{key}: found {shore:g}, allowed: 0 to {_LARGEST_SHORE:g}")


def _reading(shore: float) -> tuple[float, float]:
    return max(shore - _READING_POINTS, 0.0), min(shore + _READING_POINTS, _LARGEST_SHORE)
