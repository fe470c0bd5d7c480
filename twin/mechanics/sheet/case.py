"""Convert the experiment's data of a thin-sheet press to the solver's: frame, laws, bodies, cells.

The world frame is that of `press`, in mm. In the solver's own frame z = 0 is the undeformed surface
midway between the faces. The contact's penalty stiffness is E* / (h / 4): pressure per penetration,
with E* = E / (1 - nu^2) and the thickness h. With this value the results are nearest to those of
solid elements (shared notes on the sheet).
"""

from dataclasses import dataclass

import numpy as np

from twin.config.elastomer import SHEET_THICKNESS_MM
from twin.config.models import Elastomer, Mechanics, Press, Specimen
from twin.mechanics.errors import PressError
from twin.mechanics.hardness import young_modulus
from twin.mechanics.layouts import weight_kpa
from twin.mechanics.press import check_outline
from twin.mechanics.sheet.energy import Bodies, Sheet
from twin.mechanics.sheet.grid import Frame, sheet_grid, span_mm
from twin.mechanics.sheet.laws import Laws
from twin.mechanics.sheet.splines import GROWTH, SplineLine, Widths, graded_line
from twin.mechanics.sheet.thickness import SheetThickness, sheet_thickness
from twin.mechanics.size import check_face_nodes
from twin.mechanics.validity import THINNEST
from twin.shape import Shape, SignedDistance
from twin.specimens import shape_of
from twin.specimens.distance import RectangularInside, RoundInside, distances_of, frame_wall, plate

# Incompressible: E* = E / (1 - 1/4), and shear modulus E / 3.
_COMPLIANCE, _STICK_COMPLIANCE = 0.25, 0.5
_LONGEST_CELL_MM = 1.0
_TACK_RANGE_MM = 0.08
# Without a wall only the rim keeps a sheet under pressure out of the frame's material.
_WALL_MM = 0.5


#: West, east, south and north ends, world, mm.
Box = tuple[float, float, float, float]


@dataclass(frozen=True, eq=False)
class Cells:
    """Widths of the cells of a sheet's grid: in the contact, at the rim, and between them."""

    pitch_mm: float
    rim_mm: float
    #: region of the world's x and y with cells of the pitch
    box_mm: Box
    #: largest widths along x and y where cells may be wider than the pitch
    allowed: tuple[Widths, Widths] | None = None
    #: change of the width over distance outside the box
    growth: float = GROWTH


@dataclass(frozen=True, eq=False)
class SheetCase:
    """Data of one press, converted by `sheet_case` from the experiment to the solver's form."""

    frame: Frame
    laws: Laws
    bodies: Bodies
    #: number of the moving bodies that are the specimen's own, before its plate
    parts: int
    shape: Shape
    sticks: bool
    #: largest friction over contact pressure where it sticks; infinite: no slip
    friction_coefficient: float
    #: width of the finest cells
    cell_mm: float
    #: the experiment specifies the cells
    is_cell_specified: bool
    #: pitch of the specimen's finest grooves, None without grooves
    ridge_pitch_mm: float | None
    #: None: uniform
    thickness: SheetThickness | None = None

    def sheet(self, cells: Cells) -> Sheet:
        """Return the sheet on a grid with the given widths of cells."""
        # With a cohesive range below half a cell the sheet would jump from point to point.
        laws = self.laws._replace(tack_range_mm=max(_TACK_RANGE_MM, 0.5 * cells.pitch_mm))
        grid = sheet_grid(self.frame, *self.lines(cells)).with_thickness(self.thickness)
        return Sheet(
            grid,
            laws,
            self.bodies,
            self.touched_z_mm,
            self.sticks,
            cells.pitch_mm,
            self.friction_coefficient,
        )

    @property
    def touched_z_mm(self) -> float:
        """Height z of the mounted sheet's lower face in the solver's frame, mm.

        It is that of a sheet of the mean thickness.
        """
        return -self.laws.thickness_mm / self.frame.pre_stretch**2 / 2

    def lines(self, cells: Cells) -> tuple[SplineLine, SplineLine]:
        """Return the spline lines along x and y, whose cells have the given widths."""
        x_span, y_span = span_mm(self.frame)
        stretch = self.frame.pre_stretch
        west, east, south, north = (end / stretch for end in cells.box_mm)
        widths = cells.pitch_mm, cells.rim_mm, _LONGEST_CELL_MM
        along_x, along_y = cells.allowed or (None, None)
        return (
            graded_line(x_span, (west, east), *widths, allowed=along_x, growth=cells.growth),
            graded_line(y_span, (south, north), *widths, allowed=along_y, growth=cells.growth),
        )


def sheet_case(
    specimen: Specimen, elastomer: Elastomer, load: Press, mechanics: Mechanics
) -> SheetCase:
    """Return the data of a press in the solver's form.

    Raises
    ------
    PressError
        The sheet model cannot compute this press, see `check_sheet`.
    """
    shape = shape_of(specimen)
    check_sheet(shape, elastomer, load, mechanics)
    frame = Frame(
        elastomer.length_x_mm,
        elastomer.length_y_mm,
        elastomer.outline,
        "simple" if mechanics.support == "simple" else "clamped",
        elastomer.pre_stretch,
        elastomer.rim_compliance_mm2_per_n,
    )
    parts = distances_of(shape)
    return SheetCase(
        frame=frame,
        laws=_laws(elastomer, load),
        bodies=Bodies((*parts, *_plate(shape)), _walls(frame)),
        parts=len(parts),
        shape=shape,
        sticks=elastomer.sticks,
        friction_coefficient=elastomer.largest_friction,
        cell_mm=finest_cell_mm(elastomer, load),
        is_cell_specified=load.cell_mm is not None,
        ridge_pitch_mm=specimen.finest_pitch_mm,
        thickness=sheet_thickness(elastomer),
    )


