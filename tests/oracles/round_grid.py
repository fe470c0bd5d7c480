"""Q2/Q1 elements in axisymmetry: a brick grid's, with the hoop strain u_r / r and 2 pi r.

Axes r, z with z along the press, z = 0 on the touched face; tensors have the axes r, z, hoop.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import skfem

from reconstruction.arrays import FloatArray
from twin.mechanics.reference.grid import Components, ElementGrid, Surface

_IN_PLANE = ((0, 0), (0, 1), (1, 0), (1, 1))


@dataclass(frozen=True)
class RoundGrid(ElementGrid):
    """A rectangle grid over r and z, given by its element edges."""

    components: ClassVar[Components] = (*_IN_PLANE, (2, 2))
    mesh_of: ClassVar[Any] = skfem.MeshQuad
    displacement_element: ClassVar[Any] = skfem.ElementQuad2
    pressure_element: ClassVar[Any] = skfem.ElementQuad1

    @cached_property
    def weights(self) -> FloatArray:
        """(element, point) integration weights over the full circle, mm^3."""
        weights: FloatArray = self._displacement.dx
        return weights * 2 * np.pi * self._points_r

    @cached_property
    def gradient(self) -> FloatArray:
        """(element, point, component, unknown): displacement to deformation gradient less I."""
        slopes = self._slopes(_IN_PLANE)
        hoop = np.zeros_like(slopes[:, :, :1])
        values = [np.asarray(shape[0]) for shape in self._displacement.basis]
        hoop[:, :, 0, ::2] = np.stack(values, axis=-1) / self._points_r[..., None]
        return np.concatenate((slopes, hoop), axis=2)

    def surface(self, gauss: int) -> Surface:
        """Return the touched face; each point represents a ring."""
        plane = super().surface(gauss)
        around_mm = 2 * np.pi * (plane.trace @ self.nodes_mm[:, 0])
        return replace(plane, weight_mm2=plane.weight_mm2 * around_mm)

    @cached_property
    def _points_r(self) -> FloatArray:
        return np.asarray(np.asarray(self._displacement.global_coordinates())[0])
