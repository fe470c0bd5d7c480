"""The `neo_hookean` model: solid elements at large strain, see `twin.mechanics.reference`."""

from twin.mechanics.models import (
    MODELS,
    ElastomerModel,
    PressInput,
    Progress,
    refuse_sheet_keys,
    sheet_keys,
)
from twin.mechanics.press import PressedElastomer, check_load
from twin.mechanics.validity import SHEET_LIMIT, sheet_estimate_mm


class NeoHookeanModel(ElastomerModel):
    """Neo-Hookean bricks, without film, back pressure and weight."""

    name = "neo_hookean"
    summary = "solid elements at large strain, for thick slabs and deep presses"
    is_automatic = True

    def applies(self, case: PressInput) -> bool:
        """Whether bricks can press a free slab, from the linear slab's press as a first guess."""
        elastomer, load = case.elastomer, case.load
        loaded = load.back_pressure_kpa or load.gravity_deg is not None or elastomer.film
        plain = not (loaded or case.reaches_thickness or sheet_keys(elastomer))
        return plain and elastomer.layout == "opposite_face"

    def error_estimate_mm(self, case: PressInput) -> float | None:
        """Return the error of a sheet at its limit, beyond which bricks are more accurate.

        None: the elastomer does not stretch, and bricks are the coarser model.
        """
        limit_mm = sheet_estimate_mm(case.elastomer.thickness_mm, SHEET_LIMIT)
        return limit_mm if case.stretches else None

    def check(self, case: PressInput) -> None:
        """Raise an error for film, back pressure or weight, or an impossible slab; any travel."""
        from twin.mechanics.reference.neo_hookean import check_neo_hookean

        refuse_sheet_keys(case.elastomer, self.name)
        check_load(case.shape, case.elastomer, case.load, any_depth=True)
        check_neo_hookean(case.elastomer, case.load)

    def press(self, case: PressInput, progress: Progress | None = None) -> PressedElastomer:
        """Return the pressed elastomer, solved in load steps."""
        from twin.mechanics.reference.neo_hookean import press_neo_hookean

        return press_neo_hookean(case.specimen, case.elastomer, case.load)


NEO_HOOKEAN = MODELS.register(NeoHookeanModel())
