"""A fingertip's ridges as data."""

from math import hypot
from typing import Annotated, Literal

from pydantic import Field, model_validator

from twin.config.specimen_pose import OptionalSize, Size, Specimen, require_at_most


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
    pattern_seed: Annotated[int, Field(ge=0)] = Field(
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
