"""Projector and camera as data. Device frames are OpenCV's, see `models`."""

from typing import Annotated, Literal

from pydantic import Field

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
    blur_px: Annotated[float, Field(ge=0, le=10)] = Field(
        description="lens blur, Gaussian sigma in projector pixels, on top of the DMD pixel box"
    )


class Camera(Model):
    """A monochrome camera: geometry of an ideal lens and EMVA 1288 noise (release 4 terms)."""

    width_px: Annotated[int, Field(ge=8, le=16384)]
    height_px: Annotated[int, Field(ge=8, le=16384)]
    pixel_pitch_um: Positive
    focal_length_mm: Length
    f_number: Annotated[float, Field(ge=0.7, le=64)]
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
