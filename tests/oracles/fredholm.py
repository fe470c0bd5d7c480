"""A rigid ball on an elastic layer, semi-analytic: the reference for the spectral layer.

A Fredholm equation of the second kind (Lebedev, N. N., Ufliand, Ia. S. (1958): Axisymmetric
contact problem for an elastic layer. PMM 22, 320-326; half-space limit: Sneddon, I. N. (1965),
Int. J. Eng. Sci. 3, 47-57), frictionless, at unit Young's modulus:

    phi(s) + (2/pi) int_0^a [K(s+t) + K(s-t)] / 2 phi(t) dt = (E*/pi) (d - g(s)),   phi(a) = 0
    K(x) = (1/h) int_0^inf (Phi(q) - 1) cos(q x / h) dq

Symbols: a contact radius, d depth, h thickness, E* = E / (1 - nu^2), g(s) = s^2 / R (paraboloid)
or s artanh(s / R) (sphere), q wavenumber times thickness, Phi the layer's compliance over that of
the half-space. Phi is from closed forms, so that the oracle shares no code with `transfer`.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Literal

import numpy as np
from scipy.optimize import brentq
from scipy.special import j0

from reconstruction.arrays import FloatArray
from twin.mechanics.errors import PressError, SolverError

LayerBase = Literal["bonded", "slip", "half_space"]
Profile = Literal["sphere", "paraboloid"]

_NODES = 64
# |Phi - 1| ~ q^2 exp(-2 q): below 1e-30 from here on.
_LARGEST_Q, _Q_NODES = 40.0, 400
# phi is even and analytic in s; the pressure needs d phi / d(s^2), from a fit in s^2.
_FIT_DEGREE = 24


def layer_compliance(q: FloatArray, poisson_ratio: float, base: LayerBase) -> FloatArray:
    """Return Phi(q), the layer's normal compliance over that of the half-space; closed forms.

    Parameters
    ----------
    q : (...) float
        Wavenumber times thickness, >= 0.
    poisson_ratio : float
        0 < nu <= 0.5.
    base : {"bonded", "slip", "half_space"}
        Far face: no displacement; no normal displacement and no friction; infinitely far away.
    """
    # Numerator and denominator times about 2 exp(-2 q), to avoid overflow.
    kappa, fade = 3 - 4 * poisson_ratio, np.exp(-2 * q)
    if base == "half_space":
        return np.ones_like(q)
    if base == "slip":
        lower = 1 - fade**2 + 4 * q * fade
        slip: FloatArray = np.divide((1 - fade) ** 2, lower, out=np.zeros_like(q), where=q > 0)
        return slip
    upper = kappa * (1 - fade**2) - 4 * q * fade
    bonded: FloatArray = upper / (kappa * (1 + fade**2) + (4 * q**2 + 1 + kappa**2) * fade)
    return bonded


@dataclass(frozen=True)
class BallOnLayer:
    """A solved press; lengths in mm, pressure and force over Young's modulus."""

    radius_mm: float
    thickness_mm: float
    poisson_ratio: float
    base: LayerBase
    depth_mm: float
    contact_radius_mm: float
    #: (n,) Gauss points on 0..a, their weights, and the solution phi / E there
    s_mm: FloatArray
    weight_mm: FloatArray
    phi: FloatArray

    @property
    def force_over_modulus_mm2(self) -> float:
        """Force over Young's modulus: 2 pi int phi ds."""
        return float(2 * np.pi * self.weight_mm @ self.phi)

    def pressure_over_modulus(self, r_mm: FloatArray) -> FloatArray:
        """Return the pressure at radii (n,): -int_r^a phi'(s) / sqrt(s^2 - r^2) ds."""
        # With s^2 = r^2 + t^2 the integrand is d phi / d(s^2) and has no singularity.
        length = np.sqrt(np.maximum(self.contact_radius_mm**2 - r_mm**2, 0.0))
        unit, weight = _gauss(_NODES, 1.0)
        t = length[:, None] * unit
        slope = self._phi_series.deriv()(r_mm[:, None] ** 2 + t**2)
        pressure: FloatArray = -2 * length * (slope @ weight)
        return pressure

    def deflection_mm(self, r_mm: FloatArray) -> FloatArray:
        """Return the touched face's deflection along the press at radii (n,)."""
        limit = np.arcsin(np.minimum(1.0, self.contact_radius_mm / np.maximum(r_mm, 1e-300)))
        unit, weight = _gauss(_NODES, 1.0)
        s = r_mm[:, None] * np.sin(limit[:, None] * unit)
        half_space = limit * (self._phi_series(s**2) @ weight)
        q, q_weight = _gauss(_Q_NODES, _LARGEST_Q)
        excess = layer_compliance(q, self.poisson_ratio, self.base) - 1
        transformed = np.cos(np.outer(q, self.s_mm) / self.thickness_mm) @ (
            self.weight_mm * self.phi
        )
        layer = j0(np.outer(r_mm, q) / self.thickness_mm) @ (q_weight * excess * transformed)
        deflection: FloatArray = (
            2 * (1 - self.poisson_ratio**2) * (half_space + layer / self.thickness_mm)
        )
        return deflection

    @cached_property
    def _phi_series(self) -> np.polynomial.Chebyshev:
        return np.polynomial.Chebyshev.fit(
            self.s_mm**2, self.phi, _FIT_DEGREE, domain=[0.0, self.contact_radius_mm**2]
        )


