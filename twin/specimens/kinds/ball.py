"""Specimen kind `ball`: one ball."""

from typing import ClassVar, Literal

from twin.config.bounds import Length
from twin.config.nominal import NominalBall
from twin.config.specimen_base import SPECIMENS, Specimen
from twin.shape import Sphere
from twin.specimens.closed_form import SphereCluster


@SPECIMENS.register
class Ball(Specimen):
    """A specimen that is one ball."""

    kind: Literal["ball"] = "ball"
    diameter_mm: Length = 8.0

    slab_fit_paths: ClassVar[tuple[str, ...]] = ("diameter_mm", "x_mm", "y_mm")

    def shape(self) -> SphereCluster:
        """Return the ball, centred on the origin."""
        return SphereCluster((Sphere(0.0, 0.0, 0.0, self.diameter_mm / 2),))

    def nominal_features(self) -> tuple[NominalBall, ...]:
        """Return the nominal ball, the only feature of known size."""
        return (NominalBall(self.diameter_mm / 2),)
