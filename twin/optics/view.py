"""External view camera: where it stands, what lies behind its pixels, and pictures in soft light.

For pictures of rigs, specimens and measured reliefs, without noise; the measurement does not use
this module. World frame, mm; pixels as everywhere: (0, 0) is the CENTRE of the first, row 0 is the
top. Scene objects have colours here, which the monochrome backend renders as three passes with the
same seed, one per primary: noise is grey.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from reconstruction.arrays import BoolImage, FloatArray, FloatImage, Levels
from reconstruction.rig.pinhole import Pinhole
from twin.optics.bsdfs import level
from twin.optics.materials import mitsuba_mesh
from twin.optics.rig import perspective_sensor
from twin.optics.session import renderer_session

if TYPE_CHECKING:
    import trimesh


Point = tuple[float, float, float]


@dataclass(frozen=True)
class ViewCamera:
    """A pinhole camera that looks at a point, the world's z axis upright in its picture."""

    eye_mm: Point
    target_mm: Point
    width_mm: float
    """How much of the plane through the target, across the view, the picture's width shows."""
    width_px: int = 640
    height_px: int = 480

    @property
    def pinhole(self) -> Pinhole:
        """Intrinsics."""
        distance_mm = float(np.linalg.norm(np.subtract(self.target_mm, self.eye_mm)))
        focal_px = self.width_px * distance_mm / self.width_mm
        centre = (self.width_px - 1) / 2, (self.height_px - 1) / 2
        return Pinhole(self.width_px, self.height_px, focal_px, focal_px, *centre)

    @property
    def world_from_eye(self) -> FloatArray:
        """Pose (4, 4) in OpenCV's frame.

        A view straight down has world y at the top.
        """
        forward = np.subtract(self.target_mm, self.eye_mm)
        forward /= np.linalg.norm(forward)
        level = np.hypot(forward[0], forward[1]) < 1e-6
        right = np.cross(forward, [0.0, 1.0, 0.0] if level else [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right)
        pose = np.eye(4)
        pose[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
        pose[:3, 3] = self.eye_mm
        return pose

    def project(self, points_world_mm: Any) -> FloatArray:
        """Return the pixels (..., 2) where world points (..., 3) appear."""
        pose = self.world_from_eye
        return self.pinhole.project((np.asarray(points_world_mm) - pose[:3, 3]) @ pose[:3, :3])


@dataclass(frozen=True, eq=False)
class VisibleSurface:
    """What lies behind each pixel centre.

    Attributes
    ----------
    hit : (row, col) bool
    points_mm : (row, col, xyz) float32, 0 where nothing is hit
    normals : (row, col, xyz) float32, unit normals of the facets, turned to the camera
    sunlit : (row, col) bool; nothing lies between the point and the distant lamp, which is on the
        visible side
    """

    hit: BoolImage
    points_mm: FloatImage
    normals: FloatImage
    sunlit: BoolImage


@renderer_session()
def visible_surface(
    vertices_mm: ArrayLike,
    triangles: ArrayLike,
    camera: ViewCamera,
    towards_lamp: tuple[float, float, float],
) -> VisibleSurface:
    """Cast one ray through each pixel centre.

    Parameters
    ----------
    vertices_mm : (vertex, xyz) float, world
    triangles : (triangle, 3) int
    towards_lamp : direction to a lamp infinitely far away

    Raises
    ------
    MissingBackend : no usable Dr.Jit backend
    """
    import drjit as dr
    import mitsuba as mi

    scene = mi.load_dict(
        {"type": "scene", "relief": mitsuba_mesh("relief", vertices_mm, triangles)}
    )
    directions = _directions(camera)
    ray = mi.Ray3f(mi.Point3f(*camera.eye_mm), mi.Vector3f(directions.astype(np.float32).T))
    met = scene.ray_intersect_preliminary(ray, coherent=True)
    hit = met.is_valid()
    surface = met.compute_surface_interaction(ray)
    normal = dr.select(dr.dot(surface.n, ray.d) > 0.0, -surface.n, surface.n)
    lamp = dr.normalize(mi.Vector3f(*towards_lamp))
    faces_lamp = dr.dot(normal, lamp) > 0.0
    surface.n = normal  # spawn_ray leaves the surface on this side
    free = ~scene.ray_test(surface.spawn_ray(lamp), hit & faces_lamp)
    shape = camera.height_px, camera.width_px
    found = hit.numpy().reshape(shape)
    return VisibleSurface(
        hit=found,
        points_mm=surface.p.numpy().T.reshape(*shape, 3) * found[..., None],
        normals=normal.numpy().T.reshape(*shape, 3),
        sunlit=(hit & faces_lamp & free).numpy().reshape(shape),
    )


def _directions(camera: ViewCamera) -> FloatArray:
    """World directions through the pixel centres, row by row, (n, xyz)."""
    rows, cols = np.mgrid[: camera.height_px, : camera.width_px]
    slopes = camera.pinhole.unproject(np.stack([cols.ravel(), rows.ravel()], axis=-1))
    rays = np.column_stack([slopes, np.ones(len(slopes))]) @ camera.world_from_eye[:3, :3].T
    return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))


