"""Young's modulus from one real press: far better than from a hardness."""

from twin.mechanics.errors import PressError
from twin.mechanics.hardness import ModulusEstimate
from twin.mechanics.press import PressedElastomer

# Of a ball press: frictionless linear slab against neo-Hookean ones, bonded and free (shared
# notes, mechanics.md, section 6), +1 to +4 %.
_MODEL_SHARE = 0.04


def calibrate_modulus(
    measured_force_n: float,
    pressed: PressedElastomer,
    *,
    force_error: float = 0.02,
    depth_error_mm: float = 0.01,
) -> ModulusEstimate:
    """Find Young's modulus from the force that one real press to a known depth took.

    Parameters
    ----------
    measured_force_n : float, N
        Read from the stage, > 0.
    pressed : PressedElastomer
        The same press by DEPTH, of any modulus, without back pressure, gravity or film: its force
        is then in proportion to the modulus.
    force_error : float
        Relative error of the force gauge.
    depth_error_mm : float, mm
        Error of the depth, first touch included.

    Returns
    -------
    ModulusEstimate
        Range: errors of gauge, depth (force grows at least as depth^1.5, taken as depth^2) and
        model (4 %) added up.

    Raises
    ------
    PressError
        A force that is not positive.
    """
    if not measured_force_n > 0:
        raise PressError(f"measured force: found {measured_force_n:g} N, allowed: more than 0")
    best = pressed.young_modulus_kpa * measured_force_n / pressed.force_n
    share = force_error + 2 * depth_error_mm / pressed.depth_mm + _MODEL_SHARE
    return ModulusEstimate(
        low_kpa=best * max(0.0, 1 - share),
        best_kpa=best,
        high_kpa=best * (1 + share),
        source=f"{measured_force_n:g} N measured at {pressed.depth_mm:g} mm",
        extrapolated=False,
    )
