"""Where an observer's rays meet a surface: for shaded pictures of measured reliefs, without noise.

World frame, mm. Row 0 of a picture is its top.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from reconstruction.arrays import FloatImage
from twin.optics.backend import activate
from twin.optics.observer import Observer


@dataclass(frozen=True, eq=False)
class Sight:
    """What lies behind each pixel centre.

    Attributes
    ----------
    hit : (row, col) bool
    points_mm : (row, col, xyz) float32, 0 where nothing is hit
    normals : (row, col, xyz) float32, unit normals of the facets, turned to the observer
    sunlit : (row, col) bool
        Nothing lies between the point and the distant lamp, which is on the visible side.
    """

    hit: NDArray[np.bool_]
    points_mm: FloatImage
    normals: FloatImage
    sunlit: NDArray[np.bool_]


def look(
    vertices_mm: NDArray[Any],
    triangles: NDArray[Any],
    observer: Observer,
    towards_lamp: tuple[float, float, float],
) -> Sight:
    """Cast one ray through each pixel centre.

    Parameters
    ----------
    vertices_mm : (vertex, xyz) float, world
    triangles : (triangle, 3) int
    observer : Observer
    towards_lamp : direction to a lamp infinitely far away

    Raises
    ------
    MissingBackend
        No usable Dr.Jit backend.
    """
    activate()
    import drjit as dr
    import mitsuba as mi

    scene = mi.load_dict({"type": "scene", "relief": _surface(vertices_mm, triangles)})
    directions = _directions(observer)
    ray = mi.Ray3f(mi.Point3f(*observer.eye_mm), mi.Vector3f(directions.astype(np.float32).T))
    met = scene.ray_intersect_preliminary(ray, coherent=True)
    hit = met.is_valid()
    surface = met.compute_surface_interaction(ray)
    normal = dr.select(dr.dot(surface.n, ray.d) > 0.0, -surface.n, surface.n)
    lamp = dr.normalize(mi.Vector3f(*towards_lamp))
    faces_lamp = dr.dot(normal, lamp) > 0.0
    surface.n = normal  # spawn_ray leaves the surface on this side
    free = ~scene.ray_test(surface.spawn_ray(lamp), hit & faces_lamp)
    shape = observer.height_px, observer.width_px
    found = hit.numpy().reshape(shape)
    return Sight(
        hit=found,
        points_mm=surface.p.numpy().T.reshape(*shape, 3) * found[..., None],
        normals=normal.numpy().T.reshape(*shape, 3),
        sunlit=(hit & faces_lamp & free).numpy().reshape(shape),
    )


def _surface(vertices_mm: NDArray[Any], triangles: NDArray[Any]) -> Any:
    import mitsuba as mi

    mesh = mi.Mesh("relief", vertex_count=len(vertices_mm), face_count=len(triangles))
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = np.asarray(vertices_mm, np.float32).ravel()
    parameters["faces"] = np.asarray(triangles, np.uint32).ravel()
    parameters.update()
    return mesh


def _directions(observer: Observer) -> NDArray[np.float64]:
    """World directions through the pixel centres, row by row, (n, xyz)."""
    rows, cols = np.mgrid[: observer.height_px, : observer.width_px]
    slopes = observer.pinhole.unproject(np.stack([cols.ravel(), rows.ravel()], axis=-1))
    rays = np.column_stack([slopes, np.ones(len(slopes))]) @ observer.world_from_eye[:3, :3].T
    return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))
