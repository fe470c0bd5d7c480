"""Elastomer models, one file each. A model computes a press from specimen, elastomer and load.

    class Winkler(ElastomerModel):
        name = "winkler"
        summary = "independent springs on a window"

        def press(self, case, progress=None):
            return PressedElastomer(...)

    WINKLER = MODELS.register(Winkler())

World frame, mm: see `twin.mechanics.press`. A module of this package imports its solver at the
first press, not when the module is imported.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, Protocol, TypeVar, cast

from reconstruction.arrays import FloatArray
from reconstruction.registry import Registry
from twin.config import elastomer_models
from twin.config.base import Model
from twin.config.elastomer import SHEET_THICKNESS_MM
from twin.config.models import Elastomer, Mechanics, Press, Specimen
from twin.mechanics.errors import PressError
from twin.mechanics.press import PressedElastomer, check_load, press
from twin.mechanics.validity import DEFLECTION_OVER_THICKNESS_LIMIT
from twin.shape import Shape
from twin.specimens import shape_of

Settings = TypeVar("Settings", bound=Model)
Progress = Callable[[float], None]
"""Function that a model calls with the finished fraction of a press, 0 to 1."""


@dataclass(frozen=True, eq=False)
class PressInput:
    """Input of an elastomer model: settings, specimen, elastomer and load of one press."""

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
        """Whether the load states a travel that is the elastomer's thickness or more."""
        depth_mm = self.load.depth_mm
        return depth_mm is not None and depth_mm >= self.elastomer.thickness_mm

    @property
    def linear(self) -> PressedElastomer:
        """The pressed elastomer by the linear slab model; computed once.

        Raises
        ------
        PressError : the linear slab model cannot compute this press
        SolverError : the solution did not converge
        """
        if isinstance(self._linear, PressError):
            raise self._linear
        return self._linear

    @cached_property
    def _linear(self) -> PressedElastomer | PressError:
        try:
            refuse_sheet_keys(self.elastomer, "spectral", slab_refusals(self))
            return press(self.specimen, self.elastomer, self.load)
        except PressError as error:
            return error

    @property
    def stretches(self) -> bool:
        """Whether a free coated face deflects so far that bending also stretches the elastomer.

        Raises
        ------
        PressError : as `linear`, whose deflection is compared with the limit
        """
        bent = self.linear.validity.deflection_over_thickness > DEFLECTION_OVER_THICKNESS_LIMIT
        return bent and self.elastomer.layout == "opposite_face"


class SettledPress(Protocol):
    """Equilibrium of a press with its derivatives, which give presses with similar input."""

    def result(self) -> PressedElastomer:
        """Return the pressed elastomer at this equilibrium."""

    def nearby(self, case: PressInput) -> PressedElastomer:
        """Return the pressed elastomer for a small change of the input, to first order."""


