"""Shore A hardness to Young's modulus, as a range: durometers and formulas differ by 1.5 to 2.

Sources
-------
Gent, A. N. (1958): On the relation between indentation hardness and Young's modulus. Rubber
Chemistry and Technology 31(4), 896-906, the linear relation
E [MPa] = 0.0981 (56 + 7.62336 S) / (0.137505 (254 - 2.54 S)), trusted for 20 < S < 80.

Qi, H. J., Joyce, K., Boyce, M. C. (2003): Durometer hardness and the stress-strain behavior of
elastomeric materials. Rubber Chemistry and Technology 76(2), 419-435:
log10 E [MPa] = 0.0235 S - 0.6403, 20 < S < 80. Base 10; calculators that use exp are wrong.

The rubbers of tactile sensors (S <= 20) lie below both ranges; there the data sheets' 100 %
moduli of cast silicones come out down to 1.6 times below Gent.
"""

from dataclasses import dataclass

from twin.config.models import Elastomer
from twin.mechanics.errors import PressError

VALID_SHORE_A = (20.0, 80.0)
# A durometer's reading is good to 5 points (ISO 48-4 practice), the formula's own spread aside.
_READING_POINTS = 5.0
_SOFT_LOW_FACTOR = 1.6
_LARGEST_SHORE_A = 95.0


@dataclass(frozen=True)
class ModulusEstimate:
    """Young's modulus with the range that hardness leaves open, kPa."""

    low_kpa: float
    best_kpa: float
    high_kpa: float
    #: where the numbers come from, one line
    source: str
    #: the hardness lies outside the formulas' own range (20 to 80)
    extrapolated: bool


def gent_modulus_kpa(shore_a: float) -> float:
    """Return Young's modulus by Gent 1958.

    >>> round(gent_modulus_kpa(10.0))
    413
    """
    return 1e3 * 0.0981 * (56 + 7.62336 * shore_a) / (0.137505 * (254 - 2.54 * shore_a))


def qi_modulus_kpa(shore_a: float) -> float:
    """Return Young's modulus by Qi, Joyce and Boyce 2003.

    >>> round(qi_modulus_kpa(10.0))
    393
    """
    return 1e3 * float(10 ** (0.0235 * shore_a - 0.6403))


def estimate_modulus(shore_a: float) -> ModulusEstimate:
    """Estimate Young's modulus from Shore A: Gent, bracketed by both formulas at S +- 5.

    Raises
    ------
    PressError
        Hardness outside 0 to 95, where Gent's relation diverges.
    """
    if not 0 <= shore_a <= _LARGEST_SHORE_A:
        raise PressError(f"elastomer.shore_a: found {shore_a:g}, allowed: 0 to 95")
    soft = max(shore_a - _READING_POINTS, 0.0)
    hard = min(shore_a + _READING_POINTS, _LARGEST_SHORE_A)
    low = min(gent_modulus_kpa(soft), qi_modulus_kpa(soft))
    return ModulusEstimate(
        low_kpa=low / (_SOFT_LOW_FACTOR if shore_a < VALID_SHORE_A[0] else 1.0),
        best_kpa=gent_modulus_kpa(shore_a),
        high_kpa=max(gent_modulus_kpa(hard), qi_modulus_kpa(hard)),
        source="Shore A by Gent 1958; range: Gent 1958 and Qi et al. 2003 at +-5 points",
        extrapolated=not VALID_SHORE_A[0] <= shore_a <= VALID_SHORE_A[1],
    )


def young_modulus(elastomer: Elastomer) -> ModulusEstimate:
    """Return the configured modulus, or the estimate from hardness when none is given."""
    given = elastomer.young_modulus_kpa
    if given is None:
        return estimate_modulus(elastomer.shore_a)
    return ModulusEstimate(given, given, given, "given as young_modulus_kpa", False)
