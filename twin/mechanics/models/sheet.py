"""The `sheet` model: a thin sheet that wraps round the specimen, see `twin.mechanics.sheet`."""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

from twin.mechanics.errors import PressError
from twin.mechanics.models import (
    MODELS,
    ElastomerModel,
    PressInput,
    Progress,
    SettledPress,
)
from twin.mechanics.press import PressedElastomer
from twin.mechanics.validity import bend_over_ball, sheet_estimate_mm

if TYPE_CHECKING:
    from twin.mechanics.sheet.neighbour import Neighbourhood
    from twin.mechanics.sheet.press import SettledSheet


class SheetModel(ElastomerModel):
    """A thin sheet with finite rotation and stretch; it neglects shear through its thickness."""

    name = "sheet"
    summary = "0.05 to 1 mm thick, wraps the specimen"
    takes = ("support",)
    is_automatic = True
    refuses_sheet_keys = False
    wraps = True
    leaves_out = "shear through the thickness"

    def applies(self, case: PressInput) -> bool:
        """Whether the elastomer is a thin sheet."""
        return case.elastomer.is_thin_sheet

    def error_estimate_mm(self, case: PressInput) -> float | None:
        """Return the expected height error, mm, that results from neglecting shear.

        The result is None if the elastomer bends without stretching, as a slab does.
        """
        try:
            wraps = case.stretches
        except PressError:
            wraps = True  # Travel, air or a key that a linear slab cannot have.
        thickness_mm = case.elastomer.thickness_mm
        ratio = bend_over_ball(thickness_mm, case.shape)
        return sheet_estimate_mm(thickness_mm, ratio) if wraps else None

    def check(self, case: PressInput) -> None:
        """Raise an error if a thin sheet does not describe the press."""
        from twin.mechanics.sheet.case import check_sheet

        check_sheet(case.shape, case.elastomer, case.load, case.mechanics)

    def press(self, case: PressInput, progress: Progress | None = None) -> PressedElastomer:
        """Return the sheet in equilibrium.

        The cached load path of an earlier press that differs only in its loads is reused.
        """
        return _settled(case, progress).result()

    def preview(self, case: PressInput, near: SettledPress | None = None) -> "SettledWithTangent":
        """Return the sheet on coarse cells; the load steps start from the state of `near`."""
        from twin.mechanics.sheet.press import coarse_sheet

        state = near.sheet if isinstance(near, SettledWithTangent) else None
        parts = case.specimen, case.elastomer, case.load, case.mechanics
        return SettledWithTangent(coarse_sheet(*parts, state))

    def settle(self, case: PressInput, progress: Progress | None = None) -> "SettledWithTangent":
        """Press, and return the sheet with its tangent, by which `nearby` computes changes."""
        return SettledWithTangent(_settled(case, progress))


@dataclass(frozen=True, eq=False)
class SettledWithTangent:
    """A sheet in equilibrium; its tangent is factorised at the first call of `nearby`."""

    sheet: "SettledSheet"

    def result(self) -> PressedElastomer:
        """Return the pressed elastomer at this equilibrium."""
        return self.sheet.result()

    def nearby(self, case: PressInput) -> PressedElastomer:
        """Return the pressed elastomer for a small change of the input, to first order.

        Raises
        ------
        PressError : the sheet sticks to the specimen, or the change needs another sheet or grid
        SolverError : the tangent is not positive definite, because other equilibria are close
        """
        return self._neighbourhood.press(case.mechanics, case.specimen, case.elastomer, case.load)

    @cached_property
    def _neighbourhood(self) -> "Neighbourhood":
        from twin.mechanics.sheet.neighbour import Neighbourhood

        return Neighbourhood(self.sheet)


def _settled(case: PressInput, progress: Progress | None) -> "SettledSheet":
    from twin.mechanics.sheet.press import settled_sheet  # its compiled kernels load slowly

    return settled_sheet(case.specimen, case.elastomer, case.load, case.mechanics, progress)


SHEET = MODELS.register(SheetModel())
