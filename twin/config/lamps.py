"""Photometric-stereo sensor as data: lamps at the sides of the gel, and image processing.

World frame: z = 0 is the undeformed coated face, and z points up to the camera. In the image of a
camera that points straight down, +x is right and +y is up. Azimuths are measured from +x towards
+y.
"""

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field, model_validator

from reconstruction.colour_maps import COLOUR_MAPS, DEFAULT_MAP
from reconstruction.integration_schemes import SCHEMES
from twin.config.base import Angle, Fraction, Model
from twin.config.bounds import Flux, Irradiance, Length
from twin.config.kinds import NameOf, follows
from twin.config.layers import Layer, outer_face
from twin.config.materials import MATERIALS, Material
from twin.config.methods import TRAITS

Channel = Literal["red", "green", "blue"]
CHANNELS: tuple[Channel, ...] = ("red", "green", "blue")
Drift = Annotated[float, Field(ge=0, le=20)]
Gain = Annotated[float, Field(gt=0, le=20)]
Place = Annotated[float, Field(ge=-200, le=200)]


class Lamp(Model):
    """Straight row of LEDs that shine into the gel from its side.

    Each LED is a point source with the radiant intensity I = I0 cos(angle)^exponent; the angle is
    that to the direction of strongest emission.
    """

    channel: Channel
    x_mm: Place = Field(description="world x of the row's middle")
    y_mm: Place = Field(description="world y of the row's middle")
    height_mm: Annotated[float, Field(gt=0, le=200)] = Field(
        description="height above the undeformed coat"
    )
    length_mm: Annotated[float, Field(ge=0, le=200)] = Field(
        description="length of the row: each LED is in the middle of an equal part of it"
    )
    along_deg: Angle = Field(description="azimuth of the row")
    # Excluded at its default, so that digests of experiments with thin, even rows do not change.
    tall_mm: Annotated[float, Field(ge=0, le=200)] = Field(
        default=0.0,
        exclude_if=lambda tall_mm: tall_mm == 0.0,
        description="height of the shining area, amid height_mm: the LEDs are spread over it as"
        " well; shadows that the relief casts grow softer with it",
    )
    aim_azimuth_deg: Angle = Field(description="horizontal direction of strongest emission")
    aim_down_deg: Annotated[float, Field(ge=-90, le=90)] = Field(
        description="angle of strongest emission below the horizontal; the window's outer face"
        " reflects light that is emitted upwards"
    )
    taper: Fraction = Field(
        default=0.0,
        exclude_if=lambda taper: taper == 0.0,
        description="relative deficit of the flux at the row's ends against its mean; the flux of "
        "its LEDs decreases with the square of the distance from the middle",
    )
    exponent: Annotated[float, Field(ge=0, le=200)] = Field(
        description="0: even over the half-space ahead"
    )
    flux_mw: Flux = Field(description="radiant flux of the whole row inside the gel")
    fill_mw_per_mm2: Irradiance = Field(
        default=0.0,
        description="irradiance of the undeformed coat by light that coat, window and housing"
        " scatter; equal radiance from all directions of total reflection at the window",
    )
    wavelength_nm: Annotated[float, Field(ge=300, le=1100)]
    emitters: Annotated[int, Field(ge=1, le=64)] = Field(default=8, description="number of LEDs")
    drift_percent: Drift = Field(
        default=0.0, description="SD of the row's flux from press to press, common to all LEDs"
    )
    led_drift_percent: Drift = Field(
        default=0.0,
        description="SD of each LED's flux over the row's mean from press to press: LEDs share one"
        " current, so that their sum is constant; no effect on a row of one LED",
    )


class Markers(Model):
    """Dots printed on the coat, on a rectangular lattice about the origin, fixed in its material.

    They move in the plane of the coat if the model of the elastomer computes this displacement.
    """

    pitch_x_mm: Length
    pitch_y_mm: Length
    radius_mm: Length
    relative_albedo: Fraction = Field(description="reflectance of the dots over the coat's")

    @model_validator(mode="after")
    def _apart(self) -> "Markers":
        if 2 * self.radius_mm >= min(self.pitch_x_mm, self.pitch_y_mm):
            raise ValueError(
                f"radius_mm: found {self.radius_mm:g}, allowed less than half of the pitches"
            )
        return self


class WhiteBalance(Model):
    """Gains of the camera driver before the power law; they amplify noise and signal equally."""

    red: Gain = 1.0
    green: Gain = 1.0
    blue: Gain = 1.0


