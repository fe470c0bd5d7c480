"""Everyday objects as data: nut, T-slot bolt, toy brick, bear, fingertip; all in the paper.

Defaults come from the standards and drawings named at each key; what has no source is `assumed`.
"""

from math import hypot, radians, sqrt, tan
from typing import Annotated, Literal

from pydantic import Field, model_validator

from twin.config.bounds import OptionalSize, Size
from twin.config.specimen_base import Specimen, require_at_most

Thread = Annotated[float, Field(ge=1, le=30)]
Pitch = Annotated[float, Field(ge=0.2, le=4)]
# A finer or longer thread than this only makes facets that nobody sees.
_MOST_TURNS = 60


class Nut(Specimen):
    """A hex nut lying flat, with a real helical thread (ISO 68-1 basic profile); default M6."""

    kind: Literal["nut"] = "nut"
    thread_mm: Thread = Field(default=6.0, description="major diameter of the thread")
    pitch_mm: Pitch = Field(default=1.0, description="ISO 261 coarse: 1.0 for M6")
    across_flats_mm: Size = Field(default=10.0, description="ISO 4032: 10 for M6")
    height_mm: Size = Field(default=5.2, description="ISO 4032: 4.9 to 5.2 for M6")
    chamfer_mm: OptionalSize = Field(
        default=1.1,
        description="how far the 30 deg chamfer cuts the corners, radially; ISO 4032: bearing face "
        "of at least 8.9 for M6",
    )
    countersink_mm: OptionalSize = Field(
        default=6.4,
        description="diameter of the 120 deg countersinks, none if below the hole's; "
        "ISO 4032: 6 to 6.75 for M6",
    )

    @model_validator(mode="after")
    def _fits(self) -> "Nut":
        require_at_most("pitch_mm", self.pitch_mm, self.thread_mm / 4, "a quarter of thread_mm")
        require_at_most("height_mm", self.height_mm, _MOST_TURNS * self.pitch_mm, "60 turns")
        limit = 0.9 * self.across_flats_mm
        require_at_most("thread_mm", self.thread_mm, limit, "0.9 across_flats_mm")
        face = min(2 * self.face_radius_mm, self.across_flats_mm) * 0.99
        require_at_most("countersink_mm", self.countersink_mm, face, "the chamfered face")
        drop, why = self.chamfer_mm * tan(radians(30)), "0.45 height_mm; fall = chamfer_mm tan 30"
        require_at_most("chamfer's fall", drop, 0.45 * self.height_mm, why)
        return self

    @property
    def face_radius_mm(self) -> float:
        """Radius of the circle where the chamfer begins."""
        return self.across_flats_mm / sqrt(3) - self.chamfer_mm


