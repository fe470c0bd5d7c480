"""Camera and projector as data: tables `[camera]` and `[projector]`, with their poses."""

from itertools import pairwise
from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field, ValidationInfo, field_validator

from twin.config.base import Angle, Fraction, Model
from twin.config.bounds import (
    EXPOSURE_PERCENTILE,
    BlackLevel,
    Contrast,
    DarkCurrent,
    Distortion,
    DitherPeriods,
    DriftFrames,
    Exposure,
    Flicker,
    Flux,
    FNumber,
    FullWell,
    GlareWidth,
    Length,
    LightDrift,
    PixelPitch,
    PixelWidth,
    Rate,
    ReadNoise,
    ResponseSpread,
    ScatteredShare,
    ThrowRatio,
)
from twin.config.kinds import follows
from twin.config.noise_models import NOISE_MODELS, AnyNoise


class Pose(Model):
    """Pose of a camera or projector, given by the position of its pinhole round the world origin.

    The ray of the image centre passes through the origin. The optical axis may have another
    direction, if the image is off-axis.
    """

    standoff_mm: Length = Field(description="distance from the pinhole to the world origin")
    polar_deg: Annotated[float, Field(ge=0, lt=90)] = Field(
        default=0.0, description="angle between the line to the origin and the world z axis"
    )
    azimuth_deg: Angle = Field(
        default=0.0, description="direction of the pinhole in the world xy plane; 0 is +x"
    )
    roll_deg: Angle = Field(default=0.0, description="rotation about the ray of the image centre")


def _optional(description: str) -> Any:
    """Return a field whose value may be absent; digests exclude an absent value."""
    return Field(default=None, exclude_if=lambda value: value is None, description=description)


def _off(description: str) -> Any:
    """Return a field that is 0, without effect, by default; digests exclude this default."""
    return Field(default=0.0, exclude_if=lambda value: value == 0.0, description=description)


