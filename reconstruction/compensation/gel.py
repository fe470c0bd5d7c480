"""Compute contact and pressure of an object pressed into a coated gel on a window, from the coat.

This is the contact-face layout; lengths in mm, pressures in kPa. World frame: the undeformed coat
is z = 0, the object approaches from below. In contact the coat has the shape of the object's
surface; elsewhere the gel is free. The layer's compliance G distinguishes the two and gives the
pressure: the non-negative p with the deflection G p nearest to the measured heights u,

    min |w (G p - u)|^2,  p >= 0,  p = 0 where u was not measured  (w = 1 where u was measured).

Accelerated projected gradients with restart (Beck and Teboulle 2009, SIAM J. Imaging Sci. 2, 183;
O'Donoghue and Candes 2015, Found. Comput. Math. 15, 715), started at the regularised inverse. The
number of passes is fixed: further passes fit noise only.
A cell is in contact if its smoothed pressure exceeds a share of the highest pressure in the
connected part of the contact to which the cell belongs.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from reconstruction.arrays import BoolArray, FloatArray
from reconstruction.compensation.parts import without_blurred_edge
from reconstruction.compensation.presentation import PresentedObject
from reconstruction.compensation.relief import Relief
from reconstruction.errors import FitError

Deflect = Callable[[FloatArray], FloatArray]
"""Function that maps pressure over Young's modulus, (row, col) on the layer's cells, to the
deflection of the coat along +z, mm, on the same cells."""

_PASSES = 120
# Shares of the highest pressure: threshold that separates parts, and contact within each part.
_SEPARATE, _TOUCHING = 0.1, 0.3
_SMOOTH_MM = 0.16
# Parts with less than this share of the force of the strongest part are noise.
_WEAKEST = 0.02
# Relative error of the force: linear frictionless model against neo-Hookean gel with friction.
_FORCE_THEORY = 0.04


@dataclass(frozen=True)
class GelLayer:
    """Known values of the gel.

    Attributes
    ----------
    deflect : function that returns the layer's deflection for a pressure over modulus, both on
        the relief's cells with a margin
    margin_cells : rows and columns by which the layer extends beyond the relief, on each side
    young_modulus_kpa, sigma_young_modulus_kpa : Young's modulus and its standard uncertainty
    """

    deflect: Deflect
    margin_cells: tuple[int, int]
    young_modulus_kpa: float
    sigma_young_modulus_kpa: float = 0.0


@dataclass(frozen=True, eq=False, repr=False)
class CompensatedGel(PresentedObject):
    """Object and contact computed from the coat of a pressed gel; arrays on the relief's cells.

    Attributes
    ----------
    relief : the measured coat
    contact : (row, col) bool, True for cells in contact
    pressure_kpa : (row, col) pressure of the object on the coat
    normal : (row, col, xyz) unit normal of the coat, upwards
    misfit_mm : RMS of measured minus modelled heights
    layer : values of the gel used in the computation
    """

    relief: Relief
    contact: BoolArray
    pressure_kpa: FloatArray
    normal: FloatArray
    misfit_mm: float
    layer: GelLayer

    @property
    def sure(self) -> BoolArray:
        """Contact without its blurred edge, (row, col) bool."""
        return without_blurred_edge(self.contact, self.relief, self.blur_mm)

    @property
    def theory_sigma_mm(self) -> FloatArray:
        """Standard uncertainty, mm, of each point by the model's errors, (row, col): 0."""
        return np.zeros(self.contact.shape)

    @property
    def object_mm(self) -> FloatArray:
        """Points of the coat, world (row, col, xyz), mm; in contact these are on the object."""
        return self.relief.points_mm

    @property
    def blur_mm(self) -> float:
        """Width, mm, by which the edge of the contact is blurred."""
        return _SMOOTH_MM

    @property
    def force_n(self) -> float:
        """Force of the object on the gel along z, N."""
        return float(self.pressure_kpa.sum()) * self.relief.cell_area_mm2 * 1e-3

    @property
    def force_sigma_n(self) -> float:
        """Standard uncertainty of the force, N, from the modulus and the error of the model."""
        share = self.layer.sigma_young_modulus_kpa / self.layer.young_modulus_kpa
        return self.force_n * float(np.hypot(share, _FORCE_THEORY))

    @property
    def area_mm2(self) -> float:
        """Area of the contact projected along z, mm^2."""
        return float(self.contact.sum()) * self.relief.cell_area_mm2

    @property
    def layer_moves_mm(self) -> list[FloatArray]:
        """Shifts of the object's points by uncertain values of the layer: an empty list.

        In contact the coat is on the object's surface for any values of the layer.
        """
        return []

    def theory_mm(self, _: float) -> float:
        """Return the model's error of a radius, mm: 0, because the shape itself is measured."""
        return 0.0


