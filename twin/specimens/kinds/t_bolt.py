"""Specimen kind `t_bolt`: a hammer-head bolt for T slots."""

from functools import lru_cache
from typing import TYPE_CHECKING, Literal

import numpy as np
from pydantic import Field, model_validator

from reconstruction.arrays import FloatArray
from twin.config.bounds import Size
from twin.config.specimen_base import SPECIMENS, Specimen, require_at_most
from twin.specimens.catalogue import unposed
from twin.specimens.meshes import MeshShape
from twin.specimens.solids import along_axis, arc, box, common, moved, prism, turned, union
from twin.specimens.threads import MOST_TURNS, Pitch, Thread, minor_diameter_mm, screw

if TYPE_CHECKING:
    import trimesh

_X, _Y, _Z = np.eye(3)
# Rotations from the bolt's axes (shank along -z, head's long side along y) to the specimen's.
_FACING: dict[str, tuple[FloatArray, FloatArray, FloatArray]] = {
    "side": (-_Z, _Y, _X),
    "tip": (-_X, _Y, -_Z),
    "head": (_X, _Y, _Z),
}


@SPECIMENS.register
class TBolt(Specimen):
    """A hammer-head bolt for T slots: head, square neck, threaded shank; default M5."""

    kind: Literal["t_bolt"] = "t_bolt"
    facing: Literal["side", "tip", "head"] = Field(
        default="side", description="part that touches the elastomer; side: the bolt is along x"
    )
    thread_mm: Thread = Field(default=5.0, description="major diameter of the thread")
    pitch_mm: Pitch = Field(default=0.8, description="ISO 261 coarse: 0.8 for M5")
    shank_mm: Size = Field(default=11.5, description="assumed: length of the threaded shank")
    neck_mm: Size = Field(default=1.5, description="assumed: length of the square neck")
    head_length_mm: Size = Field(
        default=10.0, description="along the slot's width; BS 2485: recess of 11 mm for M5"
    )
    head_width_mm: Size = Field(
        default=5.8, description="also the neck's side; BS 2485: throat of 6 mm for M5"
    )
    head_height_mm: Size = Field(
        default=4.0, description="along the axis; BS 2485: recess 5 mm deep for M5"
    )

    @model_validator(mode="after")
    def _fits(self) -> "TBolt":
        require_at_most("pitch_mm", self.pitch_mm, self.thread_mm / 4, "0.25 thread_mm")
        require_at_most("shank_mm", self.shank_mm, MOST_TURNS * self.pitch_mm, "60 turns")
        require_at_most("thread_mm", self.thread_mm, 0.99 * self.head_width_mm, "head_width_mm")
        require_at_most("head_width_mm", self.head_width_mm, self.head_length_mm, "head_length_mm")
        return self

    def shape(self) -> MeshShape:
        """Return the bolt with its part `facing` up and the middle of its length at the origin."""
        bolt = _bolt(unposed(self.model_copy(update={"facing": "side"})))
        length_below = self.shank_mm + self.neck_mm
        centred = moved(bolt, 0.0, 0.0, (length_below - self.head_height_mm) / 2)
        return MeshShape(along_axis(centred, *_FACING[self.facing]))


@lru_cache(maxsize=8)
def _bolt(bolt: TBolt) -> "trimesh.Trimesh":
    """Return the union of head (above z = 0), neck and shank (below z = 0)."""
    half, inside_mm = bolt.head_width_mm / 2, bolt.head_height_mm / 2
    head = prism(_hammer(bolt.head_length_mm / 2, half), 0.0, bolt.head_height_mm)
    # Each part overlaps the part above it, because a union does not join faces that only touch.
    neck = box((-half, -half, -bolt.neck_mm), (half, half, inside_mm))
    tip_mm = -bolt.neck_mm - bolt.shank_mm
    thread = screw(bolt.thread_mm, bolt.pitch_mm, tip_mm, inside_mm)
    envelope = _shank(bolt.thread_mm, bolt.pitch_mm, tip_mm, -bolt.neck_mm / 2)
    return union([head, neck, common([thread, envelope])])


def _hammer(half_length_mm: float, half_width_mm: float) -> FloatArray:
    """Return the outline (n, xy), mm, of the head.

    Two opposite corners are round, so that the head can turn in the slot.
    """
    radius = min(half_width_mm, half_length_mm)
    x, y = half_width_mm, half_length_mm
    first = arc((x - radius, y - radius), radius, 0, 90)
    second = arc((radius - x, radius - y), radius, 180, 270)
    return np.array([*first, (-x, y), *second, (x, -y)])


def _shank(thread_mm: float, pitch_mm: float, tip_mm: float, top_mm: float) -> "trimesh.Trimesh":
    """Return the shank's envelope: a cylinder with a tip chamfered at 45 degrees."""
    root, outer = minor_diameter_mm(thread_mm, pitch_mm) / 2 * 0.95, thread_mm
    profile = [(0.0, tip_mm), (root, tip_mm), (outer, tip_mm + outer - root), (outer, top_mm)]
    return turned([*profile, (0.0, top_mm)])
