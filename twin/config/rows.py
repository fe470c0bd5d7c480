"""Measured figures of a sensor as data: rows with a value, and one-sided limits."""

from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from twin.config.base import Model
from twin.config.bounds import Figure, FigureSigma, Spread

Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9_\-]+$", max_length=48)]
Metric = str | tuple[str, ...]
Statistic = Literal["mean", "sd"]
LearnedAs = Literal["value", "log", "reciprocal"]
Use = Literal["fitted", "steered", "predicted"]


class Row(Model):
    """One measured value of a figure, with its standard uncertainty, for an identification."""

    experiment: Name
    metric: Metric = Field(
        description="name of the figure in result.json, or of a free field; the mean of several "
        "names"
    )
    statistic: Statistic = Field(
        default="mean", description="over repeats: their mean, or their standard deviation"
    )
    learned_as: LearnedAs = Field(
        default="value", description="log or reciprocal if that is a smoother function"
    )
    value: Figure
    sd: FigureSigma = Field(description="standard uncertainty of the value, and of one simulation")
    trials: Annotated[int, Field(ge=1, le=10**6)] = Field(
        default=1, description="number of measurements that the value is the mean of"
    )
    realisations: Annotated[int, Field(ge=1, le=10**6)] | None = Field(
        default=None,
        description="number of draws (coats) that the value is the mean of; their learned scatter "
        "over the root of this number adds to sd; absent: sd includes it",
    )
    shared: Annotated[float, Field(ge=0, le=1)] | None = Field(
        default=None,
        description="share of the scatter's variance that is common to all trials of the row, "
        "as for trials with one coat; it adds to sd of a mean and is no part of a deviation; "
        "absent: 1 with realisations, 0 with statistic = 'sd'",
    )
    coat: Name | None = Field(
        default=None,
        description="rows of one figure with the same coat share one draw of the scatter",
    )
    discrepancy: Spread = Field(
        default=0.0, description="standard deviation of the error of the twin's model"
    )
    nuisance: dict[Name, Figure] = Field(
        default={}, description="change of the figure for a nuisance of 1, by name"
    )
    held_out: bool = Field(default=False, description="predicted, not fitted")
    steered: str | None = Field(
        default=None,
        description="choice of model or evaluation that was made after a comparison with this "
        "held-out row: its prediction is then no independent test",
    )
    source: str | None = None

    @model_validator(mode="after")
    def _scatter_is_of_a_mean(self) -> "Row":
        if self.statistic == "sd" and self.realisations is not None:
            raise ValueError("realisations: not allowed with statistic = 'sd'")
        if self.statistic == "mean" and self.realisations is None:
            for name in ("shared", "coat"):
                if getattr(self, name) is not None:
                    raise ValueError(f"{name}: of a mean it needs realisations; add them")
        if self.statistic == "sd" and self.coat is not None:
            raise ValueError("coat: not allowed with statistic = 'sd'")
        return self

    @model_validator(mode="after")
    def _a_steering_row_is_held_out(self) -> "Row":
        if self.steered is not None and not self.held_out:
            raise ValueError("steered: needs held_out = true; a fitted row is no test in any case")
        return self

    @property
    def use(self) -> Use:
        """Use of the row: fitted, predicted, or steered if it influenced a choice."""
        if not self.held_out:
            return "fitted"
        return "predicted" if self.steered is None else "steered"

    @property
    def scatter_share(self) -> float:
        """Factor by which the emulated standard deviation over repeats is multiplied for the row.

        For a mean, the product is the standard deviation of the part that is common to all trials
        of the row: sqrt(shared / realisations), or 0 without `realisations`. For a standard
        deviation, it is that of the part that differs between the trials: sqrt(1 - shared).
        """
        if self.statistic == "sd":
            return float(np.sqrt(1.0 - (self.shared or 0.0)))
        shared = 1.0 if self.shared is None else self.shared
        return 0.0 if self.realisations is None else float(np.sqrt(shared / self.realisations))

    @property
    def needs_repeats(self) -> str:
        """Key of the row that needs several measurements per simulation; empty if no key does."""
        if self.statistic == "sd":
            return "statistic = 'sd'"
        return "" if self.realisations is None else "realisations"

    @property
    def scatter(self) -> float:
        """Standard deviation of one measurement: sd times the root of `trials`."""
        return self.sd * float(np.sqrt(self.trials))


class Limit(Model):
    """Known one-sided bound on a figure, for example from an image or a saturated meter."""

    experiment: Name
    metric: Metric = Field(description="as of a row")
    learned_as: LearnedAs = "value"
    at_least: Figure | None = None
    at_most: Figure | None = None
    sd: FigureSigma = Field(description="standard uncertainty of the bound")
    compare_at: tuple[Figure, ...] = Field(
        default=(),
        description="other values of the bound for which the posterior is sampled, too, as it is "
        "without the limit, to show the influence of the bound",
    )
    source: str | None = None

    @model_validator(mode="after")
    def _one_side(self) -> "Limit":
        if (self.at_least is None) == (self.at_most is None):
            raise ValueError("at_least, at_most: exactly one of them is needed")
        return self

    @property
    def statistic(self) -> Statistic:
        """Always "mean": a limit applies to the mean over repeats."""
        return "mean"

    @property
    def value(self) -> float:
        """Value of the bound, in the unit of the figure."""
        (given,) = (bound for bound in (self.at_least, self.at_most) if bound is not None)
        return given

    @property
    def side(self) -> int:
        """Allowed side: 1 if figures above the bound are allowed, -1 if figures below are."""
        return 1 if self.at_least is not None else -1

    @property
    def words(self) -> str:
        """The bound as text, for example "at least 5"."""
        return f"at {'least' if self.side > 0 else 'most'} {self.value:g}"

    def at(self, bound: float) -> "Limit":
        """Return this limit with another value of its bound."""
        return self.model_copy(update={"at_least" if self.side > 0 else "at_most": bound})

    def allows(self, figure: float) -> bool:
        """Return True if a figure is on the allowed side of the bound, or equal to it."""
        return self.side * (figure - self.value) >= 0.0
