"""Result of the renderer: linear radiance of every frame, and the geometric truth per pixel."""

from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np

from reconstruction.arrays import BoolImage, FloatArray, FloatImage

Frames = tuple[FloatImage, ...]


@dataclass(frozen=True)
class Truth:
    """True geometry at each pixel CENTRE of the camera.

    Attributes
    ----------
    points_world_mm : (row, col, xyz) float32; surface point; 0 without a hit
    normals_world : (row, col, xyz) float32; unit normal of the (smooth) surface there; 0
        without a hit
    depth_mm : (row, col) float32; distance from the camera along its optical axis; 0 without a
        hit
    column_px, row_px : (row, col) float32; projector coordinate of that point
    lit : (row, col) bool; the point is visible to the camera and lit by the projector's image
    measured : (row, col) bool; the point is on the measured surface (coat or specimen), not on the
        stage
    """

    points_world_mm: FloatImage
    normals_world: FloatImage
    depth_mm: FloatImage
    column_px: FloatImage
    row_px: FloatImage
    lit: BoolImage
    measured: BoolImage


@dataclass(frozen=True, eq=False)
class TraceMaps:
    """Sums over the rays of each camera pixel, independent of patterns; all (row, col) float64.

    Attributes
    ----------
    weight : radiance under a full white field, mW / (mm^2 sr)
    column_px, row_px : weighted mean of the projector coordinates
    axial_mm : weighted mean distance along the projector's axis
    column_range_px, row_range_px : between the farthest two lit samples
    lit : bool; light arrives
    samples : rays per pixel
    """

    weight: FloatArray
    column_px: FloatArray
    row_px: FloatArray
    axial_mm: FloatArray
    column_range_px: FloatArray
    row_range_px: FloatArray
    lit: BoolImage
    samples: int


@dataclass(frozen=True)
class RadianceStack:
    """All frames of one sequence, without any sensor.

    Attributes
    ----------
    frames : tuple of (row, col) float32, mW / (mm^2 sr) Mean radiance over each camera pixel, in
        the order of the sequence. Not one array: at full size a stack has 600 MB, and the camera
        takes it frame by frame.
    """

    frames: Frames
    truth: Truth


Images = TypeVar("Images", Truth, TraceMaps)


def rows_of(images: Images, band: slice) -> Images:
    """Return some rows of all images."""
    fields: dict[str, Any] = vars(images)
    rows: dict[str, Any] = {k: v[band] for k, v in fields.items() if isinstance(v, np.ndarray)}
    return replace(images, **rows)
