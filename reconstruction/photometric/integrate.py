"""Heights from slopes: the correct Poisson solver, and the vendor's with their scale error.

Height is positive towards the camera (an indentation is positive), row 0 at the top; slopes are
(2, row, col) mm/mm, along rows (down) and along columns (right). Zero is where each scheme puts it.
"""

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.fft import dctn, idctn

from reconstruction.arrays import FloatArray
from reconstruction.errors import InputError, require_number
from reconstruction.photometric.poisson import (
    BOUNDARIES,
    Boundary,
    edge_steps,
    solve_poisson,
    solve_weighted,
    sum_of_steps,
)

Form = Literal["2024", "2025"]
FORMS = ("2024", "2025")
Integration = Literal["corrected", "sdk_2024", "sdk_2025"]
INTEGRATIONS = ("corrected", "sdk_2024", "sdk_2025")
SMALLEST_IMAGE_PX = 4


def integrate(
    slopes: ArrayLike,
    pitch_mm: float,
    integration: Integration = "corrected",
    boundary: Boundary = "neumann",
    weights: ArrayLike | None = None,
) -> FloatArray:
    """Integrate by the named scheme; boundary and weights act on `corrected` only.

    Raises
    ------
    InputError : unknown scheme, or as `corrected` and `sdk_faithful`
    """
    if integration not in INTEGRATIONS:
        raise InputError(f"integration is {integration!r}; give one of {', '.join(INTEGRATIONS)}")
    if integration == "corrected":
        return corrected(slopes, pitch_mm, boundary, weights)
    return sdk_faithful(slopes, pitch_mm, "2024" if integration == "sdk_2024" else "2025")


def corrected(
    slopes: ArrayLike,
    pitch_mm: float,
    boundary: Boundary = "neumann",
    weights: ArrayLike | None = None,
) -> FloatArray:
    """Return the heights whose steps fit the slopes best in the (weighted) least-squares sense.

    Parameters
    ----------
    slopes : (2, row, col) float, mm/mm
    pitch_mm : distance of neighbouring pixels on the surface
    boundary : `neumann` leaves the border free and makes the mean 0; `dirichlet` holds the border
        pixels at 0, which is right only where the gel is untouched there
    weights : (row, col) float >= 0, proportional to 1 / variance of the slopes; 0: ignore the
        pixel, its height is returned as 0. None: all alike

    Returns
    -------
    (row, col) float, mm

    Raises
    ------
    InputError : wrong shape, values not finite, weight below 0, unknown boundary, pitch not above 0
    FitError : weights span too many orders of magnitude
    """
    field = _checked(slopes, pitch_mm)
    if boundary not in BOUNDARIES:
        raise InputError(f"boundary is {boundary!r}; give one of {', '.join(BOUNDARIES)}")
    steps = edge_steps(field, pitch_mm)
    if weights is None:
        return solve_poisson(sum_of_steps(*steps), boundary)
    return solve_weighted(*steps, _checked_weights(weights, field.shape[1:]), boundary)


def sdk_faithful(slopes: ArrayLike, pitch_mm: float, form: Form = "2025") -> FloatArray:
    """Return what the vendor's Poisson step makes of the slopes, its wrong height scale included.

    Parameters
    ----------
    slopes : (2, row, col) float, mm/mm
    pitch_mm : distance of neighbouring pixels on the surface
    form : `2024` (also that of the derived research kit) or `2025`

    Returns
    -------
    (row, col) float, mm

    Raises
    ------
    InputError : wrong shape, values not finite, unknown form, pitch not above 0

    Notes
    -----
    Written from the behaviour of the published programs, not from their code. The scheme is that
    of `corrected` with a free border but for two deviations:

    1. 2024 divides the central difference of the slopes by one pixel instead of two, which doubles
       all heights; 2025 takes a one-sided difference, which halves them again.
    2. The eigenvalues are those of modes 1..N where modes 0..N-1 belong, and the mean's is not left
       out: mode k comes out smaller by about (k / (k + 1))^2, so the wider a shape, the flatter.
    """
    if form not in FORMS:
        raise InputError(f"form is {form!r}; give one of {', '.join(FORMS)}")
    along_row, along_col = _checked(slopes, pitch_mm)
    divergence = _change(along_row, form) + _change(along_col.T, form).T
    divergence -= _flow_through_border(along_row, along_col)
    modes = [4.0 * np.sin(0.5 * np.pi * np.arange(1, n + 1) / n) ** 2 for n in divergence.shape]
    spectrum = dctn(-divergence, type=2, norm="ortho") / (modes[0][:, np.newaxis] + modes[1])
    height: FloatArray = pitch_mm * idctn(spectrum, type=2, norm="ortho")
    return height


def _change(along_axis: FloatArray, form: Form) -> FloatArray:
    """Difference along axis 0 with the border repeated."""
    after = np.concatenate([along_axis[1:], along_axis[-1:]])
    before = np.concatenate([along_axis[:1], along_axis[:-1]])
    change: FloatArray = after - (before if form == "2024" else along_axis)
    return change


def _flow_through_border(along_row: FloatArray, along_col: FloatArray) -> FloatArray:
    """Outward slope at the border, which an inhomogeneous Neumann condition takes off."""
    flow = np.zeros_like(along_row)
    flow[0] -= along_row[0]
    flow[-1] += along_row[-1]
    flow[:, 0] -= along_col[:, 0]
    flow[:, -1] += along_col[:, -1]
    return flow


def _checked(slopes: ArrayLike, pitch_mm: float) -> FloatArray:
    require_number("pitch_mm", pitch_mm, 0.0, open_low=True)
    field = np.asarray(slopes, dtype=np.float64)
    if field.ndim != 3 or field.shape[0] != 2 or min(field.shape[1:]) < SMALLEST_IMAGE_PX:
        raise InputError(
            f"slopes have shape {field.shape}; give (2, row, col) of at least "
            f"{SMALLEST_IMAGE_PX} rows and columns"
        )
    if not bool(np.all(np.isfinite(field))):
        raise InputError("slopes hold NaN or infinity; give finite numbers and weight 0 instead")
    return field


def _checked_weights(weights: ArrayLike, shape: tuple[int, ...]) -> FloatArray:
    values = np.asarray(weights, dtype=np.float64)
    if values.shape != shape:
        raise InputError(f"weights have shape {values.shape}; the slopes need {shape}")
    if not bool(np.all(np.isfinite(values) & (values >= 0.0))):
        raise InputError("weights hold a negative or infinite number; give finite numbers from 0")
    return values
