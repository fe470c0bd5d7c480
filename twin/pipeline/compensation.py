"""The rigid object from a measured coat: `twin compensate`, and the figures beside a measurement's.

Nothing of the truth is used: the measured points, and what is known of elastomer and load
(`SensorLayer`). The specimen's nominal places only name figures: which part is ball 1.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage

from reconstruction.arrays import FloatArray, Reason
from reconstruction.compensation import (
    Compensated,
    CompensatedGel,
    CompensatedSheet,
    GelLayer,
    ObjectPart,
    SheetLayer,
    SheetOpening,
    calibrate_sheet,
    compensate_gel,
    compensate_sheet,
    parts_of,
    relief_on_frame,
)
from reconstruction.errors import InputError
from reconstruction.evaluate.surface import write_surface
from reconstruction.netcdf import Labelled, LabelledArrays, write_arrays
from reconstruction.pipeline import Reconstruction, read_reconstruction, write_reconstruction
from reconstruction.reading import is_regular
from reconstruction.triangulation import PointMap
from twin.config import Experiment, load_experiment
from twin.config.digest import content_digest
from twin.config.loading import read_toml
from twin.config.sensor_layer import (
    SensorLayer,
    layer_to_toml,
    load_sensor_layer,
    sensor_layer_of,
)
from twin.mechanics.choice import may_wrap
from twin.mechanics.hardness import young_modulus
from twin.mechanics.layer import BondedLayer
from twin.mechanics.layouts import WINDOW_MARGIN, coat_film
from twin.output import EXPERIMENT_FILE, output_folder
from twin.pipeline.dimensions import RECONSTRUCTION_FILE
from twin.pipeline.progress import ProgressCallback, no_progress
from twin.results.names import COMPENSATED, may_compensate
from twin.results.parts import write_outcome
from twin.results.record import Fringes, Measurement
from twin.specimens import Sphere, shape_of

CONTACT_FILE, LAYER_FILE = "contact.nc", "layer.toml"
_UM = 1e3
# Of the gel: as fine as ridges that a bonded layer still answers to.
_GEL_CELL_MM = 0.08


@dataclass(frozen=True, eq=False)
class CompensationResult:
    """A compensation with what it rests on.

    Attributes
    ----------
    layer : as it was believed, or calibrated on a ball
    figures : as in result.json
    """

    found: Compensated
    layer: SensorLayer
    figures: Mapping[str, Any]


Draw = Callable[[Path, CompensationResult], None]


def _draws_nothing(_: Path, __: CompensationResult) -> None:
    return


def compensate_result(
    folder: Path,
    out: Path,
    layer_file: Path | None = None,
    watch: ProgressCallback = no_progress,
    draw: Draw = _draws_nothing,
    *,
    ball_diameter_mm: float | None = None,
) -> dict[str, Any]:
    """Compensate a result of `twin measure` or `twin reconstruct` into `out`; returns the figures.

    `out` holds the object's points as `twin reconstruct` writes the coat's (reconstruction.nc,
    points.ply, surface.ply, height_map.*), contact.nc, the layer, and result.json.

    Parameters
    ----------
    draw : adds a report to the folder
    ball_diameter_mm : of every ball in contact: the layer is calibrated on them first

    Raises
    ------
    InputError : no points, no layer, a layout that is not known, or points that tell no object
    """
    inputs = [folder, *([layer_file] if layer_file else [])]
    with output_folder(out, inputs) as target:
        watch("read", 0.0)
        measured = _read_points(folder)
        layer, experiment = _layer_of(folder, layer_file)
        watch("read", 1.0)
        watch("compensate", 0.0)
        figures: dict[str, Any] = {}
        if ball_diameter_mm is not None:
            layer, figures = calibrated_layer(measured.point_map, layer, ball_diameter_mm)
        found = compensate_points(measured.point_map, layer)
        watch("compensate", 1.0)
        balls = shape_of(experiment.specimen).spheres() if experiment else ()
        figures |= object_figures(found, balls)
        _write(target, measured, found)
        draw(target, CompensationResult(found, layer, figures))
        (target / LAYER_FILE).write_text(layer_to_toml(layer), encoding="utf-8")
        (target / EXPERIMENT_FILE).write_text(
            (folder / EXPERIMENT_FILE).read_text(encoding="utf-8")
            if is_regular(folder / EXPERIMENT_FILE)
            else layer_to_toml(layer),
            encoding="utf-8",
        )
        points = measured.point_map
        digest = content_digest(layer, points.points_world_mm, points.mask_reason)
        write_outcome(target, "compensate", figures, digest=digest)
    return figures


def compensate_points(points: PointMap, layer: SensorLayer) -> Compensated:
    """Compensate measured points by what carries them: a thin sheet, or a gel on a window.

    Raises
    ------
    InputError : a layout that is not known, or points that tell no object
    """
    elastomer = layer.elastomer
    on_window = elastomer.layout == "contact_face"
    if not (on_window or may_wrap(elastomer)):
        raise InputError(
            f"elastomer: found {elastomer.layout}, {elastomer.thickness_mm:g} mm thick; free forms "
            "are found under a sheet of up to 1 mm with no film, or with layout = 'contact_face'"
        )
    valid = points.valid
    if not valid.any():
        raise InputError("compensate: found no valid point; look at the mask's reasons")
    found = points.points_world_mm[valid].astype(np.float64)
    sigma_mm = points.sigma_z_mm[valid].astype(np.float64)
    if on_window:
        return _on_gel(found, sigma_mm, layer)
    return compensate_sheet(found, sigma_mm, sheet_layer(layer))


def calibrated_layer(
    points: PointMap, layer: SensorLayer, ball_diameter_mm: float
) -> tuple[SensorLayer, dict[str, Any]]:
    """Fit thickness and modulus of a sheet to a press of known balls; the layer, and the figures.

    Raises
    ------
    InputError : the elastomer is no thin sheet, or no ball is found
    """
    elastomer = layer.elastomer
    if not may_wrap(elastomer):
        raise InputError(
            f"--ball-diameter-mm: found {elastomer.layout}, {elastomer.thickness_mm:g} mm thick; a "
            "ball calibrates a sheet of up to 1 mm with layout = 'opposite_face'"
        )
    valid = points.valid
    found = calibrate_sheet(
        points.points_world_mm[valid].astype(np.float64),
        points.sigma_z_mm[valid].astype(np.float64),
        sheet_layer(layer),
        ball_diameter_mm / 2,
    )
    sheet = found.layer
    known = {"shore_a": None, "shore_00": None, "young_modulus_kpa": sheet.young_modulus_kpa}
    changed = elastomer.model_dump() | known | {"thickness_mm": sheet.thickness_mm}
    sigma = layer.sigma.model_dump() | {
        "thickness_mm": sheet.sigma_thickness_mm,
        "young_modulus_kpa": sheet.sigma_young_modulus_kpa,
        "pre_stretch": sheet.sigma_pre_stretch,
    }
    figures = {
        "calibrated_thickness_mm": sheet.thickness_mm,
        "calibrated_thickness_sigma_um": _UM * sheet.sigma_thickness_mm,
        "calibrated_modulus_kpa": sheet.young_modulus_kpa if found.modulus_found else None,
        "calibrated_modulus_sigma_kpa": (
            sheet.sigma_young_modulus_kpa if found.modulus_found else None
        ),
        "radius_before_calibration_mm": found.radius_before_mm,
        "thickness_per_pre_stretch_mm": found.thickness_per_pre_stretch_mm,
        "calibration_balls": found.balls,
    }
    return (
        layer.model_copy(
            update={
                "elastomer": type(elastomer).model_validate(changed),
                "sigma": type(layer.sigma).model_validate(sigma),
            }
        ),
        figures,
    )


def _on_gel(points_mm: FloatArray, sigma_mm: FloatArray, layer: SensorLayer) -> CompensatedGel:
    """Compensate the coat of a gel on a window, on the part of the pad that was measured."""
    elastomer = layer.elastomer
    span_x, span_y = (
        min(length, 2 * float(np.abs(points_mm[:, axis]).max()))
        for axis, length in enumerate((elastomer.length_x_mm, elastomer.length_y_mm))
    )
    cells = tuple(max(16, round(span / _GEL_CELL_MM)) for span in (span_x, span_y))
    relief = relief_on_frame(
        points_mm, sigma_mm, SheetOpening(span_x, span_y), (cells[0], cells[1])
    )
    pitch = relief.pitch_mm
    margins = [
        _margin(count, step, elastomer.thickness_mm)
        for count, step in zip(cells, pitch, strict=True)
    ]
    modulus = young_modulus(elastomer)
    cols, rows = (count + 2 * margin for count, margin in zip(cells, margins, strict=True))
    bonded = BondedLayer(
        rows=rows,
        cols=cols,
        length_x_mm=cols * pitch[0],
        length_y_mm=rows * pitch[1],
        thickness_mm=elastomer.thickness_mm,
        poisson_ratio=elastomer.poisson_ratio,
        film=coat_film(elastomer, modulus.best_kpa),
    )
    gel = GelLayer(
        bonded.deflect, (margins[1], margins[0]), modulus.best_kpa, _sigma_of_modulus(layer)
    )
    return compensate_gel(relief, gel)


def _margin(cells: int, pitch_mm: float, thickness_mm: float) -> int:
    """Return the cells to add on each side: enough, and a number that is quick to transform."""
    least = cells + 2 * int(np.ceil(WINDOW_MARGIN * thickness_mm / pitch_mm))
    total = fft.next_fast_len(least, real=True)
    while (total - cells) % 2:
        total = fft.next_fast_len(total + 1, real=True)
    return int(total - cells) // 2


def _sigma_of_modulus(layer: SensorLayer) -> float:
    """Return the modulus' standard uncertainty: given, or that of all its range as likely."""
    if layer.sigma.young_modulus_kpa is not None:
        return layer.sigma.young_modulus_kpa
    modulus = young_modulus(layer.elastomer)
    return float((modulus.high_kpa - modulus.low_kpa) / np.sqrt(12.0))


