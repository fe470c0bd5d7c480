"""Heights and slopes of a pressed gel that a photometric sensor measured from one image."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from reconstruction.arrays import (
    BoolImage,
    FloatArray,
    FloatImage,
    PhotometricReason,
    ReasonImage,
)
from reconstruction.photometric.rest_surface import RestSurface

if TYPE_CHECKING:
    import xarray

    from reconstruction.drawing import Drawing


@dataclass(frozen=True, eq=False)
class HeightMap:
    """Heights and slopes of a pressed gel measured from one image; row 0 is at the top.

    Heights and slopes are finite at all pixels; at pixels that are not valid they are estimates.

    Parameters
    ----------
    height_mm : (row, col) float32, positive towards the camera, 0 for undeformed gel; on a dome the
        height of the coat above the plane z = 0 of the undeformed coat `rest`
    slopes : (2, row, col) float32, mm/mm, downwards and to the right
    mask_reason : (row, col) uint8, reason why a pixel is not valid, see `PhotometricReason`
    pitch_mm : distance of neighbouring pixels on the surface; on a dome on the plane z = 0
    rest : undeformed coat of a domed gel; None: the gel is flat
    """

    height_mm: FloatImage
    slopes: FloatImage
    mask_reason: ReasonImage
    pitch_mm: float
    rest: RestSurface | None = None

    @property
    def relief_mm(self) -> FloatImage:
        """Height above the undeformed gel, (row, col), mm."""
        if self.rest is None:
            return self.height_mm
        return np.asarray(self.height_mm - self.rest.points_mm[..., 2])

    @property
    def valid(self) -> BoolImage:
        """Pixels with a measured slope, (row, col) bool: those without a reason code."""
        return np.asarray(self.mask_reason == PhotometricReason.VALID)

    def points_mm(self) -> FloatArray:
        """Return the valid points (n, xyz), mm, row by row: x right, y up, z towards the camera.

        The origin is the middle of the image, at the height 0.
        """
        if self.rest is not None:
            return self.rest.points_at(self.height_mm)[self.valid]
        row, col = np.nonzero(self.valid)
        rows, cols = self.height_mm.shape
        x = (col - 0.5 * (cols - 1)) * self.pitch_mm
        y = (0.5 * (rows - 1) - row) * self.pitch_mm
        return np.column_stack([x, y, self.height_mm[row, col].astype(np.float64)])

    def __repr__(self) -> str:
        shown = ", ".join(f"{name} {value}" for name, value in self._in_short().items())
        rows, cols = self.height_mm.shape
        return f"<HeightMap: {rows} x {cols} pixels of {self.pitch_mm:.3g} mm, {shown}>"

    def _repr_html_(self) -> str:
        from reconstruction.drawing import as_html

        return as_html("height map", self._in_short(), self.plot())

    def _in_short(self) -> dict[str, str]:
        """Return the share of valid pixels and the range of their heights as texts, by name."""
        valid = self.valid
        shown = {"points": f"{100 * valid.mean():.1f} % of all pixels"}
        if valid.any():
            low, high = float(self.height_mm[valid].min()), float(self.height_mm[valid].max())
            shown["heights"] = f"{low:.3g} to {high:.3g} mm"
        return shown

    def plot(self) -> "Drawing":
        """Return a figure of heights, mm, steepness, degrees, and a section of the heights.

        Raises
        ------
        InputError : no pixel is valid
        """
        from reconstruction.photometric.presentation import height_drawing

        return height_drawing(self)

    def to_xarray(self) -> "xarray.Dataset":
        """Return heights, slopes and reason codes over image row and column.

        The coordinates x and y, mm, of columns and rows are included.
        """
        from reconstruction.photometric.presentation import height_arrays, places_mm

        x_mm, y_mm = places_mm(self)
        places = {"x": ("col", x_mm, {"units": "mm"}), "y": ("row", y_mm, {"units": "mm"})}
        return height_arrays(self).to_xarray().assign_coords(places)
