"""Press with the model that the experiment asks for; every model returns the same type."""

from dataclasses import replace
from typing import TYPE_CHECKING

from twin.config.models import Elastomer, Mechanics, PadFile, Press, Specimen
from twin.mechanics.errors import PressError
from twin.mechanics.press import PressedElastomer, check_load, press
from twin.mechanics.validity import DEFLECTION_OVER_THICKNESS_LIMIT
from twin.specimens import shape_of
from twin.specimens.mesh_file import read_closed_mesh

if TYPE_CHECKING:
    from twin.mechanics.reference.pad import Pad


def press_with(
    mechanics: Mechanics, specimen: Specimen, elastomer: Elastomer, load: Press
) -> PressedElastomer:
    """Press `specimen` into `elastomer` with the chosen model.

    Raises
    ------
    PressError
        What the model cannot do, and what to change.
    SolverError
        The solution did not converge.
    """
    # The references pull in scikit-fem and interpolators: only on demand.
    if mechanics.model == "fem":
        from twin.mechanics.reference.fem_press import press_fem

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
    if mechanics.model != "neo_hookean":
        pressed = press(specimen, elastomer, load)
        if mechanics.model == "spectral" or choose_model(pressed, elastomer, load) == "spectral":
            return pressed
    from twin.mechanics.reference.thin_sheet import press_neo_hookean

    return replace(press_neo_hookean(specimen, elastomer, load), model="neo_hookean")


def check_press(
    mechanics: Mechanics, specimen: Specimen, elastomer: Elastomer, load: Press
) -> None:
    """Refuse what `press_with` refuses before it solves anything.

    Raises
    ------
    PressError
        What the model cannot do, and what to change.
    """
    if mechanics.model == "fem":
        from twin.mechanics.reference.fem_press import check_fem

        check_fem(elastomer, mechanics.support)
        if mechanics.pad is not None:
            _check_pad(elastomer)
        return
    check_load(shape_of(specimen), elastomer, load)
    if mechanics.model == "neo_hookean":
        from twin.mechanics.reference.thin_sheet import check_neo_hookean

        check_neo_hookean(elastomer, load)


def choose_model(pressed: PressedElastomer, elastomer: Elastomer, load: Press) -> str:
    """Return the model that is right for a case, from its spectral solution.

    A sheet that deflects by about its thickness stretches as it bends, which a linear slab leaves
    out. The large-strain model knows neither film, back pressure nor weight: such cases stay
    spectral and flagged.
    """
    preloaded = load.back_pressure_kpa > 0 or load.gravity_deg is not None
    thin = (
        elastomer.layout == "opposite_face"
        and pressed.validity.deflection_over_thickness > DEFLECTION_OVER_THICKNESS_LIMIT
    )
    return "neo_hookean" if thin and not preloaded and elastomer.film is None else "spectral"


def read_pad(source: PadFile, elastomer: Elastomer) -> "Pad":
    """Read a pad from CAD, put it in place and name its faces.

    Raises
    ------
    InputError
        The file is missing, unreadable or not closed, or the layout does not fit.
    """
    from twin.mechanics.reference.pad import Hold, Pad, facing, on_plane

    _check_pad(elastomer)
    body = read_closed_mesh("mechanics.pad.file", source.file)
    body.apply_scale(source.scale_mm)
    low, high = body.bounds
    body.apply_translation((-(low[0] + high[0]) / 2, -(low[1] + high[1]) / 2, -low[2]))
    coated = facing((0, 0, -1), source.facing_deg)
    window = on_plane("z", float(body.bounds[1, 2]))
    return Pad(body, elastomer.poisson_ratio, (Hold(window),), touched=coated, coated=coated)


def _check_pad(elastomer: Elastomer) -> None:
    if elastomer.layout != "contact_face":
        raise PressError(
            "mechanics.pad: needs elastomer.layout = 'contact_face' (it is seen through its window)"
        )
