"""Experiment as data: every number that describes sensor, specimen, press and decoding.

All models are frozen and reject unknown keys. The name of every float ends with the unit (mm, px,
deg, ms, N, kPa); a name without a unit is dimensionless. In the world frame, the undeformed coated
face is z = 0, and z points up to camera and projector. Device frames are those of OpenCV: x right,
y down, z forward; pixel coordinate (0, 0) is the centre of the first pixel.
"""

from typing import Annotated, Literal

from pydantic import ConfigDict, Field, ValidationInfo, field_validator, model_validator

from reconstruction.decoding import DecodeOptions, PhaseReference, Weights
from reconstruction.spatial_unwrapping import Islands
from twin.config.base import Model
from twin.config.bounds import Distortion, FilterWidth, Length, Photons, Tolerance
from twin.config.coatings import COATINGS, AnyCoating, Coating, Texture
from twin.config.devices import Camera, Pose, Projector
from twin.config.elastomer import Elastomer, Film, Mechanics, PadFile, Press
from twin.config.kinds import follows
from twin.config.lamps import Lamp, Photometric, check_lamps
from twin.config.layers import Layer, Layers, check_rig
from twin.config.materials import MATERIALS, Material
from twin.config.measurands import ObjectMeasurand
from twin.config.methods import TRAITS, Method, MethodTraits
from twin.config.motion import Motion
from twin.config.noise_models import NOISE_MODELS, NoiseModel
from twin.config.optics import Optics
from twin.config.overview import overview
from twin.config.patterns import Patterns
from twin.config.sigma import AssumedSigma
from twin.config.specimen_base import SPECIMENS, AnySpecimen, Specimen, Stage
from twin.config.timing import Timing

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
    "Motion",
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
    "Timing",
]


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
    max_residual_sigmas: Annotated[float, Field(gt=0, le=1e6)] | None = Field(
        default=None,
        exclude_if=lambda sigmas: sigmas is None,
        description="mask pixels whose phase frames deviate more from a fringe at rest (motion), in"
        " standard deviations of their levels; needs 4 steps or more; absent: none",
    )
    motion_error: bool = Field(
        default=False,
        exclude_if=lambda predicted: not predicted,
        description="predict the error of each point by motion from the residuals of the phase "
        "frames, in place of the motion that the experiment states; needs 4 steps or more",
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
    timing: Timing = Field(default=Timing(), exclude_if=lambda timing: timing == Timing())
    motion: Motion = Field(default=Motion(), exclude_if=lambda motion: motion == Motion())
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