class TBolt(Specimen):
    """A hammer-head bolt for T slots: head, square neck, threaded shank; default M5."""

    kind: Literal["t_bolt"] = "t_bolt"
    facing: Literal["side", "tip", "head"] = Field(
        default="side", description="what meets the elastomer; side: it lies along x"
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
        require_at_most("pitch_mm", self.pitch_mm, self.thread_mm / 4, "a quarter of thread_mm")
        require_at_most("shank_mm", self.shank_mm, _MOST_TURNS * self.pitch_mm, "60 turns")
        require_at_most("thread_mm", self.thread_mm, 0.99 * self.head_width_mm, "head_width_mm")
        require_at_most("head_width_mm", self.head_width_mm, self.head_length_mm, "head_length_mm")
        return self


class Brick(Specimen):
    """A toy brick, studs up, hollow below, with tubes that clutch the studs of the next one."""

    kind: Literal["brick"] = "brick"
    studs_x: Annotated[int, Field(ge=1, le=8)] = 2
    studs_y: Annotated[int, Field(ge=1, le=8)] = 2
    pitch_mm: Size = Field(default=8.0, description="literature: distance between studs")
    height_mm: Size = Field(default=9.6, description="literature: 9.6, a plate 3.2; without studs")
    play_mm: OptionalSize = Field(default=0.2, description="literature: gap between bricks")
    stud_diameter_mm: Size = Field(default=4.8, description="literature: 4.8 to 4.9")
    stud_height_mm: Size = Field(default=1.7, description="literature: 1.7 to 1.8")
    edge_radius_mm: OptionalSize = Field(default=0.1, description="assumed: studs' upper edge")
    wall_mm: Size = Field(default=1.5, description="literature: 1.2 to 1.6")
    roof_mm: Size = Field(default=1.0, description="literature: thickness under the studs")

    @model_validator(mode="after")
    def _fits(self) -> "Brick":
        stud = self.stud_diameter_mm
        require_at_most("stud_diameter_mm", stud, 0.7 * self.pitch_mm, "0.7 pitch_mm")
        require_at_most("play_mm", self.play_mm, 0.1 * self.pitch_mm, "a tenth of pitch_mm")
        edge_limit = min(stud / 4, self.stud_height_mm)
        why = "stud_height_mm, and a quarter of stud_diameter_mm"
        require_at_most("edge_radius_mm", self.edge_radius_mm, edge_limit, why)
        require_at_most("roof_mm", self.roof_mm, 0.9 * self.height_mm, "0.9 height_mm")
        room = self.pitch_mm - self.play_mm / 2 - self.tube_diameter_mm / 2
        require_at_most("wall_mm", self.wall_mm, 0.95 * room, "the space beside the tubes")
        return self

    @property
    def tube_diameter_mm(self) -> float:
        """Outer diameter of the tubes: each touches the four studs that stand round it."""
        return sqrt(2) * self.pitch_mm - self.stud_diameter_mm


class Bear(Specimen):
    """A bear ornament lying on its back: a smooth union of ellipsoids, assumed proportions."""

    kind: Literal["bear"] = "bear"
    length_mm: Annotated[float, Field(ge=5, le=60)] = Field(
        default=16.0, description="from ears to feet, along y, up to the blending"
    )
    blend_mm: Annotated[float, Field(ge=0.02, le=0.6)] = Field(
        default=0.15, description="softness of the creases between the parts, for a length of 16"
    )


class Fingerprint(Specimen):
    """A plate, flat or domed, whose upper side carries the ridges of a fingerprint."""

    kind: Literal["fingerprint"] = "fingerprint"
    pitch_mm: Annotated[float, Field(ge=0.3, le=2)] = Field(
        default=0.45,
        description="between ridges; literature: about 0.5, 0.4 to 0.6 in adults (Maltoni et al., "
        "Handbook of Fingerprint Recognition, 3.1)",
    )
    depth_mm: Annotated[float, Field(gt=0, le=0.2)] = Field(
        default=0.07, description="assumed: crest to furrow, 0.04 to 0.1"
    )
    pattern: Literal["loop", "whorl"] = "loop"
    minutiae: Annotated[int, Field(ge=0, le=200)] = Field(
        default=30, description="assumed: ridge endings and forks, 20 to 60 in a print"
    )
    pattern_seed: Annotated[int, Field(ge=0, lt=2**63)] = Field(
        default=1, description="which finger: place and turn of the core, places of the minutiae"
    )
    length_x_mm: Annotated[float, Field(ge=2, le=40)] = 20.0
    length_y_mm: Annotated[float, Field(ge=2, le=40)] = 20.0
    thickness_mm: Size = Field(default=2.0, description="of the plate below the lowest furrow")
    dome_radius_mm: OptionalSize = Field(default=0.0, description="of the finger pad; 0: flat")

    @model_validator(mode="after")
    def _fits(self) -> "Fingerprint":
        # A steeper furrow is no height field that a press could follow.
        require_at_most("depth_mm", self.depth_mm, 0.3 * self.pitch_mm, "0.3 pitch_mm")
        least = hypot(self.length_x_mm, self.length_y_mm) / 2 * 1.25
        if 0 < self.dome_radius_mm < least:
            raise ValueError(
                f"dome_radius_mm: found {self.dome_radius_mm:g}, allowed 0 or at least {least:.4g},"
                " 1.25 times half the plate's diagonal"
            )
        return self
