"""A fingerprint: ridges that follow a loop or a whorl, with endings and forks.

The height is depth / 2 times the real part of exp(2 pi i s / pitch) times one vortex
(u +- i v) / sqrt(u^2 + v^2 + r^2) per minutia, (u, v) the place relative to it: a ridge more on
one side of it than on the other (Larkin and Fletcher 2007, fingerprints as holograms). s is the
distance to the core, a line that ends in the middle of the print (loop) or a short piece of line
(whorl), softened by a quarter of a pitch: so neighbours are one pitch apart, but for what the
minutiae pull.
"""

from functools import lru_cache

import numpy as np
import trimesh

from reconstruction.arrays import FloatArray, IntArray
from twin.config.objects import Fingerprint
from twin.specimens.catalogue import register, unposed
from twin.specimens.meshes import MeshShape
from twin.specimens.solids import grid_facets

# Chords stay within depth pi^2 / 4 / 12^2 of a ridge, 1.2 um at 0.07 mm.
_STEPS_PER_PITCH = 12
# Radius of a minutia's core and least distance of two, in pitches.
_VORTEX, _APART = 0.5, 2.5
# Half length of a whorl's core over the pitch; a loop's core leaves the print.
_WHORL_CORE = 4.0
_TRIES = 100


@register("fingerprint")
def build_fingerprint(specimen: Fingerprint) -> MeshShape:
    """Lay the plate with its ridges up."""
    return MeshShape(_plate(unposed(specimen)))


def ridges_mm(print_: Fingerprint, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
    """Return the ridges' height over the mean surface, same shape as x and y, without the dome."""
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
    height: FloatArray = print_.depth_mm / 2 * wave.real
    return height


def _minutiae(
    print_: Fingerprint, half_mm: FloatArray, rng: np.random.Generator
) -> list[tuple[FloatArray, int]]:
    """Draw places and senses, as many as there is room for; senses alternate."""
    places: list[FloatArray] = []
    for _ in range(_TRIES * print_.minutiae):
        place = rng.uniform(-half_mm, half_mm)
        apart = _APART * print_.pitch_mm
        if len(places) < print_.minutiae and all(np.hypot(*(place - p)) > apart for p in places):
            places.append(place)
    return [(place, 1 - 2 * (number % 2)) for number, place in enumerate(places)]


@lru_cache(maxsize=4)
def _plate(print_: Fingerprint) -> trimesh.Trimesh:
    """Close the ridged surface by walls and a flat base."""
    x, y = (_lines(length, print_.pitch_mm) for length in (print_.length_x_mm, print_.length_y_mm))
    grid_x, grid_y = np.meshgrid(x, y)
    z = ridges_mm(print_, grid_x, grid_y)
    if print_.dome_radius_mm > 0:
        radius2 = print_.dome_radius_mm**2
        z += np.sqrt(radius2 - grid_x**2 - grid_y**2) - print_.dome_radius_mm
    top = np.stack((grid_x, grid_y, z), axis=-1).reshape(-1, 3)
    index = np.arange(z.size).reshape(z.shape)
    rim = np.concatenate((index[0], index[1:, -1], index[-1, -2::-1], index[-2:0:-1, 0]))
    base = top[rim] * [1, 1, 0] + [0, 0, z.min() - print_.thickness_mm]
    below, middle = z.size + np.arange(rim.size), base.mean(axis=0)
    faces = (grid_facets(*z.shape), _wall(rim, below), _fan(below, z.size + rim.size))
    return trimesh.Trimesh(
        np.concatenate((top, base, middle[None])), np.concatenate(faces), process=False
    )


def _lines(length_mm: float, pitch_mm: float) -> FloatArray:
    count = int(np.ceil(length_mm / pitch_mm * _STEPS_PER_PITCH)) + 1
    return np.linspace(-length_mm / 2, length_mm / 2, count)


def _wall(rim: IntArray, below: IntArray) -> IntArray:
    """Return the facets between the rim, counter-clockwise seen from above, and the base."""
    after, below_after = np.roll(rim, -1), np.roll(below, -1)
    return np.stack((rim, below, below_after, rim, below_after, after), axis=-1).reshape(-1, 3)


def _fan(loop: IntArray, middle: int) -> IntArray:
    """Return the base's facets, which look down."""
    return np.stack((np.roll(loop, -1), loop, np.full_like(loop, middle)), axis=-1)
