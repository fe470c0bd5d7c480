"""Rigid motions of specimens: world = rotation @ body + shift, mm."""

from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from reconstruction.arrays import FloatArray
from twin.config.models import Specimen

AnySpecimen = TypeVar("AnySpecimen", bound=Specimen)


@dataclass(frozen=True, eq=False)
class Placement:
    """A rotation and a shift."""

    #: (3, 3) rotation
    rotation: FloatArray
    #: (xyz) shift, mm
    shift_mm: FloatArray

    def apply(self, points_mm: FloatArray) -> FloatArray:
        """Move points (..., xyz)."""
        moved: FloatArray = points_mm @ self.rotation.T + self.shift_mm
        return moved

    def then(self, later: "Placement") -> "Placement":
        """Return this motion followed by another."""
        return Placement(later.rotation @ self.rotation, later.apply(self.shift_mm))

    @property
    def matrix(self) -> FloatArray:
        """(4, 4) homogeneous matrix."""
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = self.rotation, self.shift_mm
        return matrix


UNMOVED = Placement(np.eye(3), np.zeros(3))


def unposed(specimen: AnySpecimen) -> AnySpecimen:
    """Return what a specimen's shape alone depends on: a key under which to keep the shape."""
    return type(specimen)(**specimen.model_dump(exclude=set(Specimen.model_fields)))


def raised(height_mm: float) -> Placement:
    """Return a shift along z."""
    return Placement(np.eye(3), np.array([0.0, 0.0, height_mm]))


def pose_of(specimen: Specimen) -> Placement:
    """Return a specimen's own pose: tilt about its y axis, yaw about z, then shift in the plane."""
    tilt, yaw = np.deg2rad(specimen.tilt_deg), np.deg2rad(specimen.yaw_deg)
    c, s = np.cos(tilt), np.sin(tilt)
    tilted = np.array([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]])
    c, s = np.cos(yaw), np.sin(yaw)
    turned = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return Placement(turned @ tilted, np.array([specimen.x_mm, specimen.y_mm, 0.0]))