def sheet_layer(layer: SensorLayer) -> SheetLayer:
    """Return the layer as the thin sheet's equations take it."""
    elastomer, sigma = layer.elastomer, layer.sigma
    modulus = young_modulus(elastomer)
    return SheetLayer(
        frame=SheetOpening(
            elastomer.length_x_mm, elastomer.length_y_mm, elastomer.outline == "round"
        ),
        thickness_mm=elastomer.thickness_mm,
        young_modulus_kpa=modulus.best_kpa,
        pre_stretch=elastomer.pre_stretch,
        back_pressure_kpa=layer.press.back_pressure_kpa,
        sticks=elastomer.sticks,
        sigma_thickness_mm=sigma.thickness_mm,
        sigma_young_modulus_kpa=_sigma_of_modulus(layer),
        sigma_pre_stretch=sigma.pre_stretch,
        sigma_back_pressure_kpa=sigma.back_pressure_kpa,
    )


def with_compensation(done: Measurement, layer: SensorLayer | None = None) -> Measurement:
    """Return a measurement by fringes with the figures of the object behind its coat.

    Parameters
    ----------
    layer : what is believed of elastomer and load; default: the experiment's own
    """
    if not isinstance(done.images, Fringes):
        return done
    found = compensated_figures(done.experiment, done.images.reconstruction.point_map, layer)
    return replace(done, metrics={**done.metrics, **found})


