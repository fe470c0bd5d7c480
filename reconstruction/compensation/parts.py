"""Shape of the object in contact: balls, rods and flat faces with their uncertainty; mm.

Each connected part of the contact, without its blurred edge, is fitted with a sphere, a cylinder
and a plane. Its form is the simplest with residuals not much above the least ones.

The standard uncertainty of a radius (JCGM 100, 5.1.2) has three shares: noise and texture of the
coat, from variance and correlation area of the residuals; uncertain values of the layer, which move
all points of a part together; and the error of the model.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Literal, Protocol

import numpy as np
from scipy import ndimage

from reconstruction.arrays import BoolArray, FloatArray
from reconstruction.compensation.presentation import LayerMaps
from reconstruction.compensation.relief import Relief, variance_and_area
from reconstruction.errors import FitError
from reconstruction.evaluate.estimates import FittedDimension, ball_radius, cylinder_radius
from reconstruction.evaluate.fit import fit_plane, rms

Form = Literal["ball", "rod", "flat"]
RadiusFit = Callable[[FloatArray], FittedDimension]
RadiusOf = Callable[[FloatArray], float]

_LEAST_CELLS = 30
# Largest ratio of the residuals to those of the simpler form for which a form is chosen.
_MUCH_LESS = 0.7
_LARGEST_RADIUS_MM = 500.0


class Compensated(Protocol):
    """Compensated coat of any kind of layer; arrays (row, col, ...)."""

    @property
    def relief(self) -> Relief:
        """The measured coat."""
        ...

    @property
    def contact(self) -> BoolArray:
        """Cells in which the object is in contact."""
        ...

    @property
    def sure(self) -> BoolArray:
        """Cells in contact with certainty: without those that the filters may have blurred."""
        ...

    @property
    def edge_sigma_mm(self) -> FloatArray:
        """Standard uncertainty of each point along the normal because of edges near it."""
        ...

    @property
    def pressure_kpa(self) -> FloatArray:
        """Pressure of the contact."""
        ...

    @property
    def normal(self) -> FloatArray:
        """Unit normal of the coat."""
        ...

    @property
    def object_mm(self) -> FloatArray:
        """Points of the object, in the contact cells."""
        ...

    @property
    def blur_mm(self) -> float:
        """Width by which the contact's edge is blurred."""
        ...

    @property
    def area_mm2(self) -> float:
        """Area of the contact projected along z."""
        ...

    @property
    def force_n(self) -> float:
        """Force along z."""
        ...

    @property
    def force_sigma_n(self) -> float:
        """Standard uncertainty of the force."""
        ...

    @property
    def layer_moves_mm(self) -> list[FloatArray]:
        """Standard uncertainties that move all points of a part together, along their normals."""
        ...

    @property
    def layer_maps(self) -> LayerMaps:
        """Maps that only this kind of layer has."""
        ...

    def theory_mm(self, radius_mm: float) -> float:
        """Return the model's error of a radius."""
        ...


@dataclass(frozen=True, eq=False)
class ObjectPart:
    """One part of the object that carries the sheet.

    Attributes
    ----------
    cells : (row, col) bool, all cells of the contact
    core : (row, col) bool, cells used in the fit
    middle_mm : (xy) mean of its cells
    highest_mm : highest z of the object in its core
    form : fitted form
    radius_mm, sigma_mm : of a ball or rod with its standard uncertainty; 0 of a flat face
    noise_mm, layer_mm : shares of that: noise and texture; uncertain values of the layer
    residual_um : RMS from the form
    pressure_kpa : mean over its cells
    """

    cells: BoolArray
    core: BoolArray
    middle_mm: tuple[float, float]
    highest_mm: float
    form: Form
    radius_mm: float
    sigma_mm: float
    noise_mm: float
    layer_mm: float
    residual_um: float
    pressure_kpa: float


def parts_of(compensated: Compensated) -> list[ObjectPart]:
    """Return the parts of the contact from -x to +x, without those of too few cells."""
    labels, count = ndimage.label(compensated.contact)
    core = without_blurred_edge(compensated.contact, compensated.relief, compensated.blur_mm)
    parts = []
    for number in range(1, count + 1):
        cells = labels == number
        own = cells & core
        if own.sum() >= _LEAST_CELLS:
            try:
                parts.append(_fitted(compensated, cells, own))
            except FitError:  # too small or of no known form: it is in the map only
                continue
    return sorted(parts, key=lambda part: part.middle_mm)


