"""Integration schemes of the vendor's programs of 2024 and 2025, with their wrong height scale."""

from reconstruction.arrays import FloatArray
from reconstruction.integration_schemes import SCHEMES, Boundary, IntegrationScheme
from reconstruction.photometric.integrate import Form, sdk_faithful


class VendorIntegration(IntegrationScheme):
    """Integration scheme of the vendor's programs of one year.

    It ignores the boundary condition and the weights.
    """

    finds_small_markers = False
    corrects_light = False
    fills_smoothly = False

    def __init__(self, form: Form, rank: int, marker_growth_px: int) -> None:
        self.form, self.rank, self.marker_growth_px = form, rank, marker_growth_px
        self.name, self.title = f"sdk_{form}", f"vendor {form}"
        self.summary = f"as the vendor's programs of {form}, its height scale included"

    def heights_mm(
        self, slopes: FloatArray, pitch_mm: float, boundary: Boundary, weights: FloatArray | None
    ) -> FloatArray:
        """Return the heights (row, col), nominally mm, with the vendor's wrong scale."""
        return sdk_faithful(slopes, pitch_mm, self.form)


# The programs of 2025 do not enlarge dots, so that the dark rims of dots are decoded as slopes.
SCHEMES.register(VendorIntegration("2025", 1, 0))
SCHEMES.register(VendorIntegration("2024", 2, 2))
