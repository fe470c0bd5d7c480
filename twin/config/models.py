"""Experiment as data: every number that describes sensor, specimen, press and decoding.

All models are frozen and reject unknown keys. The name of every float ends with the unit (mm, px,
deg, ms, N, kPa); a name without a unit is dimensionless. In the world frame, the undeformed coated
face is z = 0, and z points up to camera and projector. Device frames are those of OpenCV: x right,
y down, z forward; pixel coordinate (0, 0) is the centre of the first pixel.
"""

from itertools import pairwise
from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field, ValidationInfo, field_validator, model_validator

from reconstruction.decoding import DecodeOptions, PhaseReference, Weights
from reconstruction.spatial_unwrapping import Islands
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
    FilterWidth,
    Flicker,
    Flux,
    FNumber,
    FullWell,
    GlareWidth,
    Length,
    LightDrift,
    Photons,
    PixelPitch,
    PixelWidth,
    Rate,
    ReadNoise,
    ResponseSpread,
    ScatteredShare,
    ThrowRatio,
    Tolerance,
)
from twin.config.coatings import COATINGS, AnyCoating, Coating, Texture
from twin.config.elastomer import Elastomer, Film, Mechanics, PadFile, Press
from twin.config.kinds import follows
from twin.config.lamps import Lamp, Photometric, check_lamps
from twin.config.layers import Layer, Layers, check_rig
from twin.config.materials import MATERIALS, Material
from twin.config.measurands import ObjectMeasurand
from twin.config.methods import TRAITS, Method, MethodTraits
from twin.config.noise_models import NOISE_MODELS, AnyNoise, NoiseModel
from twin.config.optics import Optics
from twin.config.overview import overview
from twin.config.patterns import Patterns
from twin.config.sigma import AssumedSigma
from twin.config.specimen_base import SPECIMENS, AnySpecimen, Specimen, Stage

__all__ = [
    "AnySpecimen",
    "Camera",
    "Coating",
    "Decode",
    "Distortion",
    "Elastomer",
    "Experiment",
    "Film",
    "Lamp",
    "Layer",
    "Material",
    "Mechanics",
    "Model",
    "NoiseModel",
    "ObjectMeasurand",
    "Optics",
    "PadFile",
    "Patterns",
    "Photometric",
    "Pose",
    "Press",
    "Projector",
    "Provenance",
    "Render",
    "ScoreSettings",
    "Specimen",
    "Stage",
    "Texture",
]


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


# Reflections of light between specimen and stage that are traced: a fourth one at albedo 0.35 adds
# less than 1 %.
_DIRECT_BOUNCES = 3


class Render(Model):
    """Settings of rendering: engine, samples, and reflections between surfaces."""

    engine: Literal["one_trace", "stock"] = Field(
        default="one_trace", description="stock: one plain Mitsuba render per frame, the oracle"
    )
    stock_emitter: Literal["projector", "spot"] = Field(
        default="projector", description="Mitsuba emitter that carries the pattern texture"
    )
    samples: Literal[1, 4, 9, 16, 25, 36, 64, 256] = Field(
        default=4, description="camera rays per pixel; one_trace uses a fixed square grid of them"
    )
    bounces: Annotated[int, Field(ge=0, le=16)] | None = Field(
        default=None,
        description="reflections at matte surfaces after the first (light between surfaces); 0: "
        "direct light only; absent: 0 for the coat, 3 for a bare specimen",
    )
    bounce_paths: Annotated[int, Field(ge=1, le=4096)] = Field(
        default=4, description="random continuations per camera ray, when there are bounces"
    )
    photons: Photons = Field(
        default=4_000_000,
        description="light paths from the projector through clear or polished specimens",
    )


class Decode(Model):
    """Settings of decoding and triangulation: filter, coordinates, and refraction."""

    filter_taps: Annotated[int, Field(ge=0, le=31)] = Field(
        default=DecodeOptions.filter_taps,
        description="Gaussian on the projector coordinate; 0 switches it off",
    )
    filter_sigma_px: FilterWidth = DecodeOptions.filter_sigma_px
    # Excluded if it is the default, so that digests of experiments do not change.
    weights: Weights = Field(
        default=DecodeOptions.weights,
        description="weights of the pixels in the filter; equal: glints do not move the result, "
        "and relief is restored; modulation: Gaussian on the complex phasor, as published decoders",
        exclude_if=lambda weights: weights == DecodeOptions.weights,
    )
    use: Literal["column", "row", "both"] = "column"
    frame_gains: bool = Field(
        default=DecodeOptions.frame_gains,
        exclude_if=lambda estimated: estimated,
        description="estimate the light of every phase frame from the frames, and divide by it if "
        "it differs significantly; needs 4 steps or more",
    )
    reference_pixels: tuple[tuple[float, ...], ...] = Field(
        default=(),
        exclude_if=lambda pixels: not pixels,
        description="code 'spatial': camera column and row, projector column and, if known, row of"
        " pixels with a known coordinate",
    )
    reference_z_mm: Annotated[float, Field(ge=-1e3, le=1e3)] | None = Field(
        default=None,
        exclude_if=lambda z_mm: z_mm is None,
        description="code 'spatial': world z of the largest continuous surface",
    )
    reference_sigma_mm: Annotated[float, Field(gt=0, le=1e3)] = Field(
        default=PhaseReference.sigma_mm,
        exclude_if=lambda sigma_mm: sigma_mm == PhaseReference.sigma_mm,
        description="standard deviation of reference_z_mm, including the relief of the surface",
    )
    islands: Islands = Field(
        default=PhaseReference.islands,
        exclude_if=lambda islands: islands == PhaseReference.islands,
        description="code 'spatial': mask islands behind jumps of the phase without a reference;"
        " all: number each one by reference_z_mm; join: the jumps are less than half a period",
    )
    through_layers: bool = Field(
        default=True,
        description="bend the rays at the plane layers; false: triangulate as in air",
    )


