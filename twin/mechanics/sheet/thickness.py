"""Thickness field of the undeformed sheet: waves, wedge and measured map, with mean 0.

Positions (X, Y), mm, are coordinates on the undeformed sheet from its centre. The field is added to
`elastomer.thickness_mm` at every point. The undeformed surface midway between the faces is flat.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from reconstruction.arrays import FloatArray
from twin.config.elastomer import Elastomer
from twin.config.thickness_field import ThicknessField
from twin.mechanics.errors import PressError
from twin.mechanics.texture import Field, random_field
from twin.specimens.height_files import MapFile

#: local over mean thickness
_ALLOWED = (0.5, 1.5)
# Samples of the sheet, for mean, RMS and range: 4 per correlation length, within these limits.
_SAMPLES = (129, 1025)
_PER_LENGTH = 4


@dataclass(frozen=True, eq=False)
class MeasuredMap:
    """A measured map of the thickness, interpolated linearly; constant beyond its outer pixels."""

    #: (row, col)
    map_mm: FloatArray
    pixel_mm: float
    #: X (col,) and Y (row,) of the pixels' middles
    axes_mm: tuple[FloatArray, FloatArray]

    def at(self, X_mm: FloatArray, Y_mm: FloatArray) -> FloatArray:
        """Return the thickness, mm, at positions (...)."""
        pixels = [
            np.asarray(along) / self.pixel_mm + (count - 1) / 2
            for along, count in zip((Y_mm, X_mm), self.map_mm.shape, strict=True)
        ]
        values: FloatArray = ndimage.map_coordinates(self.map_mm, pixels, order=1, mode="nearest")
        return values


@dataclass(frozen=True, eq=False)
class SheetThickness:
    """Deviation of the local undeformed thickness from its mean, made by `sheet_thickness`."""

    waves: Field | None
    #: mm per mm along X and along Y
    slope: tuple[float, float]
    measured: MeasuredMap | None
    #: mean of the sum of the parts over the sheet, mm
    mean_mm: float = 0.0

    def deviation_mm(self, X_mm: FloatArray, Y_mm: FloatArray) -> FloatArray:
        """Return local minus mean thickness, mm, at positions (...) on the undeformed sheet."""
        total = self.slope[0] * X_mm + self.slope[1] * Y_mm - self.mean_mm
        if self.waves is not None:
            total = total + self.waves.height_mm(X_mm, Y_mm)
        if self.measured is not None:
            total = total + self.measured.at(X_mm, Y_mm)
        return np.asarray(total, np.float64)


def sheet_thickness(elastomer: Elastomer) -> SheetThickness | None:
    """Return the thickness field of an elastomer's undeformed sheet; None: uniform.

    Raises
    ------
    PressError : the local thickness is not everywhere 0.5 to 1.5 x the mean, or the map does not
        cover the sheet
    InputError : the file of the map cannot be used
    """
    table = elastomer.thickness_field
    if table is None:
        return None
    half_mm = _half_mm(elastomer)
    X, Y = _samples(elastomer, table)
    angle, slope = np.deg2rad(table.slope_deg), 1e-3 * table.slope_um_per_mm
    field = SheetThickness(
        waves=_waves(table, half_mm, (X, Y)) if table.rms_um else None,
        slope=(float(slope * np.cos(angle)), float(slope * np.sin(angle))),
        measured=None,
    )
    field = replace(field, mean_mm=float(field.deviation_mm(X, Y).mean()))
    if table.file is not None:
        measured = _measured(table, half_mm)
        at_pixels = _on_sheet(elastomer, *measured.axes_mm)
        densest = max((X, Y), at_pixels, key=lambda places: places[0].size)
        mean_mm = field.mean_mm + float(measured.at(*densest).mean())
        field = replace(field, measured=measured, mean_mm=mean_mm)
        X, Y = (np.concatenate(both) for both in zip((X, Y), at_pixels, strict=True))
    _check_range(field.deviation_mm(X, Y), elastomer.thickness_mm)
    return field


def _half_mm(elastomer: Elastomer) -> tuple[float, float]:
    """Return half lengths of the undeformed sheet along x and y, mm."""
    stretch = 2 * elastomer.pre_stretch
    return elastomer.length_x_mm / stretch, elastomer.length_y_mm / stretch


def _samples(elastomer: Elastomer, table: ThicknessField) -> tuple[FloatArray, FloatArray]:
    """Return X and Y (point,) of a grid that covers the sheet to its edges."""
    fewest, most = _SAMPLES
    per_mm = _PER_LENGTH / table.correlation_mm
    x, y = (
        half * np.linspace(-1, 1, int(np.clip(2 * half * per_mm, fewest, most)))
        for half in _half_mm(elastomer)
    )
    return _on_sheet(elastomer, x, y)


def _on_sheet(
    elastomer: Elastomer, x_mm: FloatArray, y_mm: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return X and Y (point,) of the nodes of a grid (row, col) that are on the sheet."""
    X, Y = np.meshgrid(x_mm, y_mm)
    half_x_mm, half_y_mm = _half_mm(elastomer)
    if elastomer.outline == "round":
        inside = np.hypot(X, Y) <= half_x_mm
    else:
        inside = np.maximum(np.abs(X) / half_x_mm, np.abs(Y) / half_y_mm) <= 1 + 1e-9
    return X[inside], Y[inside]


def _waves(
    table: ThicknessField, half_mm: tuple[float, float], places_mm: tuple[FloatArray, FloatArray]
) -> Field:
    """Return random waves whose deviation from their mean over the sheet has the table's RMS.

    Parameters
    ----------
    places_mm : X and Y (point,) of points on the sheet, evenly distributed
    """
    extent = (-half_mm[0], half_mm[0], -half_mm[1], half_mm[1])
    unit = random_field(("sheet thickness", table.seed), table.correlation_mm, extent)
    return replace(unit, rms_mm=1e-3 * table.rms_um / float(unit.height_mm(*places_mm).std()))


def _measured(table: ThicknessField, half_mm: tuple[float, float]) -> MeasuredMap:
    assert table.file is not None and table.pixel_mm is not None  # noqa: PT018
    source = MapFile(
        "elastomer.thickness_field",
        table.file,
        table.pixel_mm,
        table.unit_mm,
        table.variable,
        "thickness",
    )
    map_mm = source.read_mm()
    covered = [count * table.pixel_mm for count in map_mm.shape[::-1]]
    needed = [2 * half for half in half_mm]
    if any(have < need * (1 - 1e-9) for have, need in zip(covered, needed, strict=True)):
        raise PressError(
            f"elastomer.thickness_field.file: {table.file} covers {covered[0]:.4g} x "
            f"{covered[1]:.4g} mm, needed {needed[0]:.4g} x {needed[1]:.4g} mm, the undeformed "
            "sheet; enlarge the map, or correct elastomer.thickness_field.pixel_mm"
        )
    return MeasuredMap(map_mm, table.pixel_mm, source.axes_mm(map_mm))


def _check_range(deviation_mm: FloatArray, mean_mm: float) -> None:
    low, high = (mean_mm + float(end) for end in (deviation_mm.min(), deviation_mm.max()))
    least, most = (share * mean_mm for share in _ALLOWED)
    if low < least or high > most:
        raise PressError(
            f"elastomer.thickness_field: the sheet is {low:.4g} to {high:.4g} mm thick, allowed "
            f"{least:.4g} to {most:.4g} mm, {_ALLOWED[0]:g} to {_ALLOWED[1]:g} x thickness_mm; "
            "lower rms_um or slope_um_per_mm, or correct the map or its unit_mm"
        )
