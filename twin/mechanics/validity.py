"""Numbers that describe how accurately the linear slab or the thin sheet models a press.

Limits and error scale are from comparisons with an axisymmetric neo-Hookean slab (shared notes,
mechanics.md, sections 1 and 6). With depth d, ball radius R and thickness h: heights of a bonded
layer have an error of 1 to 2 % of the depth up to d/R = 0.6. On the far face of a free slab the
peak has an error of 2.4 % at d = h/4 = R/4.
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from reconstruction.arrays import BoolArray, FloatArray
from twin.config.models import Elastomer
from twin.shape import Shape

Layout = Literal["opposite_face", "contact_face"]

DEPTH_OVER_THICKNESS_LIMIT = 0.25
DEPTH_OVER_RADIUS_LIMIT = 0.4
SLOPE_LIMIT_DEG = 45.0
DEFLECTION_OVER_THICKNESS_LIMIT = 0.4
_FEWEST_CELLS_ACROSS = 10.0
#: smallest allowed thickness of a sheet over its undeformed thickness: silicones tear before that
THINNEST = 0.2
#: thickness over radius of bending up to which a thin sheet is accurate, and up to which usable
SHEET_GOOD, SHEET_LIMIT = 0.125, 0.25
#: pitch over thickness of the finest ridges that a thin sheet models, because it neglects shear
SHEET_RIDGES = 5.0
_STRAINS, _STRETCH, _STEEP = "strains are large above", "a sheet stretches as it bends", "deg steep"
_RIM, _SIDES, _SHEAR = "how the rim is held", "its free sides yield", "shear through the thickness"
_REMEDIES = {
    _STRAINS: 'press less deep, use a thicker elastomer, or set mechanics.model = "neo_hookean"',
    _STRETCH: "press less deep, or use a thicker slab",
    _STEEP: "limit x_mm and y_mm of each [[measurand]] to flat parts at least one thickness from "
    "walls, or give the edges a slope or a radius",
    _RIM: "use a larger elastomer.length_x_mm and length_y_mm, or a smaller part",
    _SIDES: "use a larger elastomer.length_x_mm and length_y_mm, or a smaller part",
    _SHEAR: "use a thinner sheet",
}
# Height error of the thin sheet over h^2 / R, from solid neo-Hookean elements: ball of 4 mm, sheets
# of 0.1 to 1.5 mm, error at most 18 um at h = 1 mm (shared notes on the sheet).
_SHEET_ERROR = 0.072


@dataclass(frozen=True)
class Validity:
    """Numbers that describe the accuracy of a press, and a warning for each exceeded limit."""

    depth_over_thickness: float
    #: depth over the smallest ball's radius, 0 for specimens without balls
    depth_over_radius: float
    #: largest deflection of the coated face over thickness; above about 0.4 bending also stretches
    #: the elastomer
    deflection_over_thickness: float
    #: slab: steepest slope of the specimen within the contact; sheet: that of the deformed sheet
    max_slope_deg: float
    #: distance from the contact to the nearest rim
    margin_mm: float
    #: diameter, in cells, of a circle with the area of the contact; slab: with 1 / n of this area
    #: for a specimen of n balls
    cells_across: float
    #: expected largest height error of the coated face, because the model neglects large strain
    #: (slab) or shear through the thickness (sheet)
    height_error_mm: float
    warnings: tuple[str, ...]


def remedy_of(warning: str) -> str:
    """Return the remedy for a warning of a press; empty if the warning states it itself."""
    return next((remedy for words, remedy in _REMEDIES.items() if words in warning), "")


def max_slope_deg(height_mm: FloatArray, contact: BoolArray, pitch_mm: float) -> float:
    """Return the specimen's steepest slope within the contact, degrees.

    It is 90 if the contact reaches the specimen's outline. Arrays are (row, col) on cells at
    intervals of `pitch_mm`.
    """
    known = np.where(np.isfinite(height_mm), height_mm, np.nan)
    across_y, across_x = np.gradient(known, pitch_mm)
    slope = np.hypot(across_x, across_y)[contact]
    return 90.0 if np.isnan(slope).any() else float(np.rad2deg(np.arctan(slope.max())))


def margin_mm(
    contact: BoolArray, x_mm: FloatArray, y_mm: FloatArray, half_mm: tuple[float, float]
) -> float:
    """Return the distance from the contact's cells to the nearest edge of the slab, mm.

    `half_mm` are the slab's half lengths along x and y; `x_mm` and `y_mm` are cell centres. A
    contact smaller than a cell may include no centre: then it is assumed in the middle.
    """
    if not contact.any():
        return min(half_mm)
    used = x_mm[contact.any(axis=0)], y_mm[contact.any(axis=1)]
    cells = x_mm[1] - x_mm[0], y_mm[1] - y_mm[0]
    reach = (float(np.abs(along).max() + cell / 2) for along, cell in zip(used, cells, strict=True))
    return min(half - far for half, far in zip(half_mm, reach, strict=True))


def assess(
    *,
    layout: Layout,
    depth_mm: float,
    thickness_mm: float,
    radius_mm: float | None,
    deflection_mm: float,
    slope_deg: float,
    margin_to_rim_mm: float,
    cells_across: float,
) -> Validity:
    """Return the accuracy of a linear slab's press: ratios, height error estimate and warnings.

    Notes
    -----
    The estimated error is 2 % of the depth (free slab) or 1.2 % (bonded layer) up to d/R = 0.25. It
    increases in proportion to d/R above 0.25. For a free slab w (w/h)^2 / 10 is added, with the
    peak deflection w of the coated face: the slab stretches as it bends. This term is the project's
    own estimate, after von Karman's plate with a rim that may move inwards.
    """
    free = layout == "opposite_face"
    over_radius = depth_mm / radius_mm if radius_mm else 0.0
    bent = deflection_mm / thickness_mm
    figures = Validity(
        depth_over_thickness=depth_mm / thickness_mm,
        depth_over_radius=over_radius,
        deflection_over_thickness=bent,
        max_slope_deg=slope_deg,
        margin_mm=margin_to_rim_mm,
        cells_across=cells_across,
        height_error_mm=(0.02 if free else 0.012) * depth_mm * max(1.0, over_radius / 0.25)
        + (0.1 * bent**2 * deflection_mm if free else 0.0),
        warnings=(),
    )
    return _with_warnings(figures, thickness_mm, layout)


def _with_warnings(figures: Validity, thickness_mm: float, layout: Layout) -> Validity:
    free = layout == "opposite_face"
    needed = (1.0 if free else 3.0) * thickness_mm
    checks = (
        (
            figures.depth_over_thickness > DEPTH_OVER_THICKNESS_LIMIT,
            f"depth is {figures.depth_over_thickness:.2f} of the thickness: {_STRAINS} "
            f"{DEPTH_OVER_THICKNESS_LIMIT}",
        ),
        (
            figures.depth_over_radius > DEPTH_OVER_RADIUS_LIMIT,
            f"depth is {figures.depth_over_radius:.2f} of the ball's radius: {_STRAINS} "
            f"{DEPTH_OVER_RADIUS_LIMIT}",
        ),
        (
            free and figures.deflection_over_thickness > DEFLECTION_OVER_THICKNESS_LIMIT,
            f"the coated face rises by {figures.deflection_over_thickness:.2f} of the thickness: "
            f"{_STRETCH} above {DEFLECTION_OVER_THICKNESS_LIMIT}, which a "
            "linear slab leaves out",
        ),
        (
            figures.max_slope_deg > SLOPE_LIMIT_DEG,
            f"the specimen is {figures.max_slope_deg:.0f} {_STEEP} within the contact: "
            f"a height field holds up to {SLOPE_LIMIT_DEG:.0f} deg",
        ),
        (
            figures.margin_mm < needed,
            f"the contact ends {figures.margin_mm:.2f} mm from the rim, less than one thickness: "
            f"{_RIM} matters there"
            if free
            else f"the contact ends {figures.margin_mm:.2f} mm from the pad's side, less than "
            f"three thicknesses: {_SIDES}, which an endless layer leaves out",
        ),
        (
            figures.cells_across < _FEWEST_CELLS_ACROSS,
            f"the contact is {figures.cells_across:.0f} solver cells wide: use a finer "
            "press.solver_pitch_mm",
        ),
    )
    return replace(figures, warnings=tuple(text for exceeded, text in checks if exceeded))


def contact_validity(
    shape: Shape,
    elastomer: Elastomer,
    cells: tuple[FloatArray, FloatArray, BoolArray],
    depth_mm: float,
    deflection_mm: float,
) -> Validity:
    """Return the accuracy of a linear slab's press from its contact on cells, see `assess`.

    Parameters
    ----------
    cells : (col,) x and (row,) y of the cells' centres, mm, and (row, col) bool: cells in contact
    depth_mm, deflection_mm : travel, and largest deflection of the coated face
    """
    x_mm, y_mm, contact = cells
    pitch_mm = float(np.sqrt((x_mm[1] - x_mm[0]) * (y_mm[1] - y_mm[0])))
    half_mm = elastomer.length_x_mm / 2, elastomer.length_y_mm / 2
    return assess(
        layout=elastomer.layout,
        depth_mm=depth_mm,
        thickness_mm=elastomer.thickness_mm,
        radius_mm=min((ball.radius_mm for ball in shape.spheres()), default=None),
        deflection_mm=deflection_mm,
        slope_deg=max_slope_deg(shape.height_above_lowest(x_mm, y_mm), contact, pitch_mm),
        margin_to_rim_mm=margin_mm(contact, x_mm, y_mm, half_mm),
        cells_across=float(np.sqrt(4 / np.pi * contact.sum() / max(1, len(shape.spheres())))),
    )


def with_sides(validity: Validity) -> Validity:
    """Return the accuracy of a model that contains the pad's sides: without the warning on them."""
    warnings = tuple(text for text in validity.warnings if _SIDES not in text)
    return replace(validity, warnings=warnings)


