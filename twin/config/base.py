"""What all configuration models share: ranges with a name, and the frozen base."""

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
Fraction = Annotated[float, Field(ge=0, le=1)]
Length = Annotated[float, Field(gt=0, le=1000)]
Angle = Annotated[float, Field(ge=-180, le=180)]
Distortion = tuple[float, float, float, float, float]


class Model(BaseModel):
    """Base of all configuration: immutable, no unknown keys, no NaN or infinity."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
