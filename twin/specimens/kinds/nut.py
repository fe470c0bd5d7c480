"""Specimen kind `nut`: a hex nut with a helical thread."""

from functools import lru_cache
from math import radians, sqrt, tan
from typing import TYPE_CHECKING, Literal

import numpy as np
from pydantic import Field, model_validator

from twin.config.bounds import OptionalSize, Size
from twin.config.nominal import NominalHexNut
from twin.config.specimen_base import SPECIMENS, Specimen, require_at_most
from twin.specimens.catalogue import unposed
from twin.specimens.meshes import MeshShape
from twin.specimens.solids import SECTIONS, along_axis, common, prism, turned, without
from twin.specimens.threads import MOST_TURNS, Pitch, Thread, minor_diameter_mm, screw

if TYPE_CHECKING:
    import trimesh

_CHAMFER_SLOPE = np.tan(np.deg2rad(30))
_COUNTERSINK_SLOPE = np.tan(np.deg2rad(30))  # 120 degrees between the flanks
_X, _Y, _Z = np.eye(3)


@SPECIMENS.register
class Nut(Specimen):
    """A hex nut on its face, with a helical thread (ISO 68-1 basic profile); default M6."""

    kind: Literal["nut"] = "nut"
    thread_mm: Thread = Field(default=6.0, description="major diameter of the thread")
    pitch_mm: Pitch = Field(default=1.0, description="ISO 261 coarse: 1.0 for M6")
    across_flats_mm: Size = Field(default=10.0, description="ISO 4032: 10 for M6")
    height_mm: Size = Field(default=5.2, description="ISO 4032: 4.9 to 5.2 for M6")
    chamfer_mm: OptionalSize = Field(
        default=1.1,
        description="radial depth of the 30 deg chamfer at the corners; ISO 4032: bearing face "
        "of at least 8.9 for M6",
    )
    countersink_mm: OptionalSize = Field(
        default=6.4,
        description="diameter of the 120 deg countersinks, none if smaller than the hole; "
        "ISO 4032: 6 to 6.75 for M6",
    )

    @model_validator(mode="after")
    def _fits(self) -> "Nut":
        require_at_most("pitch_mm", self.pitch_mm, self.thread_mm / 4, "0.25 thread_mm")
        require_at_most("height_mm", self.height_mm, MOST_TURNS * self.pitch_mm, "60 turns")
        limit = 0.9 * self.across_flats_mm
        require_at_most("thread_mm", self.thread_mm, limit, "0.9 across_flats_mm")
        face = min(2 * self.face_radius_mm, self.across_flats_mm) * 0.99
        require_at_most("countersink_mm", self.countersink_mm, face, "the chamfered face")
        drop, why = self.chamfer_mm * tan(radians(30)), "0.45 height_mm; fall = chamfer_mm tan 30"
        require_at_most("chamfer's fall", drop, 0.45 * self.height_mm, why)
        return self

    @property
    def face_radius_mm(self) -> float:
        """Radius of the circle on the face at which the chamfer starts."""
        return self.across_flats_mm / sqrt(3) - self.chamfer_mm

    def shape(self) -> MeshShape:
        """Return the nut with its axis along z and two of its flats normal to y, centred."""
        return MeshShape(_nut(unposed(self)))

    def nominal_features(self) -> tuple[NominalHexNut, ...]:
        """Return the nominal nut: hexagon, and the flat ring between countersink and chamfer."""
        hole_mm = max(self.countersink_mm, self.thread_mm) / 2
        fall_mm = self.chamfer_mm * tan(radians(30))
        return (NominalHexNut(self.across_flats_mm, (hole_mm + self.face_radius_mm) / 2, fall_mm),)


@lru_cache(maxsize=8)
def _nut(nut: Nut) -> "trimesh.Trimesh":
    """Return a chamfered hexagon with the thread and both countersinks cut out."""
    half, corner_mm = nut.height_mm / 2, nut.across_flats_mm / np.sqrt(3)
    turn = np.arange(6) * np.pi / 3
    hexagon = corner_mm * np.stack((np.cos(turn), np.sin(turn)), axis=-1)
    body = prism(hexagon, -half, half)
    if nut.chamfer_mm > 0:
        body = common([body, _chamfered(nut.face_radius_mm, corner_mm, half)])
    holes = [screw(nut.thread_mm, nut.pitch_mm, -half, half)]
    if nut.countersink_mm > minor_diameter_mm(nut.thread_mm, nut.pitch_mm):
        holes += [_countersink(nut.countersink_mm / 2, half, side) for side in (1, -1)]
    return without(body, *holes)


def _chamfered(face_radius_mm: float, corner_mm: float, half_mm: float) -> "trimesh.Trimesh":
    """Return a disc with chamfers of 30 degrees on both faces, from `face_radius_mm` outwards.

    `corner_mm` is the radius of the hexagon's corners, `half_mm` half the height of the nut.
    """
    import trimesh

    rim = corner_mm * 1.1
    fall = (rim - face_radius_mm) * _CHAMFER_SLOPE
    upper = [(rim, half_mm - fall), (face_radius_mm, half_mm)]
    lower = [(face_radius_mm, -half_mm), (rim, fall - half_mm)]
    disc = turned([(0.0, -half_mm), *lower, *upper, (0.0, half_mm)])
    # Rotated by half a facet: the hexagon's corners must not be on the disc's edges.
    disc.apply_transform(trimesh.transformations.rotation_matrix(np.pi / SECTIONS, _Z))
    return disc


def _countersink(radius_mm: float, half_mm: float, side: int) -> "trimesh.Trimesh":
    """Return the cone to cut from the upper (+1) or lower (-1) face; it extends beyond the face.

    `radius_mm` is its radius at the face, `half_mm` half the height of the nut.
    """
    depth_mm = radius_mm * _COUNTERSINK_SLOPE
    rim = (2 * radius_mm, half_mm + depth_mm)
    cone = turned([(0.0, half_mm - depth_mm), rim, (0.0, half_mm + 2 * depth_mm)])
    return cone if side > 0 else along_axis(cone, _X, -_Y, -_Z)
