"""Press with the model that the experiment asks for; every model returns the same type.

At a given depth the shape of a linear slab does not depend on its modulus. With unit modulus the
contact pressure is what the solver finds; pressure and force of any modulus are that times the
modulus, to the last bit, because the solver works in pressure over modulus: one press for all.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from twin.config.models import Elastomer, Mechanics, PadFile, Press, Specimen
from twin.mechanics.errors import PressError
from twin.mechanics.hardness import young_modulus
from twin.mechanics.press import PressedElastomer, check_load, press
from twin.mechanics.validity import (
    DEFLECTION_OVER_THICKNESS_LIMIT,
    SHEET_LIMIT,
    SHEET_THICKNESS_MM,
)
from twin.shape import Shape
from twin.specimens import shape_of
from twin.specimens.mesh_files import read_body_mm

if TYPE_CHECKING:
    from twin.mechanics.reference.pad import Pad
    from twin.mechanics.sheet.press import SettledSheet

_STIFFNESS = {"shore_a", "shore_00", "young_modulus_kpa"}


def press_with(
    mechanics: Mechanics,
    specimen: Specimen,
    elastomer: Elastomer,
    load: Press,
    progress: Callable[[float], None] | None = None,
) -> PressedElastomer:
    """Press `specimen` into `elastomer` with the chosen model.

    Parameters
    ----------
    progress : called with the share of the load steps that a thin sheet has made

    Raises
    ------
    PressError : what the model cannot do, and what to change
    SolverError : the solution did not converge
    """
    pressed = _pressed_by(mechanics, specimen, elastomer, load, progress)
    doubts = specimen.warnings()
    validity = replace(pressed.validity, warnings=(*pressed.validity.warnings, *doubts))
    return replace(pressed, validity=validity)


def _pressed_by(
    mechanics: Mechanics,
    specimen: Specimen,
    elastomer: Elastomer,
    load: Press,
    progress: Callable[[float], None] | None,
) -> PressedElastomer:
    # The references pull in scikit-fem and interpolators: only on demand.
    if mechanics.model == "fem":
        from twin.mechanics.reference.fem import press_fem

        found = press_fem(
            specimen,
            elastomer,
            load,
            support=mechanics.support,
            ledge_mm=mechanics.ledge_mm,
            pad=None if mechanics.pad is None else read_pad(mechanics.pad, elastomer),
            count=mechanics.tetrahedra,
        )
        return replace(found, model="fem")
    model, slab = _decided(mechanics, specimen, elastomer, load)
    if model == "sheet":
        return _press_sheet(mechanics, specimen, elastomer, load, progress)
    if model == "spectral":
        return slab or _press_slab(specimen, elastomer, load)
    from twin.mechanics.reference.neo_hookean import press_neo_hookean

    _refuse_sheet_keys(elastomer, "neo_hookean")
    return replace(press_neo_hookean(specimen, elastomer, load), model="neo_hookean")


def settled_with(
    mechanics: Mechanics,
    specimen: Specimen,
    elastomer: Elastomer,
    load: Press,
    progress: Callable[[float], None] | None = None,
) -> "SettledSheet":
    """Press a thin sheet, and return it as the solver holds it.

    Parameters
    ----------
    progress : called with the share of the load steps that is done

    Raises
    ------
    PressError : the chosen model is another one, or as `press_with`
    SolverError : the solution did not converge
    """
    model, _ = _decided(mechanics, specimen, elastomer, load)
    if model != "sheet":
        raise PressError(
            f"mechanics.model: found '{model}', which has no derivatives; the thin sheet has "
            f"(opposite_face, no film, {SHEET_THICKNESS_MM[0]:g} to {SHEET_THICKNESS_MM[1]:g} mm); "
            "twin sweep shows what another model does"
        )
    from twin.mechanics.sheet.press import settled_sheet

    return settled_sheet(specimen, elastomer, load, mechanics, progress)


def check_press(
    mechanics: Mechanics, specimen: Specimen, elastomer: Elastomer, load: Press
) -> None:
    """Refuse what `press_with` refuses before it solves anything.

    Raises
    ------
    PressError : what the model cannot do, and what to change
    """
    if mechanics.model == "fem":
        from twin.mechanics.reference.fem import check_fem

        check_fem(elastomer, mechanics.support)
        if mechanics.pad is not None:
            read_pad(mechanics.pad, elastomer)
        return
    wraps = mechanics.model == "auto" and must_wrap(elastomer, load)
    if mechanics.model == "sheet" or wraps:
        from twin.mechanics.sheet.case import check_sheet

        check_sheet(shape_of(specimen), elastomer, load, mechanics)
        return
    _refuse_sheet_keys(elastomer, mechanics.model)
    bends = mechanics.model == "neo_hookean"
    check_load(shape_of(specimen), elastomer, load, any_depth=bends)
    if mechanics.model == "neo_hookean":
        from twin.mechanics.reference.neo_hookean import check_neo_hookean

        check_neo_hookean(elastomer, load)


def _decided(
    mechanics: Mechanics, specimen: Specimen, elastomer: Elastomer, load: Press
) -> tuple[str, PressedElastomer | None]:
    """Return the model that presses, and the slab's press where the choice rests on it."""
    if mechanics.model != "auto":
        return mechanics.model, None
    slab = None if must_wrap(elastomer, load) else _slab_first(specimen, elastomer, load)
    return choose_model(slab, shape_of(specimen), elastomer, load), slab


