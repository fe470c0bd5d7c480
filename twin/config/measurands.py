"""Requests for quantities of the specimen: `[[measurand]]` tables with nominal and tolerance.

Nominal lengths (step height, width, ...) are in mm. Form, deviation and all limits are in um.
Coverage is a share, 0 to 1.

A kind of quantity is defined in one file of `twin.results.measurands`, of an installed package
(entry points of the group `fringe_twin.measurands`) or of the user (`--plugin`).
"""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from reconstruction.arrays import Alignment
from reconstruction.registry import Registry
from twin.config.base import Fraction, Model
from twin.config.bounds import Length, Limit, Micrometres, Place, Tolerance
from twin.config.kinds import NameOf

Unit = Literal["mm", "um", "share"]


class QuantityKind:
    """Properties of a kind of quantity, with which its `[[measurand]]` tables are checked.

    Attributes
    ----------
    name : value of the key `quantity`
    summary : one line of documentation for the list of keys
    unit : "mm": a length, which has a nominal value and limits on the deviation from it; "um": a
        quantity that is ideally 0, with a largest allowed value; "share": a share with a least
        allowed value
    hidden : True: if the elastomer is between object and coat, the value of the coat is not the
        value of the object
    bound_name : name of the figure with the Cramer-Rao bound of the first measurand of this kind;
        empty if the value has no such bound
    """

    name: str
    summary: str
    unit: Unit = "mm"
    hidden: bool = False
    bound_name: str = ""


MEASURANDS: Registry[QuantityKind] = Registry(
    "measurands", "twin.results.measurands", lambda kind: kind.name
)
"""Registry of the kinds of quantities that a measurand may have."""

CALIBRATION_SHARE = 2.7e-5
"""Standard uncertainty of a length over the length, by a calibration on 12 poses of a dot board:
10 mm lengths have an RMS error of 0.27 um (`./run bench calibration`)."""

Range = tuple[Place, Place]


class ObjectMeasurand(Model):
    """One requested quantity of the specimen, with its evaluated region and its tolerance."""

    name: Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*$", max_length=40)] = Field(
        description="its figures are called object_NAME_..."
    )
    quantity: Annotated[str, NameOf(MEASURANDS)] = Field(description="kind of quantity")
    part: str = Field(default="", description="of a group: the part's name; empty: the first")
    number: Annotated[int, Field(ge=1, le=100)] = Field(
        default=1, description="which of several balls, rods or bars, counted along x"
    )
    x_mm: Range | None = Field(default=None, description="only points between these world x")
    y_mm: Range | None = Field(default=None, description="only points between these world y")
    over: Literal["contact", "specimen"] = Field(
        default="contact",
        description="form, deviation: points in contact with the specimen, or all over it",
    )
    alignment: Alignment = Field(
        default="offset", description="of a deviation: the best fit that is subtracted first"
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
        default=0.0, description="standard uncertainty of repeated set-up and measurement"
    )
    calibration_um: Micrometres | None = Field(
        default=None,
        description="standard uncertainty from the sensor's calibration; absent: of a length "
        "2.7e-5 of it, as with a calibration on a dot board (not known for "
        "photometric_stereo), else 0",
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
        if self.unit == "um" and (both or self.lower_um is not None):
            raise ValueError(f"{self.quantity} ought to be 0: give upper_um, its largest value")
        if self.unit == "share" and (both or self.lower_um or self.upper_um):
            raise ValueError(f"{self.quantity} is a share: give at_least")
        if self.unit != "mm" and self.nominal_mm is not None:
            raise ValueError(f"{self.quantity} has no nominal_mm: remove it")
        if self.unit != "share" and self.at_least is not None:
            shares = ", ".join(kind.name for kind in MEASURANDS if kind.unit == "share")
            raise ValueError(f"at_least: allowed for {shares}; use upper_um or plus_minus_um")
        return self

    @property
    def unit(self) -> Unit:
        """Unit of the value, which is also the suffix of the figure's name."""
        return MEASURANDS[self.quantity].unit

    def sigma_of_calibration_um(self, value: float, fringes: bool) -> float | None:
        """Return the standard uncertainty, um, of a value in its unit, from the calibration.

        None if it is not known: a length by a method without fringes, unless the user states it.
        """
        if self.calibration_um is not None:
            return self.calibration_um
        if self.unit != "mm":
            return 0.0
        return 1e3 * CALIBRATION_SHARE * abs(value) if fringes else None

    @property
    def hidden(self) -> bool:
        """Whether the coat does not show the object's value if the elastomer is between both.

        See `QuantityKind`.
        """
        return MEASURANDS[self.quantity].hidden