def compensated_figures(
    experiment: Experiment, points: PointMap, layer: SensorLayer | None = None
) -> dict[str, Any]:
    """Return figures of the object under a thin sheet, to stand beside those of the coat.

    Nothing where the elastomer does not wrap; why, where the points tell no object.
    """
    if not may_compensate(experiment):
        return {}
    try:
        found = compensate_points(points, layer or sensor_layer_of(experiment))
    except InputError as error:
        return {"compensation_failure": str(error)}
    balls = shape_of(experiment.specimen).spheres()
    figures = object_figures(found, balls)
    return {key: one for key, one in figures.items() if key.startswith(COMPENSATED)}


def object_figures(found: Compensated, balls: Sequence[Sphere] = ()) -> dict[str, Any]:
    """Return the figures of the object and its contact; units in the names."""
    parts = parts_of(found)
    figures: dict[str, Any] = {
        "compensated_force_n": found.force_n,
        "compensated_force_sigma_n": found.force_sigma_n,
        "compensated_contact_area_mm2": found.area_mm2,
    }
    if isinstance(found, CompensatedSheet):
        figures |= _sheet_figures(found)
    if isinstance(found, CompensatedGel):
        figures["misfit_um"] = _UM * found.misfit_mm
    figures["parts"] = len(parts)
    for number, part in enumerate(parts, 1):
        figures |= {f"part_{number}_{name}": one for name, one in _part_figures(part).items()}
    for number, ball in enumerate(balls, 1):
        figures |= _ball_figures(f"compensated_sphere_{number}", _under(parts, ball, found))
    return figures


