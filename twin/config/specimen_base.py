"""What every specimen has: its pose on the stage, and the optical material that it is made of.

Lengths in mm, relative to the slab's centre; the specimen presses from below.
"""

from typing import Annotated, Any

from pydantic import ConfigDict, Field

from twin.config.base import Angle, Model
from twin.config.bounds import Length, Place
from twin.config.kinds import follows
from twin.config.materials import MATERIALS, Albedo, Material


class Stage(Model):
    """The matte table under a specimen that is seen directly."""

    albedo: Albedo = 0.35
    size_mm: Length = Field(default=80.0, description="edge of the square, round the world origin")


class Specimen(Model):
    """What every specimen has: its pose on the stage, relative to the slab's centre."""

    model_config = ConfigDict(defer_build=True)

    @classmethod
    def __pydantic_init_subclass__(cls, **_: Any) -> None:
        """Build each kind again when there is another material."""
        follows(MATERIALS)(cls)

    x_mm: Place = 0.0
    y_mm: Place = 0.0
    z_mm: Place = Field(
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
    ValueError : names the key, what was found, what is allowed and which other keys say so
    """
    if found_mm > limit_mm:
        raise ValueError(f"{key}: found {found_mm:g}, allowed at most {limit_mm:g}: {why}")
