"""Results of the renderer: linear radiance of every frame, and the true geometry at each pixel."""

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
    normals_world : (row, col, xyz) float32; unit normal of the (smooth) surface at this point; 0
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
    """Light and projector position of each camera pixel, for any pattern; (row, col) float64.

    Means are taken over the rays of a pixel, weighted by their radiance.

    Attributes
    ----------
    weight : radiance under a full white field, mW / (mm^2 sr)
    column_px, row_px : mean projector coordinates
    axial_mm : mean distance along the projector's axis
    column_range_px, row_range_px : difference of the projector coordinates of the farthest two lit
        rays
    lit : (row, col) bool; True where light of the projector reaches the pixel
    samples : number of rays per pixel
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
class MotionAccuracy:
    """How the frames of a moving scene were computed, and their error.

    The errors are those of random pixels of random frames against their own trace, with one more
    time in each exposure. They exclude light between surfaces.

    Attributes
    ----------
    moments : number of instants at which all pixels were traced
    exposure_nodes : times in each exposure over which the light is integrated
    crossed_share : share of the lit pixels that cross an edge, or more, during the sequence
    radiance_rms_percent : error of the radiance, percent of the mean radiance in white light
    coordinate_rms_px : error of the projector column of smooth pixels
    moved_px : median change of a pixel's projector coordinate from the first to the last moment, of
        the axis with the larger change
    """

    moments: int
    exposure_nodes: int
    crossed_share: float
    radiance_rms_percent: float
    coordinate_rms_px: float
    moved_px: float


@dataclass(frozen=True)
class RadianceStack:
    """Radiance of all frames of one pattern sequence, before the camera model is applied.

    Attributes
    ----------
    frames : tuple of (row, col) float32, mW / (mm^2 sr); mean radiance of each camera pixel, in the
        order of the sequence. The frames are separate arrays, because a full-size stack has 600 MB
        and the camera model processes one frame at a time.
    truth : true geometry at each pixel centre; of a moving scene that of the sequence's middle
    motion : error of the frames of a moving scene; None: the scene is at rest
    """

    frames: Frames
    truth: Truth
    motion: MotionAccuracy | None = None


Images = TypeVar("Images", Truth, TraceMaps)


def rows_of(images: Images, band: slice) -> Images:
    """Return the rows `band` of all images in a `Truth` or `TraceMaps`."""
    fields: dict[str, Any] = vars(images)
    rows: dict[str, Any] = {k: v[band] for k, v in fields.items() if isinstance(v, np.ndarray)}
    return replace(images, **rows)