class ScoreSettings(Model):
    """Settings of the comparison with the truth and of the sphere fits."""

    roi_radius_mm: Length = Field(
        description="sphere fit over points within this lateral distance of each apex"
    )
    # Excluded if empty, so that digests of experiments without regions do not change.
    regions_mm: tuple[Length, ...] = Field(
        default=(),
        max_length=16,
        exclude_if=lambda regions: not regions,
        description="same fit over further distances, up to the ball's footprint; figures named "
        "sphere_1_within_4_radius_mm",
    )
    good_within_um: Tolerance = Field(
        default=50.0, description="largest height error of a point that counts as good"
    )


class Provenance(Model):
    """Source of one number, and its valid range if stated."""

    source: str
    range: tuple[float, float] | None = None


@follows(COATINGS, MATERIALS, NOISE_MODELS, SPECIMENS)
class Experiment(Model):
    """Complete description of one virtual measurement."""

    model_config = ConfigDict(defer_build=True)

    schema_version: Literal[1] = 1
    name: Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9_\-]*$", max_length=64)]
    description: str = ""
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    links: dict[str, str] = Field(
        default_factory=dict,
        exclude_if=lambda links: not links,
        description="linked keys: each has the value of the key that it names, which must be set",
    )
    modality: Method = Field(
        default="contact_fpp",
        description="contact_fpp: fringes on the coat of the pressed elastomer; "
        "direct_fpp: fringes on the bare specimen on the stage; "
        "photometric_stereo: the coat under coloured lamps, imaged through its gel",
    )
    specimen: AnySpecimen
    stage: Stage = Stage()
    elastomer: Elastomer
    coating: AnyCoating
    press: Press
    mechanics: Mechanics = Mechanics()
    projector: Projector
    camera: Camera
    optics: Optics = Field(default=Optics(), exclude_if=lambda optics: not optics.is_stated)
    patterns: Patterns
    render: Render = Render()
    decode: Decode = Decode()
    score: ScoreSettings
    sigma: AssumedSigma = Field(
        default=AssumedSigma(),
        exclude_if=lambda sigma: sigma == AssumedSigma(),
        description="standard uncertainties of elastomer and load, for those of the object",
    )
    measurand: tuple[ObjectMeasurand, ...] = Field(
        default=(),
        max_length=200,
        exclude_if=lambda measurands: not measurands,
        description="[[measurand]]: quantities to be measured, each with name, quantity and "
        "optionally nominal_mm and limits",
    )
    layers: Layers = Field(
        default={},
        max_length=32,
        description="[layers.NAME]: clear plane layers above the coat, each with bottom_mm (world "
        "z; 0 or less: contains the coat), thickness_mm, ior, absorption_per_mm (0)",
    )
    lamps: dict[str, Lamp] = Field(
        default={},
        max_length=64,
        validate_default=True,
        description="[lamps.NAME]: rows of LEDs at the sides of the gel (photometric_stereo)",
    )
    photometric: Photometric = Field(
        default_factory=Photometric, description="images and calibration of photometric_stereo"
    )
    provenance: dict[str, Provenance] = Field(
        default_factory=dict, description="source and valid range by dotted path"
    )

    def __repr__(self) -> str:
        return overview(self)

    __str__ = __repr__

    @property
    def bounces(self) -> int:
        """Number of traced reflections of light after the first reflection."""
        if self.render.bounces is not None:
            return self.render.bounces
        return 0 if self.method.presses else _DIRECT_BOUNCES

    @property
    def method(self) -> MethodTraits:
        """Traits of the method that `modality` names."""
        return TRAITS[self.modality]

    @model_validator(mode="after")
    def _mesh_resolves_the_texture(self) -> "Experiment":
        texture, pitch_mm = self.coating.texture, self.press.relief_pitch_mm
        if texture is not None and pitch_mm > texture.correlation_mm / 2:
            raise ValueError(
                f"press.relief_pitch_mm: found {pitch_mm:g}, allowed up to "
                f"{texture.correlation_mm / 2:g}, half of coating.texture.correlation_mm; use a "
                "finer relief or a coarser texture"
            )
        return self

    @field_validator("measurand")
    @classmethod
    def _measurands_have_names(
        cls, measurands: tuple[ObjectMeasurand, ...]
    ) -> tuple[ObjectMeasurand, ...]:
        names = [measurand.name for measurand in measurands]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ValueError(f"found the name {', '.join(twice)} twice; each needs its own")
        return measurands

    @field_validator("layers")
    @classmethod
    def _layers_fit_the_rig(
        cls, layers: dict[str, Layer], info: ValidationInfo
    ) -> dict[str, Layer]:
        check_rig(layers, info.data)
        return layers

    @field_validator("lamps")
    @classmethod
    def _lamps_fit_the_rig(cls, lamps: dict[str, Lamp], info: ValidationInfo) -> dict[str, Lamp]:
        check_lamps(lamps, info.data)
        return lamps