@follows(MATERIALS)
class BallPresses(Model):
    """Reference presses of balls, from which the map from colour to slope is calibrated."""

    model_config = ConfigDict(defer_build=True)

    count: Annotated[int, Field(ge=4, le=500)] = 50
    smallest_diameter_mm: Length = 4.0
    largest_diameter_mm: Length = 9.0
    shallowest: Annotated[float, Field(gt=0.05, lt=0.5)] = Field(
        default=0.06, description="depth over radius of the gentlest press"
    )
    deepest: Annotated[float, Field(gt=0.05, lt=0.5)] = 0.24
    backgrounds: Annotated[int, Field(ge=1, le=100)] = Field(
        default=10, description="images without contact that are averaged"
    )
    truncated_background: bool = Field(
        default=False, description="their mean is cut to whole levels, as the vendor stores it"
    )
    material: Material | None = Field(
        default=None,
        exclude_if=lambda material: material is None,
        description="of the balls, and of specimens that name none: it shines through a coat with"
        " transmittance",
    )

    @model_validator(mode="after")
    def _ascending(self) -> "BallPresses":
        if self.smallest_diameter_mm > self.largest_diameter_mm or self.shallowest > self.deepest:
            raise ValueError("smallest_diameter_mm and shallowest must not exceed the largest")
        return self


@follows(MATERIALS)
class Photometric(Model):
    """Image processing and calibration of a photometric-stereo sensor.

    The steps are those of camera and driver: linear image, gains, power law and 8 bits, crop,
    resize. Colour filter array, sharpening and compression are not modelled.
    """

    model_config = ConfigDict(defer_build=True)

    vignetting_exponent: Annotated[float, Field(ge=0, le=10)] = Field(
        default=4.0,
        description="the image darkens off the axis with this power of the cosine; 4: natural "
        "vignetting; 0: the driver corrects it",
    )
    white_balance: WhiteBalance = WhiteBalance()
    gamma: Annotated[float, Field(ge=0.3, le=4)] = Field(
        default=2.2, description="level = 255 linear ** (1 / gamma)"
    )
    crop: Annotated[float, Field(ge=0, lt=0.5)] = Field(
        default=1 / 7, description="share of width and height that is cut off on each side"
    )
    width_px: Annotated[int, Field(ge=16, le=4096)] = 320
    height_px: Annotated[int, Field(ge=16, le=4096)] = 240
    field_x_mm: Length = Field(default=18.6, description="evaluated part of the coat, centred")
    field_y_mm: Length = 14.3
    markers: Markers | None = Field(
        default=None,
        description="dots printed on the coat, in images of every modality with a press",
    )
    presses: BallPresses = Field(default_factory=BallPresses)
    colour_map: Annotated[str, NameOf(COLOUR_MAPS)] = Field(
        default=DEFAULT_MAP, description="how colours become slopes"
    )
    integration: Annotated[str, NameOf(SCHEMES)] = Field(
        default="corrected", description="how slopes become heights"
    )


def check_lamps(lamps: Mapping[str, Lamp], tables: Mapping[str, Any]) -> None:
    """Raise ValueError if lamps contradict other tables of the experiment.

    Parameters
    ----------
    lamps : the lamps by name
    tables : those tables of the experiment, by name, that are valid

    Raises
    ------
    ValueError : one line: key, found, allowed, remedy
    """
    if "modality" in tables and not TRAITS[tables["modality"]].fringes:
        _check_method(lamps, tables)
    layers: Mapping[str, Layer] = tables.get("layers", {})
    face = outer_face(layers)
    top_mm = max((layer.top_mm for layer in layers.values()), default=0.0)
    if face is not None:
        top_mm = face.height_mm
    for name, lamp in lamps.items():
        if layers and lamp.height_mm >= top_mm:
            raise ValueError(
                f"{name}.height_mm: found {lamp.height_mm:g}, allowed below {top_mm:g}, the top of"
                " the layers up to the first gap: lamps shine into them from the side; lower it"
            )
        highest_mm = lamp.height_mm + lamp.tall_mm / 2
        if lamp.tall_mm / 2 >= lamp.height_mm or (layers and highest_mm >= top_mm):
            reach_mm = min(lamp.height_mm, top_mm - lamp.height_mm) if layers else lamp.height_mm
            raise ValueError(
                f"{name}.tall_mm: found {lamp.tall_mm:g}, allowed below {2 * reach_mm:g}: the"
                " whole lamp must be above the undeformed coat and below the top of the layers"
            )


def _check_method(lamps: Mapping[str, Lamp], tables: Mapping[str, Any]) -> None:
    missing = [name for name in CHANNELS if name not in {lamp.channel for lamp in lamps.values()}]
    if missing:
        raise ValueError(
            f"no lamp has channel {', '.join(missing)}; modality = 'photometric_stereo' needs all"
            " three: add [lamps.NAME]"
        )
    if "elastomer" in tables and tables["elastomer"].layout != "contact_face":
        raise ValueError(
            "modality = 'photometric_stereo' views the coat through the gel; set"
            " elastomer.layout = 'contact_face'"
        )
    if "layers" in tables and not tables["layers"]:
        raise ValueError("modality = 'photometric_stereo' needs the gel: add [layers.gel]")
