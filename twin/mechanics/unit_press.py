"""Press once for all moduli: at a given depth the shape of a linear slab does not depend on it.

With unit modulus the contact pressure is what the solver finds; pressure and force of any modulus
are that times the modulus, to the last bit, because the solver works in pressure over modulus.
"""

from dataclasses import replace

from twin.config.models import Elastomer, Mechanics, Press, Specimen
from twin.mechanics.choice import may_wrap, press_with
from twin.mechanics.hardness import young_modulus
from twin.mechanics.press import PressedElastomer

_STIFFNESS = {"shore_a", "shore_00", "young_modulus_kpa"}


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
    PressError, SolverError
        As `press_with`.
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
