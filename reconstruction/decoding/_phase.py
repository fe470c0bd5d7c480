"""Phase and phase sigma of one image row.

Symbols: z phasor, phi its phase in [0, 2 pi), B modulation.
"""

# ruff: noqa: PLR0917 - compiled functions cannot take keyword-only arguments

from typing import Any

import numpy as np

from reconstruction._jit import compiled, inlined
from reconstruction.decoding._sum import Limits, noise_dn2

TURN = 2.0 * np.pi
# atan(t) = t P(t^2) on [0, 1], minimax fit of degree 8: 6e-9 rad, below single precision's 1e-7.
# The library's arctangent is a call per pixel; this polynomial runs on whole vectors.
ATAN = tuple(
    np.float32(coefficient)
    for coefficient in (
        0.999999886, -0.333325969, 0.199859053, -0.141612196, 0.104989132,
        -0.0723479412, 0.0397805317, -0.0144009572, 0.00245662921,
    )
)  # fmt: skip
HALF_PI, PI, TWO_PI = np.float32(0.5 * np.pi), np.float32(np.pi), np.float32(TURN)
TINY = np.float32(1e-30)
STEPS_PER_RAD, ROUNDING = np.float32(65536.0 / TURN), np.float32(0.5)


@compiled
def keep_usable(usable: Any, phase: Any) -> None:
    """Zero the phases of pixels without one; not by a product, as NaN times 0 is NaN."""
    for col in range(usable.size):
        phase[col] = phase[col] if usable[col] > 0.0 else np.float32(0.0)


@inlined
def _arctangent(t: Any) -> Any:
    s = t * t
    value = ATAN[8]
    value = value * s + ATAN[7]
    value = value * s + ATAN[6]
    value = value * s + ATAN[5]
    value = value * s + ATAN[4]
    value = value * s + ATAN[3]
    value = value * s + ATAN[2]
    value = value * s + ATAN[1]
    return t * (value * s + ATAN[0])


@compiled
def phase_row(real: Any, imag: Any, phase: Any) -> None:
    """Write arg z in [0, 2 pi) without a branch; 0 for z = 0."""
    for col in range(phase.size):
        x, y = abs(real[col]), abs(imag[col])
        long, short = max(x, y), min(x, y)
        phi = _arctangent(short / max(long, TINY))
        phi = HALF_PI - phi if y > x else phi
        phi = PI - phi if real[col] < 0.0 else phi
        phi = TWO_PI - phi if imag[col] < 0.0 else phi
        phase[col] = phi if phi < TWO_PI else np.float32(0.0)


@compiled
def write_turns(phase: Any, out: Any) -> None:
    """Write phases as steps of 1 / 65536 turn; what rounds up to a whole turn becomes 0."""
    for col in range(phase.size):
        out[col] = np.uint16(np.int32(phase[col] * STEPS_PER_RAD + ROUNDING))


@compiled
def phase_sigma(
    steps: int, limits: Limits, scale: Any, usable: Any, mean: Any, modulation: Any, sigma: Any
) -> None:  # fmt: skip
    """Write the predicted sigma of the phase, rad; 0 where there is none.

    sigma_phi^2 = (2 / N) sigma_I^2 / B^2 (Surrel 1997); sigma_I at the mean holds for N >= 4,
    where the modulated part of the shot noise averages out.
    """
    factor = np.float32(np.sqrt(2.0 / steps))
    for col in range(sigma.size):
        noise = np.sqrt(noise_dn2(mean[col], scale[col], limits))
        value = factor * noise / modulation[col]
        sigma[col] = value if usable[col] > 0.0 else np.float32(0.0)


@compiled
def grow_sigma(excess: Any, sigma: Any) -> None:
    """Add what fits over fewer frames cost: excess is a share of the variance."""
    for col in range(sigma.size):
        sigma[col] *= np.sqrt(np.float32(1.0) + excess[col])
