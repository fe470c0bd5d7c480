"""Standard uncertainties of elastomer and load: of an experiment, and of an assumed layer.

A layer has those of an experiment, with 0 as the default of most, and those of the measured load.
"""

from typing import Annotated

from pydantic import Field

from twin.config.base import Fraction, Model
from twin.config.bounds import AirPressure, ForceSigma, ModulusSigma, RimCompliance, Rounding


class AssumedSigma(Model):
    """Standard uncertainties of elastomer and load, for the uncertainty of the object's lengths."""

    thickness_mm: Rounding | None = Field(
        default=None, description="absent: under a thin sheet that of inputs/handling, else 0"
    )
    young_modulus_kpa: ModulusSigma | None = Field(
        default=None,
        description="absent: 0 for a measured modulus, else that of the conversion from hardness",
    )
    pre_stretch: Fraction | None = Field(default=None, description="absent: 0")
    rim_compliance_mm2_per_n: RimCompliance | None = Field(default=None, description="absent: 0")
    back_pressure_kpa: AirPressure | None = Field(
        default=None, description="absent: under a thin sheet that of inputs/handling, else 0"
    )


class LayerSigma(AssumedSigma):
    """Standard uncertainties of the elastomer and of the measured load."""

    thickness_mm: Rounding = 0.0
    pre_stretch: Fraction = 0.0
    rim_compliance_mm2_per_n: Annotated[float, Field(ge=0, le=100)] = Field(
        default=0.0, description="above 0: a press of a known ball fits the compliance"
    )
    back_pressure_kpa: AirPressure = 0.0
    depth_mm: Rounding | None = Field(
        default=None, description="of the travel; absent: a given travel is treated as unknown"
    )
    force_n: ForceSigma = 0.0
    texture_mm: Rounding | None = Field(
        default=None,
        description="RMS height of the coat's texture; absent: estimated from the points in "
        "contact",
    )
    plane_mm: Rounding = Field(
        default=0.0,
        description="of z = 0 against the undeformed coat, and of each tilt as height at the rim",
    )
