"""Artefacts with a known profile along x: rods and bars on a plate, a step, a V groove."""

import numpy as np

from twin.config.specimens import Bar, Bars, Rods, Step, VGroove, row_width_mm
from twin.specimens.catalogue import Assembly, Shape, register
from twin.specimens.closed_form import Cylinder
from twin.specimens.meshes import MeshShape, block
from twin.specimens.solids import along_axis, arc, prism

_BASE_MM = 2.0
_X, _Y, _Z = np.eye(3)


@register("rods")
def build_rods(specimen: Rods) -> Assembly:
    """Lay the rods along y on the plate's upper face, z = 0, each in a bead of cement.

    The rods touch the plate along a line: a bead between the two makes one body of them. It
    stays below the rods, where neither elastomer nor light from above finds it.
    """
    rods = list(zip(specimen.middles_mm, specimen.diameters_mm, strict=True))
    cylinders = [_lying(x, diameter, specimen) for x, diameter in rods]
    beads = [_bead(x, diameter, specimen) for x, diameter in rods]
    width_mm = row_width_mm(specimen.diameters_mm, specimen.gap_mm)
    return Assembly((*cylinders, *beads, _plate(specimen, width_mm)))


def _lying(x_mm: float, diameter_mm: float, rods: Rods) -> Shape:
    middle = np.array([x_mm, 0.0, diameter_mm / 2])
    return Cylinder(middle, _Y.copy(), diameter_mm / 2, rods.length_mm / 2, rods.edge_radius_mm)


def _bead(x_mm: float, diameter_mm: float, rods: Rods) -> Shape:
    half, end = rods.bead_mm / 2, (rods.length_mm - rods.edge_radius_mm) / 2
    low = (x_mm - half, -end, -rods.plate_mm / 2)
    return block(low, (x_mm + half, end, diameter_mm / 2), 0.0)


def _plate(artefact: Rods | Bars, width_mm: float) -> Shape:
    """Return the plate under a row of this width, its upper face z = 0, edges as the row's.

    No cut edge is perfectly sharp, and a thin sheet would hang on one point by point.
    """
    x, y = width_mm / 2 + artefact.margin_mm, artefact.length_mm / 2 + artefact.margin_mm
    edge_mm = min(artefact.edge_radius_mm, artefact.plate_mm / 4)
    return block((-x, -y, -artefact.plate_mm), (x, y, 0.0), edge_mm)


@register("bar")
def build_bar(specimen: Bar) -> MeshShape:
    """Lay one bar along y."""
    x, y, z = specimen.width_mm / 2, specimen.length_mm / 2, specimen.height_mm
    return block((-x, -y, -z), (x, y, 0.0), specimen.edge_radius_mm)


@register("bars")
def build_bars(specimen: Bars) -> Assembly:
    """Lay the bars along y on the plate's upper face, z = 0, sunk into it by half its thickness."""
    row = zip(specimen.middles_mm, specimen.widths_mm, strict=True)
    low, high, y = -specimen.plate_mm / 2, specimen.height_mm, specimen.length_mm / 2
    bars = [
        block((x - w / 2, -y, low), (x + w / 2, y, high), specimen.edge_radius_mm) for x, w in row
    ]
    return Assembly((*bars, _plate(specimen, row_width_mm(specimen.widths_mm, specimen.gap_mm))))


@register("step")
def build_step(specimen: Step) -> MeshShape:
    """Raise the level at +x; the lower one is z = 0, the riser is in x = 0."""
    x, height, edge = specimen.length_x_mm / 2, specimen.height_mm, specimen.edge_radius_mm
    # Counter-clockwise, so the rounding is passed from the upper level down.
    rounding = arc((edge, height - edge), edge, 90, 180)
    foot = [] if edge == height else [(0.0, 0.0)]
    outline = [(x, -_BASE_MM), (x, height), *rounding, *foot, (-x, 0.0), (-x, -_BASE_MM)]
    return _uniform(outline, specimen.length_y_mm)


@register("v_groove")
def build_v_groove(specimen: VGroove) -> MeshShape:
    """Cut the groove into the face z = 0, its root in x = 0."""
    x, half, root = specimen.length_x_mm / 2, specimen.opening_mm / 2, -specimen.depth_mm
    base = root - _BASE_MM
    outline = [(x, base), (x, 0.0), (half, 0.0), (0.0, root), (-half, 0.0), (-x, 0.0), (-x, base)]
    return _uniform(outline, specimen.length_y_mm)


def _uniform(outline_xz_mm: list[tuple[float, float]], length_y_mm: float) -> MeshShape:
    """Extrude an outline in xz, counter-clockwise with z up, along y."""
    upright = prism(np.array(outline_xz_mm), -length_y_mm / 2, length_y_mm / 2)
    return MeshShape(along_axis(upright, _X, _Z, -_Y))
