"""Projector and camera as data. Device frames are OpenCV's, see `models`."""

from itertools import pairwise
from typing import Annotated, Literal

from pydantic import Field, ValidationInfo, field_validator

from twin.config.base import Angle, Distortion, Fraction, Length, Model, NonNegative, Positive


class Pose(Model):
    """Where a device stands: its pinhole on a sphere round the world origin, looking at it.

    The ray of the image centre (not the optical axis, which may be off-axis) hits the origin.
    """

    standoff_mm: Length = Field(description="distance from the pinhole to the world origin")
    polar_deg: Annotated[float, Field(ge=0, lt=90)] = Field(
        default=0.0, description="angle between the line to the origin and the world z axis"
    )
    azimuth_deg: Angle = Field(
        default=0.0, description="direction of the pinhole in the world xy plane; 0 is +x"
    )
    roll_deg: Angle = Field(default=0.0, description="rotation about the ray of the image centre")


class Projector(Model):
    """A DLP projector as an inverse camera with radiometry."""

    width_px: Annotated[int, Field(ge=16, le=8192)]
    height_px: Annotated[int, Field(ge=16, le=8192)]
    throw_ratio: Positive = Field(description="distance / image width; focal length in widths")
    offset_percent: Annotated[float, Field(ge=-200, le=200)] = Field(
        description="100: the optical axis leaves at the lower edge of the image, 0: centred"
    )
    distortion: Distortion = (0.0, 0.0, 0.0, 0.0, 0.0)
    pose: Pose
    flux_mw: Positive = Field(description="radiant flux of a full white image")
    wavelength_nm: Annotated[float, Field(ge=300, le=1100)]
    contrast: Annotated[float, Field(gt=1)] = Field(description="full white / full black")
    gamma: Annotated[float, Field(ge=0.3, le=4)] = Field(
        default=1.0, description="light = (level / 255) ** gamma"
    )
    response: tuple[Fraction, ...] | None = Field(
        default=None,
        description="measured instead of gamma: relative light at equally spaced levels from 0 to "
        "255, between which it is interpolated; never falling, the last is 1; black is `contrast`",
    )
    blur_px: Annotated[float, Field(ge=0, le=10)] = Field(
        description="lens blur at best focus, Gaussian sigma in projector pixels, on top of the "
        "DMD pixel box"
    )
    aperture_mm: Annotated[float, Field(ge=0, le=100)] = Field(
        default=0.0,
        description="diameter of the exit pupil: blur grows with the distance from the focal "
        "plane; 0: the same blur at every distance",
    )
    focus_mm: Length | None = Field(
        default=None,
        description="axial distance of best focus; absent: that of the world origin",
    )

    @field_validator("response")
    @classmethod
    def _response_is_a_curve(
        cls, response: tuple[float, ...] | None, info: ValidationInfo
    ) -> tuple[float, ...] | None:
        if response is None:
            return None
        if info.data.get("gamma", 1.0) != 1.0:
            raise ValueError("allowed only with gamma = 1: give either a table or a power law")
        if len(response) < 2 or response[-1] != 1.0:
            raise ValueError("allowed two or more numbers, the last 1; divide by the white level")
        if any(higher < lower for lower, higher in pairwise(response)):
            raise ValueError("allowed numbers that never fall with the level; smooth the curve")
        return response


class Camera(Model):
    """A monochrome camera: geometry of an ideal lens and EMVA 1288 noise (release 4 terms)."""

    width_px: Annotated[int, Field(ge=8, le=16384)]
    height_px: Annotated[int, Field(ge=8, le=16384)]
    pixel_pitch_um: Positive
    focal_length_mm: Length
    f_number: Annotated[float, Field(ge=0.7, le=64)]
    depth_of_field: bool = Field(
        default=False,
        description="True: thin lens of diameter focal_length_mm / f_number, in focus on the plane "
        "across its axis through the world origin; False: everything is in focus",
    )
    distortion: Distortion = (0.0, 0.0, 0.0, 0.0, 0.0)
    pose: Pose = Field(description="its standoff is also the distance of best focus")
    exposure_ms: Positive | Literal["auto"] = Field(
        description="'auto': the white frame's 99.5th percentile reaches auto_level"
    )
    auto_level: Annotated[float, Field(gt=0, lt=1)] = Field(
        default=0.85, description="target of the automatic exposure as a fraction of saturation"
    )
    quantum_efficiency: Fraction
    lens_transmission: Fraction
    full_well_e: Positive = Field(description="saturation capacity")
    read_noise_e: NonNegative = Field(description="temporal dark noise")
    dark_current_e_per_s: NonNegative = 0.0
    prnu_percent: NonNegative = Field(default=0.0, description="photo response non-uniformity")
    dsnu_e: NonNegative = Field(default=0.0, description="dark signal non-uniformity")
    bit_depth: Literal[8, 10, 12, 14, 16]
    black_level_dn: NonNegative
    binning: Literal[1, 2, 4] = Field(
        default=1, description="pixels summed per axis; DN stays scaled to the bit depth"
    )
    noise: bool = Field(default=True, description="False: expected value, no quantisation")
