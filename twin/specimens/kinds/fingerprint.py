"""Specimen kind `fingerprint`: a plate with the ridges of a fingertip, with endings and forks.

The ridges follow a loop or a whorl. Their height is depth / 2 times the real part of
exp(2 pi i s / pitch) times one vortex (u +- i v) / sqrt(u^2 + v^2 + r^2) per minutia (ending or
fork). (u, v) is the position relative to the minutia and r the radius of the minutia's core; one
side of a minutia has one ridge more (Larkin and Fletcher 2007, fingerprints as holograms). s is the
distance to the core of the print, smoothed over 0.25 pitches: a line that ends in the middle of the
print (loop), or a short line (whorl). The spacing of ridges is therefore one pitch, except near
minutiae.
"""

from functools import lru_cache
from math import hypot
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from reconstruction.arrays import FloatArray
from twin.config.bounds import OptionalSize, Size
from twin.config.specimen_base import SPECIMENS, Specimen, require_at_most
from twin.specimens.catalogue import unposed
from twin.specimens.meshes import MeshShape
from twin.specimens.solids import height_grid_body

if TYPE_CHECKING:
    import trimesh

# With 12 steps the error of chords is at most depth pi^2 / 4 / 12^2: 1.2 um for a depth of 0.07 mm.
_STEPS_PER_PITCH = 12
# Radius of a minutia's core and least distance of two minutiae, in pitches.
_VORTEX, _SPACING = 0.5, 2.5
# Half length of a whorl's core over the pitch; a loop's core extends beyond the print.
_WHORL_CORE = 4.0
_TRIES = 100


@SPECIMENS.register
class Fingerprint(Specimen):
    """A plate, flat or domed, with the ridges of a fingerprint on its upper side."""

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
        default=1,
        description="of the finger: position and rotation of the core, positions of minutiae",
    )
    length_x_mm: Annotated[float, Field(ge=2, le=40)] = 20.0
    length_y_mm: Annotated[float, Field(ge=2, le=40)] = 20.0
    thickness_mm: Size = Field(default=2.0, description="of the plate below the lowest furrow")
    dome_radius_mm: OptionalSize = Field(default=0.0, description="of the finger pad; 0: flat")

    @model_validator(mode="after")
    def _fits(self) -> "Fingerprint":
        # A steeper furrow would be no height field, which the press needs.
        require_at_most("depth_mm", self.depth_mm, 0.3 * self.pitch_mm, "0.3 pitch_mm")
        least = hypot(self.length_x_mm, self.length_y_mm) / 2 * 1.25
        if 0 < self.dome_radius_mm < least:
            raise ValueError(
                f"dome_radius_mm: found {self.dome_radius_mm:g}, allowed 0 or at least {least:.4g},"
                " 0.625 x the plate's diagonal"
            )
        return self

    def shape(self) -> MeshShape:
        """Return the plate with its ridges up; their mean height at x = y = 0 is z = 0."""
        return MeshShape(_plate(unposed(self)))

    @property
    def finest_pitch_mm(self) -> float:
        """Distance between ridges."""
        return self.pitch_mm

    @property
    def ridge_height_mm(self) -> float:
        """Height of the ridges, crest to furrow."""
        return self.depth_mm


def ridges_mm(print_: Fingerprint, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
    """Return the height of the ridges above the mean surface, mm, at each x and y.

    The dome of the fingertip is not included.
    """
    rng = np.random.default_rng(print_.pattern_seed)
    half = np.array([print_.length_x_mm, print_.length_y_mm]) / 2
    core, turn = rng.uniform(-0.15, 0.15, 2) * half, np.deg2rad(90 + rng.uniform(-20, 20))
    along = (x_mm - core[0]) * np.cos(turn) + (y_mm - core[1]) * np.sin(turn)
    across = (y_mm - core[1]) * np.cos(turn) - (x_mm - core[0]) * np.sin(turn)
    ahead = _WHORL_CORE * print_.pitch_mm
    behind = ahead if print_.pattern == "whorl" else np.inf
    beyond = np.maximum(along - ahead, 0) + np.maximum(-behind - along, 0)
    softened = np.sqrt(beyond**2 + across**2 + (print_.pitch_mm / 4) ** 2)
    wave = np.exp(2j * np.pi * softened / print_.pitch_mm)
    for place, sense in _minutiae(print_, half, rng):
        off = (x_mm - place[0]) + 1j * sense * (y_mm - place[1])
        wave *= off / np.sqrt(np.abs(off) ** 2 + (_VORTEX * print_.pitch_mm) ** 2)
    return np.asarray(print_.depth_mm / 2 * wave.real)


def _minutiae(
    print_: Fingerprint, half_mm: FloatArray, rng: np.random.Generator
) -> list[tuple[FloatArray, int]]:
    """Return random positions (xy), mm, and alternating senses (+1, -1) of the minutiae.

    There are fewer than configured if no more fit at the least spacing.
    """
    places: list[FloatArray] = []
    for _ in range(_TRIES * print_.minutiae):
        place = rng.uniform(-half_mm, half_mm)
        spacing_mm = _SPACING * print_.pitch_mm
        if len(places) < print_.minutiae and all(
            np.hypot(*(place - p)) > spacing_mm for p in places
        ):
            places.append(place)
    return [(place, 1 - 2 * (number % 2)) for number, place in enumerate(places)]


@lru_cache(maxsize=4)
def _plate(print_: Fingerprint) -> "trimesh.Trimesh":
    """Return the ridged surface as a body, closed by walls and a flat base."""
    x, y = (_lines(length, print_.pitch_mm) for length in (print_.length_x_mm, print_.length_y_mm))
    grid_x, grid_y = np.meshgrid(x, y)
    z = ridges_mm(print_, grid_x, grid_y)
    if print_.dome_radius_mm > 0:
        radius2 = print_.dome_radius_mm**2
        z += np.sqrt(radius2 - grid_x**2 - grid_y**2) - print_.dome_radius_mm
    return height_grid_body(x, y, z, z.min() - print_.thickness_mm)


def _lines(length_mm: float, pitch_mm: float) -> FloatArray:
    count = int(np.ceil(length_mm / pitch_mm * _STEPS_PER_PITCH)) + 1
    return np.linspace(-length_mm / 2, length_mm / 2, count)