Picture = Levels

MOST_BOUNCES = 12
"""Enough for light to leave a hollow clear body: each wall takes two."""

# The sky lights from everywhere; two lamps, high on the left and low on the right, model the form.
_SKY, _KEY, _FILL = 0.5, 1.15, 0.4
# Half the edge of a lamp, in widths of the picture: large and dim, or clear bodies sparkle.
_LAMP = 1.0
_PRIMARIES = 3


@dataclass(frozen=True, eq=False)
class SceneObject:
    """A surface with its colours.

    Attributes
    ----------
    bsdf : for `mi.load_dict`; a tuple of three numbers stands for red, green and blue
    shade : (vertex,) float; albedo of a matte surface at each vertex; the BSDF is then not used
    smooth : with the mesh's vertex normals; faceted otherwise
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


@renderer_session()
def picture(
    objects: Sequence[SceneObject],
    camera: ViewCamera,
    samples: int = 64,
    *,
    gray: bool = False,
    bounces: int = MOST_BOUNCES,
) -> Picture:
    """Render objects before a white background in soft light.

    Parameters
    ----------
    objects : at least one, all names different
    samples : paths per pixel
    gray : True: one pass instead of three, for objects without colours
    bounces : most surfaces that light meets; 4 do where nothing is clear

    Returns
    -------
    (row, col, 3) uint8, sRGB

    Raises
    ------
    MissingBackend : no usable Dr.Jit backend
    """
    passes = [0] if gray else range(_PRIMARIES)
    layers = [_render(_scene(objects, camera, primary, samples, bounces)) for primary in passes]
    light = np.stack(layers * (_PRIMARIES // len(layers)), axis=-1)
    return _srgb(light)


def _render(scene: Any) -> FloatImage:
    """Return the light of one primary over white, (row, col) float, 1 is white."""
    import mitsuba as mi

    image = np.array(mi.render(scene, seed=0))
    light, alpha = image[..., 0], image[..., -1]
    return np.asarray(light + (1.0 - np.clip(alpha, 0.0, 1.0)), np.float32)


def _scene(
    objects: Sequence[SceneObject], camera: ViewCamera, primary: int, samples: int, bounces: int
) -> Any:
    import mitsuba as mi

    sensor = perspective_sensor(camera.pinhole, camera.world_from_eye, samples)
    sensor["film"]["pixel_format"] = "luminance_alpha"
    # One more than bounces: Mitsuba counts the way to the lamp.
    integrator = {"type": "path", "max_depth": bounces + 1, "hide_emitters": True}
    return mi.load_dict(
        {
            "type": "scene",
            "integrator": integrator,
            "sensor": sensor,
            **_lights(camera),
            **{part.name: _mesh(part, primary) for part in objects},
        },
        optimize=False,  # load_dict would merge shapes
    )


def _lights(camera: ViewCamera) -> dict[str, Any]:
    """Sky and two square lamps that follow the camera and the size of what it shows."""
    import mitsuba as mi

    target, size = np.array(camera.target_mm), camera.width_mm
    right, _, forward = camera.world_from_eye[:3, :3].T
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


def _mesh(part: SceneObject, primary: int) -> Any:
    return mitsuba_mesh(
        part.name,
        part.mesh.vertices,
        part.mesh.faces,
        _of_primary(_bsdf(part), primary),
        normals=part.mesh.vertex_normals if part.smooth else None,
        shade=part.shade,
    )


def _bsdf(part: SceneObject) -> dict[str, Any]:
    if part.shade is None:
        return part.bsdf
    reflectance = {"type": "mesh_attribute", "name": "vertex_shade"}
    return {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": reflectance}}


def _of_primary(tree: Any, primary: int) -> Any:
    """Return a dictionary with each colour replaced by its part of one primary."""
    if isinstance(tree, dict):
        return {key: _of_primary(value, primary) for key, value in tree.items()}
    return tree[primary] if isinstance(tree, tuple) else tree


def _srgb(light: FloatImage) -> Picture:
    """Encode linear light, 1 is white (IEC 61966-2-1)."""
    linear = np.clip(light, 0.0, 1.0)
    encoded = np.where(
        linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055
    )
    return np.asarray(np.rint(255.0 * encoded), np.uint8)
