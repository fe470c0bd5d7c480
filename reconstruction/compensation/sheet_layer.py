"""Known values of a thin sheet and its load; lengths mm, pressures kPa."""

from dataclasses import dataclass

from reconstruction.compensation.relief import SheetOpening

SQUEEZED_SHARE = 0.25
"""Depth of the sheet that a contact pressure compresses, over its thickness: from solid elements
(docs/sheet.md); half of the value of an exact layer on a rigid face for long waves."""
# E / (1 - nu^2) over E, of an incompressible solid.
_PLANE_STRAIN = 4 / 3


@dataclass(frozen=True)
class SheetLayer:
    """Known values of the mounted sheet and its load; sigma_: standard uncertainties.

    Attributes
    ----------
    frame : opening in which the sheet is held
    thickness_mm : undeformed, before the sheet is stretched into its frame
    young_modulus_kpa : of the incompressible silicone
    pre_stretch : of the mounted sheet, equal along x and y
    rim_compliance_mm2_per_n : displacement of its edge along the frame per line tension in excess
        of the mounted sheet's; 0: rigid
    back_pressure_kpa : of the air on the coat
    sticks : whether the sheet keeps its place after first contact
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
        """Return the indentation of its clear face per pressure, per undeformed area."""
        return SQUEEZED_SHARE * self.thickness_mm / (_PLANE_STRAIN * self.young_modulus_kpa)

    @property
    def tension_unit_n_mm(self) -> float:
        """Shear modulus times thickness, N/mm."""
        return self.young_modulus_kpa / 3e3 * self.thickness_mm

    @property
    def rim_yield(self) -> float:
        """Compliance of the rim times shear modulus times thickness, mm."""
        return self.rim_compliance_mm2_per_n * self.tension_unit_n_mm

    @property
    def sigma_rim_yield(self) -> float:
        """Standard uncertainty of `rim_yield` by the compliance, mm."""
        return self.sigma_rim_compliance_mm2_per_n * self.tension_unit_n_mm
