"""The `spectral` model: the exact linear slab, see `twin.mechanics.press`."""

from twin.mechanics.models import MODELS, ElastomerModel, PressInput, Progress
from twin.mechanics.press import PressedElastomer
from twin.mechanics.sliding import check_slide, slid_press


class SpectralModel(ElastomerModel):
    """A linear slab, frictionless, on a simply supported rim or bonded to a window."""

    name = "spectral"
    summary = "exact linear slab, while deflections are small"
    is_automatic = True
    is_linear_slab = True
    relaxes = True
    slides = True

    def check(self, case: PressInput) -> None:
        """Raise an error if the slab model cannot compute this press or its slide."""
        super().check(case)
        if case.load.slides:
            check_slide(case.shape, case.elastomer, case.load)

    def error_estimate_mm(self, case: PressInput) -> float | None:
        """Return the expected height error, mm, that results from neglecting large strain.

        The result is None if the elastomer stretches as it bends, which the model neglects too.
        """
        return None if case.stretches else case.linear.validity.height_error_mm

    def press(self, case: PressInput, progress: Progress | None = None) -> PressedElastomer:
        """Return the linear press, after its slide; a press of the error estimate is reused."""
        if not case.load.slides:
            return case.linear
        return slid_press(case.linear, (case.shape, case.elastomer, case.load))


SPECTRAL = MODELS.register(SpectralModel())