def _sheet_figures(found: CompensatedSheet) -> dict[str, Any]:
    contact, free = found.contact, found.modulus_of_free_span_kpa()
    thickness = found.layer.thickness_mm * found.thinning
    return {
        "compensated_thickness_mm": float(thickness[contact].mean()) if contact.any() else None,
        "pressure_sigma_kpa": found.balance.sigma_kpa,
        "free_span_modulus_kpa": None if free is None else free[0],
        "free_span_modulus_scatter_kpa": None if free is None else free[1],
    }


def _part_figures(part: ObjectPart) -> dict[str, Any]:
    told: dict[str, Any] = {
        "form": part.form,
        "x_mm": part.middle_mm[0],
        "y_mm": part.middle_mm[1],
        "highest_mm": part.highest_mm,
        "residual_um": part.residual_um,
        "pressure_kpa": part.pressure_kpa,
    }
    if part.form == "flat":
        return told
    return told | {"radius_mm": part.radius_mm, "radius_sigma_um": _UM * part.sigma_mm}


def _ball_figures(name: str, part: ObjectPart | None) -> dict[str, Any]:
    found = part if part is not None and part.form == "ball" else None
    return {
        f"{name}_radius_mm": None if found is None else found.radius_mm,
        f"{name}_radius_sigma_um": None if found is None else _UM * found.sigma_mm,
    }


def _under(parts: Sequence[ObjectPart], ball: Sphere, found: Compensated) -> ObjectPart | None:
    """Return the part whose cells lie over a ball's nominal middle."""
    col = int(np.argmin(np.abs(found.relief.x_mm - ball.x_mm)))
    row = int(np.argmin(np.abs(found.relief.y_mm - ball.y_mm)))
    return next((part for part in parts if part.cells[row, col]), None)


def _read_points(folder: Path) -> Reconstruction:
    file = folder / RECONSTRUCTION_FILE
    if not file.exists():
        raise InputError(
            f"{folder}: no {RECONSTRUCTION_FILE}; give a result of twin measure or twin reconstruct"
        )
    return read_reconstruction(file)


def _layer_of(folder: Path, layer_file: Path | None) -> tuple[SensorLayer, Experiment | None]:
    """Return the layer, given or the experiment's, and the experiment if there is one."""
    own = folder / EXPERIMENT_FILE
    told = read_toml(own) if is_regular(own) else {}
    experiment = load_experiment(own) if "elastomer" in told else None
    if layer_file is not None:
        return load_sensor_layer(layer_file), experiment
    if experiment is None:
        raise InputError(
            f"{folder}: tells no elastomer; give --layer layer.toml with [elastomer] and [press], "
            "see docs/compensation.md"
        )
    return sensor_layer_of(experiment), experiment


