"""Contact of a rigid ball with the deformed face, axisymmetric: frictionless to full stick.

Axes r, z with z along the press; the ball is at z < 0 and its foremost point is at z = d.
Augmented Lagrangian penalty at integration points in the current configuration (stress per
undeformed area). Symbols: v from the ball's centre to the point, n = v / |v|, penetration
R - |v|, lambda the carried pressure, eps the penalty, theta the polar angle of v, so that the
ball drags along the tangent tau = dn / dtheta.
"""

from dataclasses import dataclass, replace

import numpy as np

from reconstruction.arrays import BoolArray, FloatArray
from twin.mechanics.reference.grid import Surface
from twin.mechanics.reference.newton import Pushed, StepFailedError, push

# The tangential penalty may be softer: sticking needs no sharp constraint.
_TANGENTIAL_STIFFNESS = 0.3
# Over the radius (2 um at 4 mm); a spurious pocket is ten times as deep.
_HARMLESS_GAP = 5e-4


@dataclass(frozen=True)
class BallContact:
    """A rigid ball against the touched face, with the memory of friction."""

    surface: Surface
    #: (node, axis) undeformed
    nodes_mm: FloatArray
    radius_mm: float
    #: pressure over modulus per mm of penetration
    penalty: float
    #: Coulomb coefficient; inf sticks
    friction: float
    #: Eulerian contact on the undeformed face, as in the linear slab
    linear: bool
    #: (point,) carried pressure
    carried: FloatArray
    #: (point,) polar angle and tangential stress at the end of the last load step
    angle_before: FloatArray
    drag_before: FloatArray

    def evaluate(self, moved_mm: FloatArray, depth_mm: float, active: BoolArray | None) -> Pushed:
        """Return the ball's action.

        Parameters
        ----------
        moved_mm : (node, axis) float, mm
            Displacement.
        depth_mm : float, mm
            Travel after first touch.
        active : (point,) bool or None
            Frozen contact set, or None to find it.
        """
        if self.linear:
            return self._push_along(moved_mm, depth_mm, active)
        return self._push_and_drag(moved_mm, depth_mm, active)[0]

    def _push_and_drag(
        self, moved_mm: FloatArray, depth_mm: float, active: BoolArray | None
    ) -> tuple[Pushed, FloatArray]:
        """Return the ball's action, and the tangential stress (point,) of it."""
        v = self.surface.trace @ (self.nodes_mm + moved_mm)
        v[:, 1] += self.radius_mm - depth_mm
        distance = np.linalg.norm(v, axis=1)
        n = v / distance[:, None]
        raw = self.carried + self.penalty * (self.radius_mm - distance)
        # Far outside, the face may be below the ball's equator plane: no contact there.
        touching = ((raw > 0) & (n[:, 1] > 0)) if active is None else active
        pressure = np.where(touching, raw, 0.0)
        tau = np.stack((n[:, 1], -n[:, 0]), axis=1)
        normal = np.einsum("qi,qj->qij", n, n)
        stiffness = self.penalty * normal - (pressure / distance)[:, None, None] * (
            np.eye(2) - normal
        )
        drag, dragging = self._drag(n, tau, distance, pressure)
        traction = pressure[:, None] * n - drag[:, None] * tau
        stiffness = np.where(touching[:, None, None], stiffness + dragging, 0.0)
        return push(self.surface, traction, stiffness, pressure), drag

    def settle(self, moved_mm: FloatArray, depth_mm: float) -> "BallContact":
        """Return the contact with angle and drag of a finished load step as its memory.

        Raises StepFailedError if the contact is spurious.
        """
        if self.is_spurious(moved_mm, depth_mm):
            raise StepFailedError("the contact has a hole where there is none")
        if self.linear:
            return self
        drag = self._push_and_drag(moved_mm, depth_mm, None)[1]
        return replace(self, angle_before=self._angle(moved_mm, depth_mm), drag_before=drag)

    def carry(self, pressure: FloatArray) -> "BallContact":
        """Return the contact with a new carried pressure."""
        return replace(self, carried=pressure)

    def is_spurious(self, moved_mm: FloatArray, depth_mm: float) -> bool:
        """Return True if the face has a gap to the ball within the contact's outer radius."""
        touching = self.evaluate(moved_mm, depth_mm, None).active
        within = np.arange(touching.size) < np.flatnonzero(touching).max(initial=0)
        gap = self._behind(moved_mm) - depth_mm if self.linear else self._gap(moved_mm, depth_mm)
        # The carried pressure ripples slightly between the points: such gaps are ignored.
        return bool((gap[within] > _HARMLESS_GAP * self.radius_mm).any())

    def _drag(
        self, n: FloatArray, tau: FloatArray, distance: FloatArray, pressure: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return the tangential stress (point,) and its stiffness (point, 2, 2)."""
        if not self.friction:
            return np.zeros_like(pressure), np.zeros((pressure.size, 2, 2))
        stiff = _TANGENTIAL_STIFFNESS * self.penalty
        slip = self.radius_mm * (np.arctan2(n[:, 0], n[:, 1]) - self.angle_before)
        trial = self.drag_before + stiff * slip
        cap = (
            self.friction * pressure if np.isfinite(self.friction) else np.full_like(trial, np.inf)
        )
        sliding = np.abs(trial) > cap
        drag = np.where(sliding, np.sign(trial) * np.minimum(cap, np.abs(trial)), trial)
        drag = np.where(pressure > 0, drag, 0.0)
        # d(drag)/dx: sticking follows the slip, sliding follows the pressure.
        follow = (stiff * self.radius_mm / distance)[:, None] * tau
        if np.isfinite(self.friction):
            yielding = -np.sign(trial)[:, None] * self.friction * self.penalty * n
            follow = np.where(sliding[:, None], yielding, follow)
        stiffness = np.einsum("qi,qj->qij", tau, follow)
        # dtau/dtheta = -n
        stiffness -= (drag / distance)[:, None, None] * np.einsum("qi,qj->qij", n, tau)
        return drag, stiffness

    def _angle(self, moved_mm: FloatArray, depth_mm: float) -> FloatArray:
        v = self.surface.trace @ (self.nodes_mm + moved_mm)
        angle: FloatArray = np.arctan2(v[:, 0], v[:, 1] + self.radius_mm - depth_mm)
        return angle

    def _gap(self, moved_mm: FloatArray, depth_mm: float) -> FloatArray:
        v = self.surface.trace @ (self.nodes_mm + moved_mm)
        gap: FloatArray = np.hypot(v[:, 0], v[:, 1] + self.radius_mm - depth_mm) - self.radius_mm
        return gap

    def _behind(self, moved_mm: FloatArray) -> FloatArray:
        """Return the gap along the press at depth 0, at the undeformed radius."""
        r = self.surface.trace @ self.nodes_mm[:, 0]
        fall = self.radius_mm - np.sqrt(np.maximum(self.radius_mm**2 - r**2, 0.0))
        behind: FloatArray = self.surface.trace @ moved_mm[:, 1] + fall
        return behind

    def _push_along(
        self, moved_mm: FloatArray, depth_mm: float, active: BoolArray | None
    ) -> Pushed:
        raw = self.carried - self.penalty * (self._behind(moved_mm) - depth_mm)
        outside = self.surface.trace @ self.nodes_mm[:, 0] >= self.radius_mm
        touching = ((raw > 0) & ~outside) if active is None else active
        pressure = np.where(touching, raw, 0.0)
        along = np.array([0.0, 1.0])
        stiffness = np.where(touching, self.penalty, 0.0)[:, None, None] * np.outer(along, along)
        return push(self.surface, pressure[:, None] * along, stiffness, pressure)
