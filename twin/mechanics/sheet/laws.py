"""Compiled energies of the thin sheet, and their data: membrane, bending, contact and cohesion.

Energies are per undeformed area, kPa mm = J/m^2; lengths are in mm. The sheet is a Kirchhoff-Love
shell of an incompressible neo-Hookean solid (Kiendl et al. 2015); its energy has a closed form.
"""

# ruff: noqa: PLR0917 - compiled functions cannot take keyword-only arguments

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from reconstruction.arrays import FloatArray
from reconstruction.compiling import NESTED, compile_and_keep, digest_of_sources

# Sums may be reordered for vector units: the tolerances of comparisons allow for it.
_OPTIONS: dict[str, Any] = {
    "nogil": True,
    # The callers count references to arrays: counted in every call, they take longer than the
    # sums.
    "_nrt": False,
    "error_model": "numpy",
    "fastmath": {"contract", "reassoc", "arcp", "nsz"},
}
Function = TypeVar("Function", bound=Callable[..., Any])


_SOURCES = ("laws.py", "point.py", "tangent.py", "kernel.py", "surface.py", "pressure.py")


_SOURCE_DIGEST = digest_of_sources(Path(__file__).parent, _SOURCES)


def kernel(function: Function) -> Function:
    """Compile `function` on its first call and store the compiled code on disk."""
    return compile_and_keep(function, _OPTIONS, _SOURCE_DIGEST)


def inlined(function: Function) -> Function:
    """Inline `function` into its compiled callers: for code that runs once per Gauss point."""
    return compile_and_keep(function, _OPTIONS | NESTED | {"forceinline": True}, _SOURCE_DIGEST)


class Rest(NamedTuple):
    """Spline functions and areas of the undeformed sheet at its Gauss points."""

    #: (col, 2, derivative, 3) functions of a cell along the grid's x, at its Gauss points
    along_x: FloatArray
    #: (row, 2, derivative, 3) and along y
    along_y: FloatArray
    #: (row, col, 4, 5, 5) derivatives (X, Y, XX, YY, XY) along the sheet from those along the grid;
    #: empty where the two are equal
    turned: FloatArray
    #: (row, col, 4) area of each Gauss point, mm^2
    area_mm2: FloatArray
    #: (row, col, 4) local minus mean thickness, mm; empty: uniform
    deviation_mm: FloatArray


class Touch(NamedTuple):
    """Signed distances of the bodies near the sheet, at the Gauss points."""

    #: (body, row, col, 4)
    distance_mm: FloatArray
    #: (body, row, col, 4, 3)
    gradient: FloatArray
    #: (body, row, col, 4, 3, 3) 1/mm
    hessian: FloatArray


class Grip(NamedTuple):
    """Anchors of a sheet with friction: positions of its middle surface at first contact.

    They move with the specimen, and are given in the solver's frame at travel 0. `normal` is the
    unit normal of the touched body there. With a friction coefficient the anchor of a point that
    slips follows the point after each load step.
    """

    #: (row, col, 4) 1 where it sticks
    held: FloatArray
    #: (row, col, 4, 3)
    anchor_mm: FloatArray
    #: (row, col, 4, 3)
    normal: FloatArray
    #: (row, col, 4) largest friction per undeformed area, kPa; infinite: the sheet cannot slip
    limit_kpa: FloatArray


class Laws(NamedTuple):
    """Constants of the sheet, the contact and the loads in the energy."""

    thickness_mm: float
    shear_modulus_kpa: float
    #: pressure per penetration, kPa/mm
    contact_stiffness: float
    #: the same along the surface, where the sheet sticks
    stick_stiffness: float
    #: adhesion energy, kPa mm = J/m^2
    tack: float
    #: range of the cohesive law
    tack_range_mm: float
    #: follows the sheet, towards its touched side
    pressure_kpa: float
    #: weight per area along -z, kPa
    weight_kpa: float


@inlined
def local_laws(laws: Laws, deviation_mm: float) -> Laws:
    """Return the constants at a point whose undeformed thickness deviates from the mean."""
    h = laws.thickness_mm + deviation_mm
    ratio = h / laws.thickness_mm
    return Laws(
        h,
        laws.shear_modulus_kpa,
        laws.contact_stiffness / ratio,
        laws.stick_stiffness / ratio,
        laws.tack,
        laws.tack_range_mm,
        laws.pressure_kpa,
        laws.weight_kpa * ratio,
    )


class Material(NamedTuple):
    """Work arrays of `material`: derivatives of (tr a, det a, T, det b, tr b) by a and b."""

    #: (6, 5) by (a11, a22, a12, b11, b22, b12); those that are constant are set by the caller
    slopes: FloatArray
    #: (6, 5) the same times the energy's Hessian by the invariants
    bent: FloatArray