def _write(target: Path, measured: Reconstruction, found: Compensated) -> None:
    points = object_points(measured.point_map, found)
    write_reconstruction(target / RECONSTRUCTION_FILE, measured.decoded, points)
    if points.valid.any():
        write_surface(target, points)
    write_arrays(target / CONTACT_FILE, contact_arrays(found))


def object_points(coat: PointMap, found: Compensated) -> PointMap:
    """Return the object's surface pixel by pixel: where there is contact, and no point elsewhere.

    Each measured point moves down its normal by the local thickness, if there is a sheet; its sigma
    is that of the coat and, along the normal, of what is open of the layer.
    """
    relief = found.relief
    world = coat.points_world_mm.astype(np.float64)
    at = [
        (world[..., axis] - first[0]) / step
        for axis, first, step in (
            (1, relief.y_mm, relief.pitch_mm[1]),
            (0, relief.x_mm, relief.pitch_mm[0]),
        )
    ]
    touching = coat.valid & (_at(found.contact.astype(np.float64), at) > 0.5)
    behind = _at(np.sum((relief.points_mm - found.object_mm) * found.normal, axis=-1), at)
    normal = np.stack([_at(found.normal[..., axis], at) for axis in range(3)], axis=-1)
    moves = found.layer_moves_mm or [np.zeros(found.contact.shape)]
    open_mm = _at(np.linalg.norm(moves, axis=0), at)
    sigma = np.hypot(coat.sigma_xyz_mm, np.abs(normal) * open_mm[..., None])
    moved = np.where(touching[..., None], world - behind[..., None] * normal, 0.0)
    return replace(
        coat,
        points_world_mm=moved.astype(np.float32),
        sigma_xyz_mm=np.where(touching[..., None], sigma, 0.0).astype(np.float32),
        mask_reason=np.where(
            touching, Reason.VALID, np.where(coat.valid, Reason.NO_POINT, coat.mask_reason)
        ).astype(np.uint8),
    )


def _at(values: FloatArray, at: list[FloatArray]) -> FloatArray:
    return np.asarray(ndimage.map_coordinates(values, at, order=1, mode="nearest"))


def contact_arrays(found: Compensated) -> LabelledArrays:
    """Return contact, pressure, thickness and the clear face over world x and y."""
    clear = found.object_mm
    maps: dict[str, tuple[NDArray[Any], str, str]] = {
        "contact": (found.contact.astype(np.uint8), "1", "1 where the object carries the sheet"),
        "measured": (found.relief.measured.astype(np.uint8), "1", "1 where the coat was measured"),
        "coat_z_mm": (found.relief.heights_mm, "mm", "world z of the coat, gaps filled in"),
        "clear_x_mm": (clear[..., 0], "mm", "world x of the clear face, or the object"),
        "clear_y_mm": (clear[..., 1], "mm", "world y of the clear face, or the object"),
        "clear_z_mm": (clear[..., 2], "mm", "world z of the clear face, or the object"),
        "pressure_kpa": (found.pressure_kpa, "kPa", "of the contact, blurred at its edge"),
    }
    if isinstance(found, CompensatedSheet):
        thickness, sigma = found.layer.thickness_mm * found.thinning, found.sigma_thickness_mm
        maps["thickness_mm"] = (thickness, "mm", "local thickness")
        maps["sigma_thickness_mm"] = (sigma, "mm", "standard uncertainty of the local thickness")
    axes: dict[str, Labelled] = {
        name: (name, values, {"units": "mm", "long_name": f"world {name} of the cell's middle"})
        for name, values in (("x", found.relief.x_mm), ("y", found.relief.y_mm))
    }
    told: dict[str, Labelled] = {
        name: (("y", "x"), values, {"units": units, "long_name": long_name})
        for name, (values, units, long_name) in maps.items()
    }
    attributes = {"Conventions": "CF-1.11", "force_n": found.force_n}
    return LabelledArrays(told, axes, attributes)
