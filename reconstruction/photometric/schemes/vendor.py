"""The vendor's Poisson step of 2024 and of 2025, with its wrong height scale."""

from reconstruction.arrays import FloatArray
from reconstruction.integration_schemes import SCHEMES, Boundary, IntegrationScheme
from reconstruction.photometric.integrate import Form, sdk_faithful


class VendorIntegration(IntegrationScheme):
    """The behaviour of one year's programs; boundary and weights have no effect."""

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
        """Return heights in the vendor's scale."""
        return sdk_faithful(slopes, pitch_mm, self.form)


# The form of 2025 does not enlarge dots: their dark rims pass for slopes, as in its programs.
SCHEMES.register(VendorIntegration("2025", 1, 0))
SCHEMES.register(VendorIntegration("2024", 2, 2))
