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
    """Neo-Hookean brick elements, without film, back pressure and weight."""

    name = "neo_hookean"
    summary = "solid elements at large strain, for thick slabs and deep presses"
    is_automatic = True

    def applies(self, case: PressInput) -> bool:
        """Whether the input is a free slab that bricks can press.

        The travel is below the thickness, because the linear slab's press is the first guess.
        """
        elastomer, load = case.elastomer, case.load
        loaded = load.back_pressure_kpa or load.gravity_deg is not None or elastomer.film
        plain = not (loaded or case.reaches_thickness or sheet_keys(elastomer))
        return plain and elastomer.layout == "opposite_face"

    def error_estimate_mm(self, case: PressInput) -> float | None:
        """Return the height error of a thin sheet at its limit of bending, mm.

        Beyond this limit bricks are selected, because they are more accurate. The result is None if
        the elastomer does not stretch: then the linear slab is more accurate than bricks.
        """
        limit_mm = sheet_estimate_mm(case.elastomer.thickness_mm, SHEET_LIMIT)
        return limit_mm if case.stretches else None

    def check(self, case: PressInput) -> None:
        """Raise an error for film, back pressure, weight or an impossible press.

        The travel may exceed the thickness of a free slab.
        """
        from twin.mechanics.reference.neo_hookean import check_neo_hookean

        refuse_sheet_keys(case.elastomer, self.name)
        check_load(case.shape, case.elastomer, case.load, any_depth=True)
        check_neo_hookean(case.elastomer, case.load)

    def press(self, case: PressInput, progress: Progress | None = None) -> PressedElastomer:
        """Return the pressed elastomer, solved in load steps."""
        from twin.mechanics.reference.neo_hookean import press_neo_hookean

        return press_neo_hookean(case.specimen, case.elastomer, case.load)


NEO_HOOKEAN = MODELS.register(NeoHookeanModel())
