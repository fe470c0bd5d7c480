"""Contact of a rigid height field with the deformed face in space, frictionless.

Axes x, y, z with z along the press; the specimen's surface is z = d - S(x, y). Augmented
Lagrangian penalty on the overlap d - S - z at integration points in the current configuration.
Its gradient g = (S_x, S_y, 1) is the surface's normal over its share along the press.
"""

from dataclasses import dataclass, replace

import numpy as np

from reconstruction.arrays import FloatArray
from twin.mechanics.control import BoolArray
from twin.mechanics.reference.grid import Surface
from twin.mechanics.reference.height_field import HeightField
from twin.mechanics.reference.pushed import Pushed, push


@dataclass(frozen=True)
class HeightContact:
    """A rigid specimen against the touched face."""

    surface: Surface
    #: (node, xyz) undeformed
    nodes_mm: FloatArray
    field: HeightField
    #: pressure over modulus per mm of overlap
    penalty: float
    #: contact along the press on the undeformed face, as in the linear slab
    linear: bool
    #: (point,) carried pressure
    carried: FloatArray

    def evaluate(self, moved_mm: FloatArray, depth_mm: float, active: BoolArray | None) -> Pushed:
        """Return the specimen's action; arguments as for `BallContact`."""
        at = self.surface.trace @ (self.nodes_mm + moved_mm)
        x, y = (self.surface.trace @ self.nodes_mm if self.linear else at)[:, :2].T
        height = self.field.value(x, y)
        overlap = np.where(np.isfinite(height), depth_mm - height - at[:, 2], -np.inf)
        raw = self.carried + self.penalty * overlap
        touching = raw > 0 if active is None else active & np.isfinite(raw)
        pressure = np.where(touching, raw, 0.0)
        normal, bend = self._shape(x, y)
        stiffness = self.penalty * np.einsum("qi,qj->qij", normal, normal)
        stiffness[:, :2, :2] -= pressure[:, None, None] * bend
        return push(
            self.surface,
            pressure[:, None] * normal,
            np.where(touching[:, None, None], stiffness, 0.0),
            pressure,
            np.zeros_like(pressure),
        )

    def settle(self, moved_mm: FloatArray, depth_mm: float) -> "HeightContact":
        """Return the contact itself: without friction nothing is remembered."""
        return self

    def carry(self, pressure: FloatArray) -> "HeightContact":
        """Return the contact with another carried pressure."""
        return replace(self, carried=pressure)

    def is_spurious(self, moved_mm: FloatArray, depth_mm: float) -> bool:
        """Tell nothing: a specimen of any shape may touch with holes."""
        return False

    def _shape(self, x_mm: FloatArray, y_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return normals (point, xyz) along the gradient and curvatures (point, 2, 2)."""
        normal = np.zeros((x_mm.size, 3))
        normal[:, 2] = 1.0
        if self.linear:
            return normal, np.zeros((x_mm.size, 2, 2))
        normal[:, :2] = self.field.slope(x_mm, y_mm)
        return normal, self.field.curvature(x_mm, y_mm)
