"""The experiment as data: every number that describes sensor, specimen, press and decoding.

All models are frozen and refuse unknown keys; every float carries its unit in its name (mm, px,
deg, ms, N, kPa; no suffix means dimensionless). World frame: undeformed coated face is z = 0, z
points up to camera and projector. Device frames are OpenCV's (x right, y down, z forward; pixel
(0, 0) is the centre of the first pixel).
"""

from typing import Annotated, Literal

from pydantic import Field, ValidationInfo, field_validator, model_validator

from reconstruction.decoding import DecodeOptions
from reconstruction.patterns import (
    MOST_FURTHER_PERIODS,
    PERIOD_RANGE_PX,
    STEPS_RANGE,
    CodeName,
    PatternSet,
)
from twin.config.base import Distortion, Model, Positive
from twin.config.devices import Camera, Pose, Projector
from twin.config.elastomer import Coating, Elastomer, Film, Mechanics, PadFile, Press, Texture
from twin.config.lamps import Lamp, Photometric, check_lamps
from twin.config.layers import Layer, Layers, check_rig
from twin.config.methods import TRAITS, Method, MethodTraits
from twin.config.specimen_base import Conductor, Dielectric, Diffuse, Material, Plastic, Stage
from twin.config.specimens import (
    AnySpecimen,
    Ball,
    Flat,
    Grating,
    Group,
    MeshFile,
    Rod,
    Specimen,
    TwoBalls,
)

__all__ = [
    "AnySpecimen",
    "Ball",
    "Camera",
    "Coating",
    "Conductor",
    "Decode",
    "Dielectric",
    "Diffuse",
    "Distortion",
    "Elastomer",
    "Experiment",
    "Film",
    "Flat",
    "Grating",
    "Group",
    "Lamp",
    "Layer",
    "Material",
    "Mechanics",
    "MeshFile",
    "Model",
    "PadFile",
    "Patterns",
    "Photometric",
    "Plastic",
    "Pose",
    "Press",
    "Projector",
    "Provenance",
    "Render",
    "Rod",
    "ScoreSettings",
    "Specimen",
    "Stage",
    "Texture",
    "TwoBalls",
]


# Specimen and stage light each other; what a fourth reflection adds at albedo 0.35 is below 1 %.
_DIRECT_BOUNCES = 3


PeriodPx = Annotated[float, Field(ge=PERIOD_RANGE_PX[0], le=PERIOD_RANGE_PX[1])]
Periods = Annotated[tuple[PeriodPx, ...], Field(max_length=MOST_FURTHER_PERIODS)]


class Patterns(Model):
    """What of a `PatternSet` does not follow from the projector, with its ranges and defaults."""

    period_px: PeriodPx
    steps: Annotated[int, Field(ge=STEPS_RANGE[0], le=STEPS_RANGE[1])]
    code: CodeName = Field(default=PatternSet.code, description="how the fringes are numbered")
    further_periods_px: Periods = Field(
        default=PatternSet.further_periods_px,
        description="hierarchical: coarser periods, one at least the image; heterodyne: one or two"
        " periods slightly above period_px",
    )


class Render(Model):
    """How the frames are computed."""

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
        description="reflections at matte surfaces after the first (light between surfaces); 0 is "
        "direct light alone; absent: 0 for the coat, 3 where the bare specimen is seen",
    )
    bounce_paths: Annotated[int, Field(ge=1, le=4096)] = Field(
        default=4, description="random continuations per camera ray, when there are bounces"
    )
    photons: Annotated[int, Field(ge=1000, le=10**9)] = Field(
        default=4_000_000,
        description="light paths from the projector through clear or polished specimens",
    )


class Decode(Model):
    """How the stack becomes points."""

    filter_taps: Annotated[int, Field(ge=0, le=31)] = Field(
        default=DecodeOptions.filter_taps,
        description="Gaussian on the projector coordinate; 0 switches it off",
    )
    filter_sigma_px: Positive = DecodeOptions.filter_sigma_px
    use: Literal["column", "row", "both"] = "column"
    through_layers: bool = Field(
        default=True,
        description="bend the rays at the plane layers; false: triangulate as in air",
    )


class ScoreSettings(Model):
    """What is evaluated."""

    roi_radius_mm: Positive = Field(
        description="sphere fit over points within this lateral distance of each apex"
    )
    good_within_um: Positive = Field(
        default=50.0, description="a point counts as good when its height errs by no more"
    )


class Provenance(Model):
    """Where one number comes from."""

    source: str
    range: tuple[float, float] | None = None


class Experiment(Model):
    """One virtual measurement, whole."""

    schema_version: Literal[1] = 1
    name: Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9_\-]*$", max_length=64)]
    description: str = ""
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    modality: Method = Field(
        default="contact_fpp",
        description="contact_fpp: fringes on the coat of the pressed elastomer; "
        "direct_fpp: fringes on the bare specimen, which stands on the stage; "
        "photometric_stereo: the coat in the light of coloured lamps, seen through its gel",
    )
    specimen: AnySpecimen
    stage: Stage = Stage()
    elastomer: Elastomer
    coating: Coating
    press: Press
    mechanics: Mechanics = Mechanics()
    projector: Projector
    camera: Camera
    patterns: Patterns
    render: Render = Render()
    decode: Decode = Decode()
    score: ScoreSettings
    layers: Layers = Field(
        default={},
        description="[layers.NAME]: clear plane layers above the coat, each with bottom_mm (world "
        "z; 0 or less holds the coat), thickness_mm, ior, absorption_per_mm (0)",
    )
    lamps: dict[str, Lamp] = Field(
        default={},
        validate_default=True,
        description="[lamps.NAME]: rows of LEDs beside the gel (photometric_stereo)",
    )
    photometric: Photometric = Field(
        default=Photometric(), description="images and calibration of photometric_stereo"
    )
    provenance: dict[str, Provenance] = Field(
        default_factory=dict, description="source and valid range by dotted path"
    )

    @property
    def bounces(self) -> int:
        """Reflections after the first that are traced."""
        if self.render.bounces is not None:
            return self.render.bounces
        return 0 if self.method.presses else _DIRECT_BOUNCES

    @property
    def method(self) -> MethodTraits:
        """What the method of `modality` does."""
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
