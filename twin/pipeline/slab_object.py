"""Fit the parameters of an object of known form under a thick slab to the slab's coat."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.compensation import (
    CompensatedSlab,
    FittedNumber,
    FittedSlab,
    KnownForce,
    Relief,
    SheetOpening,
    bound_under_slab,
    fit_under_slab,
    relief_on_frame,
    require_determined,
)
from reconstruction.errors import InputError
from twin.config.models import Elastomer
from twin.config.sensor_layer import SensorLayer
from twin.config.specimen_base import Specimen
from twin.mechanics.hardness import young_modulus
from twin.pipeline.slab_model import (
    AIR,
    MODULUS,
    PLANE,
    STRAIN,
    THICKNESS,
    TRAVEL,
    PressedCoat,
    SlabObject,
    value_of,
    with_modulus,
    with_value,
)
from twin.results.under_sheet import sigma_of_modulus
from twin.specimens import shape_of

# Size of the relief's cells: much finer than the finest detail that a slab transmits, and coarser
# than a pixel. The mean of a cell differs from its middle by curvature times cell^2 / 24, < 0.1 um.
_CELL_MM = 0.1
_MOST_CELLS = 60_000
# Least share of the slab that must be measured: the fit uses no filled gaps, so that the area
# around the object is enough.
_LEAST_SHARE = 0.02
# Grid spacings of the contact solution. The difference of the two results is part of the
# uncertainty of the result on the finer grid.
_SOLVER_PITCHES_MM = 0.08, 0.055
# Allowed ranges about the start values: factor for lengths, difference for positions and angles,
# factor for parameters of the layer.
_LENGTH_FACTOR, _PLACE_MM, _ANGLE_DEG, _LAYER_FACTOR = 4.0, 5.0, 20.0, 2.0
_LEAST_TRAVEL_MM, _MOST_TRAVEL = 0.01, 0.98
_PLANE_MM = 1.0
_MOST_SIGMAS = 10.0
# Relative error of the force of a linear frictionless slab, compared with a neo-Hookean slab.
_FORCE_THEORY = 0.04


def slab_object(layer: SensorLayer, specimen: Specimen | None) -> SlabObject:
    """Return the object of known form under a slab, and the parameters to be fitted.

    Parameters
    ----------
    layer : slab and load; its specimen and list of fitted parameters are used if it has them
    specimen : specimen of the experiment, used if the layer has none

    Raises
    ------
    InputError : there is no specimen, or it is not known which of its parameters to fit
    """
    pressed = layer.specimen or specimen
    if pressed is None:
        raise InputError(
            f"elastomer: {layer.elastomer.thickness_mm:g} mm thick, coated on the far face, which "
            "shows no free form; add [specimen] to the layer file: the form that was pressed, its "
            "numbers about right, see docs/compensation.md"
        )
    fitted_paths = layer.fitted or pressed.slab_fit_paths
    if not fitted_paths:
        raise InputError(
            f"specimen.kind = '{pressed.kind}': not known which of its numbers to fit; give "
            'fitted = ["..."] in the layer file, such as ["x_mm", "y_mm"]'
        )
    for path in fitted_paths:
        value_of(pressed, path)
    return SlabObject(pressed, tuple(fitted_paths), layer)


def fit_slab(
    points_mm: FloatArray,
    sigma_mm: FloatArray,
    slab: SlabObject,
    extra: Sequence[FittedNumber] = (),
) -> CompensatedSlab:
    """Fit the parameters of the object under a slab to measured points of the coat.

    Parameters
    ----------
    points_mm, sigma_mm : (n, xyz) points, world, and (n,) standard uncertainty of z
    slab : object of known form, slab and load
    extra : parameters of the layer that are fitted without a prior; they replace those of the same
        name with a stated standard uncertainty

    Raises
    ------
    FitError : no press agrees with the points, or the points do not separate the parameters
    """
    relief = _relief(points_mm, sigma_mm, slab.elastomer)
    unknowns = _unknowns(slab, extra)
    names, force = tuple(unknown.name for unknown in unknowns), _force(slab)
    models = [PressedCoat(slab, relief, names, pitch) for pitch in _SOLVER_PITCHES_MM]
    fitted = fit_under_slab(relief, models, unknowns, force)
    return _compensated(relief, fitted, models[-1])


def bound_slab(points_mm: FloatArray, sigma_mm: FloatArray, slab: SlabObject) -> dict[str, float]:
    """Return the least standard deviation by noise (Cramer-Rao bound) of each fitted parameter.

    The result is by path in the specimen, in mm or degrees.

    Parameters
    ----------
    points_mm, sigma_mm : as in `fit_slab`, for points with independent noise
    slab : object with its true parameters

    Raises
    ------
    FitError : no press exists with these parameters, or the coat does not separate them
    """
    relief = _relief(points_mm, sigma_mm, slab.elastomer)
    unknowns = _unknowns(slab, ())
    names = tuple(unknown.name for unknown in unknowns)
    model = PressedCoat(slab, relief, names, _SOLVER_PITCHES_MM[0])
    sigma = np.sqrt(np.diag(bound_under_slab(relief, model, unknowns, _force(slab))))
    bounds = dict(zip(names, sigma.tolist(), strict=True))
    return {path: bounds[f"specimen.{path}"] for path in slab.fitted_paths}


def calibrate_slab(
    points_mm: FloatArray, sigma_mm: FloatArray, slab: SlabObject, ball_diameter_mm: float
) -> tuple[SensorLayer, dict[str, Any]]:
    """Fit the thickness of a slab, and if possible its modulus, to a press of a known ball.

    The modulus is fitted if the back pressure is not 0 or the force is known. Errors of the linear
    model are not included in the uncertainties here: later presses of the same slab have the same
    errors, and include them in their uncertainties.

    Parameters
    ----------
    points_mm, sigma_mm : as in `fit_slab`
    ball_diameter_mm : known diameter of the ball

    Returns
    -------
    the layer with the fitted values and their standard uncertainties, and figures of result.json

    Raises
    ------
    InputError : the object is no ball
    FitError : for the reasons of `fit_slab`, or the press does not determine thickness or modulus
    """
    if "diameter_mm" not in slab.fitted_paths:
        kind = slab.specimen.kind
        raise InputError(f"--ball-diameter-mm: found specimen.kind = '{kind}', allowed a ball")
    layer, elastomer = slab.layer, slab.elastomer
    slab = replace(slab, theory=False)
    before = fit_slab(points_mm, sigma_mm, slab).fitted.value("specimen.diameter_mm") / 2
    known = replace(
        slab,
        specimen=with_value(slab.specimen, "diameter_mm", ball_diameter_mm),
        fitted_paths=tuple(path for path in slab.fitted_paths if path != "diameter_mm"),
    )
    thickness = {THICKNESS: elastomer.thickness_mm}
    if layer.press.back_pressure_kpa or layer.press.force_n is not None:
        thickness[MODULUS] = young_modulus(elastomer).best_kpa
    free = [
        FittedNumber(name, value, value / _LAYER_FACTOR, value * _LAYER_FACTOR)
        for name, value in thickness.items()
    ]
    fitted = fit_slab(points_mm, sigma_mm, known, free).fitted
    for name in thickness:
        require_determined(name, fitted.value(name), fitted.sigma(name))
    sigma = {"thickness_mm": fitted.sigma(THICKNESS)}
    changed = elastomer.model_copy(update={"thickness_mm": fitted.value(THICKNESS)})
    figures: dict[str, Any] = {
        "calibrated_thickness_mm": fitted.value(THICKNESS),
        "calibrated_thickness_sigma_um": 1e3 * fitted.sigma(THICKNESS),
        "calibrated_modulus_kpa": None,
        "calibrated_modulus_sigma_kpa": None,
        "radius_before_calibration_mm": before,
    }
    if MODULUS in thickness:
        changed = with_modulus(changed, fitted.value(MODULUS))
        sigma["young_modulus_kpa"] = fitted.sigma(MODULUS)
        figures["calibrated_modulus_kpa"] = fitted.value(MODULUS)
        figures["calibrated_modulus_sigma_kpa"] = fitted.sigma(MODULUS)
    known_now = {"elastomer": changed, "sigma": layer.sigma.model_copy(update=sigma)}
    return layer.model_copy(update=known_now), figures


def _relief(points_mm: FloatArray, sigma_mm: FloatArray, elastomer: Elastomer) -> Relief:
    lengths = elastomer.length_x_mm, elastomer.length_y_mm
    cell = max(_CELL_MM, float(np.sqrt(lengths[0] * lengths[1] / _MOST_CELLS)))
    cells = round(lengths[0] / cell), round(lengths[1] / cell)
    return relief_on_frame(points_mm, sigma_mm, SheetOpening(*lengths), cells, _LEAST_SHARE)


def _unknowns(slab: SlabObject, extra: Sequence[FittedNumber]) -> list[FittedNumber]:
    """Return all unknowns of a fit.

    They are the parameters of the object, the travel, the uncertain parameters of layer, load and
    plane, the effect of large strain, and `extra`.
    """
    unknowns = [_of_the_specimen(slab.specimen, path) for path in slab.fitted_paths]
    unknowns += [number for number in [_travel(slab)] if number is not None]
    layer, extra_names = slab.layer, {number.name for number in extra}
    modulus = young_modulus(layer.elastomer).best_kpa
    for name, value, sigma in (
        (THICKNESS, layer.elastomer.thickness_mm, layer.sigma.thickness_mm),
        (MODULUS, modulus, sigma_of_modulus(layer)),
        (AIR, layer.press.back_pressure_kpa, layer.sigma.back_pressure_kpa),
    ):
        if sigma > 0 and name not in extra_names:
            low, high = value / _LAYER_FACTOR, max(value * _LAYER_FACTOR, value + 10 * sigma)
            unknowns.append(FittedNumber(name, value, low, high, value, sigma))
    if slab.theory:
        unknowns.append(FittedNumber(STRAIN, 0.0, -_MOST_SIGMAS, _MOST_SIGMAS, 0.0, 1.0))
    plane = layer.sigma.plane_mm
    if plane > 0:
        unknowns += [FittedNumber(name, 0.0, -_PLANE_MM, _PLANE_MM, 0.0, plane) for name in PLANE]
    return [*unknowns, *extra]


def _of_the_specimen(specimen: Specimen, path: str) -> FittedNumber:
    start, last = value_of(specimen, path), path.rpartition(".")[2]
    if last.endswith("_deg"):
        return FittedNumber(f"specimen.{path}", start, start - _ANGLE_DEG, start + _ANGLE_DEG)
    if last in ("x_mm", "y_mm", "z_mm"):
        return FittedNumber(f"specimen.{path}", start, start - _PLACE_MM, start + _PLACE_MM)
    return FittedNumber(f"specimen.{path}", start, start / _LENGTH_FACTOR, start * _LENGTH_FACTOR)


def _travel(slab: SlabObject) -> FittedNumber | None:
    """Return the travel as an unknown of the fit, with its prior; None if the travel is exact."""
    depth_mm, sigma = slab.layer.press.depth_mm, slab.layer.sigma.depth_mm
    most = _MOST_TRAVEL * slab.elastomer.thickness_mm
    start = slab.load.depth_mm
    assert start is not None  # `load` presses to a depth
    if depth_mm is None or sigma is None:
        return FittedNumber(TRAVEL, start, _LEAST_TRAVEL_MM, most)
    return (
        None
        if sigma == 0
        else FittedNumber(TRAVEL, depth_mm, _LEAST_TRAVEL_MM, most, depth_mm, sigma)
    )


def _force(slab: SlabObject) -> KnownForce | None:
    """Return the measured force, with the uncertainties of gauge and model; None: not measured."""
    force, sigma = slab.layer.press.force_n, slab.layer.sigma.force_n
    return (
        None if force is None else KnownForce(force, float(np.hypot(sigma, _FORCE_THEORY * force)))
    )


def _compensated(relief: Relief, fitted: FittedSlab, model: PressedCoat) -> CompensatedSlab:
    """Return contact, pressure and touched face of the fitted press on the cells of the relief."""
    solved = model.solved(fitted.values)
    specimen = model.specimen(fitted.values)
    behind = shape_of(specimen).height_above_lowest(relief.x_mm, relief.y_mm)
    row, col = (
        np.clip(np.rint((at - cells[0]) / (cells[1] - cells[0])).astype(int), 0, len(cells) - 1)
        for at, cells in ((relief.y_mm, solved.layer.y_mm), (relief.x_mm, solved.layer.x_mm))
    )
    pressure = solved.contact.pressure[np.ix_(row, col)]
    contact = (pressure > 0) & np.isfinite(behind)
    face = solved.touched_mm[np.ix_(row, col)]
    top = solved.contact.depth_mm - np.where(np.isfinite(behind), behind, 0.0)
    return CompensatedSlab(
        relief=relief,
        contact=contact,
        pressure_kpa=pressure * young_modulus(solved.elastomer).best_kpa,
        touched_mm=np.where(contact, top - solved.elastomer.thickness_mm, face),
        fitted=fitted,
        force_theory=_FORCE_THEORY,
    )
