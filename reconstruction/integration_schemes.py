"""Integration schemes, which compute heights from the slopes of photometric stereo.

A scheme is one module of `reconstruction.photometric.schemes`, of an installed package (entry
points of the group `fringe_twin.integrations`) or of the user (`--plugin`). Minimal example:

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
    """Base class of the schemes, which integrate slopes to heights.

    A subclass sets `name`, `title` and `summary` and overrides `heights_mm`.

    Attributes
    ----------
    name : value of the key `integration` that selects the scheme
    title : name in reports and documentation
    summary : one line of documentation
    rank : position in tables and figures, the smallest first; schemes of equal rank by name
    marker_growth_px : width by which the mask of printed dots is enlarged before slopes are filled
        in
    finds_small_markers : whether dots are also detected by their contrast to the gel around them
    corrects_light : whether a change of the lamps' light that varies slowly over the image is
        removed before the slopes are computed
    fills_smoothly : whether slopes under dots continue their surroundings smoothly; False: they are
        those of the nearest pixel outside the dot
    takes_boundary : whether `boundary` "dirichlet", which fixes the height at the image border to
        0, has an effect
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
        """Return the heights (row, col), mm, up to an additive constant.

        Parameters
        ----------
        slopes : (2, row, col) float64, mm/mm, finite: change of height per distance in the
            direction of increasing row (down), then of increasing column (right)
        pitch_mm : distance of neighbouring pixels on the surface
        boundary : "dirichlet": height 0 at the image border; "neumann": free height there
        weights : (row, col) >= 0, proportional to 1 / variance of the slopes; None: equal weights

        Raises
        ------
        FitError : the heights cannot be computed
        """
        raise NotImplementedError(f"integration {self.name!r} has no function heights_mm")


SCHEMES: Registry[IntegrationScheme] = Registry(
    "integrations", "reconstruction.photometric.schemes", lambda scheme: scheme.name
)
"""All integration schemes by name."""


def schemes_in_order() -> list[IntegrationScheme]:
    """Return all schemes in the order in which tables and figures list them."""
    return sorted(SCHEMES, key=lambda scheme: (scheme.rank, scheme.name))