def without_blurred_edge(contact: BoolArray, relief: Relief, blur_mm: float) -> BoolArray:
    """Return a contact, (row, col), without the cells that a filter blurs at its edge."""
    reach = int(np.ceil(blur_mm / min(relief.pitch_mm)))
    return np.asarray(ndimage.binary_erosion(contact, iterations=reach))


def _fitted(compensated: Compensated, cells: BoolArray, core: BoolArray) -> ObjectPart:
    points, relief = compensated.object_mm[core], compensated.relief
    form, fit = _form(points)
    residual, radius, noise, layer, theory = fit_plane(points).residuals_mm, 0.0, 0.0, 0.0, 0.0
    if fit is not None:
        estimate = fit(points)
        residual, radius = estimate.residuals_mm[estimate.used], estimate.value
        noise = _noise_mm(compensated, core, estimate)
        layer = _layer_mm(compensated, core, lambda moved: fit(moved).value)
        theory = compensated.theory_mm(radius)
    row, col = np.nonzero(cells)
    return ObjectPart(
        cells=cells,
        core=core,
        middle_mm=(float(relief.x_mm[col].mean()), float(relief.y_mm[row].mean())),
        highest_mm=float(points[:, 2].max()),
        form=form,
        radius_mm=radius,
        sigma_mm=float(np.sqrt(noise**2 + layer**2 + theory**2)),
        noise_mm=noise,
        layer_mm=layer,
        residual_um=1e3 * rms(residual),
        pressure_kpa=float(compensated.pressure_kpa[cells].mean()),
    )


def _form(points_mm: FloatArray) -> tuple[Form, RadiusFit | None]:
    """Return the simplest form that fits, and the function that fits its radius, or None."""
    least = rms(fit_plane(points_mm).residuals_mm)
    directions = np.linalg.svd(points_mm - points_mm.mean(axis=0), full_matrices=False)[2][:2]
    candidates: list[tuple[Form, RadiusFit]] = [("ball", _ball)]
    candidates += [("rod", partial(_rod, axis=axis)) for axis in directions]
    best: tuple[Form, RadiusFit | None] = ("flat", None)
    for form, fit in candidates:
        try:
            estimate = fit(points_mm)
        except FitError:
            continue
        residual_mm = rms(estimate.residuals_mm[estimate.used])
        if estimate.value < _LARGEST_RADIUS_MM and residual_mm < _MUCH_LESS * least:
            least, best = residual_mm, (form, fit)
    return best


def _ball(points_mm: FloatArray) -> FittedDimension:
    return ball_radius(points_mm)[0]


def _rod(points_mm: FloatArray, axis: FloatArray) -> FittedDimension:
    return cylinder_radius(points_mm, axis)[0]


def _noise_mm(compensated: Compensated, core: BoolArray, estimate: FittedDimension) -> float:
    """Return the standard uncertainty of a radius from noise and texture of the coat.

    Uses the residuals' variance along the normal as that along z; both are equal at gentle
    slopes.
    """
    relief: Relief = compensated.relief
    rest, used = np.zeros(core.shape), np.zeros(core.shape, bool)
    rest[core], used[core] = estimate.residuals_mm, estimate.used
    variance, area = variance_and_area(rest, used, relief.cell_area_mm2)
    spread = np.full(int(core.sum()), np.sqrt(variance))
    return estimate.noise_mm(spread, area / relief.cell_area_mm2)


def _layer_mm(compensated: Compensated, core: BoolArray, radius_of: RadiusOf) -> float:
    """Return the uncertainty from the layer: its moves shift all points along their normals."""
    points = compensated.object_mm[core]
    radius, changes = radius_of(points), [0.0]
    for move in compensated.layer_moves_mm:
        away = move[core]
        if away.any():
            changes.append(radius_of(points - away[:, None] * compensated.normal[core]) - radius)
    return float(np.linalg.norm(changes))
