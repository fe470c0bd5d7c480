"""The exact Poisson solver, or weighted least squares."""

from reconstruction.arrays import FloatArray
from reconstruction.integration_schemes import SCHEMES, Boundary, IntegrationScheme
from reconstruction.photometric.integrate import corrected


class CorrectedIntegration(IntegrationScheme):
    """Heights whose steps fit the slopes best."""

    name = "corrected"
    title = "corrected"
    summary = "least-squares heights, with the true scale"
    rank = 0
    takes_boundary = True

    def heights_mm(
        self, slopes: FloatArray, pitch_mm: float, boundary: Boundary, weights: FloatArray | None
    ) -> FloatArray:
        """Return least-squares heights."""
        return corrected(slopes, pitch_mm, boundary, weights)


SCHEMES.register(CorrectedIntegration())
