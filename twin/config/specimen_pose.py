"""What every specimen has: its pose on the stage and what it is made of.

Lengths in mm, relative to the slab's centre; the specimen presses from below.
"""

from typing import Annotated

from pydantic import Field

from twin.config.base import Angle, Model
from twin.config.materials import Material

#: A length of a part that fits under the sensor.
Size = Annotated[float, Field(gt=0, le=100)]
#: A length that may be left out by giving 0.
OptionalSize = Annotated[float, Field(ge=0, le=100)]


class Specimen(Model):
    """What every specimen has: its pose on the stage, relative to the slab's centre."""

    x_mm: float = 0.0
    y_mm: float = 0.0
    z_mm: float = Field(
        default=0.0, description="within a group: height of the foremost point over the others'"
    )
    yaw_deg: Angle = 0.0
    tilt_deg: Annotated[float, Field(ge=-30, le=30)] = Field(
        default=0.0, description="tilt about the specimen's y axis; positive lifts its +x side"
    )
    material: Material | None = Field(
        default=None, description="needed where the specimen itself is seen (direct_fpp)"
    )


def require_at_most(key: str, found_mm: float, limit_mm: float, why: str) -> None:
    """Refuse a length above a limit that other keys set, in one line.

    Raises
    ------
    ValueError
        Names the key, what was found, what is allowed and which other keys say so.
    """
    if found_mm > limit_mm:
        raise ValueError(f"{key}: found {found_mm:g}, allowed at most {limit_mm:g}: {why}")
