"""Fit balls, rods and flat faces to the object in contact, with their uncertainty; lengths in mm.

Each connected part of the contact, without its blurred edge, is fitted with a plane, a sphere and
two cylinders, in this order. A later form replaces an earlier one only if its RMS residual is less
than 70 % of the RMS residual of the earlier one.

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
from reconstruction.compensation.relief import Relief
from reconstruction.compensation.scatter import noise_of_fit
from reconstruction.errors import FitError
from reconstruction.evaluate.estimates import FittedDimension, ball_radius, cylinder_radius
from reconstruction.evaluate.fit import fit_plane, rms

Form = Literal["ball", "rod", "flat"]
RadiusFit = Callable[[FloatArray], FittedDimension]
RadiusOf = Callable[[FloatArray], float]

_LEAST_CELLS = 30
# Largest ratio of a form's RMS residual to that of the earlier form at which it is preferred.
_MUCH_LESS = 0.7
_LARGEST_RADIUS_MM = 500.0


class Compensated(Protocol):
    """Object and contact computed from a coat, for any kind of layer: sheet, gel or slab.

    Arrays are (row, col, ...) on the relief's cells, in the world frame.
    """

    @property
    def relief(self) -> Relief:
        """The measured coat."""
        ...

    @property
    def contact(self) -> BoolArray:
        """Cells in which the object is in contact with the layer, (row, col) bool."""
        ...

    @property
    def sure(self) -> BoolArray:
        """Cells certainly in contact, (row, col) bool: the contact without its blurred edge."""
        ...

    @property
    def theory_sigma_mm(self) -> FloatArray:
        """Standard uncertainty, mm, of each object point along the normal by the model's errors."""
        ...

    @property
    def pressure_kpa(self) -> FloatArray:
        """Contact pressure of the object on the layer, (row, col)."""
        ...

    @property
    def normal(self) -> FloatArray:
        """Unit normal of the layer, pointing from object to coat, (row, col, xyz)."""
        ...

    @property
    def object_mm(self) -> FloatArray:
        """Points of the face that touches the object, (row, col, xyz), mm.

        In the contact cells they are points of the object.
        """
        ...

    @property
    def blur_mm(self) -> float:
        """Width, mm, by which the edge of the contact is blurred."""
        ...

    @property
    def area_mm2(self) -> float:
        """Area of the contact projected along z, mm^2."""
        ...

    @property
    def force_n(self) -> float:
        """Force of the object on the layer along z, N."""
        ...

    @property
    def force_sigma_n(self) -> float:
        """Standard uncertainty of `force_n`, N."""
        ...

    @property
    def layer_moves_mm(self) -> list[FloatArray]:
        """Shifts of the object's points along the normals, mm, by uncertain values of the layer.

        Each entry is (row, col), one standard uncertainty, and common to all points of a part.
        """
        ...

    @property
    def layer_maps(self) -> LayerMaps:
        """Further maps, by name, that exist only for this kind of layer."""
        ...

    def theory_mm(self, radius_mm: float) -> float:
        """Return the standard uncertainty, mm, of a radius due to errors of the layer's model."""
        ...


@dataclass(frozen=True, eq=False)
class ObjectPart:
    """One connected part of the contact, and the form fitted to the object there.

    Attributes
    ----------
    cells : (row, col) bool, all cells of this part of the contact
    core : (row, col) bool, cells used in the fit: without the blurred edge
    middle_mm : (xy) mean position of `cells`, world
    highest_mm : highest world z of the object in `core`
    form : fitted form
    radius_mm, sigma_mm : radius of the ball or rod and its standard uncertainty; 0 for a flat face
    noise_mm, layer_mm : shares of `sigma_mm` from noise and texture of the coat, and from the
        uncertain values of the layer
    residual_um : RMS distance of the points from the form
    pressure_kpa : mean contact pressure over `cells`
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
    """Return the connected parts of the contact, from -x to +x, with the form fitted to each.

    Parts with fewer than 30 cells away from their blurred edge are left out, and parts to which no
    form can be fitted.
    """
    labels, count = ndimage.label(compensated.contact)
    core = without_blurred_edge(compensated.contact, compensated.relief, compensated.blur_mm)
    parts = []
    for number in range(1, count + 1):
        cells = labels == number
        own = cells & core
        if own.sum() >= _LEAST_CELLS:
            try:
                parts.append(_fitted(compensated, cells, own))
            except FitError:  # no form can be fitted: the part is in the maps only
                continue
    return sorted(parts, key=lambda part: part.middle_mm)


def without_blurred_edge(contact: BoolArray, relief: Relief, blur_mm: float) -> BoolArray:
    """Return a contact, (row, col) bool, without its cells within `blur_mm` of its edge."""
    reach = int(np.ceil(blur_mm / min(relief.pitch_mm)))
    return np.asarray(ndimage.binary_erosion(contact, iterations=reach))


def _fitted(compensated: Compensated, cells: BoolArray, core: BoolArray) -> ObjectPart:
    points, relief = compensated.object_mm[core], compensated.relief
    form, fit = _form(points)
    residual, radius, noise, layer, theory = fit_plane(points).residuals_mm, 0.0, 0.0, 0.0, 0.0
    if fit is not None:
        estimate = fit(points)
        residual, radius = estimate.residuals_mm[estimate.used], estimate.value
        noise = _noise_mm(core, estimate)
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
    """Return the form of points (n, xyz), and the function that fits its radius.

    The function is None for a flat face. The module docstring defines how the form is selected.
    """
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


def _noise_mm(core: BoolArray, estimate: FittedDimension) -> float:
    """Return the standard uncertainty, mm, of a radius from noise and texture of the coat.

    It is a lower limit for a contact of few patches of the texture, see `FitNoise.is_known`.
    """
    return noise_of_fit(estimate, np.flatnonzero(core), core.shape).sigma_mm


def _layer_mm(compensated: Compensated, core: BoolArray, radius_of: RadiusOf) -> float:
    """Return the standard uncertainty, mm, of a radius from the uncertain values of the layer.

    Each of `layer_moves_mm` shifts all points along their normals and so changes the radius. The
    changes are added as a root sum of squares.
    """
    points = compensated.object_mm[core]
    radius, changes = radius_of(points), [0.0]
    for move in compensated.layer_moves_mm:
        away = move[core]
        if away.any():
            changes.append(radius_of(points - away[:, None] * compensated.normal[core]) - radius)
    return float(np.linalg.norm(changes))
