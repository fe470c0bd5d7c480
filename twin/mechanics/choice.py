"""Press with the configured elastomer model, or with the model of the least expected error.

At a given depth the shape of a linear slab does not depend on its Young's modulus. The solver
computes pressure over modulus. Pressure and force for any modulus are therefore those of 1 kPa
times the modulus in kPa, equal to the last bit: a single press is sufficient for all moduli.
"""

from dataclasses import replace
from functools import partial
from math import inf

from reconstruction.arrays import FloatArray
from twin.config.elastomer import SHEET_THICKNESS_MM
from twin.config.elastomer_models import AUTO
from twin.config.models import Elastomer, Mechanics, Press, Specimen
from twin.mechanics.errors import PressError, SolverError
from twin.mechanics.hardness import young_modulus
from twin.mechanics.models import (
    MODELS,
    ElastomerModel,
    PressInput,
    Progress,
    SettledPress,
    model_of,
)
from twin.mechanics.press import PressedElastomer, scaled_stress
from twin.mechanics.relaxation import check_relaxation, press_relaxing, relaxed_press, relaxes

_STIFFNESS = {"shore_a", "shore_00", "young_modulus_kpa", "relaxation"}


def press_with(
    mechanics: Mechanics,
    specimen: Specimen,
    elastomer: Elastomer,
    load: Press,
    progress: Progress | None = None,
) -> PressedElastomer:
    """Press `specimen` into `elastomer` with the model that `select_model` returns.

    Parameters
    ----------
    progress : called by models with load steps, with the finished fraction of them, 0 to 1

    Raises
    ------
    PressError : the model cannot compute this press; the message states the remedy
    SolverError : the solution did not converge
    """
    case = PressInput(mechanics, specimen, elastomer, load)
    model = select_model(case)
    _check(model, case)
    run = partial(press_relaxing, model) if relaxes(elastomer, load) else model.press
    pressed = replace(run(case, progress), model=model.name)
    doubts = specimen.warnings()
    validity = replace(pressed.validity, warnings=(*pressed.validity.warnings, *doubts))
    return replace(pressed, validity=validity)


def settled_with(case: PressInput, progress: Progress | None = None) -> SettledPress:
    """Press with the model that `select_model` returns, and return the equilibrium.

    By its derivatives, the equilibrium also gives presses with slightly changed input.

    Parameters
    ----------
    progress : called with the finished fraction of the load steps, 0 to 1

    Raises
    ------
    PressError : the model has no derivatives, or an error of `press_with`
    SolverError : the solution did not converge
    """
    model = select_model(case)
    check_history(model, case)
    return model.settle(case, progress)


def preview_with(case: PressInput, near: SettledPress | None = None) -> SettledPress | None:
    """Press less accurately than `press_with`, with the same model, in less time.

    Parameters
    ----------
    near : an earlier preview of a similar press, from which the solution may start

    Returns
    -------
    The press; None if the model has no faster computation than that of `press_with`

    Raises
    ------
    PressError, SolverError : as `press_with`
    """
    model = select_model(case)
    _check(model, case)
    if near is None:
        return model.preview(case)
    try:
        return model.preview(case, near)
    except SolverError:
        return model.preview(case)  # without the start, which may be far from this press


def check_press(
    mechanics: Mechanics, specimen: Specimen, elastomer: Elastomer, load: Press
) -> None:
    """Raise the errors that `press_with` raises before it solves.

    Raises
    ------
    PressError : the model cannot compute this press; the message states the remedy. If `auto` may
        select several models and none of them can compute the press: the error of the first model
    """
    case = PressInput(mechanics, specimen, elastomer, load)
    errors = []
    for model in possible_models(case):
        try:
            return _check(model, case)
        except PressError as error:
            errors.append(error)
    raise errors[0]


def check_history(model: ElastomerModel, case: PressInput) -> None:
    """Raise an error if a model lacks the relaxation or the slide of a press.

    Raises
    ------
    PressError : the message states key, value and remedy
    """
    check_relaxation(model, case)
    if case.load.slides and not model.slides:
        key = "slide_x_mm" if case.load.slide_x_mm else "slide_y_mm"
        raise PressError(
            f"press.{key}: found {getattr(case.load, key):g} mm, which the {model.name} model "
            "lacks; use mechanics.model = 'spectral' with elastomer.layout = 'contact_face', or "
            "remove it"
        )


