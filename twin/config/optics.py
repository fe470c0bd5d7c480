"""Table [optics]: field, lens and distance as a designer states them, and the data of a lens.

From this table `twin.config.rig` computes keys of camera and projector. A lens is one data file
with the limits that its maker states; `[optics.lens] use = "scenes/lenses/NAME"` reads one.
"""

from typing import Annotated, Literal

from pydantic import Field, field_validator

from twin.config.base import Model
from twin.config.bounds import FNumber, Length, Magnification, Rounding

ApertureRange = tuple[FNumber, FNumber]


class FixedFocal(Model):
    """Lens of one focal length that focuses from its nearest distance to infinity."""

    kind: Literal["fixed_focal"] = "fixed_focal"
    model: str = Field(description="maker and type")
    focal_length_mm: Length
    f_numbers: ApertureRange = Field(description="of the widest and of the smallest aperture")
    image_circle_mm: Length = Field(description="largest diagonal of a sensor without dark corners")
    nearest_mm: Length = Field(description="shortest working distance")
    principal_plane_mm: Rounding = Field(
        default=0.0,
        description="distance from the front of the lens to its object-side principal plane, which "
        "is the camera's pinhole; 0: the working distance is counted from the principal plane",
    )

    @field_validator("f_numbers")
    @classmethod
    def _widest_first(cls, f_numbers: ApertureRange) -> ApertureRange:
        if f_numbers[0] > f_numbers[1]:
            raise ValueError("allowed two numbers, the smaller one first")
        return f_numbers

    def largest_magnification(self, extension_mm: float) -> float:
        """Return the magnification at the nearest distance, with a ring behind the lens.

        Infinite if the nearest distance is within the focal length. `extension_mm` is the length
        of the ring, which adds extension / focal length to the magnification.
        """
        beyond_mm = self.nearest_mm + self.principal_plane_mm - self.focal_length_mm
        nearest = self.focal_length_mm / beyond_mm if beyond_mm > 0.0 else float("inf")
        return nearest + extension_mm / self.focal_length_mm


class Telecentric(Model):
    """Lens of one magnification, with parallel chief rays at the object and a fixed aperture."""

    kind: Literal["telecentric"] = "telecentric"
    model: str = Field(description="maker and type")
    magnification: Magnification = Field(description="size of the image over size of the object")
    working_f_number: FNumber = Field(description="magnification / (2 x numerical aperture)")
    image_circle_mm: Length = Field(description="largest diagonal of a sensor without dark corners")
    working_distance_mm: Length = Field(description="from the front of the lens to the object")


Lens = FixedFocal | Telecentric


class Optics(Model):
    """Requested field, distance, depth and angle; keys of camera and projector follow from them.

    Two of lens, field and working distance determine the third. If only `field_mm` or only
    `working_distance_mm` is stated, the camera keeps its own focal length.
    """

    field_mm: tuple[Length, Length] | None = Field(
        default=None,
        description="least field of view, width and height, in the plane of focus; computes "
        "camera.pose.standoff_mm, and without a lens also camera.focal_length_mm if "
        "working_distance_mm is stated",
    )
    working_distance_mm: Length | None = Field(
        default=None,
        description="from the front of the lens to the coat; computes camera.pose.standoff_mm",
    )
    depth_mm: Length | None = Field(
        default=None,
        description="height range round the undeformed coat whose blur is at most one pixel; "
        "computes camera.f_number",
    )
    extension_mm: Rounding = Field(
        default=0.0, description="length of a ring between lens and camera, for shorter distances"
    )
    angle_deg: Annotated[float, Field(gt=0, lt=180)] | None = Field(
        default=None,
        description="angle between camera and projector, seen from the coat's centre; computes "
        "projector.pose.polar_deg",
    )
    baseline_mm: Length | None = Field(
        default=None,
        description="distance between the pinholes of camera and projector, instead of angle_deg",
    )
    lens: Annotated[Lens, Field(discriminator="kind")] | None = Field(
        default=None, description="limits of a real lens; sets camera.focal_length_mm"
    )

    @property
    def is_stated(self) -> bool:
        """Whether any key is set."""
        return self != Optics()
