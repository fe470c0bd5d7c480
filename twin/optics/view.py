"""Pictures for people: what an observer beside the rig sees in soft light.

The measurement does not use this module. Bodies have colours here, which the monochrome backend
renders as three passes with the same seed, one per primary: noise is grey. World frame, mm.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from reconstruction.arrays import FloatArray
from twin.optics.backend import activate
from twin.optics.device_frames import perspective_sensor
from twin.optics.materials import mitsuba_mesh
from twin.optics.observer import Observer

if TYPE_CHECKING:
    import trimesh

Picture = NDArray[np.uint8]

MOST_BOUNCES = 12
"""Enough for light to leave a hollow clear body: each wall takes two."""

# The sky lights from everywhere; two lamps, high on the left and low on the right, model the form.
_SKY, _KEY, _FILL = 0.5, 1.15, 0.4
# Half the edge of a lamp, in widths of the picture: large and dim, or clear bodies sparkle.
_LAMP = 1.0
_PRIMARIES = 3


@dataclass(frozen=True, eq=False)
class Thing:
    """A surface with its look.

    Attributes
    ----------
    bsdf : dict
        For `mi.load_dict`; a tuple of three numbers stands for red, green and blue.
    shade : (vertex,) float, optional
        Albedo of a matte surface at each vertex; the BSDF is then not used.
    smooth : bool
        With the mesh's vertex normals; faceted otherwise.
    """

    name: str
    mesh: "trimesh.Trimesh"
    bsdf: dict[str, Any] = field(default_factory=dict)
    shade: FloatArray | None = None
    smooth: bool = False


def matte(red: float, green: float, blue: float) -> dict[str, Any]:
    """Return the BSDF of a diffuse colour, seen from both sides."""
    reflectance = {"type": "spectrum", "value": (red, green, blue)}
    return {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": reflectance}}


def picture(
    things: Sequence[Thing],
    observer: Observer,
    samples: int = 64,
    *,
    seed: int = 0,
    gray: bool = False,
    bounces: int = MOST_BOUNCES,
) -> Picture:
    """Render things before a white background in soft light.

    Parameters
    ----------
    things : at least one, all names different
    observer : Observer
    samples : paths per pixel
    seed : the same seed gives the same picture
    gray : True: one pass instead of three, for things without colours
    bounces : most surfaces that light meets; 4 do where nothing is clear

    Returns
    -------
    (row, col, 3) uint8, sRGB

    Raises
    ------
    MissingBackend
        No usable Dr.Jit backend.
    """
    activate()
    passes = [0] if gray else range(_PRIMARIES)
    layers = [
        _render(_scene(things, observer, primary, samples, bounces), seed) for primary in passes
    ]
    light = np.stack(layers * (_PRIMARIES // len(layers)), axis=-1)
    return _srgb(light)


def _render(scene: Any, seed: int) -> NDArray[np.float32]:
    """Return the light of one primary over white, (row, col) float, 1 is white."""
    import mitsuba as mi

    image = np.array(mi.render(scene, seed=seed))
    light, alpha = image[..., 0], image[..., -1]
    return np.asarray(light + (1.0 - np.clip(alpha, 0.0, 1.0)), np.float32)


def _scene(
    things: Sequence[Thing], observer: Observer, primary: int, samples: int, bounces: int
) -> Any:
    import mitsuba as mi

    sensor = perspective_sensor(observer.pinhole, observer.world_from_eye, samples)
    sensor["film"]["pixel_format"] = "luminance_alpha"
    # One more than bounces: Mitsuba counts the way to the lamp.
    integrator = {"type": "path", "max_depth": bounces + 1, "hide_emitters": True}
    return mi.load_dict(
        {
            "type": "scene",
            "integrator": integrator,
            "sensor": sensor,
            **_lights(observer),
            **{thing.name: _mesh(thing, primary) for thing in things},
        },
        optimize=False,  # load_dict would merge shapes
    )


def _lights(observer: Observer) -> dict[str, Any]:
    """Sky and two square lamps that follow observer and size of what he looks at."""
    import mitsuba as mi

    target, size = np.array(observer.target_mm), observer.width_mm
    right, _, forward = observer.world_from_eye[:3, :3].T
    towards, up = -np.array([forward[0], forward[1], 0.0]), np.array([0.0, 0.0, 1.0])
    places = {
        "key": (target + size * (-1.0 * right + 0.6 * towards + 1.7 * up), _KEY),
        "fill": (target + size * (1.5 * right + 0.9 * towards + 0.8 * up), _FILL),
    }
    lamps = {
        name: {
            "type": "rectangle",
            "to_world": mi.ScalarTransform4f().look_at(
                origin=place.tolist(), target=target.tolist(), up=[0.1, 0.2, 1.0]
            )
            @ mi.ScalarTransform4f().scale([_LAMP * size] * 3),
            "emitter": {"type": "area", "radiance": _level(radiance)},
        }
        for name, (place, radiance) in places.items()
    }
    return {"sky": {"type": "constant", "radiance": _level(_SKY)}, **lamps}


def _mesh(thing: Thing, primary: int) -> Any:
    return mitsuba_mesh(
        thing.name,
        thing.mesh.vertices,
        thing.mesh.faces,
        _of_primary(_bsdf(thing), primary),
        normals=thing.mesh.vertex_normals if thing.smooth else None,
        shade=thing.shade,
    )


def _bsdf(thing: Thing) -> dict[str, Any]:
    if thing.shade is None:
        return thing.bsdf
    reflectance = {"type": "mesh_attribute", "name": "vertex_shade"}
    return {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": reflectance}}


def _of_primary(tree: Any, primary: int) -> Any:
    """Return a dictionary with each colour replaced by its part of one primary."""
    if isinstance(tree, dict):
        return {key: _of_primary(value, primary) for key, value in tree.items()}
    return tree[primary] if isinstance(tree, tuple) else tree


def _level(value: float) -> dict[str, Any]:
    return {"type": "spectrum", "value": value}


def _srgb(light: NDArray[np.float32]) -> Picture:
    """Encode linear light, 1 is white (IEC 61966-2-1)."""
    linear = np.clip(light, 0.0, 1.0)
    encoded = np.where(
        linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055
    )
    return np.asarray(np.rint(255.0 * encoded), np.uint8)
