"""Compute the rigid object behind a measured coat, for `twin compensate` and for measurements.

The simulated truth is not used. Inputs are the measured points, and the nominal elastomer and load
(`SensorLayer`). Nominal positions of the specimen's features are used only to name the figures, for
example which part of the contact is ball 1.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import fft

from reconstruction.arrays import FloatArray, at_pixels
from reconstruction.compensation import (
    BarPlace,
    Compensated,
    CompensatedGel,
    GelLayer,
    SheetOpening,
    compensate_gel,
    contact_arrays,
    relief_on_frame,
)
from reconstruction.compensation.presentation import in_short, object_drawing
from reconstruction.errors import InputError, require_instance
from reconstruction.evaluate.surface import write_surface
from reconstruction.netcdf import write_arrays
from reconstruction.pipeline import Reconstruction, read_reconstruction, write_reconstruction
from reconstruction.reading import is_regular
from reconstruction.triangulation import PointMap
from reconstruction.writing import write_text
from twin.config import Experiment, load_experiment
from twin.config.digest import content_digest
from twin.config.loading import read_toml
from twin.config.quantities import outside_sources
from twin.config.sensor_layer import SensorLayer, layer_to_toml, load_sensor_layer, sensor_layer_of
from twin.config.specimen_base import Specimen
from twin.mechanics.choice import is_slab, may_wrap
from twin.mechanics.hardness import young_modulus
from twin.mechanics.layer import BondedLayer
from twin.mechanics.layouts import WINDOW_MARGIN, coat_film
from twin.mechanics.relaxation import elastic_equivalent, relaxed_share
from twin.output import EXPERIMENT_FILE, output_folder, write_outcome
from twin.pipeline.calibrated_layer import calibrated_layer
from twin.pipeline.dimensions import RECONSTRUCTION_FILE
from twin.pipeline.progress import ProgressCallback, no_progress
from twin.pipeline.slab_object import fit_slab, slab_object
from twin.results.compensated import load_figures, object_figures, object_points
from twin.results.features import bars_of
from twin.results.figures import COMPENSATED
from twin.results.names import may_compensate
from twin.results.record import Fringes, Measurement
from twin.results.under_sheet import (
    SheetCompensation,
    compensated_sheet,
    sheet_compensation,
    sigma_of_modulus,
)
from twin.specimens import shape_of

if TYPE_CHECKING:
    import xarray

    from reconstruction.drawing import Drawing

CONTACT_FILE, LAYER_FILE = "contact.nc", "layer.toml"
# Cell of a gel's relief: as fine as the finest ridges that deform a bonded layer.
_GEL_CELL_MM = 0.08


@dataclass(frozen=True, eq=False, repr=False)
class CompensationResult:
    """Object behind a measured coat, with the assumed layer and the figures.

    Attributes
    ----------
    compensated : object and contact, (row, col) on the cells of the measured coat
    layer : elastomer and load, as assumed or as calibrated on a ball
    figures : figures of result.json, units in the names
    """

    compensated: Compensated
    layer: SensorLayer
    figures: Mapping[str, Any]

    def __repr__(self) -> str:
        shown = ", ".join(f"{name} {value}" for name, value in self._in_short().items())
        return f"<CompensationResult: {shown}>"

    def _repr_html_(self) -> str:
        from reconstruction.drawing import as_html

        return as_html("object behind the coat", self._in_short(), self.plot())

    def _in_short(self) -> dict[str, str]:
        """Return contact area, force, pressure and fitted radii as texts with units, by name."""
        radii = {
            name.removesuffix("_mm").replace("_", " "): f"{value:.4f} mm"
            for name, value in self.figures.items()
            if name.endswith("_radius_mm") and value is not None
        }
        return in_short(self.compensated) | radii

    def plot(self) -> "Drawing":
        """Return a figure with maps of coat and pressure, and a section of coat and object."""
        return object_drawing(self.compensated)

    def to_xarray(self) -> "xarray.Dataset":
        """Return contact, pressure and both faces over world x and y, mm, as in file contact.nc."""
        return contact_arrays(self.compensated).to_xarray()


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
    """Compute the object behind the coat of a result, write it to `out`, and return the figures.

    `out` contains the points of the object in the files of `twin reconstruct` (reconstruction.nc,
    points.ply, surface.ply, height_map.*), contact.nc, layer.toml and result.json.

    Parameters
    ----------
    folder : result folder of `twin measure` or `twin reconstruct`
    layer_file : TOML file of elastomer and load; None: those of the result's experiment
    draw : function that adds a report to the folder
    ball_diameter_mm : known diameter of every ball in contact, on which the layer is calibrated
        first; None: the layer is not calibrated

    Raises
    ------
    InputError : there are no points or no layer, the layout is not supported, or the points do not
        determine an object
    """
    inputs = [folder, *([layer_file] if layer_file else [])]
    with output_folder(out, inputs) as target:
        watch("read", 0.0)
        measured = _read_points(folder)
        layer, experiment = _layer_of(folder, layer_file)
        watch("read", 1.0)
        watch("compensate", 0.0)
        figures: dict[str, Any] = {}
        points, specimen = measured.point_map, experiment.specimen if experiment else None
        if ball_diameter_mm is not None:
            layer, figures = calibrated_layer(points, layer, ball_diameter_mm, specimen)
        result = _compensation(points, layer, experiment)
        watch("compensate", 1.0)
        figures |= result.figures
        if outside := outside_sources(layer):
            figures["warnings"] = list(outside)
        _write(target, measured, result.compensated, layer)
        draw(target, replace(result, figures=figures))
        write_text(target / LAYER_FILE, layer_to_toml(layer))
        write_text(
            target / EXPERIMENT_FILE,
            (folder / EXPERIMENT_FILE).read_text(encoding="utf-8")
            if is_regular(folder / EXPERIMENT_FILE)
            else layer_to_toml(layer),
        )
        digest = content_digest(layer, points.points_world_mm, points.mask_reason)
        write_outcome(target, "compensate", figures, digest=digest)
    return figures


def compensate(
    measured: Measurement | Reconstruction | PointMap,
    layer: SensorLayer | Path | str | None = None,
) -> CompensationResult:
    """Return the object behind a measured coat, its contact and force; writes no files.

    Parameters
    ----------
    measured : result of `twin.measure` or `twin.reconstruct`, or the points of such a result
    layer : assumed elastomer and load, or the file with them (docs/compensation.md); None: those
        of the measurement's experiment

    Raises
    ------
    InputError : there are no points or no layer, the layout is not supported, or the points do not
        determine an object
    """
    kinds = (Measurement, Reconstruction, PointMap)
    require_instance("measured", measured, kinds, "give a result of twin.measure")
    experiment = measured.experiment if isinstance(measured, Measurement) else None
    if isinstance(layer, (str, Path)):
        layer = load_sensor_layer(Path(layer))
    if layer is None and experiment is None:
        raise InputError("layer: found none, needed with points that have no experiment")
    known = sensor_layer_of(experiment) if layer is None and experiment else layer
    assert known is not None
    return _compensation(_points_of(measured), known, experiment)


def _points_of(measured: Measurement | Reconstruction | PointMap) -> PointMap:
    if isinstance(measured, PointMap):
        return measured
    if isinstance(measured, Reconstruction):
        return measured.point_map
    if not isinstance(measured.images, Fringes):
        method = measured.experiment.modality
        raise InputError(f"compensate: found a measurement by {method}, allowed one by fringes")
    return measured.images.reconstruction.point_map


def _compensation(
    points: PointMap, layer: SensorLayer, experiment: Experiment | None
) -> CompensationResult:
    """Return the object behind measured points, with figures named by nominal feature positions."""
    specimen = experiment.specimen if experiment else None
    compensated = compensate_points(points, layer, specimen)
    balls = shape_of(specimen).spheres() if specimen else ()
    figures = object_figures(compensated, balls, _bars(layer, experiment)) | load_figures(
        compensated, layer
    )
    return CompensationResult(compensated, layer, figures)


def compensate_points(
    points: PointMap, layer: SensorLayer, specimen: Specimen | None = None
) -> Compensated:
    """Return the object behind the coat of a thin sheet, of a gel on a window, or of a thick slab.

    Parameters
    ----------
    points : measured points of the coat
    layer : assumed elastomer and load
    specimen : form of the object under a thick slab, used if the layer has no specimen

    Raises
    ------
    InputError : the layout is not supported, or the points do not determine an object
    """
    elastomer = layer.elastomer
    on_window, thin = elastomer.layout == "contact_face", may_wrap(elastomer)
    if not (on_window or thin or is_slab(elastomer)):
        raise InputError(
            f"elastomer: found {elastomer.layout}, {elastomer.thickness_mm:g} mm thick; objects "
            "are found under a sheet of up to 1 mm with no film, under a thicker slab with a "
            "rectangular rim, or with layout = 'contact_face'"
        )
    if thin:
        return compensated_sheet(points, layer)
    valid = points.valid
    if not valid.any():
        raise InputError("compensate: found no valid point; look at the mask's reasons")
    points_mm = at_pixels(points.points_world_mm, valid).astype(np.float64)
    sigma_mm = at_pixels(points.sigma_z_mm, valid).astype(np.float64)
    layer = _relaxed(layer)
    if on_window:
        return _on_gel(points_mm, sigma_mm, layer)
    return fit_slab(points_mm, sigma_mm, slab_object(layer, specimen))


def _relaxed(layer: SensorLayer) -> SensorLayer:
    """Return the layer with the modulus that its elastomer has at the time of the measurement."""
    relaxation = layer.elastomer.relaxation
    if relaxation is None:
        return layer
    share = relaxed_share(relaxation, layer.press)
    sigma = {"young_modulus_kpa": share * sigma_of_modulus(layer)}
    return layer.model_copy(
        update={
            "elastomer": elastic_equivalent(layer.elastomer, layer.press),
            "sigma": layer.sigma.model_copy(update=sigma),
        }
    )


def _on_gel(points_mm: FloatArray, sigma_mm: FloatArray, layer: SensorLayer) -> CompensatedGel:
    """Return the object in a gel on a window, over the part of the gel that was measured.

    Parameters
    ----------
    points_mm, sigma_mm : (n, xyz) points of the coat, world, and (n,) standard uncertainty of z
    """
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
        bonded.deflect, (margins[1], margins[0]), modulus.best_kpa, sigma_of_modulus(layer)
    )
    return compensate_gel(relief, gel)


def _margin(cells: int, pitch_mm: float, thickness_mm: float) -> int:
    """Return the number of cells to add on each side of a relief along one axis.

    It covers `WINDOW_MARGIN` thicknesses, and makes the total a fast length for the FFT.
    """
    least = cells + 2 * int(np.ceil(WINDOW_MARGIN * thickness_mm / pitch_mm))
    total = fft.next_fast_len(least, real=True)
    while (total - cells) % 2:
        total = fft.next_fast_len(total + 1, real=True)
    return int(total - cells) // 2


def with_compensation(done: Measurement, layer: SensorLayer | None = None) -> Measurement:
    """Return a measurement with figures of the object behind its coat added to its metrics.

    The names of these figures begin with `compensated_`, as in the results of `twin measure`. If
    the points do not determine an object, `compensation_failure` is the reason. A measurement by a
    method without fringes is returned unchanged.

    Parameters
    ----------
    done : the measurement
    layer : assumed elastomer and load; None: those of the measurement, or of its experiment. Under
        a thin sheet, another layer also changes the other figures of the object
    """
    require_instance("done", done, Measurement, "give a result of twin.measure")
    if not isinstance(done.images, Fringes):
        return done
    points = done.images.reconstruction.point_map
    known = done.compensation
    if known is not None and layer not in (None, known.layer):
        known = sheet_compensation(done.experiment, points, layer)
        done = replace(done, compensation=known).with_object()
    if known is None:
        figures = compensated_figures(done.experiment, points, layer)
    else:
        figures = _sheet_figures(known)
    return done.with_same_object(metrics={**done.metrics, **figures})


def _sheet_figures(compensation: SheetCompensation) -> dict[str, Any]:
    """Return the figures of the object under a thin sheet, or the reason why there is no object."""
    experiment, under = compensation.experiment, compensation.compensated
    if under is None:
        return {"compensation_failure": compensation.why}
    layer = compensation.layer or sensor_layer_of(experiment)
    balls = shape_of(experiment.specimen).spheres()
    figures = object_figures(under.sheet, balls, _bars(layer, experiment), under.parts)
    return {key: value for key, value in figures.items() if key.startswith(COMPENSATED)}


def compensated_figures(
    experiment: Experiment, points: PointMap, layer: SensorLayer | None = None
) -> dict[str, Any]:
    """Return the figures `compensated_*` of the object behind the coat, by name.

    The result is empty if no object is computed for the experiment, see `may_compensate`. If the
    points do not determine an object, it has only `compensation_failure`, the reason.

    Parameters
    ----------
    layer : assumed elastomer and load; None: those of the experiment
    """
    if not may_compensate(experiment):
        return {}
    try:
        believed = layer or sensor_layer_of(experiment)
        compensated = compensate_points(points, believed, experiment.specimen)
    except InputError as error:
        return {"compensation_failure": str(error)}
    balls = shape_of(experiment.specimen).spheres()
    figures = object_figures(compensated, balls, _bars(believed, experiment))
    return {key: value for key, value in figures.items() if key.startswith(COMPENSATED)}


def _bars(layer: SensorLayer, experiment: Experiment | None) -> list[BarPlace]:
    specimen = layer.specimen or (experiment.specimen if experiment else None)
    if layer.bar or specimen is None:
        return [BarPlace(**bar.model_dump()) for bar in layer.bar]
    return bars_of(specimen)


def _read_points(folder: Path) -> Reconstruction:
    file = folder / RECONSTRUCTION_FILE
    if not file.exists():
        raise InputError(
            f"{folder}: no {RECONSTRUCTION_FILE}; give a result of twin measure or twin reconstruct"
        )
    return read_reconstruction(file)


def _layer_of(folder: Path, layer_file: Path | None) -> tuple[SensorLayer, Experiment | None]:
    """Return the layer of a file or of the result's experiment, and this experiment or None."""
    own = folder / EXPERIMENT_FILE
    tables = read_toml(own) if is_regular(own) else {}
    experiment = load_experiment(own) if "elastomer" in tables else None
    if layer_file is not None:
        return load_sensor_layer(layer_file), experiment
    if experiment is None:
        raise InputError(
            f"{folder}: found no elastomer; give --layer layer.toml with [elastomer] and [press], "
            "see docs/compensation.md"
        )
    return sensor_layer_of(experiment), experiment


def _write(
    target: Path, measured: Reconstruction, compensated: Compensated, layer: SensorLayer
) -> None:
    points = object_points(measured.point_map, compensated, layer.sigma.texture_mm)
    write_reconstruction(target / RECONSTRUCTION_FILE, measured.decoded, points)
    if points.valid.any():
        write_surface(target, points)
    write_arrays(target / CONTACT_FILE, contact_arrays(compensated))
