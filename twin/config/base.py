"""What all configuration models share: ranges with a name, the frozen base, and errors."""

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

from reconstruction.errors import InputError


class ConfigError(InputError):
    """An experiment file that cannot be used; one line per problem."""


class AssetCycleError(ConfigError):
    """Data files that `use` each other in a circle."""


Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
Fraction = Annotated[float, Field(ge=0, le=1)]
Length = Annotated[float, Field(gt=0, le=1000)]
Angle = Annotated[float, Field(ge=-180, le=180)]
Distortion = tuple[float, float, float, float, float]


class Model(BaseModel):
    """Base of all configuration: immutable, no unknown keys, no NaN or infinity."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
