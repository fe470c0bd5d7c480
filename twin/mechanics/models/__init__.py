"""Elastomer models, one file each: from specimen, elastomer and load to the pressed elastomer.

    class Winkler(ElastomerModel):
        name = "winkler"
        summary = "independent springs on a window"

        def press(self, case, progress=None):
            return PressedElastomer(...)

    WINKLER = MODELS.register(Winkler())

World frame, mm: see `twin.mechanics.press`. A module of this package loads its solver when it
presses, not when it is imported.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, Protocol, TypeVar, cast

from reconstruction.registry import Registry
from twin.config import elastomer_models
from twin.config.base import Model
from twin.config.models import Elastomer, Mechanics, Press, Specimen
from twin.mechanics.errors import PressError
from twin.mechanics.press import PressedElastomer, check_load, press
from twin.mechanics.validity import DEFLECTION_OVER_THICKNESS_LIMIT, SHEET_THICKNESS_MM
from twin.shape import Shape
from twin.specimens import shape_of

Settings = TypeVar("Settings", bound=Model)
Progress = Callable[[float], None]
"""Is called with the finished share of a press, 0 to 1."""


@dataclass(frozen=True, eq=False)
class PressInput:
    """The data of one press."""

    mechanics: Mechanics
    specimen: Specimen
    elastomer: Elastomer
    load: Press

    def settings(self, model: str, kind: type[Settings]) -> Settings:
        """Return the table `[mechanics.settings.MODEL]`; its defaults if the experiment has none.

        Parameters
        ----------
        kind : data model of the table, the `settings` of that model
        """
        table = self.mechanics.settings.get(model)
        return table if isinstance(table, kind) else kind()

    @cached_property
    def shape(self) -> Shape:
        """The specimen's shape in its pose."""
        return shape_of(self.specimen)

    @property
    def reaches_thickness(self) -> bool:
        """Whether the travel is set, and is the elastomer's thickness or more."""
        depth_mm = self.load.depth_mm
        return depth_mm is not None and depth_mm >= self.elastomer.thickness_mm

    @property
    def linear(self) -> PressedElastomer:
        """The pressed elastomer by the linear slab model; computed once.

        Raises
        ------
        PressError : the linear slab cannot make this press
        SolverError : the solution did not converge
        """
        if isinstance(self._linear, PressError):
            raise self._linear
        return self._linear

    @cached_property
    def _linear(self) -> PressedElastomer | PressError:
        try:
            refuse_sheet_keys(self.elastomer, "spectral")
            return press(self.specimen, self.elastomer, self.load)
        except PressError as error:
            return error

    @property
    def stretches(self) -> bool:
        """Whether the free coated face rises so far that the elastomer stretches as it bends.

        Raises
        ------
        PressError : as `linear`, from which it is computed
        """
        bent = self.linear.validity.deflection_over_thickness > DEFLECTION_OVER_THICKNESS_LIMIT
        return bent and self.elastomer.layout == "opposite_face"


class SettledPress(Protocol):
    """An equilibrium of specimen and elastomer, kept to differentiate it by the input fields."""

    def result(self) -> PressedElastomer:
        """Return the pressed elastomer at this equilibrium."""

    def nearby(self, case: PressInput) -> PressedElastomer:
        """Return the pressed elastomer for a small change of the input, to first order."""


class ElastomerModel(elastomer_models.ModelFields):
    """Interface of an elastomer model; a model overrides `press`, and the rest if it differs."""

    refuses_sheet_keys: ClassVar[bool] = True
    """Whether tack, friction, pre-stretch, a round frame or a soft rim are errors."""

    wraps: ClassVar[bool] = False
    """Whether the coat is a thin sheet that wraps the object and determines its shape."""

    is_linear_slab: ClassVar[bool] = False
    """Whether it is the exact linear slab: the modulus only scales pressure and force of a press to
    a depth, and the coat's displacement in its plane follows from the pressure."""

    leaves_out: ClassVar[str] = "large strain"
    """Cause of `Validity.height_error_mm`, for reports."""

    def applies(self, case: PressInput) -> bool:
        """Whether `auto` may select the model; does not solve."""
        return True

    def error_estimate_mm(self, case: PressInput) -> float | None:
        """Return the expected error of the coated face's heights; None: outside the tested range.

        `auto` selects the model with the least error. `case.linear` is the linear solution, for
        estimates that need it: it is solved once for all models.

        Raises
        ------
        PressError : the model cannot press this
        """
        return None

    def check(self, case: PressInput) -> None:
        """Raise an error if the model cannot press this, before any work.

        Raises
        ------
        PressError : key, value and remedy
        """
        if self.refuses_sheet_keys:
            refuse_sheet_keys(case.elastomer, self.name)
        check_load(case.shape, case.elastomer, case.load)

    def press(self, case: PressInput, progress: Progress | None = None) -> PressedElastomer:
        """Return both faces, pressure and force; `check` has passed.

        Raises
        ------
        PressError : the solution is outside the model's range; the message states the remedy
        SolverError : the solution did not converge
        """
        raise NotImplementedError(f"{type(self).__name__}.press")

    def settle(self, case: PressInput, progress: Progress | None = None) -> SettledPress:
        """Press, and return the equilibrium for derivatives.

        Raises
        ------
        PressError : the model has no derivatives, or as `press`
        SolverError : as `press`
        """
        low, high = SHEET_THICKNESS_MM
        raise PressError(
            f"mechanics.model: found '{self.name}', which has no derivatives; the thin sheet has "
            f"(opposite_face, no film, {low:g} to {high:g} mm); twin sweep computes differences of "
            "any model"
        )


MODELS = cast("Registry[ElastomerModel]", elastomer_models.MODELS)
"""The elastomer models by name."""


def model_of(pressed: str) -> ElastomerModel:
    """Return the model of a result, by its name; a plain one if it is not installed."""
    return MODELS[pressed] if pressed in MODELS else ElastomerModel()


def sheet_keys(elastomer: Elastomer) -> list[str]:
    """Return the keys of an elastomer that only a thin sheet models, where they have an effect."""
    given = {
        "outline": elastomer.outline != "rectangular",
        "pre_stretch": elastomer.pre_stretch != 1,
        "rim_compliance_mm2_per_n": elastomer.rim_compliance_mm2_per_n > 0,
        "tack_j_m2": elastomer.tack_j_m2 > 0,
        "friction": elastomer.friction == "stick",
    }
    return [key for key, is_given in given.items() if is_given]


def refuse_sheet_keys(elastomer: Elastomer, model: str) -> None:
    """Raise an error for a key that only a thin sheet models.

    Raises
    ------
    PressError : names the first such key
    """
    keys = sheet_keys(elastomer)
    if keys:
        low, high = SHEET_THICKNESS_MM
        raise PressError(
            f"elastomer.{keys[0]}: found {getattr(elastomer, keys[0])!r}, which the {model} model "
            f"lacks; use the sheet model (opposite_face, no film, {low:g} to {high:g} mm)"
        )
