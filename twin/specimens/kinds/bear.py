"""Specimen kind `bear`: an ornament that is a smooth union of ellipsoids.

For a point p relative to the middle of an ellipsoid with half axes r, d = (|p / r| - 1) min(r)
estimates the signed distance, negative inside. The level of the smooth union with the blending b is
-b log sum exp(-d / b); its zero set is the surface. A coarse mesh of the zero set gives the
topology. The vertices of the refined mesh are then moved onto the surface by Newton's steps along
the gradient.
"""

from functools import lru_cache
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
from pydantic import Field

from reconstruction.arrays import FloatArray
from twin.config.specimen_base import SPECIMENS, Specimen
from twin.specimens.meshes import MeshShape
from twin.specimens.solids import level_set

if TYPE_CHECKING:
    import trimesh

# The bear before scaling ("the drawing"), 16 mm long, on its back, face up, ears towards +y:
# middle and half axes of the parts, mm. Parts of pairs are mirrored in x.
_MIDDLE = [
    ((0.0, -2.1, 0.0), (3.5, 4.1, 2.7)),  # trunk
    ((0.0, -2.3, 1.5), (2.5, 2.9, 2.0)),  # belly
    ((0.0, 3.9, 0.4), (3.1, 2.9, 2.6)),  # head
    ((0.0, 3.1, 2.3), (1.45, 1.15, 1.3)),  # muzzle
    ((0.0, 3.5, 3.35), (0.65, 0.5, 0.5)),  # nose
]
_PAIRED = [
    ((2.45, 6.3, 0.5), (1.4, 1.4, 0.9)),  # ear
    ((1.35, 4.75, 2.4), (0.5, 0.5, 0.5)),  # eye
    ((3.35, 0.1, 1.3), (1.15, 1.9, 1.2)),  # arm
    ((2.5, -0.9, 2.4), (0.9, 0.9, 0.9)),  # paw
    ((2.7, -5.6, 1.1), (1.6, 1.7, 2.3)),  # leg
]
_PARTS = (*_MIDDLE, *_PAIRED, *[((-x, y, z), axes) for (x, y, z), axes in _PAIRED])
_CENTRES_MM = np.array([centre for centre, _ in _PARTS])
_HALF_AXES_MM = np.array([axes for _, axes in _PARTS])
_LEAST_MM = _HALF_AXES_MM.min(axis=-1)
# The box that contains the drawing, x, y, z low and high.
_BOX_MM = (-6.0, -9.0, -4.0, 6.0, 9.0, 5.0)
_COARSE_MM, _REFINED = 0.7, 5
_NEWTON_STEPS, _CLOSE_MM = 5, 1e-9


@SPECIMENS.register
class Bear(Specimen):
    """A bear ornament on its back: a smooth union of ellipsoids with assumed proportions."""

    kind: Literal["bear"] = "bear"
    length_mm: Annotated[float, Field(ge=5, le=60)] = Field(
        default=16.0, description="from ears to feet, along y, up to the blending"
    )
    blend_mm: Annotated[float, Field(ge=0.02, le=0.6)] = Field(
        default=0.15, description="softness of the creases between the parts, for a length of 16"
    )

    def shape(self) -> MeshShape:
        """Return the bear with its length along y, its bounding box centred on the origin."""
        body = drawn_bear(self.blend_mm).copy()
        body.apply_translation(-body.bounds.mean(axis=0))
        body.apply_scale(self.length_mm / body.extents[1])
        return MeshShape(body)


@lru_cache(maxsize=4)
def drawn_bear(blend_mm: float) -> "trimesh.Trimesh":
    """Return the mesh of the bear before scaling (16 mm long), in the frame of its parts."""
    body = level_set(
        lambda x, y, z: float(bear_level_mm(np.array((x, y, z)), blend_mm)),
        _BOX_MM,
        _COARSE_MM,
        _REFINED,
    )
    body.vertices = _on_surface(np.asarray(body.vertices), blend_mm)
    return body


def bear_level_mm(points_mm: FloatArray, blend_mm: float) -> FloatArray:
    """Return the level (...), mm, of the smooth union at points (..., xyz), before scaling.

    The level is 0 on the surface and negative inside.
    """
    scaled = (points_mm[..., None, :] - _CENTRES_MM) / _HALF_AXES_MM
    distance = (np.sqrt((scaled**2).sum(axis=-1)) - 1) * _LEAST_MM
    nearest = distance.min(axis=-1)
    total = np.exp((nearest[..., None] - distance) / blend_mm).sum(axis=-1)
    return np.asarray(nearest - blend_mm * np.log(total))


def bear_gradient(points_mm: FloatArray, blend_mm: float) -> FloatArray:
    """Return the gradient (n, xyz) of `bear_level_mm` at points (n, xyz)."""
    scaled = (points_mm[:, None] - _CENTRES_MM) / _HALF_AXES_MM
    reach = np.maximum(np.sqrt((scaled**2).sum(axis=-1)), 1e-9)
    distance = (reach - 1) * _LEAST_MM
    weight = np.exp((distance.min(axis=-1, keepdims=True) - distance) / blend_mm)
    pull = weight / weight.sum(axis=-1, keepdims=True) * _LEAST_MM / reach
    return np.asarray((pull[..., None] * scaled / _HALF_AXES_MM).sum(axis=1))


def _on_surface(points_mm: FloatArray, blend_mm: float) -> FloatArray:
    """Return points (n, xyz) moved along the gradient until the level is zero.

    Most points need two steps.
    """
    moved_mm, off = points_mm.copy(), np.arange(len(points_mm))
    for _ in range(_NEWTON_STEPS):
        level = bear_level_mm(moved_mm[off], blend_mm)
        far = np.abs(level) > _CLOSE_MM
        off = off[far]
        gradient = bear_gradient(moved_mm[off], blend_mm)
        moved_mm[off] -= gradient * (level[far] / (gradient**2).sum(axis=-1))[:, None]
    return moved_mm