def compensate_gel(relief: Relief, layer: GelLayer) -> CompensatedGel:
    """Compute contact and pressure of an object in a gel from the measured relief of the coat.

    Raises
    ------
    FitError : no object presses on the gel
    """
    margin = layer.margin_cells
    around = [(cells, cells) for cells in margin]
    known = np.pad(relief.measured.astype(np.float64), around)
    heights = known * np.pad(relief.heights_mm, around)
    if float(heights.max()) <= 0:
        raise FitError("gel: no object presses on it; the coat is nowhere above its plane z = 0")
    pressure = _pressure(layer.deflect, heights, known)
    misfit = known * (layer.deflect(pressure) - heights)
    inner = tuple(slice(m, size - m) for m, size in zip(margin, heights.shape, strict=True))
    own = pressure[inner]
    smooth = ndimage.gaussian_filter(own, [_SMOOTH_MM / p for p in relief.pitch_mm[::-1]])
    contact = _touching(smooth) & relief.measured
    slope_y, slope_x = np.gradient(relief.smoothed(_SMOOTH_MM), relief.y_mm, relief.x_mm)
    normal = np.stack((-slope_x, -slope_y, np.ones_like(slope_x)), axis=-1)
    return CompensatedGel(
        relief=relief,
        contact=contact,
        pressure_kpa=layer.young_modulus_kpa * own,
        normal=normal / np.linalg.norm(normal, axis=-1, keepdims=True),
        misfit_mm=float(np.sqrt(np.sum(misfit**2) / known.sum())),
        layer=layer,
    )


def _pressure(deflect: Deflect, heights_mm: FloatArray, known: FloatArray) -> FloatArray:
    """Return the non-negative pressure over modulus with the deflection nearest to the heights.

    Parameters
    ----------
    heights_mm : (row, col) on the layer's cells, 0 where not measured
    known : (row, col) 1 for measured cells, 0 for all others
    """
    largest = _largest_compliance(deflect, known)
    pressure = np.maximum(known * heights_mm, 0.0) / largest
    # One factor for the size of the deflection; the passes find the shape.
    first = deflect(pressure)
    pressure *= max(float(np.sum(known * first * heights_mm) / np.sum(known * first**2)), 0.0)
    ahead, momentum = pressure, 1.0
    for _ in range(_PASSES):
        downhill = known * deflect(known * (deflect(ahead) - heights_mm))
        moved = np.maximum(ahead - downhill / largest**2, 0.0)
        if float(np.sum((ahead - moved) * (moved - pressure))) > 0:
            momentum = 1.0  # the step reverses: restart
        after = (1 + np.sqrt(1 + 4 * momentum**2)) / 2
        ahead = moved + (momentum - 1) / after * (moved - pressure)
        pressure, momentum = moved, after
    return pressure


def _largest_compliance(deflect: Deflect, known: FloatArray) -> float:
    """Return the largest eigenvalue, mm, of the compliance between measured cells, plus 2 %."""
    wave = known * (1 + 0.1 * np.cos(np.arange(known.size)).reshape(known.shape))
    size = 1.0
    for _ in range(30):
        wave = wave / np.linalg.norm(wave)
        image = known * deflect(wave)
        size = float(np.linalg.norm(image))
        wave = image
    return 1.02 * size


def _touching(pressure: FloatArray) -> BoolArray:
    """Return the cells in contact, (row, col) bool, from the smoothed pressure.

    In each connected part these are the cells above a share of the part's highest pressure.
    Parts with a small share of the force are left out as noise.
    """
    highest = float(pressure.max())
    labels, count = ndimage.label(pressure > _SEPARATE * highest)
    numbers = np.arange(1, count + 1)
    tops = np.concatenate(([np.inf], ndimage.maximum(pressure, labels, numbers)))
    forces = np.concatenate(([0.0], ndimage.sum(pressure, labels, numbers)))
    strong = forces >= _WEAKEST * forces.max()
    return np.asarray((pressure > _TOUCHING * tops[labels]) & strong[labels])
