"""Table [patterns]: the projected sequence of fringes and code words."""

from typing import Annotated, Any, Literal

from pydantic import Field, ValidationInfo, field_validator

from reconstruction.codes import CODES
from reconstruction.patterns import (
    LEAST_STRIPE_PX,
    MOST_FURTHER_PERIODS,
    PERIOD_RANGE_PX,
    Axis,
    PatternSet,
    Waveform,
)
from reconstruction.stepping import STEPPINGS, STEPS_RANGE
from reconstruction.words import WORDS
from twin.config.base import Model
from twin.config.kinds import NameOf

PeriodPx = Annotated[float, Field(ge=LEAST_STRIPE_PX, le=PERIOD_RANGE_PX[1])]
Periods = Annotated[tuple[PeriodPx, ...], Field(max_length=MOST_FURTHER_PERIODS + 1)]
Shift = Annotated[float, Field(ge=-360.0, le=360.0)]
Level = Annotated[int, Field(ge=0, le=255)]


def _of_set(name: str, description: str) -> Any:
    """Return a field with the default of `PatternSet`; at this default, digests exclude it."""
    default = getattr(PatternSet, name)
    return Field(
        default=default, exclude_if=lambda value: value == default, description=description
    )


class Patterns(Model):
    """Projected patterns: the fields of `PatternSet` that do not follow from the projector."""

    period_px: PeriodPx
    stepping: Literal["equal", "quarter_pairs", "cyclic", "windowed", "single"] = _of_set(
        "stepping", "phase shifts of the steps; other than equal: for scenes in motion"
    )
    steps: Annotated[int, Field(ge=0, le=STEPS_RANGE[1])] = Field(
        description="phase steps, 3 or more; 0: code words only, each period_px wide, code 'gray'"
    )
    code: Annotated[str, NameOf(CODES)] = Field(
        default=PatternSet.code, description="code of the fringe order"
    )
    further_periods_px: Annotated[Periods, Field(max_length=MOST_FURTHER_PERIODS)] = Field(
        default=PatternSet.further_periods_px,
        description="additional periods of a code that needs them",
    )
    row_periods_px: Periods = _of_set(
        "row_periods_px", "all periods along rows; empty: those along columns"
    )
    axes: tuple[Axis, ...] = _of_set("axes", "axes along which patterns are shown")
    word: Annotated[str, NameOf(WORDS)] = _of_set(
        "word", "how words are shown as bits; code 'gray'"
    )
    inverse: bool = _of_set("inverse", "show the inverse of every Gray frame")
    uniform: bool = _of_set("uniform", "show a white and a black frame")
    first_shifts_deg: tuple[Shift, ...] = _of_set(
        "first_shifts_deg", "phase of step 0 at pixel 0, of every period along every axis; empty: 0"
    )
    low_level: Level = _of_set("low_level", "8-bit projector level of black")
    high_level: Level = _of_set("high_level", "8-bit projector level of white")
    waveform: Waveform = _of_set(
        "waveform", "fringe: sinusoidal, or square (1 bit), which the projector's blur smooths"
    )

    @classmethod
    def of(cls, shown: PatternSet) -> "Patterns":
        """Return the settings of a pattern sequence without those of its projector."""
        return cls(**{name: getattr(shown, name) for name in cls.model_fields})

    @field_validator("steps")
    @classmethod
    def _steps_fit_the_period(cls, steps: int, info: ValidationInfo) -> int:
        least = STEPPINGS[info.data.get("stepping", PatternSet.stepping)].least
        if 0 < steps < min(least, STEPS_RANGE[0]):
            raise ValueError(f"allowed >= {least}, <= {STEPS_RANGE[1]}, or 0: words only")
        period_px = info.data.get("period_px", PERIOD_RANGE_PX[0])
        if steps and period_px < PERIOD_RANGE_PX[0]:
            raise ValueError(
                f"allowed 0 with period_px {period_px:g}; fringes need >= {PERIOD_RANGE_PX[0]:g}"
            )
        return steps
