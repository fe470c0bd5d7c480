"""Describe the known values of a thin sheet and its load; lengths in mm, pressures in kPa."""

from dataclasses import dataclass

from reconstruction.compensation.relief import SheetOpening

SQUEEZED_SHARE = 0.25
"""Ratio of the effective depth that a contact pressure compresses to the sheet's thickness. From
solid elements (docs/sheet.md); 50 % of the value of a layer on a rigid face for long waves."""
# Ratio of the plane-strain modulus E / (1 - nu^2) to E for an incompressible solid, nu = 1/2.
_PLANE_STRAIN = 4 / 3


@dataclass(frozen=True)
class SheetLayer:
    """Known values of the mounted sheet and its load.

    The attributes that start with `sigma_` are standard uncertainties in the same units.

    Attributes
    ----------
    frame : opening in which the sheet is held
    thickness_mm : undeformed thickness, before the sheet is stretched into its frame
    young_modulus_kpa : Young's modulus of the incompressible silicone
    pre_stretch : ratio of mounted to undeformed length, equal along x and y
    rim_compliance_mm2_per_n : displacement of the sheet's edge in the plane of the frame, mm, per
        increase of the line tension above that of the mounted sheet, N/mm; 0: rigid
    back_pressure_kpa : gauge pressure of the air on the coat
    sticks : True if the sheet does not slide on the object after first contact
    """

    frame: SheetOpening
    thickness_mm: float
    young_modulus_kpa: float
    pre_stretch: float = 1.0
    rim_compliance_mm2_per_n: float = 0.0
    back_pressure_kpa: float = 0.0
    sticks: bool = False
    sigma_thickness_mm: float = 0.0
    sigma_young_modulus_kpa: float = 0.0
    sigma_pre_stretch: float = 0.0
    sigma_rim_compliance_mm2_per_n: float = 0.0
    sigma_back_pressure_kpa: float = 0.0

    @property
    def squeeze_mm_per_kpa(self) -> float:
        """Indentation of the clear face, mm, per contact force over undeformed area, kPa."""
        return SQUEEZED_SHARE * self.thickness_mm / (_PLANE_STRAIN * self.young_modulus_kpa)

    @property
    def tension_unit_n_mm(self) -> float:
        """Shear modulus times undeformed thickness, N/mm."""
        return self.young_modulus_kpa / 3e3 * self.thickness_mm

    @property
    def rim_yield(self) -> float:
        """Compliance of the rim times shear modulus times undeformed thickness, mm."""
        return self.rim_compliance_mm2_per_n * self.tension_unit_n_mm

    @property
    def sigma_rim_yield(self) -> float:
        """Standard uncertainty of `rim_yield` from that of the compliance, mm."""
        return self.sigma_rim_compliance_mm2_per_n * self.tension_unit_n_mm
