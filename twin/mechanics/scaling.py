"""Force in proportion to the modulus: one press for all moduli, one real press for the modulus.

At a given depth the shape of a linear slab does not depend on its modulus. With unit modulus the
contact pressure is what the solver finds; pressure and force of any modulus are that times the
modulus, to the last bit, because the solver works in pressure over modulus. The other way round,
the force that one real press took gives the modulus far better than a hardness does.
"""

from dataclasses import replace

from twin.config.models import Elastomer, Mechanics, Press, Specimen
from twin.mechanics.choice import may_wrap, press_with
from twin.mechanics.errors import PressError
from twin.mechanics.hardness import ModulusEstimate, young_modulus
from twin.mechanics.press import PressedElastomer

_STIFFNESS = {"shore_a", "shore_00", "young_modulus_kpa"}
# Of a ball press: frictionless linear slab against neo-Hookean ones, bonded and free (shared
# notes, mechanics.md, section 6), +1 to +4 %.
_MODEL_SHARE = 0.04


def modulus_only_scales(mechanics: Mechanics, elastomer: Elastomer, load: Press) -> bool:
    """Tell whether a press depends on the modulus through the size of pressure and force alone.

    Not under force control; not with a coat, weight or back pressure of given size beside the
    modulus; not in the references, whose solvers work in kPa.
    """
    return (
        load.control == "depth"
        and elastomer.film is None
        and load.back_pressure_kpa == 0.0
        and load.gravity_deg is None
        and (
            mechanics.model == "spectral" or (mechanics.model == "auto" and not may_wrap(elastomer))
        )
    )


def unit_press(
    mechanics: Mechanics, specimen: Specimen, elastomer: Elastomer, load: Press
) -> PressedElastomer | None:
    """Press an elastomer of 1 kPa; None where the modulus does more than scale.

    Raises
    ------
    PressError, SolverError : as `press_with`
    """
    if not modulus_only_scales(mechanics, elastomer, load):
        return None
    kept = {n: getattr(elastomer, n) for n in Elastomer.model_fields if n not in _STIFFNESS}
    soft = Elastomer(**kept, young_modulus_kpa=1.0)
    pressed = press_with(mechanics, specimen, soft, load)
    return pressed if pressed.model == "spectral" else None


def with_modulus(pressed: PressedElastomer, elastomer: Elastomer) -> PressedElastomer:
    """Scale what `unit_press` found to an elastomer's own modulus."""
    modulus_kpa = young_modulus(elastomer).best_kpa
    return replace(
        pressed,
        pressure_kpa=pressed.pressure_kpa * modulus_kpa,
        force_n=pressed.force_n * modulus_kpa,
        young_modulus_kpa=modulus_kpa,
    )


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
    measured_force_n : read from the stage, > 0
    pressed : the same press by DEPTH, of any modulus, without back pressure, gravity or film: its
        force is then in proportion to the modulus
    force_error : relative error of the force gauge
    depth_error_mm : error of the depth, first touch included

    Returns
    -------
    Range: errors of gauge, depth (force grows at least as depth^1.5, taken as depth^2) and model (4
    %) added up

    Raises
    ------
    PressError : a force that is not positive
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
