"""The experiment as data: every number that describes sensor, specimen, press and decoding.

All models are frozen and refuse unknown keys; every float carries its unit in its name (mm, px,
deg, ms, N, kPa; no suffix means dimensionless). World frame: undeformed coated face is z = 0, z
points up to camera and projector. Device frames are OpenCV's (x right, y down, z forward; pixel
(0, 0) is the centre of the first pixel).
"""

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
Fraction = Annotated[float, Field(ge=0, le=1)]
Length = Annotated[float, Field(gt=0, le=1000)]
Angle = Annotated[float, Field(ge=-180, le=180)]
Distortion = tuple[float, float, float, float, float]


class Model(BaseModel):
    """Base of all configuration: immutable, no unknown keys, no NaN or infinity."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


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


class Specimen(Model):
    """What every specimen has: its pose on the stage, relative to the slab's centre."""

    x_mm: float = 0.0
    y_mm: float = 0.0
    z_mm: float = Field(
        default=0.0, description="within a group: height of the foremost point over the others'"
    )
    yaw_deg: Angle = 0.0
    tilt_deg: Annotated[float, Field(ge=-30, le=30)] = Field(
        default=0.0, description="tilt about the specimen's y axis; positive lifts its +x side"
    )


class Ball(Specimen):
    """One ball."""

    kind: Literal["ball"] = "ball"
    diameter_mm: Length = 8.0


class TwoBalls(Specimen):
    """Two joined balls side by side along the specimen's x axis (the paper's artefact)."""

    kind: Literal["two_balls"] = "two_balls"
    diameter_mm: Length = 8.0
    separation_mm: Length = Field(default=8.0, description="distance between the two centres")


class Rod(Specimen):
    """A cylinder lying along the specimen's x axis, its ends flat: a line contact."""

    kind: Literal["rod"] = "rod"
    diameter_mm: Length = 4.8
    length_mm: Length = 12.0
    edge_radius_mm: NonNegative = Field(default=0.2, description="rounding of the end faces' edge")

    @model_validator(mode="after")
    def _edge_fits(self) -> "Rod":
        _check_edge(self.edge_radius_mm, min(self.diameter_mm, self.length_mm))
        return self


class Flat(Specimen):
    """A flat round punch, its face towards the elastomer."""

    kind: Literal["flat"] = "flat"
    diameter_mm: Length = 6.0
    height_mm: Length = 5.0
    edge_radius_mm: NonNegative = Field(default=0.2, description="rounding of the face's edge")

    @model_validator(mode="after")
    def _edge_fits(self) -> "Flat":
        _check_edge(self.edge_radius_mm, min(self.diameter_mm, self.height_mm))
        return self


class Grating(Specimen):
    """A plate with sinusoidal grooves along its y axis: what relief the coat still shows."""

    kind: Literal["grating"] = "grating"
    pitch_mm: Length = 4.0
    groove_mm: Length = Field(default=0.2, description="depth of the grooves, crest to root")
    length_x_mm: Length = 12.0
    length_y_mm: Length = 12.0


class MeshFile(Specimen):
    """A closed triangle mesh from a file: STL, PLY or OBJ."""

    kind: Literal["mesh"] = "mesh"
    file: str = Field(description="path, or the name of a shipped mesh such as scenes/meshes/x.stl")
    scale: Positive = Field(default=1.0, description="mm per unit of the file")
    up: Literal["+x", "-x", "+y", "-y", "+z", "-z"] = Field(
        default="+z", description="axis of the file that faces the elastomer"
    )


Part = Annotated[Ball | TwoBalls | Rod | Flat | Grating | MeshFile, Field(discriminator="kind")]


class Group(Specimen):
    """Several specimens on one stage, pressed together."""

    kind: Literal["group"] = "group"
    parts: dict[str, Part] = Field(
        min_length=1, description="one table per part, [specimen.parts.NAME], each with its kind"
    )