def _check(model: ElastomerModel, case: PressInput) -> None:
    check_history(model, case)
    model.check(case)


def possible_models(case: PressInput) -> list[ElastomerModel]:
    """Return a list of the configured model only, or of all models that `auto` may select."""
    if case.mechanics.model != AUTO:
        return [MODELS[case.mechanics.model]]
    return [model for model in MODELS if model.is_automatic and model.applies(case)]


def select_model(case: PressInput) -> ElastomerModel:
    """Return the model with the least expected error among the models of `possible_models`.

    A model without an error estimate is selected only if no model has an estimate. If two
    estimates are equal, the model of a thin sheet is selected: it is faster than solid elements.

    Raises
    ------
    PressError : no model can compute this press
    """
    models = possible_models(case)
    if len(models) == 1:
        return models[0]
    errors_mm: dict[ElastomerModel, float] = {}
    errors = []
    for model in models:
        try:
            error_mm = model.error_estimate_mm(case)
            errors_mm[model] = inf if error_mm is None else error_mm
        except PressError as error:
            errors.append(error)
    if not errors_mm:
        raise errors[0]
    return min(errors_mm, key=lambda model: (errors_mm[model], not model.wraps))


def rest_face_mm(case: PressInput, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray | None:
    """Return world z (row, col), mm, of the undeformed coated face; None: z = 0 everywhere.

    A face of another shape needs a stated model: none that `auto` may select has one.

    Parameters
    ----------
    x_mm, y_mm : (col,) and (row,) float, mm; nodes of the face
    """
    models = possible_models(case)
    return models[0].rest_face_mm(case, x_mm, y_mm) if len(models) == 1 else None


def may_wrap(elastomer: Elastomer) -> bool:
    """Whether an elastomer is a thin sheet, which may wrap round the object."""
    return elastomer.is_thin_sheet


def is_slab(elastomer: Elastomer) -> bool:
    """Whether an elastomer is a slab on a rectangular rim, thicker than any thin sheet (1 mm)."""
    thick = elastomer.thickness_mm > SHEET_THICKNESS_MM[1]
    return thick and elastomer.layout == "opposite_face" and elastomer.outline != "round"


def modulus_only_scales(case: PressInput) -> bool:
    """Whether Young's modulus only scales the pressure and force of a press, not its shape.

    The result is False if the force is prescribed. It is False with a film, weight or back
    pressure, because their stiffness or pressure does not scale with the modulus, and for the ramp
    of a relaxing elastomer, whose force depends on several presses. Of the models in
    `possible_models`, one must be the linear slab and none may be a sheet that wraps.
    """
    if (
        case.load.control != "depth"
        or case.elastomer.film is not None
        or case.load.back_pressure_kpa != 0.0
        or case.load.gravity_deg is not None
        or (case.elastomer.relaxation is not None and case.load.ramp_s > 0)
    ):
        return False
    models = possible_models(case)
    return any(model.is_linear_slab for model in models) and not any(
        model.wraps for model in models
    )


def unit_press(
    mechanics: Mechanics, specimen: Specimen, elastomer: Elastomer, load: Press
) -> PressedElastomer | None:
    """Press the elastomer with a Young's modulus of 1 kPa instead of its own.

    Returns
    -------
    The pressed elastomer at 1 kPa; None if the modulus also changes the shape, see
    `modulus_only_scales`

    Raises
    ------
    PressError, SolverError : as `press_with`
    """
    if not modulus_only_scales(PressInput(mechanics, specimen, elastomer, load)):
        return None
    unchanged = {n: getattr(elastomer, n) for n in Elastomer.model_fields if n not in _STIFFNESS}
    soft = Elastomer(**unchanged, young_modulus_kpa=1.0)
    pressed = press_with(mechanics, specimen, soft, load)
    return pressed if model_of(pressed.model).is_linear_slab else None


def with_modulus(case: PressInput, unit: PressedElastomer) -> PressedElastomer:
    """Scale pressure and force of a `unit_press` to the modulus of an elastomer, then relax them.

    Parameters
    ----------
    case : the press whose shape `unit` has
    """
    pressed = scaled_stress(unit, young_modulus(case.elastomer).best_kpa)
    return relaxed_press(pressed, case) if relaxes(case.elastomer, case.load) else pressed