def press_ball(
    radius_mm: float,
    depth_mm: float,
    thickness_mm: float,
    poisson_ratio: float,
    *,
    base: LayerBase = "bonded",
    profile: Profile = "sphere",
) -> BallOnLayer:
    """Press a rigid ball into an unbounded elastic layer, to a depth.

    Parameters
    ----------
    radius_mm, depth_mm, thickness_mm : float, mm
        Ball, travel after first touch, layer.
    poisson_ratio : float
        0 < nu <= 0.5.
    base : {"bonded", "slip", "half_space"}
        Support of the far face; the half-space ignores its thickness.
    profile : {"sphere", "paraboloid"}
        The true ball, or the parabola of Hertz's theory.

    Returns
    -------
    BallOnLayer
        The solution, about 1e-9 exact; takes some 50 ms.

    Raises
    ------
    PressError
        A length that is not positive.
    SolverError
        No contact radius below the ball's own fits the depth.
    """
    if min(radius_mm, depth_mm, thickness_mm) <= 0:
        raise PressError(
            "fredholm: radius, depth and thickness must be positive, found "
            f"{radius_mm:g}, {depth_mm:g} and {thickness_mm:g} mm"
        )
    rise = _rise(radius_mm, profile)

    def miss(contact_radius_mm: float) -> float:
        return _solve(contact_radius_mm, thickness_mm, poisson_ratio, base, rise)[3] - depth_mm

    scale = np.sqrt(radius_mm * depth_mm)
    low, high = 0.2 * scale, 3.0 * scale
    if profile == "sphere":
        low, high = min(low, 0.5 * radius_mm), min(high, 0.999 * radius_mm)
    if miss(low) > 0 or miss(high) < 0:
        raise SolverError(
            f"fredholm: no contact radius between {low:.3g} and {high:.3g} mm gives a depth of "
            f"{depth_mm:g} mm; press less"
        )
    contact_radius = brentq(miss, low, high, xtol=1e-12 * scale, rtol=1e-12)
    s, weight, phi, depth = _solve(contact_radius, thickness_mm, poisson_ratio, base, rise)
    return BallOnLayer(
        radius_mm, thickness_mm, poisson_ratio, base, depth, contact_radius, s, weight, phi
    )


def _rise(radius_mm: float, profile: Profile) -> Callable[[FloatArray], FloatArray]:
    """Return g(s), the Abel transform of the punch's profile."""
    if profile == "paraboloid":
        return lambda s: s**2 / radius_mm
    return lambda s: s * np.arctanh(s / radius_mm)


def _solve(
    contact_radius: float,
    thickness: float,
    nu: float,
    base: LayerBase,
    rise: Callable[[FloatArray], FloatArray],
) -> tuple[FloatArray, FloatArray, FloatArray, float]:
    """Return s, weights, phi and the depth at which phi(a) = 0."""
    s, weight = _gauss(_NODES, contact_radius)
    ends = np.append(s, contact_radius)
    q, q_weight = _gauss(_Q_NODES, _LARGEST_Q)
    excess = q_weight * (layer_compliance(q, nu, base) - 1) / thickness
    # [K(s+t) + K(s-t)] / 2 separates: cos(q s/h) cos(q t/h) under the integral.
    waves = np.cos(np.outer(ends, q) / thickness)
    kernel = (2 / np.pi) * (waves * excess) @ waves[:-1].T * weight
    # phi is linear in the depth: one solution for unit depth, one for the profile.
    right = np.stack((np.ones_like(ends), rise(ends)), axis=1) / (np.pi * (1 - nu**2))
    parts = np.linalg.solve(np.eye(s.size) + kernel[:-1], right[:-1])
    at_rim = right[-1] - kernel[-1] @ parts
    depth = float(at_rim[1] / at_rim[0])
    return s, weight, parts[:, 0] * depth - parts[:, 1], depth


@lru_cache(maxsize=8)
def _gauss(count: int, length: float) -> tuple[FloatArray, FloatArray]:
    """Return Gauss-Legendre points and weights on 0..length; 400 points take 50 ms to find."""
    if length != 1.0:
        points, weights = _gauss(count, 1.0)
        return points * length, weights * length
    points, weights = np.polynomial.legendre.leggauss(count)
    return (points + 1) / 2, weights / 2
