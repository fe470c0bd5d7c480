"""Specimen kind `group`: several specimens on one stage."""

from collections.abc import Mapping
from typing import Annotated, Literal

from pydantic import ConfigDict, Field

from twin.config.kinds import OneOf, follows
from twin.config.specimen_base import SPECIMENS, Specimen
from twin.specimens.catalogue import Assembly, raised, shape_of

Part = Annotated[Specimen, OneOf(SPECIMENS, without=("group", "random_group"))]


@SPECIMENS.register
@follows(SPECIMENS)
class Group(Specimen):
    """Several specimens on one stage, pressed together."""

    model_config = ConfigDict(defer_build=True)

    kind: Literal["group"] = "group"
    parts: dict[str, Part] = Field(
        min_length=1,
        max_length=100,
        description="one table per part, [specimen.parts.NAME], each with its kind",
    )

    @property
    def components(self) -> Mapping[str, Specimen]:
        """Specimens of the group by name."""
        return self.parts

    def shape(self) -> Assembly:
        """Return the shapes of all parts, each with its foremost point at its `z_mm`."""
        return Assembly(
            tuple(shape_of(part).placed(raised(part.z_mm)) for part in self.parts.values())
        )

    @property
    def finest_pitch_mm(self) -> float | None:
        """Finest pitch of the ridges of all parts; None without ridges."""
        pitches = [part.finest_pitch_mm for part in self.parts.values()]
        return min((pitch for pitch in pitches if pitch is not None), default=None)
