"""Energy of the one-dimensional sheet with its derivatives. Equations in `round_sheet`."""

from dataclasses import dataclass

import numpy as np

from reconstruction.arrays import FloatArray
from tests.oracles.jets import Jet, variables
from tests.oracles.round_model import Anchors, Load, RoundSheet
from tests.oracles.sections import Nearest

_COMPLIANT_SHARE = 0.25
_SLIPPING_SHARE = 0.5
_BAND = 5


@dataclass(frozen=True)
class Assembled:
    energy: float
    #: (2 n,) derivative by the coefficients
    gradient: FloatArray
    #: (point, variable, variable) weighted second derivative of the energy
    bend: FloatArray
    gap_mm: FloatArray
    force: float


def assemble(sheet: RoundSheet, load: Load, coefficients: FloatArray, anchors: Anchors):
    weights = sheet.weights_mm2
    local = spread(sheet, coefficients)
    y = variables(local)
    strained = _strained(sheet, y, load.pressure_mpa)
    touched, gap = _touched(sheet, y, load.travel_mm, anchors)
    total = strained + touched
    slopes = _gathered(sheet, weights * total.slope)
    return Assembled(
        energy=float(weights @ total.value),
        gradient=slopes,
        bend=np.moveaxis(weights * total.bend, 2, 0),
        gap_mm=gap,
        force=-float(weights @ touched.slope[3]),
    )


def spread(sheet: RoundSheet, coefficients: FloatArray) -> FloatArray:
    """Return r, r', r'', z, z', z'' at the Gauss points: (variable, point)."""
    local = sheet.line.local
    cell = np.repeat(np.arange(sheet.line.size - 2), 2)[:, None] + np.arange(3)
    return np.einsum("qda,qac->cdq", local, coefficients[cell]).reshape(6, -1)


def banded(sheet: RoundSheet, bend: FloatArray) -> FloatArray:
    """Return the tangent of the free unknowns in lower banded form."""
    local, points = sheet.line.local, bend.shape[0]
    operator = np.zeros((points, 2, 3, 3, 2))
    operator[:, 0, :, :, 0] = operator[:, 1, :, :, 1] = local
    operator = operator.reshape(points, 6, 6)
    blocks = np.swapaxes(operator, 1, 2) @ bend @ operator
    number = sheet.unknowns[_numbers(sheet)]
    row, column = np.broadcast_arrays(number[:, :, None], number[:, None])
    keep = (column >= 0) & (row >= column)
    size = sheet.unknowns.max() + 1
    flat = (row - column)[keep] * size + column[keep]
    return np.bincount(flat, blocks[keep], (_BAND + 1) * size).reshape(_BAND + 1, size)


def _strained(sheet: RoundSheet, y: list[Jet], pressure_mpa: float) -> Jet:
    """Return the sheet's own energy and that of the pressure, per undeformed area."""
    p, p1, p2, z, z1, z2 = y
    s, h = sheet.line.points_mm, sheet.thickness_mm
    squared1 = p1 * p1 + z1 * z1
    j = squared1**0.5
    k1 = (p1 * z2 - z1 * p2) / (squared1 * j)
    bent1 = squared1 * k1 * k1
    if sheet.plane_strain:
        sum_of_squares, thin2 = squared1 + 1.0, squared1**-1
        t, q, v, swept = k1, k1 * k1, bent1, z * p1
    else:
        squared2 = (p * p) * s**-2
        k2 = z1 / (j * p)
        sum_of_squares, thin2 = squared1 + squared2, (squared1 * squared2) ** -1
        t, q, v = k1 + k2, k1 * k1 + k2 * k2, bent1 + squared2 * k2 * k2
        swept = z * p1 * p * s**-1
    membrane = (sum_of_squares + thin2 - 3) * (h / 2)
    bending = ((2 * t * t + q) * thin2 + v) * thin2 * (h**3 / 24)
    return (membrane + bending) * sheet.shear_modulus_mpa + swept * pressure_mpa


def _touched(sheet: RoundSheet, y: list[Jet], travel_mm: float, anchors: Anchors):
    """Return the contact's energy per undeformed area and the gap (point,) to the nearest part."""
    p, p1, _, z, z1, _ = y
    half = sheet.thickness_mm / 2
    raised = z + (half - travel_mm)
    thin = (p1 * p1 + z1 * z1) ** -0.5
    if not sheet.plane_strain:
        thin = thin * sheet.line.points_mm / p
    energy, gaps = p * 0.0, []
    for part in sheet.section:
        near = part(p.value, raised.value)
        gap = _composed(near, p, raised) - thin * half
        energy = energy + gap.through(*_law(sheet, gap.value))
        gaps.append(gap.value)
    slip = (p - anchors.x_mm) * anchors.tangent_x + (raised - anchors.z_mm) * anchors.tangent_z
    stiff = sheet.shear_modulus_mpa / (_SLIPPING_SHARE * sheet.thickness_mm)
    return energy + slip * slip * (0.5 * stiff * anchors.held), np.min(gaps, axis=0)


def _composed(near: Nearest, x: Jet, z: Jet) -> Jet:
    """Return a signed distance as a function of the variables of x and z."""
    nx, nz, k = near.normal_x, near.normal_z, near.curvature_per_mm
    along = nz * x.slope - nx * z.slope
    return Jet(
        near.distance_mm,
        nx * x.slope + nz * z.slope,
        nx * x.bend + nz * z.bend + k * along[:, None] * along,
    )


def _law(sheet: RoundSheet, gap: FloatArray):
    """Return the potential of a gap and its two derivatives, per undeformed area."""
    plane_modulus = sheet.young_modulus_mpa / 0.75
    stiff = np.where(gap < 0, plane_modulus / (_COMPLIANT_SHARE * sheet.thickness_mm), 0.0)
    G, reach = sheet.tack_n_mm, sheet.tack_range_mm
    u = np.clip(gap / reach, 0, 1)
    value = 0.5 * stiff * gap**2 - G * (1 - u) ** 2 * (1 + 2 * u)
    near = (gap >= 0) & (gap < reach)
    second = stiff + np.where(near, 6 * G * (1 - 2 * u) / reach**2, 0.0)
    return value, stiff * gap + 6 * G * u * (1 - u) / reach, second


def _gathered(sheet: RoundSheet, slopes: FloatArray) -> FloatArray:
    """Return the gradient by the coefficients (2 n,) from that by the variables."""
    parts = np.einsum("qda,cdq->qac", sheet.line.local, slopes.reshape(2, 3, -1))
    return np.bincount(_numbers(sheet).ravel(), parts.ravel(), 2 * sheet.line.size)


def _numbers(sheet: RoundSheet) -> FloatArray:
    """Return (point, 6) coefficients that move each Gauss point, function by function."""
    first = np.repeat(np.arange(sheet.line.size - 2), 2)[:, None]
    return 2 * first + np.arange(6)
