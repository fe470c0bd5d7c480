"""Specimen kind `grating`: a plate with sinusoidal grooves."""

from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from reconstruction.arrays import IntArray
from twin.config.bounds import Length
from twin.config.nominal import NominalGrating
from twin.config.specimen_base import SPECIMENS, Specimen
from twin.specimens.meshes import MeshShape
from twin.specimens.solids import closed_mesh

_STEPS_PER_PITCH = 48
_BODY_MM = 2.0


@SPECIMENS.register
class Grating(Specimen):
    """A plate with sinusoidal grooves along its y axis, to test the lateral resolution."""

    kind: Literal["grating"] = "grating"
    pitch_mm: Length = 4.0
    groove_mm: Length = Field(default=0.2, description="depth of the grooves, crest to root")
    length_x_mm: Length = 12.0
    length_y_mm: Length = 12.0

    slab_fit_paths: ClassVar[tuple[str, ...]] = ("groove_mm", "x_mm")

    def shape(self) -> MeshShape:
        """Return a plate with grooves along y.

        The crests between grooves are at whole pitches from x = 0 and at z = `groove_mm` / 2.
        """
        steps = max(2, round(self.length_x_mm / self.pitch_mm * _STEPS_PER_PITCH))
        x = np.linspace(-self.length_x_mm / 2, self.length_x_mm / 2, steps + 1)
        z = self.groove_mm / 2 * np.cos(2 * np.pi * x / self.pitch_mm)
        y, base = self.length_y_mm / 2, np.full_like(x, -self.groove_mm - _BODY_MM)
        rows = [(x, y, z), (x, -y, z), (x, -y, base), (x, y, base)]
        vertices = [
            np.stack((along, np.full_like(along, side), up), axis=-1) for along, side, up in rows
        ]
        return MeshShape(closed_mesh(np.concatenate(vertices), _prism_facets(x.size)))

    def nominal_features(self) -> tuple[NominalGrating, ...]:
        """Return the nominal grating, the only feature of known size."""
        sides = self.length_x_mm, self.length_y_mm
        return (NominalGrating(self.pitch_mm, self.groove_mm, *sides),)

    @property
    def finest_pitch_mm(self) -> float:
        """Pitch of the grooves."""
        return self.pitch_mm

    @property
    def ridge_height_mm(self) -> float:
        """Depth of the grooves, crest to root."""
        return self.groove_mm


def _prism_facets(count: int) -> IntArray:
    """Return the facets (n, 3) of a bar with four long edges of `count` vertices each."""
    step = np.arange(count - 1)
    sides = []
    for line in range(4):
        a, b = line * count + step, (line + 1) % 4 * count + step
        sides += [np.stack((a, b, b + 1), axis=-1), np.stack((a, b + 1, a + 1), axis=-1)]
    last = count - 1
    ends = [(0, 3 * count, 2 * count), (0, 2 * count, count)]
    ends += [(last + c, last + b, last + a) for a, b, c in ends]
    return np.concatenate((*sides, np.array(ends)))
