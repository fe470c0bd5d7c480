"""Specimen kind `two_balls`: two joined balls (the paper's artefact)."""

from typing import ClassVar, Literal

from pydantic import Field

from twin.config.bounds import Length
from twin.config.nominal import NominalBall
from twin.config.specimen_base import SPECIMENS, Specimen
from twin.shape import Sphere
from twin.specimens.closed_form import SphereCluster


@SPECIMENS.register
class TwoBalls(Specimen):
    """Two joined balls along the specimen's x axis (the paper's artefact)."""

    kind: Literal["two_balls"] = "two_balls"
    diameter_mm: Length = 8.0
    separation_mm: Length = Field(default=8.0, description="distance between the two centres")

    slab_fit_paths: ClassVar[tuple[str, ...]] = (
        "diameter_mm", "separation_mm", "x_mm", "y_mm", "yaw_deg",
    )  # fmt: skip

    def shape(self) -> SphereCluster:
        """Return two balls along x; the midpoint of their centres is the origin."""
        half = self.separation_mm / 2
        return SphereCluster(
            tuple(Sphere(side * half, 0.0, 0.0, self.diameter_mm / 2) for side in (-1, 1))
        )

    def nominal_features(self) -> tuple[NominalBall, ...]:
        """Return the nominal balls from -x to +x."""
        return 2 * (NominalBall(self.diameter_mm / 2),)
