"""Integration scheme with the exact Poisson solver, or with weighted least squares."""

from reconstruction.arrays import FloatArray
from reconstruction.integration_schemes import SCHEMES, Boundary, IntegrationScheme
from reconstruction.photometric.integrate import corrected


class CorrectedIntegration(IntegrationScheme):
    """Integration scheme of least squares: the heights that best fit the slopes."""

    name = "corrected"
    title = "corrected"
    summary = "least-squares heights, with the true scale"
    rank = 0
    takes_boundary = True

    def heights_mm(
        self, slopes: FloatArray, pitch_mm: float, boundary: Boundary, weights: FloatArray | None
    ) -> FloatArray:
        """Return the heights (row, col), mm, of `corrected` for slopes (2, row, col), mm/mm."""
        return corrected(slopes, pitch_mm, boundary, weights)


SCHEMES.register(CorrectedIntegration())