@inlined
def material(
    forms: tuple[float, float, float, float, float, float],
    h: float,
    scratch: Material,
    g: FloatArray,
    H: FloatArray,
    want: bool,
) -> float:
    """Return the sheet's energy per undeformed area over shear modulus, mm; write its derivatives.

    W = h/2 (A + 1/d - 3) + h^3/24 (3 T^2/d^4 - 2 k/d^3 + (B T - k A)/d^2) with A = tr a, d = det a,
    T = a22 b11 + a11 b22 - 2 a12 b12, k = det b, B = tr b: an incompressible neo-Hookean sheet.

    Parameters
    ----------
    forms : a11, a22, a12, b11, b22, b12: first and second fundamental form, see `point`
    h : undeformed thickness, mm
    g : (6,) output: derivatives of W by `forms`
    H : (6, 6) output if `want` is True: second derivatives of W
    """
    a11, a22, a12, b11, b22, b12 = forms
    A, d, B = a11 + a22, a11 * a22 - a12 * a12, b11 + b22
    T = a22 * b11 + a11 * b22 - 2 * a12 * b12
    k = b11 * b22 - b12 * b12
    i = 1 / d
    i2, c = i * i, h * h * h / 24
    i3, i4 = i2 * i, i2 * i2
    bent = B * T - k * A
    by_A = h / 2 - c * k * i2
    by_d = -h / 2 * i2 + c * (-12 * T * T * i4 * i + 6 * k * i4 - 2 * bent * i3)
    by_T = c * (6 * T * i4 + B * i2)
    by_k = -c * (2 * i3 + A * i2)
    by_B = c * T * i2
    J, M = scratch.slopes, scratch.bent
    J[0, 1], J[1, 1], J[2, 1] = a22, a11, -2 * a12
    J[0, 2], J[1, 2], J[2, 2] = b22, b11, -2 * b12
    J[3, 2], J[4, 2], J[5, 2] = a22, a11, -2 * a12
    J[3, 3], J[4, 3], J[5, 3] = b22, b11, -2 * b12
    for n in range(6):
        g[n] = by_A * J[n, 0] + by_d * J[n, 1] + by_T * J[n, 2] + by_k * J[n, 3] + by_B * J[n, 4]
    if want:
        Ad, Ak = 2 * c * k * i3, -c * i2
        dd = h * i3 + c * (60 * T * T * i3 * i3 - 24 * k * i4 * i + 6 * bent * i4)
        dT, dk, dB = -c * (24 * T * i4 * i + 2 * B * i3), c * (6 * i4 + 2 * A * i3), -2 * c * T * i3
        TT, TB = 6 * c * i4, c * i2
        for n in range(6):
            jA, jd, jT, jk, jB = J[n, 0], J[n, 1], J[n, 2], J[n, 3], J[n, 4]
            M[n, 0] = Ad * jd + Ak * jk
            M[n, 1] = Ad * jA + dd * jd + dT * jT + dk * jk + dB * jB
            M[n, 2] = dT * jd + TT * jT + TB * jB
            M[n, 3], M[n, 4] = Ak * jA + dk * jd, dB * jd + TB * jT
        for n in range(6):
            for m in range(6):
                x = 0.0
                for e in range(5):
                    x += M[n, e] * J[m, e]
                H[n, m] = x
        _add_second_slopes((by_d, by_T, by_k), H)
    return h / 2 * (A + i - 3) + c * (3 * T * T * i4 - 2 * k * i3 + bent * i2)


@inlined
def _add_second_slopes(slopes: tuple[float, float, float], H: FloatArray) -> None:
    """Add the terms of the second derivatives of d, T and k by the forms to the Hessian."""
    by_d, by_T, by_k = slopes
    for n, m, x in (
        (0, 1, by_d), (0, 4, by_T), (1, 3, by_T), (3, 4, by_k),
    ):  # fmt: skip
        H[n, m] += x
        H[m, n] += x
    H[2, 2] -= 2 * by_d
    H[2, 5] -= 2 * by_T
    H[5, 2] -= 2 * by_T
    H[5, 5] -= 2 * by_k


@inlined
def contact_law(gap_mm: float, laws: Laws) -> tuple[float, float, float]:
    """Return the contact energy per undeformed area, J/m^2, and its two derivatives by the gap.

    A gap below 0 is repelled. With tack the sheet is attracted at gaps from 0 to the tack's range.
    """
    if gap_mm < 0:
        eps = laws.contact_stiffness
        return 0.5 * eps * gap_mm * gap_mm - laws.tack, eps * gap_mm, eps
    if laws.tack > 0 and gap_mm < laws.tack_range_mm:
        x, G, D = gap_mm / laws.tack_range_mm, laws.tack, laws.tack_range_mm
        return (
            -G * (1 - x) ** 2 * (1 + 2 * x),
            6 * G * x * (1 - x) / D,
            6 * G * (1 - 2 * x) / D**2,
        )
    return 0.0, 0.0, 0.0
