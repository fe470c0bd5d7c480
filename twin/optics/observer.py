"""External view camera: where it stands, what its image shows, where its rays meet a surface.

For shaded pictures of measured reliefs, without noise; the measurement does not use this module.
World frame, mm; pixels as everywhere: (0, 0) is the CENTRE of the first, row 0 is the top.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from reconstruction.arrays import FloatArray, FloatImage
from reconstruction.rig.pinhole import Pinhole
from twin.optics.backend import activate
from twin.optics.materials import mitsuba_mesh

Point = tuple[float, float, float]


@dataclass(frozen=True)
class Observer:
    """A pinhole eye that looks at a point, the world's z axis upright in its picture."""

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
class Sighted:
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
) -> Sighted:
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

    scene = mi.load_dict(
        {"type": "scene", "relief": mitsuba_mesh("relief", vertices_mm, triangles)}
    )
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
    return Sighted(
        hit=found,
        points_mm=surface.p.numpy().T.reshape(*shape, 3) * found[..., None],
        normals=normal.numpy().T.reshape(*shape, 3),
        sunlit=(hit & faces_lamp & free).numpy().reshape(shape),
    )


def _directions(observer: Observer) -> NDArray[np.float64]:
    """World directions through the pixel centres, row by row, (n, xyz)."""
    rows, cols = np.mgrid[: observer.height_px, : observer.width_px]
    slopes = observer.pinhole.unproject(np.stack([cols.ravel(), rows.ravel()], axis=-1))
    rays = np.column_stack([slopes, np.ones(len(slopes))]) @ observer.world_from_eye[:3, :3].T
    return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))
