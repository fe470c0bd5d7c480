"""Base class of all specimens: pose, optical material, shape and nominal features.

A kind of specimen is a subclass of `Specimen` in one file of `twin/specimens/kinds`, which
registers the class in `SPECIMENS`. Lengths are in mm. Positions are relative to the centre of the
slab. The specimen presses from below.
"""

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, TypeVar

from pydantic import ConfigDict, Field

from reconstruction.registry import PluginError, Registry
from twin.config.base import Angle, Model
from twin.config.bounds import Length, Place
from twin.config.kinds import OneOf, follows, kind_of
from twin.config.materials import MATERIALS, Albedo, Material
from twin.config.nominal import NominalFeature
from twin.shape import Shape

Feature = TypeVar("Feature", bound=NominalFeature)


class Stage(Model):
    """Matte table under a bare specimen (direct FPP)."""

    albedo: Albedo = 0.35
    size_mm: Length = Field(default=80.0, description="edge of the square, round the world origin")


class Specimen(Model):
    """Base class of specimens: the specimen in its pose, relative to the centre of the slab.

    A subclass sets `kind`, adds its dimensions and overrides `shape`. Further overrides state
    which dimensions are measured and fitted.
    """

    model_config = ConfigDict(defer_build=True)

    @classmethod
    def __pydantic_init_subclass__(cls, **_: Any) -> None:
        """Rebuild the schema of each kind when a material is registered."""
        follows(MATERIALS)(cls)

    x_mm: Place = 0.0
    y_mm: Place = 0.0
    z_mm: Place = Field(
        default=0.0, description="within a group: height of the foremost point over the others'"
    )
    yaw_deg: Angle = 0.0
    tilt_deg: Annotated[float, Field(ge=-30, le=30)] = Field(
        default=0.0, description="tilt about the specimen's y axis; positive lifts its +x side"
    )
    material: Material | None = Field(
        default=None, description="required if the camera images the bare specimen (direct_fpp)"
    )
    # After the pose, so that written experiment files keep the order of their keys.
    kind: str

    slab_fit_paths: ClassVar[tuple[str, ...]] = ()
    """Names of the numbers that `twin compensate` fits under a slab if no file sets `fitted`."""

    def shape(self) -> Shape:
        """Return the geometry in the specimen's own frame; pose and height are applied later.

        Raises
        ------
        InputError : a file that the specimen names cannot be used
        """
        raise NotImplementedError(f"{type(self).__name__}.shape")

    def nominal_features(self) -> tuple[NominalFeature, ...]:
        """Return the features with known dimensions, sorted along x; empty by default."""
        return ()

    def nominal(self, kind: type[Feature]) -> tuple[Feature, ...]:
        """Return the nominal features that are of one class."""
        return tuple(feature for feature in self.nominal_features() if isinstance(feature, kind))

    @property
    def finest_pitch_mm(self) -> float | None:
        """Finest pitch, mm, of the ridges or grooves that a sheet may span.

        None if the specimen has neither ridges nor grooves.
        """
        return None

    @property
    def ridge_height_mm(self) -> float | None:
        """Height of the ridges or grooves from root to crest, mm.

        None if the specimen has neither ridges nor grooves.
        """
        return None

    @property
    def components(self) -> "Mapping[str, Specimen]":
        """Parts of a group by name, each a specimen; empty if the specimen is not a group."""
        return {}

    def warnings(self) -> tuple[str, ...]:
        """Return warnings about the specimen's dimensions, one sentence each."""
        return tuple(line for part in self.components.values() for line in part.warnings())


def _kind_of(specimen: type[Specimen]) -> str:
    if not (isinstance(specimen, type) and issubclass(specimen, Specimen)):
        raise PluginError(f"specimens: found {specimen!r}, allowed subclasses of Specimen")
    if specimen.shape is Specimen.shape:
        raise PluginError(f"specimens: {specimen.__name__} has no shape; define shape(self)")
    return kind_of(specimen)


SPECIMENS: Registry[type[Specimen]] = Registry("specimens", "twin.specimens.kinds", _kind_of)
"""Registry of the kinds of specimens."""

AnySpecimen = Annotated[Specimen, OneOf(SPECIMENS)]


def require_at_most(key: str, length_mm: float, limit_mm: float, why: str) -> None:
    """Raise ValueError if a length exceeds a limit that other keys set.

    Raises
    ------
    ValueError : key, found length, allowed length and the keys that limit it
    """
    if length_mm > limit_mm:
        raise ValueError(f"{key}: found {length_mm:g}, allowed at most {limit_mm:g}: {why}")
