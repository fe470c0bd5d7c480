"""Render pictures of rigs and specimens in soft light, for reports and figures.

The measurement does not use this module. Surfaces have colours here. The monochrome backend renders
them in three passes, one per primary (red, green, blue), with the same random seed: the random
noise of the picture is therefore grey.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from reconstruction.arrays import FloatImage, Levels
from twin.optics.bsdfs import level
from twin.optics.materials import mitsuba_mesh
from twin.optics.rig import perspective_sensor
from twin.optics.session import renderer_session
from twin.optics.view import SceneSurface, SceneView

Picture = Levels

MOST_BOUNCES = 12
"""Largest number of surfaces on a light path. It is sufficient for light through a hollow clear
body, which needs two bounces per wall."""

# The sky is uniform; two lamps, high on the left and low on the right, give the shading.
_SKY, _KEY, _FILL = 0.5, 1.15, 0.4
# Half the edge length of a lamp, in picture widths: large, dim lamps avoid fireflies in clear
# bodies.
_LAMP = 1.0
_PRIMARIES = 3


@renderer_session()
def picture(
    surfaces: Sequence[SceneSurface],
    view: SceneView,
    samples: int = 64,
    *,
    gray: bool = False,
    bounces: int = MOST_BOUNCES,
) -> Picture:
    """Render a picture of surfaces in soft light on a white background.

    Parameters
    ----------
    surfaces : at least one, all with different names
    view : position, direction and image size of the picture's camera
    samples : number of light paths per pixel
    gray : True: render one pass instead of three, for surfaces without colours
    bounces : maximum number of surfaces on a light path; 4 suffice without clear materials

    Returns
    -------
    (row, col, 3) uint8, sRGB

    Raises
    ------
    MissingBackend : no usable Dr.Jit backend
    """
    passes = [0] if gray else range(_PRIMARIES)
    layers = [_render(_scene(surfaces, view, primary, samples, bounces)) for primary in passes]
    light = np.stack(layers * (_PRIMARIES // len(layers)), axis=-1)
    return _srgb(light)


def _render(scene: Any) -> FloatImage:
    """Return the picture in one primary on a white background, linear, (row, col); 1 is white."""
    import mitsuba as mi

    image = np.array(mi.render(scene, seed=0))
    light, alpha = image[..., 0], image[..., -1]
    return np.asarray(light + (1.0 - np.clip(alpha, 0.0, 1.0)), np.float32)


def _scene(
    surfaces: Sequence[SceneSurface], view: SceneView, primary: int, samples: int, bounces: int
) -> Any:
    import mitsuba as mi

    sensor = perspective_sensor(view.pinhole, view.world_from_eye, samples)
    sensor["film"]["pixel_format"] = "luminance_alpha"
    # One more than bounces: Mitsuba counts the path to the lamp.
    integrator = {"type": "path", "max_depth": bounces + 1, "hide_emitters": True}
    return mi.load_dict(
        {
            "type": "scene",
            "integrator": integrator,
            "sensor": sensor,
            **_lights(view),
            **{part.name: _mesh(part, primary) for part in surfaces},
        },
        optimize=False,  # load_dict would merge shapes
    )


def _lights(view: SceneView) -> dict[str, Any]:
    """Return the emitters for `mi.load_dict`: a uniform sky and two square lamps.

    The lamps' positions and sizes follow the direction and the width of the view.
    """
    import mitsuba as mi

    target, size = np.array(view.target_mm), view.width_mm
    right, _, forward = view.world_from_eye[:3, :3].T
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
            "emitter": {"type": "area", "radiance": level(radiance)},
        }
        for name, (place, radiance) in places.items()
    }
    return {"sky": {"type": "constant", "radiance": level(_SKY)}, **lamps}


def _mesh(part: SceneSurface, primary: int) -> Any:
    """Return a surface as `mi.Mesh`, with its reflectance in one primary (0: red)."""
    one_colour = part.rgb.ndim == 1
    reflectance = (
        {"type": "spectrum", "value": float(part.rgb[primary])}
        if one_colour
        else {"type": "mesh_attribute", "name": "vertex_shade"}
    )
    matte = {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": reflectance}}
    return mitsuba_mesh(
        part.name,
        part.vertices_mm,
        part.triangles,
        matte if part.bsdf is None else dict(part.bsdf),
        normals=part.normals,
        shade=None if one_colour else part.rgb[:, primary],
    )


def _srgb(light: FloatImage) -> Picture:
    """Return linear light (1 is white) as 8-bit sRGB values (IEC 61966-2-1)."""
    linear = np.clip(light, 0.0, 1.0)
    encoded = np.where(
        linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055
    )
    return np.asarray(np.rint(255.0 * encoded), np.uint8)