def check_sheet(shape: Shape, elastomer: Elastomer, load: Press, mechanics: Mechanics) -> None:
    """Raise an error if the sheet model cannot compute this press, without solving it.

    Raises
    ------
    PressError
        The model does not allow the thickness, layout, film, support or compliant rim, or the
        weight has no density. The specimen extends beyond the frame's opening, or the grid of the
        coated face takes too much memory. Or the force or the tack would tear any such sheet.
    """
    low, high = SHEET_THICKNESS_MM
    if not low <= elastomer.thickness_mm <= high:
        raise PressError(
            f"elastomer.thickness_mm: found {elastomer.thickness_mm:g}, the sheet model allows "
            f"{low:g} to {high:g}; choose mechanics.model = 'auto' for a slab"
        )
    if elastomer.layout != "opposite_face":
        raise PressError(
            "elastomer.layout: the sheet model needs 'opposite_face'; a gel bonded to a window is "
            "pressed by mechanics.model = 'spectral'"
        )
    if elastomer.film is not None:
        raise PressError("elastomer.film: the sheet model has no film of its own; remove it")
    if mechanics.support not in (None, "simple", "clamped"):
        raise PressError(
            f"mechanics.support: found '{mechanics.support}', the sheet model allows 'simple' or "
            "'clamped'"
        )
    if elastomer.rim_compliance_mm2_per_n and elastomer.outline == "round":
        raise PressError(
            f"elastomer.rim_compliance_mm2_per_n: found {elastomer.rim_compliance_mm2_per_n:g} "
            "with outline = 'round', whose rim is rigid in the sheet model (the corners of its "
            "grid have cells of no height, which a free rim folds); use outline = 'rectangular'"
        )
    check_outline(shape, elastomer)
    check_face_nodes(elastomer, load)
    weight_kpa(elastomer, load)
    _check_force(elastomer, load)
    _check_tack(elastomer)


def _check_force(elastomer: Elastomer, load: Press) -> None:
    """Raise an error if a force would tear any sheet of these properties.

    Rim and air pressure together balance the force. Stretched by lambda across the rim, a
    neo-Hookean sheet pulls with less than mu h lambda per undeformed length of rim. At a rigid rim
    it keeps its pre-stretch along the rim, so that its thickness decreases to the fraction
    1 / (lambda pre_stretch). At a compliant rim the fraction is lambda**-0.5 or less, as for a
    strip with free sides.
    """
    if load.force_n is None:
        return
    x_mm, y_mm = elastomer.length_x_mm, elastomer.length_y_mm
    shear_n_mm2, stretch = young_modulus(elastomer).best_kpa / 3e3, elastomer.pre_stretch
    largest = THINNEST**-2 if elastomer.rim_compliance_mm2_per_n else 1 / (THINNEST * stretch)
    torn_n = 2 * (x_mm + y_mm) / stretch * shear_n_mm2 * elastomer.thickness_mm * largest
    most_n = torn_n + 1e-3 * load.back_pressure_kpa * x_mm * y_mm
    if load.force_n > most_n:
        raise PressError(
            f"press.force_n: found {load.force_n:g} N, allowed up to {most_n:.3g} N, which tears "
            f"a sheet of {elastomer.thickness_mm:g} mm along all of its rim; lower it, or use a "
            "thicker or harder sheet"
        )


def _check_tack(elastomer: Elastomer) -> None:
    """Raise an error for a tack that spreads the sheet over the specimen without bound.

    If the area stretch a increases, adhesion releases the energy W per added area, and stretching
    takes mu h (1 - a^-3). If W exceeds mu h, the sheet spreads until it tears. kPa mm = J/m^2.
    """
    most_j_m2 = young_modulus(elastomer).best_kpa / 3 * elastomer.thickness_mm
    if elastomer.tack_j_m2 > most_j_m2:
        raise PressError(
            f"elastomer.tack_j_m2: found {elastomer.tack_j_m2:g}, allowed up to {most_j_m2:.3g}, "
            "shear modulus times thickness: more spreads the sheet over the specimen until it "
            "tears; lower it, or use a thicker or harder sheet"
        )


def finest_cell_mm(elastomer: Elastomer, load: Press) -> float:
    """Return the width of the finest cells, mm: `load.cell_mm`, or by default from the thickness.

    The default is 0.75 x the thickness, limited to 0.075 to 0.15 mm.
    """
    if load.cell_mm is not None:
        return load.cell_mm
    return float(np.clip(0.75 * elastomer.thickness_mm, 0.075, 0.15))


def _laws(elastomer: Elastomer, load: Press) -> Laws:
    modulus_kpa, h = young_modulus(elastomer).best_kpa, elastomer.thickness_mm
    return Laws(
        thickness_mm=h,
        shear_modulus_kpa=modulus_kpa / 3,
        contact_stiffness=modulus_kpa / 0.75 / (_COMPLIANCE * h),
        stick_stiffness=modulus_kpa / 3 / (_STICK_COMPLIANCE * h),
        tack=elastomer.tack_j_m2,
        tack_range_mm=_TACK_RANGE_MM,
        pressure_kpa=0.0,
        weight_kpa=-weight_kpa(elastomer, load),
    )


def _plate(shape: Shape) -> tuple[SignedDistance, ...]:
    """Return the signed distance to the plate under the specimen, as the only element."""
    return (plate(shape.bottom_mm),)


def _walls(frame: Frame) -> tuple[SignedDistance, ...]:
    half_x, half_y = (half + _WALL_MM for half in frame.half_mm)
    inside = RoundInside(half_x) if frame.outline == "round" else RectangularInside(half_x, half_y)
    return frame_wall(inside)
