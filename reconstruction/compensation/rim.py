"""Add a compliant rim, springs at the rim's nodes, to the boundary conditions of a sheet.

Lengths are in mm. The edge of the sheet moves in the frame's plane by u under the component of the
line tension N in that plane: k u = N cos t. Here t is the angle at which the sheet leaves the frame
and k = 1 / compliance. `membrane` computes the stretch along the surface, also round the clamp's
bend. There the full N acts on the springs, so that their stiffness is k / cos t.

Over the clamp's bend the relief is horizontal; t is extrapolated from the span next to the bend.
"""

from dataclasses import replace

import numpy as np
from scipy import ndimage

from reconstruction.arrays import FloatArray
from reconstruction.compensation.membrane import SurfaceMetric
from reconstruction.compensation.relief import Relief, SheetOpening

_RIM_POINTS, _HANGS = 2048, 1e-3
# Distances inside the rim at which the slope is taken, outside the clamp's bend; filter of the
# normals.
_NEAR_MM, _FAR_MM, _SMOOTHED_MM = 0.8, 1.6, 0.1
_STEEPEST_COSINE = 0.25
# Stiffer springs only reduce the numerical precision of the map.
_RIGID_MM = 1e-4


def on_springs(
    surface: SurfaceMetric, relief: Relief, frame: SheetOpening, rim_yield_mm: float
) -> SurfaceMetric:
    """Return the surface metric with springs at its rim, or unchanged for a nearly rigid rim.

    Parameters
    ----------
    rim_yield_mm : compliance of the rim times shear modulus times thickness of the sheet
    """
    if rim_yield_mm < _RIGID_MM:
        return surface
    free = np.pad(~surface.held, 1)
    rim_nodes = surface.held & ndimage.binary_dilation(free, np.ones((3, 3)))[1:-1, 1:-1]
    x, y = np.meshgrid(surface.x_mm, surface.y_mm)
    nodes = np.stack((x[rim_nodes], y[rim_nodes]), axis=-1)
    lengths = _nearest_lengths_mm(frame, nodes)
    springs = np.zeros(surface.held.shape)
    springs[rim_nodes] = lengths / (rim_yield_mm * _cosines(relief, frame, nodes))
    return replace(surface, springs=springs)


def _nearest_lengths_mm(frame: SheetOpening, nodes_mm: FloatArray) -> FloatArray:
    """Return (n,) length of the part of the rim, mm, that is nearest to each node (n, xy)."""
    places, perimeter_mm = _along_rim(frame)
    away = (places[:, 0, None] - nodes_mm[:, 0]) ** 2 + (places[:, 1, None] - nodes_mm[:, 1]) ** 2
    count = np.bincount(away.argmin(axis=1), minlength=len(nodes_mm))
    # A corner node of a round rim on the grid may be nearest to no point: it gets a small length.
    return np.asarray(perimeter_mm / _RIM_POINTS * np.maximum(count, _HANGS))


def _along_rim(frame: SheetOpening) -> tuple[FloatArray, float]:
    """Return (n, xy) points at equal distances along the rim, and the rim's length; mm."""
    share = (np.arange(_RIM_POINTS) + 0.5) / _RIM_POINTS
    half_x, half_y = frame.length_x_mm / 2, frame.length_y_mm / 2
    if frame.is_round:
        turn = 2 * np.pi * share
        return half_x * np.stack((np.cos(turn), np.sin(turn)), axis=-1), 2 * np.pi * half_x
    ends = np.cumsum([0.0, 2 * half_x, 2 * half_y, 2 * half_x, 2 * half_y])
    x = np.interp(share * ends[-1], ends, half_x * np.array([-1, 1, 1, -1, -1]))
    y = np.interp(share * ends[-1], ends, half_y * np.array([-1, -1, 1, 1, -1]))
    return np.stack((x, y), axis=-1), float(ends[-1])


def _cosines(relief: Relief, frame: SheetOpening, nodes_mm: FloatArray) -> FloatArray:
    """Return (n,) cosine of the angle at which the sheet leaves the rim near each node (n, xy)."""
    outwards = _outwards(frame, nodes_mm)
    down, right = np.gradient(relief.smoothed(_SMOOTHED_MM), relief.y_mm, relief.x_mm)

    def angle(within_mm: float) -> FloatArray:
        x, y = (nodes_mm - within_mm * outwards).T
        at = [
            (coordinate - axis[0]) / (axis[1] - axis[0])
            for coordinate, axis in ((y, relief.y_mm), (x, relief.x_mm))
        ]
        by_y, by_x = (
            ndimage.map_coordinates(slope, at, order=1, mode="nearest") for slope in (down, right)
        )
        return np.asarray(np.arctan(by_x * outwards[:, 0] + by_y * outwards[:, 1]))

    near, far = angle(_NEAR_MM), angle(_FAR_MM)
    steep = near + (near - far) * _NEAR_MM / (_FAR_MM - _NEAR_MM)
    limit = np.arccos(_STEEPEST_COSINE)
    return np.asarray(np.cos(np.clip(steep, -limit, limit)))


def _outwards(frame: SheetOpening, nodes_mm: FloatArray) -> FloatArray:
    """Return (n, xy) unit vectors normal to the rim near each node, pointing outwards."""
    if frame.is_round:
        return np.asarray(nodes_mm / np.linalg.norm(nodes_mm, axis=1, keepdims=True))
    share = np.abs(nodes_mm) * 2 / (frame.length_x_mm, frame.length_y_mm)
    along_x = (share[:, 0] >= share[:, 1]).astype(np.float64)
    return np.stack((along_x, 1.0 - along_x), axis=-1) * np.sign(nodes_mm)
