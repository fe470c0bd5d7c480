"""The `spectral` model: the exact linear slab, see `twin.mechanics.press`."""

from twin.mechanics.models import MODELS, ElastomerModel, PressInput, Progress
from twin.mechanics.press import PressedElastomer


class SpectralModel(ElastomerModel):
    """A linear, frictionless slab on a simply supported rim, or bonded to a window."""

    name = "spectral"
    summary = "exact linear slab, while deflections are small"
    is_automatic = True
    is_linear_slab = True

    def error_estimate_mm(self, case: PressInput) -> float | None:
        """Return the effect of large strain; None: stretching, which it neglects, matters."""
        return None if case.stretches else case.linear.validity.height_error_mm

    def press(self, case: PressInput, progress: Progress | None = None) -> PressedElastomer:
        """Return the linear press, that of the estimate if there was one."""
        return case.linear


SPECTRAL = MODELS.register(SpectralModel())