def must_wrap(elastomer: Elastomer, load: Press) -> bool:
    """Tell whether only the thin sheet can describe a case, before anything is solved.

    It alone knows tack, friction, pre-stretch and a round frame, and a slab's travel is less than
    its thickness.
    """
    deep = load.depth_mm is not None and load.depth_mm >= elastomer.thickness_mm
    return may_wrap(elastomer) and (deep or bool(_sheet_keys(elastomer)))


def may_wrap(elastomer: Elastomer) -> bool:
    """Tell whether the thin sheet can describe an elastomer."""
    low, high = SHEET_THICKNESS_MM
    thin = low <= elastomer.thickness_mm <= high
    return thin and elastomer.layout == "opposite_face" and elastomer.film is None


def is_slab(elastomer: Elastomer) -> bool:
    """Tell whether an elastomer is a slab with a rectangular rim, too thick to wrap."""
    thick = elastomer.thickness_mm > SHEET_THICKNESS_MM[1]
    return thick and elastomer.layout == "opposite_face" and elastomer.outline != "round"


def choose_model(
    slab: PressedElastomer | None, shape: Shape, elastomer: Elastomer, load: Press
) -> str:
    """Return the model whose stated error is least, from the spectral solution if there is one.

    A slab that deflects by about its thickness stretches as it bends, which the spectral one leaves
    out. The thin sheet leaves out shear through its thickness, which counts above an eighth of the
    radius of bending; beyond a quarter solid elements are right, but they know neither film, back
    pressure nor weight.
    """
    if slab is not None:
        bent = slab.validity.deflection_over_thickness > DEFLECTION_OVER_THICKNESS_LIMIT
        if elastomer.layout == "contact_face" or not bent:
            return "spectral"
    radius_mm = min((ball.radius_mm for ball in shape.spheres()), default=np.inf)
    solids = not (load.back_pressure_kpa or load.gravity_deg is not None or elastomer.film)
    if may_wrap(elastomer):
        bends = elastomer.thickness_mm / (radius_mm + elastomer.thickness_mm / 2)
        thick = bends > SHEET_LIMIT and slab is not None and solids
        return "neo_hookean" if thick else "sheet"
    return "neo_hookean" if solids or slab is None else "spectral"


def _press_slab(specimen: Specimen, elastomer: Elastomer, load: Press) -> PressedElastomer:
    _refuse_sheet_keys(elastomer, "spectral")
    return press(specimen, elastomer, load)


def _slab_first(specimen: Specimen, elastomer: Elastomer, load: Press) -> PressedElastomer | None:
    """Return the slab's press; None where it has none, but the sheet may have one."""
    try:
        return _press_slab(specimen, elastomer, load)
    except PressError:
        if may_wrap(elastomer):
            return None
        raise


def _press_sheet(
    mechanics: Mechanics,
    specimen: Specimen,
    elastomer: Elastomer,
    load: Press,
    progress: Callable[[float], None] | None,
) -> PressedElastomer:
    from twin.mechanics.sheet.press import press_sheet

    return press_sheet(specimen, elastomer, load, mechanics, progress)


def _sheet_keys(elastomer: Elastomer) -> list[str]:
    """Return the keys that only the sheet model knows and that say something."""
    said = {
        "outline": elastomer.outline != "rectangular",
        "pre_stretch": elastomer.pre_stretch != 1,
        "rim_compliance_mm2_per_n": elastomer.rim_compliance_mm2_per_n > 0,
        "tack_j_m2": elastomer.tack_j_m2 > 0,
        "friction": elastomer.friction == "stick",
    }
    return [key for key, given in said.items() if given]


def _refuse_sheet_keys(elastomer: Elastomer, model: str) -> None:
    keys = _sheet_keys(elastomer)
    if keys:
        low, high = SHEET_THICKNESS_MM
        raise PressError(
            f"elastomer.{keys[0]}: found {getattr(elastomer, keys[0])!r}, which the {model} model "
            f"does not know; use the sheet model (opposite_face, no film, {low:g} to {high:g} mm)"
        )


def read_pad(source: PadFile, elastomer: Elastomer) -> "Pad":
    """Read a pad from CAD, put it in place and name its faces.

    Raises
    ------
    InputError : the file is missing, unreadable or not closed, the layout does not fit, or the
        elastomer's rectangle reaches beyond the pad's coated face
    """
    from twin.mechanics.reference.pad import Hold, Pad, check_cover, facing, on_plane

    _check_layout(elastomer)
    scale = "mechanics.pad.scale_mm"
    body = read_body_mm("mechanics.pad.file", source.file, scale, source.scale_mm)
    low, high = body.bounds
    body.apply_translation((-(low[0] + high[0]) / 2, -(low[1] + high[1]) / 2, -low[2]))
    coated = facing((0, 0, -1), source.facing_deg)
    window = on_plane("z", float(body.bounds[1, 2]))
    check_cover(body, coated, elastomer)
    return Pad(body, elastomer.poisson_ratio, (Hold(window),), touched=coated, coated=coated)


def _check_layout(elastomer: Elastomer) -> None:
    if elastomer.layout != "contact_face":
        raise PressError(
            "mechanics.pad: needs elastomer.layout = 'contact_face' (it is seen through its window)"
        )


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