AnySpecimen = Annotated[
    Ball | TwoBalls | Rod | Flat | Grating | MeshFile | Group, Field(discriminator="kind")
]


def _check_edge(edge_radius_mm: float, smallest_mm: float) -> None:
    if edge_radius_mm > smallest_mm / 2:
        raise ValueError(
            f"edge_radius_mm: found {edge_radius_mm:g}, allowed 0 to {smallest_mm / 2:g}, "
            "half the smaller of diameter and length"
        )


class Film(Model):
    """The coat as an elastic film of its own, the outermost part of the slab's thickness."""

    thickness_mm: Length
    young_modulus_kpa: Positive
    poisson_ratio: Annotated[float, Field(gt=0, lt=0.5)] = 0.49


class Elastomer(Model):
    """A flat silicone slab: on a rim and coated on the far face, or bonded to a window."""

    thickness_mm: Length
    length_x_mm: Length = Field(description="along world x: free span, or length of the pad")
    length_y_mm: Length = Field(description="along world y: free span, or length of the pad")
    shore_a: Annotated[float, Field(ge=0, le=95)] | None = Field(
        default=None,
        description="durometer hardness; below 20 every formula for the modulus extrapolates",
    )
    shore_00: Annotated[float, Field(ge=0, le=95)] | None = Field(
        default=None, description="hardness of very soft gels, instead of shore_a"
    )
    young_modulus_kpa: Positive | None = Field(
        default=None, description="measured modulus; when absent it follows from the hardness"
    )
    poisson_ratio: Annotated[float, Field(gt=0, lt=0.5)]
    density_kg_m3: Annotated[float, Field(ge=100, le=5000)] | None = Field(
        default=None, description="needed when press.gravity_deg is given"
    )
    layout: Literal["opposite_face", "contact_face"] = Field(
        default="opposite_face",
        description="opposite_face: the object presses the clear face of a slab on a simply "
        "supported rim, the coated far face bulges (the paper); contact_face: it presses the "
        "coat of a gel bonded to a rigid window (GelSight)",
    )
    film: Film | None = Field(default=None, description="absent: the coat is as soft as the slab")

    @model_validator(mode="after")
    def _stiffness_is_known(self) -> "Elastomer":
        if (self.shore_a, self.shore_00, self.young_modulus_kpa) == (None, None, None):
            raise ValueError("needs shore_a, shore_00 or young_modulus_kpa")
        if self.shore_a is not None and self.shore_00 is not None:
            raise ValueError("takes shore_a or shore_00, not both: remove one")
        if self.film is not None and self.film.thickness_mm >= self.thickness_mm:
            raise ValueError(
                f"film.thickness_mm: found {self.film.thickness_mm:g}, allowed less than "
                f"thickness_mm, {self.thickness_mm:g}, of which it is a part"
            )
        return self

    @property
    def touched_plane_mm(self) -> float:
        """World z of the undeformed face that the object touches; the coated face is z = 0."""
        return -self.thickness_mm if self.layout == "opposite_face" else 0.0


class Coating(Model):
    """Gray ink with aluminium flakes: a blend of a diffuse and a rough conducting reflector."""

    base_albedo: Annotated[float, Field(gt=0, lt=1)]
    flake_fraction: Fraction
    flake_roughness: Annotated[float, Field(ge=0.05, le=1)] = Field(
        description="GGX alpha of the flakes' normals"
    )
    flake_ior: Positive = Field(description="real part n of the flakes' complex index")
    flake_extinction: NonNegative = Field(description="imaginary part k of the complex index")


