"""Figures, points and arrays of the object that was reconstructed behind a coat."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy import ndimage

from reconstruction.arrays import BoolArray, FloatArray, Reason
from reconstruction.compensation import (
    BarPlace,
    Compensated,
    CompensatedGel,
    CompensatedSheet,
    CompensatedSlab,
    FittedSlab,
    ObjectPart,
    bar_under_sheet,
    parts_of,
)
from reconstruction.compensation.balance import free_span
from reconstruction.compensation.texture import smoothed_variance
from reconstruction.errors import FitError
from reconstruction.evaluate.fit import spread
from reconstruction.triangulation import PointMap
from twin.config.sensor_layer import SensorLayer
from twin.shape import Sphere

_UM = 1e3
_TEXTURE_SIGMA_MM = 0.2
# Distance from the contact's border over which the smooth coat deviates from the true one.
_OFF_EDGES_MM = 0.3


def object_figures(
    compensated: Compensated,
    balls: Sequence[Sphere] = (),
    bars: Sequence[BarPlace] = (),
    parts: Sequence[ObjectPart] | None = None,
) -> dict[str, Any]:
    """Return the figures of the reconstructed object and its contact; names end with the unit.

    Parameters
    ----------
    compensated : the reconstructed object
    balls, bars : nominal balls and bars of the specimen; figures are named after their numbers
    parts : fitted parts of the contact if they are known; None: they are fitted here
    """
    if parts is None:
        parts = [] if isinstance(compensated, CompensatedSlab) else parts_of(compensated)
    figures: dict[str, Any] = {
        "compensated_force_n": compensated.force_n,
        "compensated_force_sigma_n": compensated.force_sigma_n,
        "compensated_contact_area_mm2": compensated.area_mm2,
    }
    if isinstance(compensated, CompensatedSheet):
        figures |= _sheet_figures(compensated)
    if isinstance(compensated, CompensatedGel):
        figures["misfit_um"] = _UM * compensated.misfit_mm
    if isinstance(compensated, CompensatedSlab):
        return figures | _slab_figures(compensated.fitted, balls)
    figures["parts"] = len(parts)
    for number, part in enumerate(parts, 1):
        figures |= {f"part_{number}_{name}": value for name, value in _part_figures(part).items()}
    for number, ball in enumerate(balls, 1):
        figures |= _ball_figures(f"compensated_sphere_{number}", _under(parts, ball, compensated))
    for number, bar in enumerate(bars, 1):
        if isinstance(compensated, CompensatedSheet):
            figures |= _bar_figures(f"compensated_bar_{number}", compensated, bar)
    return figures


def _slab_figures(fitted: FittedSlab, balls: Sequence[Sphere]) -> dict[str, Any]:
    """Return the fitted dimensions of an object under a slab, with standard uncertainties."""
    figures: dict[str, Any] = {"misfit_um": _UM * fitted.misfit_mm, "chi_square": fitted.chi_square}
    for unknown in fitted.unknowns:
        table, _, path = unknown.name.partition(".")
        if unknown.name == "press.depth_mm":
            path = "travel_mm"
        elif table != "specimen":
            continue
        figures |= _number_figures(f"compensated_{slab_name(path)}", path, fitted, unknown.name)
    if "specimen.diameter_mm" in [unknown.name for unknown in fitted.unknowns]:
        radius, sigma = (of("specimen.diameter_mm") / 2 for of in (fitted.value, fitted.sigma))
        for number in range(1, len(balls) + 1):
            name = f"compensated_sphere_{number}_radius"
            figures |= {f"{name}_mm": radius, f"{name}_sigma_um": _UM * sigma}
    return figures


def _number_figures(name: str, path: str, fitted: FittedSlab, unknown: str) -> dict[str, Any]:
    value, sigma = fitted.value(unknown), fitted.sigma(unknown)
    if path.endswith("_deg"):
        return {f"{name}_deg": value, f"{name}_sigma_deg": sigma}
    return {f"{name}_mm": value, f"{name}_sigma_um": _UM * sigma}


def slab_bound_name(path: str) -> str:
    """Return the name of the figure with the bound of a fitted dimension under a slab.

    >>> slab_bound_name("diameter_mm")
    'compensated_diameter_crb_um'
    """
    return f"compensated_{slab_name(path)}_crb_{'deg' if path.endswith('_deg') else 'um'}"


def slab_name(path: str) -> str:
    """Return the name of a fitted dimension without its unit: `diameter` for `diameter_mm`.

    >>> slab_name("widths_mm.0")
    'widths_0'
    """
    parts = path.split(".")
    return "_".join(part.removesuffix("_mm").removesuffix("_deg") for part in parts)


def load_figures(compensated: Compensated, layer: SensorLayer) -> dict[str, Any]:
    """Return figures of the sheet's modulus, kPa, from a gauge's force; empty without a gauge."""
    force_n, sigma_n = layer.press.force_n, layer.sigma.force_n
    if force_n is None or not isinstance(compensated, CompensatedSheet):
        return {}
    try:
        modulus, sigma = compensated.modulus_of_force_kpa(force_n, sigma_n)
    except FitError as error:
        return {"force_modulus_kpa": None, "force_modulus_why": str(error)}
    return {"force_modulus_kpa": modulus, "force_modulus_sigma_kpa": sigma}


def _sheet_figures(compensated: CompensatedSheet) -> dict[str, Any]:
    contact, free = compensated.contact, compensated.modulus_of_free_span_kpa()
    thickness = compensated.layer.thickness_mm * compensated.thinning
    return {
        "compensated_thickness_mm": float(thickness[contact].mean()) if contact.any() else None,
        "pressure_sigma_kpa": compensated.balance.sigma_kpa,
        "free_span_modulus_kpa": None if free is None else free[0],
        "free_span_modulus_scatter_kpa": None if free is None else free[1],
    }


def _part_figures(part: ObjectPart) -> dict[str, Any]:
    figures: dict[str, Any] = {
        "form": part.form,
        "x_mm": part.middle_mm[0],
        "y_mm": part.middle_mm[1],
        "highest_mm": part.highest_mm,
        "residual_um": part.residual_um,
        "pressure_kpa": part.pressure_kpa,
    }
    if part.form == "flat":
        return figures
    return figures | {"radius_mm": part.radius_mm, "radius_sigma_um": _UM * part.sigma_mm}


def _ball_figures(name: str, part: ObjectPart | None) -> dict[str, Any]:
    ball = part if part is not None and part.form == "ball" else None
    return {
        f"{name}_radius_mm": None if ball is None else ball.radius_mm,
        f"{name}_radius_sigma_um": None if ball is None else _UM * ball.sigma_mm,
    }


def _bar_figures(name: str, compensated: CompensatedSheet, bar: BarPlace) -> dict[str, Any]:
    width, sigma = f"{name}_width_mm", f"{name}_width_sigma_um"
    try:
        measured_bar = bar_under_sheet(compensated, bar)
    except FitError as error:
        return {width: None, sigma: None, f"{name}_width_why": str(error)}
    return {
        width: measured_bar.width_mm,
        sigma: _UM * measured_bar.sigma_mm,
        f"{name}_turn_deg": min(measured_bar.turn_deg),
        f"{name}_sheet_on_edge": measured_bar.on_edge,
    }


def _under(
    parts: Sequence[ObjectPart], ball: Sphere, compensated: Compensated
) -> ObjectPart | None:
    """Return the part of the contact that covers the nominal centre of a ball, or None."""
    col = int(np.argmin(np.abs(compensated.relief.x_mm - ball.x_mm)))
    row = int(np.argmin(np.abs(compensated.relief.y_mm - ball.y_mm)))
    return next((part for part in parts if part.cells[row, col]), None)


def object_points(
    coat: PointMap, compensated: Compensated, texture_mm: float | None = None
) -> PointMap:
    """Return the points of the object's surface at the pixels that are certainly in contact.

    Other pixels have no point; among them are those on the blurred edge of the contact, and those
    next to an edge of the object, where a sheet may span freely.

    Each measured point is moved inwards along its normal by the local thickness of the layer. Its
    sigma combines that of the coat's point with three contributions along the normal: the texture
    of the coat, which the object does not have, the uncertain parameters of the layer, and the
    errors of the layer's model.

    Parameters
    ----------
    coat : measured points of the coat
    compensated : the reconstructed object
    texture_mm : RMS of the coat's texture, mm; None: unknown, the scatter of the points is used
    """
    relief = compensated.relief
    world = coat.points_world_mm.astype(np.float64)
    at = [
        (world[..., axis] - first[0]) / step
        for axis, first, step in (
            (1, relief.y_mm, relief.pitch_mm[1]),
            (0, relief.x_mm, relief.pitch_mm[0]),
        )
    ]
    touching = coat.valid & (_at(compensated.sure.astype(np.float64), at) > 0.5)
    behind = _at(
        np.sum((relief.points_mm - compensated.object_mm) * compensated.normal, axis=-1), at
    )
    normal = np.stack([_at(compensated.normal[..., axis], at) for axis in range(3)], axis=-1)
    moves = compensated.layer_moves_mm or [np.zeros(compensated.contact.shape)]
    open_mm = _at(np.linalg.norm([*moves, compensated.theory_sigma_mm], axis=0), at)
    if texture_mm is None:
        texture_mm = _scatter_mm(coat, compensated, touching, at)
    along = np.abs(normal) * np.hypot(open_mm, texture_mm)[..., None]
    sigma = np.hypot(coat.sigma_xyz_mm, along)
    moved = np.where(touching[..., None], world - behind[..., None] * normal, 0.0)
    return replace(
        coat,
        points_world_mm=moved.astype(np.float32),
        sigma_xyz_mm=np.where(touching[..., None], sigma, 0.0).astype(np.float32),
        mask_reason=np.where(
            touching, Reason.VALID, np.where(coat.valid, Reason.NO_POINT, coat.mask_reason)
        ).astype(np.uint8),
    )


def _scatter_mm(
    coat: PointMap, compensated: Compensated, touching: BoolArray, at: list[FloatArray]
) -> float:
    """Return the RMS roughness, mm, of the coat's points in contact in excess of their noise.

    The reference is the coat smoothed over 0.2 mm. The part of the texture that this smoothing
    passes is estimated from the autocovariance of the rest, and added. Finer detail of the object
    counts as texture, because the points do not distinguish both.
    """
    if not touching.any():
        return 0.0
    relief = compensated.relief
    # Cubic interpolation, because the smooth coat is curved between cells.
    smooth = ndimage.map_coordinates(
        relief.smoothed(_TEXTURE_SIGMA_MM), at, order=3, mode="nearest"
    )
    away_mm = (coat.points_world_mm[..., 2] - smooth)[touching]
    noise_mm = float(np.median(coat.sigma_xyz_mm[..., 2][touching]))
    rough = max(spread(away_mm) ** 2 - noise_mm**2, 0.0)
    reach = int(np.ceil(_OFF_EDGES_MM / min(relief.pitch_mm)))
    inner = ndimage.binary_erosion(compensated.sure & relief.measured, iterations=reach)
    used = inner | free_span(relief, compensated.contact)
    return float(np.sqrt(rough + smoothed_variance(relief, used, _TEXTURE_SIGMA_MM)))


def _at(values: FloatArray, at: list[FloatArray]) -> FloatArray:
    return np.asarray(ndimage.map_coordinates(values, at, order=1, mode="nearest"))