class Projector(Model):
    """DLP projector: an inverse camera with radiometry."""

    width_px: Annotated[int, Field(ge=16, le=8192)]
    height_px: Annotated[int, Field(ge=16, le=8192)]
    throw_ratio: ThrowRatio = Field(description="distance / image width; focal length in widths")
    offset_percent: Annotated[float, Field(ge=-200, le=200)] = Field(
        description="100: the optical axis is at the lower edge of the image, 0: centred"
    )
    pixel_ratio: PixelWidth | Literal["diamond"] = Field(
        default=1.0,
        exclude_if=lambda ratio: ratio == 1.0,
        description="width of a pixel / its height; 'diamond': mirrors turned by 45 degrees, every "
        "other row displaced by half a column (912 x 1140), ratio 2",
    )
    distortion: Distortion = (0.0, 0.0, 0.0, 0.0, 0.0)
    pose: Pose
    flux_mw: Flux = Field(description="radiant flux of a full white image")
    wavelength_nm: Annotated[float, Field(ge=300, le=1100)]
    contrast: Contrast = Field(description="full white / full black")
    gamma: Annotated[float, Field(ge=0.3, le=4)] = Field(
        default=1.0, description="light = (level / 255) ** gamma"
    )
    pattern_rate_8bit_hz: Rate | None = _optional(
        "largest rate of patterns of 256 levels, for sequence_ms; absent: no limit"
    )
    pattern_rate_1bit_hz: Rate | None = _optional(
        "largest rate of patterns of black and white; absent: pattern_rate_8bit_hz"
    )
    response: Annotated[tuple[Fraction, ...], Field(max_length=65536)] | None = Field(
        default=None,
        description="measured instead of gamma: relative light at equally spaced levels from 0 to "
        "255, between which it is interpolated; not decreasing, the last is 1; black is `contrast`",
    )
    blur_px: Annotated[float, Field(ge=0, le=10)] = Field(
        description="lens blur at best focus, Gaussian sigma in projector columns, on top of the "
        "DMD pixel box"
    )
    aperture_mm: Annotated[float, Field(ge=0, le=100)] = Field(
        default=0.0,
        description="diameter of the exit pupil: blur increases with the distance from the focal "
        "plane; 0: the same blur at every distance",
    )
    focus_mm: Length | None = Field(
        default=None,
        description="axial distance of best focus; absent: that of the world origin",
    )
    drift_percent: LightDrift = _off(
        "change of the lamp's light from the first to the last frame of a sequence"
    )
    drift_frames: DriftFrames | None = _optional(
        "time constant of a drift that decreases exponentially, frames; absent: a linear drift"
    )
    flicker_percent: Flicker = _off("SD of the lamp's light from frame to frame")
    dither_periods: DitherPeriods | None = _optional(
        "exposure over the period in which the DMD shows a level by the time of its mirrors, with "
        "exposures one after the other; absent or a whole number: exact levels"
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
            raise ValueError("allowed numbers that never decrease with the level; smooth the curve")
        return response


GLARE_WIDTH_PERCENT = 10.0


@follows(NOISE_MODELS)
class Camera(Model):
    """Monochrome camera: geometry of an ideal lens, and noise as in EMVA 1288.

    The terms are those of release 4 of the standard.
    """

    model_config = ConfigDict(defer_build=True)

    width_px: Annotated[int, Field(ge=8, le=16384)]
    height_px: Annotated[int, Field(ge=8, le=16384)]
    pixel_pitch_um: PixelPitch
    focal_length_mm: Length
    f_number: FNumber
    depth_of_field: bool = Field(
        default=False,
        description="True: thin lens of diameter focal_length_mm / f_number, in focus on the plane "
        "across its axis through the world origin; False: everything is in focus",
    )
    distortion: Distortion = (0.0, 0.0, 0.0, 0.0, 0.0)
    pose: Pose = Field(description="its standoff is also the distance of best focus")
    exposure_ms: Exposure | Literal["auto"] = Field(
        description=f"'auto': the white frame's {EXPOSURE_PERCENTILE:g}th percentile reaches "
        "auto_level"
    )
    frame_rate_hz: Rate | None = _optional(
        "largest rate of images at this size and bit depth, for sequence_ms; absent: no limit"
    )
    auto_level: Annotated[float, Field(gt=0, lt=1)] = Field(
        default=0.85, description="target of the automatic exposure as a fraction of saturation"
    )
    quantum_efficiency: Fraction
    lens_transmission: Fraction
    stray_percent: ScatteredShare = _off(
        "share of a frame's light that is scattered evenly over the image"
    )
    glare_percent: ScatteredShare = _off(
        "share of a frame's light that the lens scatters by a wide Gaussian"
    )
    glare_width_percent: GlareWidth = Field(
        default=GLARE_WIDTH_PERCENT,
        exclude_if=lambda width: width == GLARE_WIDTH_PERCENT,
        description="standard deviation of this Gaussian, percent of the image width",
    )
    full_well_e: FullWell = Field(description="saturation capacity")
    read_noise_e: ReadNoise = Field(description="temporal dark noise")
    dark_current_e_per_s: DarkCurrent = 0.0
    prnu_percent: ResponseSpread = Field(default=0.0, description="photo response non-uniformity")
    dsnu_e: ReadNoise = Field(default=0.0, description="dark signal non-uniformity")
    bit_depth: Literal[8, 10, 12, 14, 16]
    black_level_dn: BlackLevel
    binning: Literal[1, 2, 4] = Field(
        default=1, description="pixels summed per axis; DN remains scaled to the bit depth"
    )
    noise: bool = Field(default=True, description="False: expected value, no quantisation")
    # Left out of digests at its default, which has no numbers.
    noise_model: AnyNoise = Field(
        default={}, validate_default=True, exclude_if=lambda model: model.is_emva1288
    )

    @field_validator("pose")
    @classmethod
    def _is_in_focus(cls, pose: Pose, info: ValidationInfo) -> Pose:
        focal_mm = info.data.get("focal_length_mm", 0.0)
        if pose.standoff_mm <= focal_mm:
            raise ValueError(
                f"standoff_mm: found {pose.standoff_mm:g}, allowed more than focal_length_mm, "
                f"{focal_mm:g}: a lens forms no image of nearer objects; move the camera "
                "away, or use a shorter lens"
            )
        return pose

    @field_validator("black_level_dn")
    @classmethod
    def _black_is_below_white(cls, black_level_dn: float, info: ValidationInfo) -> float:
        largest = 2 ** info.data["bit_depth"] - 1 if "bit_depth" in info.data else float("inf")
        if black_level_dn >= largest:
            raise ValueError(
                f"allowed less than {largest}, the largest code of bit_depth; lower it"
            )
        return black_level_dn
