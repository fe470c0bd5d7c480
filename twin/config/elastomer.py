"""Elastomer, press and choice of the elastomer model as data.

Frames and units are those of `twin.config.models`.
"""

from typing import Annotated, Any, Literal

from pydantic import Field, ValidationInfo, field_validator, model_validator

from twin.config.base import Model
from twin.config.bounds import (
    AirPressure,
    FileUnit,
    FilmModulus,
    Force,
    HoldTime,
    Length,
    Modulus,
    RimCompliance,
    SlideTravel,
    Tack,
    Travel,
)
from twin.config.elastomer_models import (
    AUTO,
    MODELS,
    default_settings,
    models_that_take,
    settings_models,
)
from twin.config.kinds import NameOf, TablesOf
from twin.config.relaxation import Relaxation
from twin.config.thickness_field import ThicknessField

SHEET_THICKNESS_MM = (0.05, 1.0)
"""Range of the thickness of a thin sheet, mm."""


class Film(Model):
    """Coat as an elastic film with its own modulus: the outermost part of the slab's thickness."""

    thickness_mm: Length
    young_modulus_kpa: FilmModulus
    poisson_ratio: Annotated[float, Field(gt=0, lt=0.5)] = 0.49


class Elastomer(Model):
    """Flat silicone slab: on a rim and coated on the far face, or bonded to a window."""

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
    young_modulus_kpa: Modulus | None = Field(
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
    outline: Literal["rectangular", "round"] = Field(
        default="rectangular",
        description="opening of the frame; round: length_x_mm = length_y_mm is its diameter "
        "(sheet model)",
    )
    pre_stretch: Annotated[float, Field(ge=1, le=2)] = Field(
        default=1.0, description="of the mounted sheet, equal along x and y (sheet model)"
    )
    rim_compliance_mm2_per_n: RimCompliance = Field(
        default=0.0,
        description="slip (mm) of the sheet's edge along its frame per N/mm of line tension "
        "beyond that of the mounted sheet; 0: a rigid rim (sheet model)",
    )
    tack_j_m2: Tack = Field(
        default=0.0, description="adhesion energy of the clear face on the specimen (sheet model)"
    )
    friction: Literal["auto", "none", "stick"] = Field(
        default="auto",
        description="between clear face and specimen; stick: no slip after contact; auto: stick "
        "where there is tack (sheet model)",
    )
    # Excluded if None, so that digests of experiments without it do not change.
    friction_coefficient: Annotated[float, Field(ge=0, le=10)] | None = Field(
        default=None,
        exclude_if=lambda coefficient: coefficient is None,
        description="Coulomb friction of the touched face on the specimen: it slips where friction "
        "would exceed this number times the contact pressure; 0: no friction; absent: as friction "
        "says (sheet model, and spectral model with press.slide_x_mm or slide_y_mm)",
    )
    # Excluded if None, so that digests of experiments with a uniform sheet do not change.
    thickness_field: ThicknessField | None = Field(
        default=None,
        exclude_if=lambda field: field is None,
        description="deviation from thickness_mm, the mean; absent: uniform (sheet model)",
    )
    # Excluded if None, so that digests of experiments with an elastic elastomer do not change.
    relaxation: Relaxation | None = Field(
        default=None,
        exclude_if=lambda relaxation: relaxation is None,
        description="stress relaxation during press.ramp_s and press.hold_s; absent: elastic",
    )

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
        if self.friction_coefficient is not None and self.friction != "auto":
            raise ValueError(
                f"friction_coefficient needs friction = 'auto', found '{self.friction}': remove one"
            )
        if self.outline == "round" and self.length_x_mm != self.length_y_mm:
            raise ValueError(
                f"outline: a round opening needs length_x_mm = length_y_mm, found "
                f"{self.length_x_mm:g} and {self.length_y_mm:g}"
            )
        return self

    @property
    def is_thin_sheet(self) -> bool:
        """Whether this is a thin sheet: opposite-face layout, no film, 0.05 to 1 mm thick."""
        low, high = SHEET_THICKNESS_MM
        thin = low <= self.thickness_mm <= high
        return thin and self.layout == "opposite_face" and self.film is None

    @property
    def sticks(self) -> bool:
        """Whether the sheet has friction on the specimen: it cannot slip freely after contact."""
        if self.friction_coefficient is not None:
            return self.friction_coefficient > 0
        return self.friction == "stick" or (self.friction == "auto" and self.tack_j_m2 > 0)

    @property
    def largest_friction(self) -> float:
        """Largest ratio of friction to contact pressure; infinite for a sheet that sticks."""
        if self.friction_coefficient is not None:
            return self.friction_coefficient
        return float("inf") if self.sticks else 0.0

    @property
    def mounted_thickness_mm(self) -> float:
        """Thickness of the elastomer in its frame, mm.

        A pre-stretched sheet is thinner than its unstretched thickness.
        """
        return self.thickness_mm / self.pre_stretch**2

    @property
    def touched_plane_mm(self) -> float:
        """World z of the undeformed face that the object touches, mm.

        The undeformed coated face is z = 0.
        """
        return -self.mounted_thickness_mm if self.layout == "opposite_face" else 0.0


def zero_excluded(description: str) -> Any:
    """Return a field of 0 that is excluded then: digests of experiments without it stay."""
    return Field(default=0.0, exclude_if=lambda value: value == 0.0, description=description)


class Press(Model):
    """Load of the press: a prescribed travel, or a prescribed force."""

    control: Literal["depth", "force"]
    depth_mm: Travel | None = Field(default=None, description="travel after first touch")
    force_n: Force | None = None
    back_pressure_kpa: AirPressure = Field(
        default=0.0,
        description="uniform gauge pressure on the coated face; drapes the sheet over the specimen",
    )
    gravity_deg: Annotated[float, Field(ge=0, le=180)] | None = Field(
        default=None,
        description="angle between world z and the vertical: 0 camera above, 180 camera below; "
        "when absent the slab has no weight",
    )
    solver_pitch_mm: Annotated[float, Field(ge=0.01, le=0.5)] = 0.08
    cell_mm: Annotated[float, Field(ge=0.02, le=0.5)] | None = Field(
        default=None,
        description="finest cells of the sheet model; absent: 0.75 thicknesses, 0.075 to 0.15",
    )
    relief_pitch_mm: Annotated[float, Field(ge=0.005, le=0.05)] = Field(
        default=0.025, description="mesh pitch of the coated face"
    )

    ramp_s: HoldTime = zero_excluded(
        "duration of the press at constant speed, or of a force that grows in proportion to time; "
        "0: a step (with elastomer.relaxation)"
    )
    hold_s: HoldTime = zero_excluded(
        "time from the end of the press to the measurement (with elastomer.relaxation)"
    )
    slide_x_mm: SlideTravel = zero_excluded(
        "travel of the specimen along world x after the press, to its pose in [specimen] "
        "(spectral model, contact_face, with elastomer.friction_coefficient)"
    )
    slide_y_mm: SlideTravel = zero_excluded("as slide_x_mm, along world y")

    @property
    def slides(self) -> bool:
        """Whether the specimen slides after the press."""
        return self.slide_x_mm != 0.0 or self.slide_y_mm != 0.0

    @model_validator(mode="after")
    def _control_has_its_value(self) -> "Press":
        needed, excluded = ("depth_mm", "force_n")[:: 1 if self.control == "depth" else -1]
        if getattr(self, needed) is None:
            raise ValueError(f"control = '{self.control}' needs {needed}")
        if getattr(self, excluded) is not None:
            raise ValueError(f"control = '{self.control}' does not take {excluded}: remove it")
        return self


class PadFile(Model):
    """Elastic body from a CAD file instead of the flat slab, such as a coated dome on a window.

    The body is moved so that its lowest point is at z = 0, and is clamped on its highest plane.
    Contact and coat are on the facets that face down (contact-face layout).
    """

    file: str = Field(description="closed surface: STL, PLY or OBJ")
    scale_mm: FileUnit = Field(default=1.0, description="length of one unit of the file")
    facing_deg: Annotated[float, Field(gt=0, lt=90)] = Field(
        default=60.0, description="facets leaning from straight down by less than this are coated"
    )


class Mechanics(Model):
    """Choice and settings of the mechanical model of the elastomer."""

    model: Annotated[str, NameOf(MODELS, also=AUTO)] = Field(
        default=AUTO,
        description="auto: of the models that apply, the one with the least stated error",
    )
    support: Literal["simple", "clamped", "ledge", "bonded", "window"] | None = Field(
        default=None,
        description="absent: fem takes the support of the layout, sheet takes clamped; sheet "
        "allows simple or clamped",
    )
    ledge_mm: Length = Field(
        default=2.0, description="fem, support = 'ledge': width of the frame under the slab"
    )
    pad: PadFile | None = Field(default=None, description="fem only")
    tetrahedra: Annotated[int, Field(ge=200, le=20000)] = Field(
        default=4000, description="fem only: about how many"
    )
    settings: Annotated[dict[str, Model], TablesOf(settings_models)] = Field(
        default={},
        validate_default=True,
        exclude_if=lambda settings: not settings,
        description="[mechanics.settings.MODEL]: settings of a model that has a table of its own",
    )

    @field_validator("settings")
    @classmethod
    def _model_has_its_settings(
        cls, settings: dict[str, Model], info: ValidationInfo
    ) -> dict[str, Model]:
        return default_settings(info.data.get("model", AUTO)) | settings

    @model_validator(mode="after")
    def _model_takes_its_keys(self) -> "Mechanics":
        for name in ("support", "pad"):
            if getattr(self, name) is None:
                continue
            takers = models_that_take(name, self.model)
            if takers:
                allowed = " or ".join(f"'{model}'" for model in takers)
                raise ValueError(f"{name} needs model = {allowed}; set it, or remove {name}")
        return self
