"""The `spectral` model: the exact linear slab, see `twin.mechanics.press`."""

from twin.mechanics.models import MODELS, ElastomerModel, PressInput, Progress
from twin.mechanics.press import PressedElastomer


class SpectralModel(ElastomerModel):
    """A linear slab, frictionless, on a simply supported rim or bonded to a window."""

    name = "spectral"
    summary = "exact linear slab, while deflections are small"
    is_automatic = True
    is_linear_slab = True

    def error_estimate_mm(self, case: PressInput) -> float | None:
        """Return the expected height error, mm, that results from neglecting large strain.

        The result is None if the elastomer stretches as it bends, which the model neglects too.
        """
        return None if case.stretches else case.linear.validity.height_error_mm

    def press(self, case: PressInput, progress: Progress | None = None) -> PressedElastomer:
        """Return the linear press; one that the error estimate has computed is reused."""
        return case.linear


SPECTRAL = MODELS.register(SpectralModel())
