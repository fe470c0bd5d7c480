"""Scene description of all 3-D pictures: surfaces, lines and views, independent of the drawer.

World frame, mm. Each output medium has one drawer:

| medium | drawer |
|---|---|
| picture in soft light, with materials | `twin.optics.picture` |
| figure of a relief, by Matplotlib | `twin.report.relief` |
| view in a report that the reader turns | `twin.report.view` |
| live view in a browser | `twin.viewer.live` |
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from reconstruction.arrays import BoolImage, FloatArray
from reconstruction.rig.pinhole import Pinhole

if TYPE_CHECKING:
    import trimesh
    from matplotlib.cm import ScalarMappable

Point = tuple[float, float, float]
Numbers = NDArray[np.floating[Any]]


@dataclass(frozen=True, eq=False)
class SceneSurface:
    """A triangle mesh with its colours; or a surface over a grid, which has triangles as well.

    Attributes
    ----------
    name : label, unique in its scene
    vertices_mm : (vertex, xyz); of a grid row by row, NaN where there is no point
    triangles : (triangle, 3) int, indices of vertices
    rgb : (3,) or (vertex, 3), 0 to 1: colour on a screen; reflectance in a picture with materials
    bsdf : material for `mi.load_dict` instead of `rgb`
    normals : (vertex, xyz) unit normals of a smooth surface; faceted without
    cells : of a grid, (row - 1, col - 1) bool; True where the four vertices are joined
    scale : colour map with the range from which `rgb` was computed
    """

    name: str
    vertices_mm: Numbers
    triangles: NDArray[np.integer[Any]]
    rgb: FloatArray
    bsdf: Mapping[str, Any] | None = None
    normals: Numbers | None = None
    cells: BoolImage | None = None
    scale: "ScalarMappable | None" = None

    @classmethod
    def of_mesh(
        cls,
        name: str,
        mesh: "trimesh.Trimesh",
        rgb: ArrayLike = (0.5, 0.5, 0.5),
        *,
        bsdf: Mapping[str, Any] | None = None,
        smooth: bool = False,
    ) -> "SceneSurface":
        """Return a mesh with its colours; `smooth` uses the normals of its vertices."""
        normals = np.asarray(mesh.vertex_normals) if smooth else None
        corners, facets = np.asarray(mesh.vertices), np.asarray(mesh.faces)
        return cls(name, corners, facets, np.asarray(rgb, np.float64), bsdf, normals)

    @classmethod
    def of_grid(
        cls,
        name: str,
        points_mm: Numbers,
        values: NDArray[Any],
        scale: "ScalarMappable",
        *,
        cut: float | None = None,
    ) -> "SceneSurface":
        """Return a surface of triangles between neighbouring points of a grid.

        Parameters
        ----------
        points_mm : (row, col, xyz), row 0 at the top
        values : (row, col), shown as colours by `scale`
        cut : cells with an edge this many times longer than the median edge are left out
        """
        cells = _joined(points_mm, cut)
        number = np.arange(points_mm[..., 0].size).reshape(points_mm.shape[:2])
        a, b, c, d = number[:-1, :-1], number[:-1, 1:], number[1:, :-1], number[1:, 1:]
        triangles = np.stack([a, c, b, b, c, d], axis=-1)[cells].reshape(-1, 3)
        rgb = scale.to_rgba(np.ma.masked_invalid(values))[..., :3].reshape(-1, 3)
        return cls(name, points_mm.reshape(-1, 3), triangles, rgb, cells=cells, scale=scale)

    @property
    def grid_mm(self) -> Numbers:
        """Vertices of a surface over a grid, (row, col, xyz)."""
        assert self.cells is not None
        rows, cols = self.cells.shape
        return self.vertices_mm.reshape(rows + 1, cols + 1, 3)


def _joined(points_mm: Numbers, cut: float | None) -> BoolImage:
    """Return the cells (row - 1, col - 1) of which all four edges are known and short."""
    across, down = (np.linalg.norm(np.diff(points_mm, axis=axis), axis=-1) for axis in (1, 0))
    longest = np.maximum.reduce([across[:-1], across[1:], down[:, :-1], down[:, 1:]])
    known = np.concatenate([edges[np.isfinite(edges)] for edges in (across, down)])
    limit_mm = np.inf if cut is None or not known.size else cut * np.median(known)
    return np.asarray(longest <= limit_mm)  # False where it is NaN


@dataclass(frozen=True, eq=False)
class SceneLines:
    """Straight pieces of one colour.

    Attributes
    ----------
    name : label, unique in its scene
    ends_mm : (end, xyz) float32, two ends per piece
    rgb : 0 to 255
    """

    name: str
    ends_mm: NDArray[np.float32]
    rgb: tuple[int, int, int]

    @classmethod
    def along(cls, name: str, paths: list[FloatArray], rgb: tuple[int, int, int]) -> "SceneLines":
        """Return the pieces of paths, each (corner, xyz)."""
        pairs = [np.stack((path[:-1], path[1:]), axis=1).reshape(-1, 3) for path in paths]
        return cls(name, np.concatenate(pairs).astype("<f4"), rgb)


@dataclass(frozen=True)
class SceneView:
    """A pinhole camera that looks at a point, the world's z axis upright in its picture.

    Attributes
    ----------
    width_mm : width of the picture on the plane through the target, across the view
    enlarged : factor on z
    shows : names of the parts of the scene that are shown at first; all where it is empty
    """

    eye_mm: Point
    target_mm: Point
    width_mm: float
    width_px: int = 640
    height_px: int = 480
    enlarged: float = 1.0
    shows: tuple[str, ...] = ()

    @classmethod
    def around(
        cls,
        target_mm: ArrayLike,
        width_mm: float,
        turn_rad: float,
        lift_rad: float,
        distance_mm: float | None = None,
        **more: Any,
    ) -> "SceneView":
        """Return the view from a direction, see `turn_and_lift_rad`; by default two widths away."""
        across, target = np.cos(lift_rad), np.asarray(target_mm, np.float64)
        towards = across * np.sin(turn_rad), -across * np.cos(turn_rad), np.sin(lift_rad)
        eye = target + (distance_mm or 2 * width_mm) * np.array(towards)
        return cls(point(eye), point(target), width_mm, **more)

    @property
    def towards_eye(self) -> FloatArray:
        """Unit vector from target to eye."""
        away = np.subtract(self.eye_mm, self.target_mm)
        return np.asarray(away / np.linalg.norm(away))

    @property
    def turn_and_lift_rad(self) -> tuple[float, float]:
        """Direction of the eye: angle about z, 0 towards -y; and elevation above the xy plane."""
        x, y, z = self.towards_eye
        return float(np.arctan2(x, -y)), float(np.arcsin(z))

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
        """Return the pixels (..., 2) of world points (..., 3); (0, 0) is a pixel's centre."""
        pose = self.world_from_eye
        return self.pinhole.project((np.asarray(points_world_mm) - pose[:3, 3]) @ pose[:3, :3])


def point(xyz: FloatArray) -> Point:
    """Return (xyz) as floats."""
    x, y, z = (float(value) for value in xyz)
    return x, y, z


@dataclass(frozen=True, eq=False)
class SceneDescription:
    """Surfaces, lines and views, each by its name."""

    surfaces: tuple[SceneSurface, ...]
    lines: tuple[SceneLines, ...] = ()
    views: Mapping[str, SceneView] = field(default_factory=dict)

    @property
    def names(self) -> tuple[str, ...]:
        """Labels of surfaces and lines."""
        return (*(part.name for part in self.surfaces), *(part.name for part in self.lines))
