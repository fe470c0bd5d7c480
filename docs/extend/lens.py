"""A specimen as a plug-in: a plano-convex lens, its curved face towards the elastomer."""

from typing import ClassVar, Literal

from twin.config.bounds import Length
from twin.config.nominal import NominalBall
from twin.config.specimen_base import SPECIMENS, Specimen
from twin.shape import Sphere
from twin.specimens.closed_form import SphereCluster


@SPECIMENS.register
class Lens(Specimen):
    """A lens, its curved face up."""

    kind: Literal["lens"] = "lens"
    radius_mm: Length = 4.0

    slab_fit_paths: ClassVar[tuple[str, ...]] = ("radius_mm", "x_mm", "y_mm")

    def shape(self) -> SphereCluster:
        """Return the sphere that the lens is a part of, its centre in the origin."""
        return SphereCluster((Sphere(0.0, 0.0, 0.0, self.radius_mm),))

    def nominal_features(self) -> tuple[NominalBall, ...]:
        """Return the curved face: its radius is measured unless the experiment says otherwise."""
        return (NominalBall(self.radius_mm),)
