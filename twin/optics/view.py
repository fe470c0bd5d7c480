"""Scene description of all 3-D pictures: surfaces, lines and views, for any output medium.

Coordinates are in the world frame, mm. One module draws the scene for each output medium:

| medium | module |
|---|---|
| picture in soft light, with materials | `twin.optics.picture` |
| figure of a relief, by Matplotlib | `twin.report.relief` |
| 3-D view in a report, turned by dragging | `twin.report.view` |
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
    """A triangle mesh with colours. The vertices may be the points of a grid.

    Attributes
    ----------
    name : label, unique in its scene
    vertices_mm : (vertex, xyz); those of a grid are row by row, NaN where there is no point
    triangles : (triangle, 3) int, indices of vertices
    rgb : (3,) or (vertex, 3), 0 to 1: colour on a screen; reflectance in a picture with materials
    bsdf : material for `mi.load_dict`, used instead of `rgb`; None: `rgb` is used
    normals : (vertex, xyz) unit normals of a smooth surface; None: the surface is faceted
    cells : (row - 1, col - 1) bool, of a grid; True where the four vertices of a cell are joined;
        None: the vertices are no grid
    scale : colour map and range from which `rgb` was computed; None: not computed from values
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
        """Return the surface of a mesh in the colour `rgb`, or with the material `bsdf`.

        If `smooth` is True, the surface is shaded with vertex normals, otherwise by facets.
        """
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
        values : (row, col); `scale` converts them to colours
        cut : cells are omitted if an edge is longer than `cut` times the median edge; None: no
            limit
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
    """Return True for cells, (row - 1, col - 1), with four finite edges that are not too long.

    The limit is `cut` times the median length of all edges; None: no limit.
    """
    across, down = (np.linalg.norm(np.diff(points_mm, axis=axis), axis=-1) for axis in (1, 0))
    longest = np.maximum.reduce([across[:-1], across[1:], down[:, :-1], down[:, 1:]])
    known = np.concatenate([edges[np.isfinite(edges)] for edges in (across, down)])
    limit_mm = np.inf if cut is None or not known.size else cut * np.median(known)
    return np.asarray(longest <= limit_mm)  # False where it is NaN


@dataclass(frozen=True, eq=False)
class SceneLines:
    """Straight line segments of one colour.

    Attributes
    ----------
    name : label, unique in its scene
    ends_mm : (end, xyz) float32, two ends per segment
    rgb : colour, 0 to 255
    """

    name: str
    ends_mm: NDArray[np.float32]
    rgb: tuple[int, int, int]

    @classmethod
    def along(cls, name: str, paths: list[FloatArray], rgb: tuple[int, int, int]) -> "SceneLines":
        """Return the line segments of polylines, each (corner, xyz), mm."""
        pairs = [np.stack((path[:-1], path[1:]), axis=1).reshape(-1, 3) for path in paths]
        return cls(name, np.concatenate(pairs).astype("<f4"), rgb)


@dataclass(frozen=True)
class SceneView:
    """A pinhole camera that looks at a target; the world's z axis is upright in its picture.

    Attributes
    ----------
    eye_mm, target_mm : world positions of the pinhole and of the point in the picture's centre
    width_mm : width of the picture in the plane through the target, perpendicular to the view
    width_px, height_px : size of the picture
    enlarged : factor by which z is exaggerated
    shows : names of the surfaces and lines that are visible at first; empty: all
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
        """Return the view of a target from the direction `turn_rad`, `lift_rad`.

        The angles are those of `turn_and_lift_rad`. The default distance is twice the width.
        """
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
        """Intrinsics of the camera, px."""
        distance_mm = float(np.linalg.norm(np.subtract(self.target_mm, self.eye_mm)))
        focal_px = self.width_px * distance_mm / self.width_mm
        centre = (self.width_px - 1) / 2, (self.height_px - 1) / 2
        return Pinhole(self.width_px, self.height_px, focal_px, focal_px, *centre)

    @property
    def world_from_eye(self) -> FloatArray:
        """Pose T_world_from_eye (4, 4), mm; the frame of the eye is OpenCV's (y down, z forward).

        In a view straight down, world +y is at the top of the picture.
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
        """Return the image coordinates (..., 2), px, of world points (..., xyz), mm.

        (0, 0) is the centre of the first pixel.
        """
        pose = self.world_from_eye
        return self.pinhole.project((np.asarray(points_world_mm) - pose[:3, 3]) @ pose[:3, :3])


def point(xyz: FloatArray) -> Point:
    """Return the three coordinates as a tuple of Python floats."""
    x, y, z = (float(value) for value in xyz)
    return x, y, z


@dataclass(frozen=True, eq=False)
class SceneDescription:
    """Content of a 3-D picture: surfaces, lines, and views by their name."""

    surfaces: tuple[SceneSurface, ...]
    lines: tuple[SceneLines, ...] = ()
    views: Mapping[str, SceneView] = field(default_factory=dict)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all surfaces and lines."""
        return (*(part.name for part in self.surfaces), *(part.name for part in self.lines))