class Press(Model):
    """How the specimen is pressed in: to a depth, or with a force."""

    control: Literal["depth", "force"]
    depth_mm: Positive | None = Field(default=None, description="travel after first touch")
    force_n: Positive | None = None
    back_pressure_kpa: NonNegative = Field(
        default=0.0,
        description="uniform gauge pressure on the coated face; drapes the sheet over the specimen",
    )
    gravity_deg: Annotated[float, Field(ge=0, le=180)] | None = Field(
        default=None,
        description="angle between world z and the vertical: 0 camera above, 180 camera below; "
        "when absent the slab has no weight",
    )
    solver_pitch_mm: Annotated[float, Field(ge=0.01, le=0.5)] = 0.08
    relief_pitch_mm: Annotated[float, Field(ge=0.005, le=0.05)] = Field(
        default=0.025, description="mesh pitch of the coated face"
    )

    @model_validator(mode="after")
    def _control_has_its_value(self) -> "Press":
        needed, other = ("depth_mm", "force_n")[:: 1 if self.control == "depth" else -1]
        if getattr(self, needed) is None:
            raise ValueError(f"control = '{self.control}' needs {needed}")
        if getattr(self, other) is not None:
            raise ValueError(f"control = '{self.control}' does not take {other}: remove it")
        return self


class PadFile(Model):
    """An elastic body from CAD in place of the flat slab: a coated dome behind a window, say.

    It is moved so that its lowest point is z = 0, held on its highest plane, and touched and seen
    on the facets that face down (contact-face layout).
    """

    file: str = Field(description="closed surface: STL, PLY or OBJ")
    scale_mm: Positive = Field(default=1.0, description="length of one unit of the file")
    facing_deg: Annotated[float, Field(gt=0, lt=90)] = Field(
        default=60.0, description="facets leaning from straight down by less than this are coated"
    )


class Mechanics(Model):
    """Which model presses the elastomer."""

    model: Literal["auto", "spectral", "fem", "neo_hookean"] = Field(
        default="auto",
        description="auto: spectral, but neo_hookean for a sheet that deflects by about its "
        "thickness; fem: other supports and pads from CAD (its mesher, and so its last digits, "
        "differ from run to run)",
    )
    support: Literal["simple", "clamped", "ledge", "bonded", "window"] | None = Field(
        default=None, description="fem only; absent: what the layout says"
    )
    ledge_mm: Positive = Field(
        default=2.0, description="fem, support = 'ledge': width of the frame under the slab"
    )
    pad: PadFile | None = Field(default=None, description="fem only")
    tetrahedra: Annotated[int, Field(ge=200, le=20000)] = Field(
        default=4000, description="fem only: about how many"
    )

    @model_validator(mode="after")
    def _fem_only(self) -> "Mechanics":
        for name in ("support", "pad"):
            if getattr(self, name) is not None and self.model != "fem":
                raise ValueError(f"{name} needs model = 'fem'; set it, or remove {name}")
        return self


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


class Patterns(Model):
    """The projected sequence: N-step phase shift both ways, Gray code, white and black."""

    period_px: Annotated[float, Field(ge=4, le=512)]
    steps: Annotated[int, Field(ge=3, le=64)]
    complementary: bool = True


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
    bounces: Annotated[int, Field(ge=0, le=16)] = Field(
        default=0, description="reflections after the first (light between surfaces); 0 is direct"
    )
    bounce_paths: Annotated[int, Field(ge=1, le=4096)] = Field(
        default=4, description="random continuations per camera ray, when there are bounces"
    )


class Decode(Model):
    """How the stack becomes points."""

    filter_taps: Annotated[int, Field(ge=0, le=31)] = Field(
        default=8, description="Gaussian on the complex phasor; 0 switches it off"
    )
    filter_sigma_px: Positive = 1.5
    use: Literal["column", "row", "both"] = "column"


class Score(Model):
    """What is evaluated."""

    roi_radius_mm: Positive = Field(
        description="sphere fit over points within this lateral distance of each apex"
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
    specimen: AnySpecimen
    elastomer: Elastomer
    coating: Coating
    press: Press
    mechanics: Mechanics = Mechanics()
    projector: Projector
    camera: Camera
    patterns: Patterns
    render: Render = Render()
    decode: Decode = Decode()
    score: Score
    provenance: dict[str, Provenance] = Field(
        default_factory=dict, description="source and valid range by dotted path"
    )