class ElastomerModel(elastomer_models.ModelFields):
    """Interface of an elastomer model: a model overrides `press`, and other members as needed."""

    refuses_sheet_keys: ClassVar[bool] = True
    """Whether tack, friction, pre-stretch, a round frame or a soft rim are errors."""

    wraps: ClassVar[bool] = False
    """Whether the elastomer is modelled as a thin sheet that wraps round the object."""

    is_linear_slab: ClassVar[bool] = False
    """Whether the model is the exact linear slab. Then the modulus only scales pressure and force
    of a press to a depth, and the coat's displacement in its plane follows from the pressure."""

    relaxes: ClassVar[bool] = False
    """Whether a press of a relaxing elastomer is equivalent to an elastic press by this model."""

    slides: ClassVar[bool] = False
    """Whether the model computes friction while the specimen slides after the press."""

    leaves_out: ClassVar[str] = "large strain"
    """Effect that the model neglects, which causes `Validity.height_error_mm`; for reports."""

    def applies(self, case: PressInput) -> bool:
        """Whether `auto` may select the model for this input, without solving it."""
        return True

    def error_estimate_mm(self, case: PressInput) -> float | None:
        """Return the expected error of the coated face's heights, mm.

        `auto` selects the model with the least error. The result is None outside the model's tested
        range. An estimate may use `case.linear`, the linear solution, which is solved once for all
        models.

        Raises
        ------
        PressError : the model cannot compute this press
        """
        return None

    def check(self, case: PressInput) -> None:
        """Raise an error if the model cannot compute this press, without solving it.

        Raises
        ------
        PressError : the message states key, value and remedy
        """
        if self.refuses_sheet_keys:
            refuse_sheet_keys(case.elastomer, self.name, slab_refusals(case))
        check_load(case.shape, case.elastomer, case.load)

    def press(self, case: PressInput, progress: Progress | None = None) -> PressedElastomer:
        """Return both faces, pressure and force of the press; the caller calls `check` before.

        `progress` is called with the finished fraction by models with load steps.

        Raises
        ------
        PressError : the solution is outside the model's range; the message states the remedy
        SolverError : the solution did not converge
        """
        raise NotImplementedError(f"{type(self).__name__}.press")

    def rest_face_mm(
        self, case: PressInput, x_mm: FloatArray, y_mm: FloatArray
    ) -> FloatArray | None:
        """Return world z (row, col), mm, of the undeformed coated face; None: z = 0 everywhere.

        Parameters
        ----------
        x_mm, y_mm : (col,) and (row,) float, mm; nodes of the face

        Raises
        ------
        InputError : the shape of the face cannot be read
        """
        return None

    def preview(self, case: PressInput, near: SettledPress | None = None) -> SettledPress | None:
        """Press less accurately than `press`, in less time, for a live view.

        Parameters
        ----------
        near : an earlier preview of a similar press, from which the solution may start

        Returns
        -------
        The press; None if the model has no faster computation than `press`

        Raises
        ------
        PressError, SolverError : as `press`
        """
        return None

    def settle(self, case: PressInput, progress: Progress | None = None) -> SettledPress:
        """Press, and return the equilibrium with its derivatives.

        Raises
        ------
        PressError : the model has no derivatives, or an error of `press`
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
    """Return the model with the name that a result states.

    If that model is not installed, the result is an `ElastomerModel` with the default members.
    """
    return MODELS[pressed] if pressed in MODELS else ElastomerModel()


def sheet_keys(elastomer: Elastomer) -> list[str]:
    """Return the keys of an elastomer that have an effect and that only a thin sheet models."""
    given = {
        "outline": elastomer.outline != "rectangular",
        "pre_stretch": elastomer.pre_stretch != 1,
        "rim_compliance_mm2_per_n": elastomer.rim_compliance_mm2_per_n > 0,
        "tack_j_m2": elastomer.tack_j_m2 > 0,
        "friction": elastomer.friction == "stick",
        "friction_coefficient": (elastomer.friction_coefficient or 0.0) > 0,
        "thickness_field": elastomer.thickness_field is not None,
    }
    return [key for key, is_given in given.items() if is_given]


def slab_refusals(case: PressInput) -> list[str]:
    """Return the keys that only a thin sheet models; a slide also uses the friction coefficient."""
    keys = sheet_keys(case.elastomer)
    return [key for key in keys if not (case.load.slides and key == "friction_coefficient")]


def refuse_sheet_keys(elastomer: Elastomer, model: str, keys: Sequence[str] | None = None) -> None:
    """Raise an error if an elastomer has a key that the model lacks.

    Parameters
    ----------
    keys : keys that the elastomer has and the model lacks; None: those of `sheet_keys`

    Raises
    ------
    PressError : the message names the first of these keys
    """
    keys = sheet_keys(elastomer) if keys is None else keys
    if keys:
        low, high = SHEET_THICKNESS_MM
        raise PressError(
            f"elastomer.{keys[0]}: found {_shown(elastomer, keys[0])}, which the {model} model "
            f"lacks; use the sheet model (opposite_face, no film, {low:g} to {high:g} mm)"
        )


def _shown(elastomer: Elastomer, key: str) -> str:
    """Return the value of a key for a message; a table as its name in brackets."""
    value = getattr(elastomer, key)
    return f"the table [elastomer.{key}]" if isinstance(value, Model) else repr(value)
