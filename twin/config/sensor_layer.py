"""Assumed elastomer and load, with which the object behind the coat is reconstructed, as data.

They are read from a file (`twin compensate RESULT --layer layer.toml`) or taken from an
experiment. docs/compensation.md explains every key.
"""

from pathlib import Path
from typing import Literal

import tomli_w
from pydantic import ConfigDict, Field, model_validator

from twin.config.base import Angle, Model
from twin.config.bounds import (
    AirPressure,
    Force,
    HoldTime,
    Length,
    Place,
    Rounding,
    Travel,
)
from twin.config.elastomer import Elastomer, zero_excluded
from twin.config.inputs import usual_inputs
from twin.config.kinds import follows
from twin.config.loading import read_toml, resolve_uses
from twin.config.materials import MATERIALS
from twin.config.models import Experiment, Provenance
from twin.config.quantities import convert_units, split_quantities
from twin.config.schema import validated
from twin.config.sigma import AssumedSigma, LayerSigma
from twin.config.specimen_base import SPECIMENS, AnySpecimen


class MeasuredLoad(Model):
    """Measured load of one press: air pressure, travel and force."""

    back_pressure_kpa: AirPressure = Field(default=0.0, description="air on the coated face")
    depth_mm: Travel | None = Field(
        default=None, description="travel after first touch, if the stage measures it"
    )
    force_n: Force | None = Field(default=None, description="if a gauge measures it")
    ramp_s: HoldTime = zero_excluded("duration of the press (with elastomer.relaxation)")
    hold_s: HoldTime = zero_excluded(
        "time from the end of the press to the measurement (with elastomer.relaxation)"
    )

    @property
    def control(self) -> Literal["depth", "force"]:
        """Which of travel and force is constant after the press: the force if only it is given."""
        return "force" if self.depth_mm is None and self.force_n is not None else "depth"


class PressedBar(Model):
    """Approximate pose and size of a bar with a flat top: start values of the fit of its walls."""

    x_mm: Place = Field(default=0.0, description="world x of its middle, within 0.5 mm")
    y_mm: Place = 0.0
    along_deg: Angle = Field(
        default=0.0, description="of its length, from world y towards -x, within about 4 degrees"
    )
    width_mm: Length = Field(description="approximate, within about 0.3 mm")
    length_mm: Length
    edge_radius_mm: Rounding = Field(description="rounding of its upper edges")
    sigma_edge_radius_mm: Rounding = 0.0


@follows(SPECIMENS, MATERIALS)
class SensorLayer(Model):
    """Assumed elastomer and load of the press, and their standard uncertainties."""

    model_config = ConfigDict(defer_build=True)

    description: str = ""
    elastomer: Elastomer
    press: MeasuredLoad = MeasuredLoad()
    sigma: LayerSigma = LayerSigma()
    bar: tuple[PressedBar, ...] = Field(
        default=(), description="bars with widths to be measured; default: the experiment's"
    )
    specimen: AnySpecimen | None = Field(
        default=None,
        description="assumed specimen: its bars; under a slab thicker than 1 mm the shape to be "
        "fitted; default: the experiment's",
    )
    fitted: tuple[str, ...] = Field(
        default=(), description="numbers of the specimen that are fitted; default: by its kind"
    )
    provenance: dict[str, Provenance] = Field(
        default_factory=dict, description="source and valid range by dotted path"
    )

    @model_validator(mode="after")
    def _sheet_is_elastic(self) -> "SensorLayer":
        if self.elastomer.relaxation is not None and self.elastomer.is_thin_sheet:
            raise ValueError(
                "elastomer.relaxation: the compensation assumes an elastic sheet; remove the "
                "table, and state the modulus at the time of the measurement"
            )
        return self

    @model_validator(mode="after")
    def _sheet_is_uniform(self) -> "SensorLayer":
        if self.elastomer.thickness_field is not None:
            raise ValueError(
                "elastomer.thickness_field: the compensation assumes a uniform sheet; remove the "
                "table, and state its effect in sigma.thickness_mm"
            )
        return self


_IN_SIGMA = tuple(AssumedSigma.model_fields)


def load_sensor_layer(path: Path) -> SensorLayer:
    """Load a layer from a file; its tables may `use` data files, as in an experiment file.

    Raises
    ------
    ConfigError : one line per problem: key, found, allowed, remedy
    """
    tree = resolve_uses(read_toml(path), (path,))
    values, origins = split_quantities(convert_units(tree))
    values["provenance"] = {key: origin.model_dump() for key, origin in origins.items()}
    return validated(SensorLayer, values, f"{path}: ")


def sensor_layer_of(experiment: Experiment) -> SensorLayer:
    """Return elastomer and load of an experiment, with the standard uncertainties of its [sigma].

    For a thin sheet, an uncertainty that [sigma] lacks is that of the same key in
    `inputs/handling`. All other uncertainties that it lacks are 0. The layer is uniform, also if
    the elastomer has a thickness field.
    """
    press = experiment.press
    load = MeasuredLoad(
        back_pressure_kpa=press.back_pressure_kpa,
        depth_mm=press.depth_mm,
        force_n=press.force_n,
        ramp_s=press.ramp_s,
        hold_s=press.hold_s,
    )
    texture = experiment.coating.texture
    sigma = LayerSigma(
        depth_mm=None if press.depth_mm is None else 0.0,
        texture_mm=0.0 if texture is None else 1e-3 * texture.rms_um,
        **_usual_sigma(experiment) | experiment.sigma.model_dump(exclude_none=True),
    )
    elastomer = experiment.elastomer
    if elastomer.thickness_field is not None:
        elastomer = elastomer.model_copy(update={"thickness_field": None})
    return SensorLayer(elastomer=elastomer, press=load, sigma=sigma)


def _usual_sigma(experiment: Experiment) -> dict[str, float]:
    """Return the standard uncertainties of `inputs/handling`, by key of [sigma].

    Empty without a thin sheet: the dimensions under a slab are fitted with its nominal values.
    """
    if not experiment.elastomer.is_thin_sheet:
        return {}
    keys = {f"{table}.{name}": name for table in ("elastomer", "press") for name in _IN_SIGMA}
    return {
        keys[given.key]: given.spread_at(given.nominal_in(experiment))
        for given in usual_inputs(experiment).inputs.values()
        if given.key in keys
    }


def layer_to_toml(layer: SensorLayer) -> str:
    """Return a layer as TOML text; values that are None are left out."""
    tree = layer.model_dump(mode="json", exclude_none=True, exclude={"provenance"})
    return tomli_w.dumps(tree)
