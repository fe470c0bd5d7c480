"""Dots printed on a coat: factor on its reflectance, fixed in the material.

Under load the material moves in the plane of the coat, and the dots move with it. The material
coordinates of a surface point are interpolated linearly between the vertices of the face.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import drjit as dr
import mitsuba as mi
import numpy as np

from reconstruction.arrays import FloatArray
from twin.config.lamps import Markers
from twin.mechanics.relief import MATERIAL_MM
from twin.optics.height_grid import height_grid, is_even

if TYPE_CHECKING:
    import trimesh

    from twin.mechanics.relief import FaceGrid


@dataclass(frozen=True, eq=False)
class MaterialShift:
    """Material coordinates minus world x and y, mm, on a uniform grid of places.

    Attributes
    ----------
    shift_mm : `mi.Texture2f` with two channels
    corner_mm : x and y of the outer corner of the first texel
    per_mm : 1 / (width of the texture), 1/mm, along x and y
    """

    shift_mm: Any
    corner_mm: tuple[Any, Any]
    per_mm: tuple[Any, Any]

    @classmethod
    def of_face(cls, face: "FaceGrid | trimesh.Trimesh") -> "MaterialShift | None":
        """Return the shift of a face; None if it has no material coordinates or no uniform grid."""
        grid = height_grid(face) if MATERIAL_MM in face.vertex_attributes else None
        if grid is None or not is_even(grid):
            return None
        material = np.asarray(face.vertex_attributes[MATERIAL_MM]).reshape(*grid.shape[:2], 2)
        return cls.of_grid(grid[..., :2], material)

    @classmethod
    def of_grid(cls, places_mm: FloatArray, material_mm: FloatArray) -> "MaterialShift":
        """Return the shift from places (row, col, xy) of a uniform grid to material coordinates."""
        shift = (material_mm - places_mm).astype(np.float32)
        first, last = places_mm[0, 0], places_mm[-1, -1]
        counts = np.array([places_mm.shape[1], places_mm.shape[0]])
        step = (last - first) / (counts - 1)
        corner, per_mm = first - step / 2, 1.0 / (step * counts)
        kind: Any = mi.Texture2f
        # Without the graphics processor's own filter, whose weights have 8 bits.
        texture = kind(
            mi.TensorXf(shift),
            use_accel=False,
            filter_mode=dr.FilterMode.Linear,
            wrap_mode=dr.WrapMode.Clamp,
        )
        opaque = [dr.opaque(mi.Float, float(value)) for value in (*corner, *per_mm)]
        return cls(texture, (opaque[0], opaque[1]), (opaque[2], opaque[3]))

    def at(self, point_mm: Any) -> tuple[Any, Any]:
        """Return the shift along x and y at surface points."""
        u = (point_mm.x - self.corner_mm[0]) * self.per_mm[0]
        v = (point_mm.y - self.corner_mm[1]) * self.per_mm[1]
        x, y = self.shift_mm.eval(mi.Point2f(u, v))
        return x, y


@dataclass(frozen=True, eq=False)
class PrintedDots:
    """Dots on one face; `shift` None: the material has not moved in the plane of the coat."""

    markers: Markers
    shift: MaterialShift | None = None

    @classmethod
    def on(
        cls, markers: Markers | None, face: "FaceGrid | trimesh.Trimesh"
    ) -> "PrintedDots | None":
        """Return the dots on a face, with its material coordinates; None if none are printed."""
        return None if markers is None else cls(markers, MaterialShift.of_face(face))

    def factor(self, point_mm: Any) -> Any:
        """Return the factor of the dots on the reflectance at world points, 1 outside the dots."""
        x, y, markers = point_mm.x, point_mm.y, self.markers
        if self.shift is not None:
            moved_x, moved_y = self.shift.at(point_mm)
            x, y = x + moved_x, y + moved_y
        x -= dr.round(x / markers.pitch_x_mm) * markers.pitch_x_mm
        y -= dr.round(y / markers.pitch_y_mm) * markers.pitch_y_mm
        inside = x * x + y * y < markers.radius_mm**2
        return dr.select(inside, markers.relative_albedo, 1.0)
