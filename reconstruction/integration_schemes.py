"""Integration schemes of photometric stereo: from slopes to heights. One scheme per module.

A scheme is a file of `reconstruction.photometric.schemes`, of an installed package (entry points of
the group `fringe_twin.integrations`) or of the user (`--plugin`). Minimal example:

    class RowByRow(IntegrationScheme):
        name, title = "row_by_row", "row by row"
        summary = "sum of the slopes along each row"

        def heights_mm(self, slopes, pitch_mm, boundary, weights):
            return pitch_mm * np.cumsum(slopes[1], axis=1)

    SCHEMES.register(RowByRow())

Frame: row 0 at the top; heights positive towards the camera.
"""

from typing import Literal

from reconstruction.arrays import FloatArray
from reconstruction.registry import Registry

Boundary = Literal["neumann", "dirichlet"]


class IntegrationScheme:
    """Integration of slopes to heights. A scheme sets `name`, `title`, `summary` and its options.

    Attributes
    ----------
    name : value of the key `integration`
    title : name in reports and documentation
    summary : one line of documentation
    rank : position in tables and figures, the smallest first; equal ranks by name
    marker_growth_px : width by which printed dots are enlarged before slopes are filled in
    finds_small_markers : whether dots are also detected by their contrast to the gel around them
    corrects_light : whether a slow change of the lamps' light is removed first
    fills_smoothly : slopes under dots are smooth continuations; False: those of the nearest pixel
    takes_boundary : whether `boundary` = dirichlet fixes the height at the border to 0
    """

    name: str
    title: str
    summary: str
    rank: int = 100
    marker_growth_px: int = 2
    finds_small_markers: bool = True
    corrects_light: bool = True
    fills_smoothly: bool = True
    takes_boundary: bool = False

    def heights_mm(
        self, slopes: FloatArray, pitch_mm: float, boundary: Boundary, weights: FloatArray | None
    ) -> FloatArray:
        """Return heights (row, col), mm, up to a constant.

        Parameters
        ----------
        slopes : (2, row, col) float64, mm/mm, along rows (down) and along columns (right); finite
        pitch_mm : distance of neighbouring pixels on the surface
        weights : (row, col) >= 0, proportional to 1 / variance of the slopes; None: equal weights

        Raises
        ------
        FitError : the heights cannot be computed
        """
        raise NotImplementedError(f"integration {self.name!r} has no function heights_mm")


SCHEMES: Registry[IntegrationScheme] = Registry(
    "integrations", "reconstruction.photometric.schemes", lambda scheme: scheme.name
)
"""The integration schemes."""


def schemes_in_order() -> list[IntegrationScheme]:
    """Return all schemes in the order of tables and figures."""
    return sorted(SCHEMES, key=lambda scheme: (scheme.rank, scheme.name))
