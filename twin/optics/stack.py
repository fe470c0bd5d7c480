"""Result of the renderer: linear radiance of every frame, and the geometric truth per pixel."""

from dataclasses import dataclass

from reconstruction.arrays import BoolImage, FloatImage

Frames = tuple[FloatImage, ...]


@dataclass(frozen=True)
class Truth:
    """What the camera truly sees at each pixel CENTRE.

    Attributes
    ----------
    points_world_mm : (row, col, xyz) float32; surface point; 0 where the ray hits nothing
    normals_world : (row, col, xyz) float32; unit normal of the (smooth) surface there; 0 where the
        ray hits nothing
    depth_mm : (row, col) float32; distance from the camera along its optical axis; 0 where the ray
        hits nothing
    column_px, row_px : (row, col) float32; projector coordinate of that point
    lit : (row, col) bool; the point is seen by the camera and lit by the projector's image
    measured : (row, col) bool; the point lies on what is to be measured (coat or specimen), not on
        the stage
    """

    points_world_mm: FloatImage
    normals_world: FloatImage
    depth_mm: FloatImage
    column_px: FloatImage
    row_px: FloatImage
    lit: BoolImage
    measured: BoolImage


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
