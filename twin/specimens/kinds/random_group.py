"""Specimen kind `random_group`: random bodies of simple forms, side by side on one plane.

The parts are drawn one after another from `seed`: size (log-uniform), then form and yaw. Each is a
ball, a lying rod, a disc or a block. From the largest to the smallest they get places at random, at
which their outline circles keep their distance from those before (random sequential addition).
"""

from collections.abc import Callable, Mapping
from typing import Annotated, Literal

import numpy as np
from pydantic import ConfigDict, Field, model_validator

from reconstruction.arrays import FloatArray
from twin.config.bounds import Length
from twin.config.digest import keyed_sequence
from twin.config.specimen_base import SPECIMENS, Specimen
from twin.specimens.catalogue import Assembly, raised, shape_of
from twin.specimens.kinds.ball import Ball
from twin.specimens.kinds.bar import Bar
from twin.specimens.kinds.flat import Flat
from twin.specimens.kinds.rod import Rod

_MOST_TRIES = 2000  # random places of one part; then the parts do not fit
_ROUNDING = 0.03  # of edges, relative to the size
_FORMS: Mapping[str, Callable[[float], tuple[Specimen, float]]] = {
    "ball": lambda size: (Ball(diameter_mm=size), size),
    "rod": lambda size: (
        Rod(diameter_mm=0.6 * size, length_mm=0.8 * size, edge_radius_mm=_ROUNDING * size),
        0.6 * size,
    ),
    "disc": lambda size: (
        Flat(diameter_mm=size, height_mm=0.3 * size, edge_radius_mm=_ROUNDING * size),
        0.3 * size,
    ),
    "block": lambda size: (
        Bar(
            width_mm=0.6 * size,
            length_mm=0.8 * size,
            height_mm=0.3 * size,
            edge_radius_mm=_ROUNDING * size,
        ),
        0.3 * size,
    ),
}
"""Part and its height, by form, of a given diameter of the outline circle, mm."""


@SPECIMENS.register
class RandomGroup(Specimen):
    """Random balls, rods, discs and blocks side by side on one plane."""

    model_config = ConfigDict(defer_build=True)

    kind: Literal["random_group"] = "random_group"
    seed: Annotated[int, Field(ge=0, lt=2**32)] = Field(
        default=0, description="of forms, sizes and places"
    )
    count: Annotated[int, Field(ge=2, le=100)] = Field(default=6, description="number of parts")
    smallest_mm: Length = Field(default=2.0, description="smallest diameter of an outline circle")
    largest_mm: Length = Field(default=5.0, description="largest diameter of an outline circle")
    gap_mm: Length = Field(default=0.2, description="smallest gap between outline circles")
    field_mm: Length = Field(default=16.0, description="side of the square that holds all parts")

    @model_validator(mode="after")
    def _fits(self) -> "RandomGroup":
        if not self.smallest_mm <= self.largest_mm <= self.field_mm:
            raise ValueError(
                f"smallest_mm, largest_mm: found {self.smallest_mm:g} and {self.largest_mm:g}, "
                f"allowed rising, up to field_mm = {self.field_mm:g}"
            )
        placed = len(self.places_mm)
        if placed < self.count:
            raise ValueError(
                f"count: found {self.count}, of which {placed} find a place; allowed fewer or "
                "smaller parts, or a larger field_mm"
            )
        return self

    @property
    def sizes_mm(self) -> FloatArray:
        """Diameters of the outline circles, mm, from the largest to the smallest."""
        shares = self._random("sizes").random(self.count)
        ratio = self.largest_mm / self.smallest_mm
        return np.sort(self.smallest_mm * ratio**shares)[::-1]

    @property
    def places_mm(self) -> FloatArray:
        """Centres x, y of the parts that find a place, (part, 2) mm, in the order of the sizes."""
        rng, placed = self._random("places"), np.zeros((0, 2))
        for number, size in enumerate(self.sizes_mm):
            least_mm = (size + self.sizes_mm[:number]) / 2.0 + self.gap_mm
            tries = (rng.random((_MOST_TRIES, 2)) - 0.5) * (self.field_mm - size)
            apart = np.linalg.norm(tries[:, None] - placed[None], axis=-1) >= least_mm
            free = np.flatnonzero(apart.all(axis=1))
            if not len(free):
                break
            placed = np.concatenate([placed, tries[free[:1]]])
        return placed

    @property
    def components(self) -> Mapping[str, Specimen]:
        """Parts by name, such as `3_rod`, each at its place, with its foot on the common plane."""
        rng = self._random("forms")
        forms = [
            (name, *_FORMS[name](size))
            for name, size in zip(
                rng.choice([*_FORMS], self.count).tolist(), self.sizes_mm.tolist(), strict=True
            )
        ]
        yaws, highest_mm = 180.0 * rng.random(self.count), max(height for *_, height in forms)
        parts = {}
        for number, ((name, part, height_mm), (x, y)) in enumerate(
            zip(forms, self.places_mm.tolist(), strict=True)
        ):
            place = {"x_mm": x, "y_mm": y, "yaw_deg": float(yaws[number])}
            parts[f"{number}_{name}"] = part.model_copy(
                update=place | {"z_mm": height_mm - highest_mm}
            )
        return parts

    def _random(self, what: str) -> np.random.Generator:
        return np.random.default_rng(keyed_sequence(self.seed, f"random_group {what}"))

    def shape(self) -> Assembly:
        """Return the shapes of all parts, each with its foremost point at its `z_mm`."""
        return Assembly(
            tuple(shape_of(part).placed(raised(part.z_mm)) for part in self.components.values())
        )
