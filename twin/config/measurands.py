"""What is to be found out about the specimen: `[[measurand]]` tables, with nominal and tolerance.

Lengths of a drawing (step height, width, ...) are in mm, what is left beside it (form, deviation)
and all limits in um, coverage is a share.
"""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from reconstruction.arrays import Alignment
from twin.config.base import Fraction, Model
from twin.config.bounds import Length, Limit, Micrometres, Place, Tolerance

Quantity = Literal[
    "step_height", "depth", "width", "radius", "resolution", "form", "deviation", "coverage"
]
Range = tuple[Place, Place]

LENGTHS: tuple[Quantity, ...] = ("step_height", "depth", "width", "radius", "resolution")
"""Quantities in mm, which have a nominal value."""

HIDDEN: tuple[Quantity, ...] = ("step_height", "depth", "width", "radius")
"""Lengths that a coat on the far face of an elastomer shows otherwise than the object has them."""

LIMITED: tuple[Quantity, ...] = ("form", "deviation")
"""Quantities in um, which ought to be 0."""


class ObjectMeasurand(Model):
    """One quantity of the specimen, where it is measured, and what is allowed."""

    name: Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*$", max_length=40)] = Field(
        description="its figures are called object_NAME_..."
    )
    quantity: Quantity = Field(
        description="step_height: between the highest and the lowest level (ISO 5436-1 A1); depth, "
        "width: of a groove, a bar; radius: of a ball or rod; resolution: finest pitch of the "
        "gratings that keeps half its depth; form: band of 95 % of the deviations after a rigid "
        "alignment; deviation: RMS after `alignment`; coverage: share of the specimen with a point "
        "where it touches"
    )
    part: str = Field(default="", description="of a group: the part's name; empty: the first")
    number: Annotated[int, Field(ge=1, le=100)] = Field(
        default=1, description="which of several balls, rods or bars, counted along x"
    )
    x_mm: Range | None = Field(default=None, description="only points between these world x")
    y_mm: Range | None = Field(default=None, description="only points between these world y")
    over: Literal["contact", "specimen"] = Field(
        default="contact",
        description="form, deviation: points where coat and specimen touch, or all over it",
    )
    alignment: Alignment = Field(
        default="offset", description="of a deviation: what is taken off by a best fit before"
    )
    nominal_mm: Length | None = Field(
        default=None, description="of a length; default: the specimen's own"
    )
    plus_minus_um: Tolerance | None = Field(
        default=None, description="allowed on both sides of nominal_mm"
    )
    lower_um: Limit | None = Field(default=None, description="least allowed value less nominal_mm")
    upper_um: Limit | None = Field(
        default=None, description="largest allowed value less nominal_mm; of form and deviation: "
        "the largest allowed"
    )  # fmt: skip
    at_least: Fraction | None = Field(default=None, description="least allowed coverage")
    repeatability_um: Micrometres = Field(
        default=0.0, description="standard uncertainty from setting up and measuring again"
    )
    calibration_um: Micrometres = Field(
        default=0.0, description="standard uncertainty from the sensor's calibration"
    )
    coverage_factor: Annotated[float, Field(ge=1, le=4)] = Field(
        default=2.0, description="k: expanded uncertainty U = k u; 2 covers about 95 %"
    )

    @model_validator(mode="after")
    def _limits_make_sense(self) -> "ObjectMeasurand":
        both = self.plus_minus_um is not None
        if both and (self.lower_um is not None or self.upper_um is not None):
            raise ValueError("takes plus_minus_um, or lower_um and upper_um: remove one")
        if (self.lower_um or 0.0) > (self.upper_um or 0.0) and None not in (
            self.lower_um,
            self.upper_um,
        ):
            raise ValueError(
                f"lower_um: found {self.lower_um:g}, allowed up to upper_um, {self.upper_um:g}"
            )
        if self.quantity in LIMITED and (both or self.lower_um is not None):
            raise ValueError(f"{self.quantity} ought to be 0: give upper_um, its largest value")
        if self.quantity == "coverage" and (both or self.lower_um or self.upper_um):
            raise ValueError("coverage is a share: give at_least")
        if self.quantity not in LENGTHS and self.nominal_mm is not None:
            raise ValueError(f"{self.quantity} has no nominal_mm: remove it")
        if self.quantity != "coverage" and self.at_least is not None:
            raise ValueError("at_least: allowed for coverage; use upper_um or plus_minus_um")
        return self

    @property
    def unit(self) -> str:
        """Suffix of its value's name."""
        if self.quantity in LENGTHS:
            return "mm"
        return "um" if self.quantity in LIMITED else "share"