def bend_over_ball(thickness_mm: float, shape: Shape) -> float:
    """Return thickness over radius of bending of a sheet that wraps round the smallest ball.

    It is 0 for a specimen without balls. Edges bend a sheet to a smaller radius, but only over a
    length smaller than its thickness.
    """
    radius_mm = min((ball.radius_mm for ball in shape.spheres()), default=np.inf)
    return thickness_mm / (radius_mm + thickness_mm / 2)


def sheet_estimate_mm(thickness_mm: float, ratio: float) -> float:
    """Return the expected height error of a sheet, mm, without a solution of its press.

    `ratio` is the thickness of the sheet over its radius of bending, see `bend_over_ball`.
    """
    return _SHEET_ERROR * thickness_mm * ratio


def sheet_height_error_mm(thickness_mm: float, bend_1_mm: float) -> float:
    """Return the expected largest height error, mm, of a sheet with the curvature `bend_1_mm`."""
    return _SHEET_ERROR * thickness_mm**2 * bend_1_mm


def assess_sheet(
    *,
    depth_mm: float,
    thickness_mm: float,
    radius_mm: float | None,
    deflection_mm: float,
    bend_1_mm: float,
    slope_deg: float,
    margin_to_rim_mm: float,
    cells_across: float,
    ridge_pitch_mm: float | None,
) -> Validity:
    """Return the accuracy of a thin sheet's press: ratios, height error estimate and warnings.

    `bend_1_mm` is the root mean square curvature of the sheet in the contact, 1/mm; on a ball it is
    1 / R. `ridge_pitch_mm` is the pitch of the specimen's finest grooves, None without grooves.
    """
    ratio = thickness_mm * bend_1_mm
    checks = (
        (
            ratio > SHEET_GOOD,
            f"the sheet is {ratio:.2f} of its radius of bending thick: {_SHEAR} "
            f"counts above {SHEET_GOOD}"
            + (", solid elements are needed above 0.25" if ratio > SHEET_LIMIT else ""),
        ),
        (
            ridge_pitch_mm is not None and ridge_pitch_mm < SHEET_RIDGES * thickness_mm,
            f"ridges every {ridge_pitch_mm} mm are finer than {SHEET_RIDGES:g} thicknesses: the "
            "sheet model errs by some micrometres in what the coat shows of them; take that from "
            "`twin press --transfer`",
        ),
        (
            cells_across < _FEWEST_CELLS_ACROSS,
            f"the contact is {cells_across:.0f} cells wide: use a finer press.cell_mm",
        ),
    )
    return Validity(
        depth_over_thickness=depth_mm / thickness_mm,
        depth_over_radius=depth_mm / radius_mm if radius_mm else 0.0,
        deflection_over_thickness=deflection_mm / thickness_mm,
        max_slope_deg=slope_deg,
        margin_mm=margin_to_rim_mm,
        cells_across=cells_across,
        height_error_mm=sheet_height_error_mm(thickness_mm, bend_1_mm),
        warnings=tuple(text for exceeded, text in checks if exceeded),
    )
