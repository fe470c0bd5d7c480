"""Radiometric scale of the projector.

Irradiance on a plane that faces the projector at distance z (along its axis) is
`irradiance_at_1mm / z**2` for a full white field: the flux spread evenly over the image, as a DLP
fills a flat screen.
"""

from reconstruction.rig.calibration import Pinhole
from twin.config.models import Projector


def irradiance_at_1mm(projector: Projector, pinhole: Pinhole) -> float:
    """Irradiance of a white field at axial distance 1 mm, in mW/mm^2 (numerically mW/mm^2 mm^2)."""
    image_area_mm2 = (pinhole.width_px / pinhole.fx_px) * (pinhole.height_px / pinhole.fy_px)
    return projector.flux_mw / image_area_mm2
