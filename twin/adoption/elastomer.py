"""Determine the elastomer of an adopted rig from one press of a known ball.

The press is an ordinary capture, read with the estimated noise and response. The assumed values of
sheet and load are from a layer file, as for `twin compensate`. The ball determines the thickness of
the sheet, and with back pressure also its modulus, see `reconstruction.compensation.known_ball`.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from reconstruction.capture.folder import Capture, read_capture
from reconstruction.characterise import UncertainValue
from reconstruction.pipeline import ReconstructOptions, reconstruct
from twin.adoption.findings import RigField
from twin.config.sensor_layer import SensorLayer, load_sensor_layer
from twin.pipeline.calibrated_layer import calibrated_layer

_HARDNESS = ("shore_a", "shore_00", "young_modulus_kpa")


@dataclass(frozen=True)
class KnownBallPress:
    """Press of a known ball into the sheet, as input of an adoption.

    Attributes
    ----------
    capture : folder of the capture of the press
    layer : file with the assumed values of sheet and load
    diameter_mm : diameter of the ball
    """

    capture: Path
    layer: Path
    diameter_mm: float


def press_capture(press: KnownBallPress, known: Capture) -> Capture:
    """Return the capture of the press with the noise and the response of `known`."""
    return replace(read_capture(press.capture), sensor=known.sensor, response=known.response)


def elastomer_fields(press: KnownBallPress, capture: Capture) -> dict[str, RigField]:
    """Return the fields of the elastomer by path.

    The ball determines the thickness and, if possible, modulus and rim compliance. All other values
    are those of the layer file.

    Raises
    ------
    InputError : the layer file is missing, the elastomer is no thin sheet, or the capture shows no
        ball
    """
    points = reconstruct(capture, ReconstructOptions()).point_map
    assumed = load_sensor_layer(press.layer)
    layer, figures = calibrated_layer(points, assumed, press.diameter_mm)
    fields = {f"elastomer.{key}": value for key, value in _stated(assumed, press.layer).items()}
    how = f"a ball of {press.diameter_mm:g} mm pressed, {press.capture.name}"
    elastomer, sigma = layer.elastomer, layer.sigma
    thickness = UncertainValue(elastomer.thickness_mm, sigma.thickness_mm)
    fields["elastomer.thickness_mm"] = RigField.measured("elastomer.thickness_mm", thickness, how)
    if figures.get("calibrated_rim_compliance_mm2_per_n") is not None:
        path = "elastomer.rim_compliance_mm2_per_n"
        gives = UncertainValue(elastomer.rim_compliance_mm2_per_n, sigma.rim_compliance_mm2_per_n)
        fields[path] = RigField.measured(path, gives, how)
    if figures["calibrated_modulus_kpa"] is not None:
        for name in _HARDNESS:
            fields.pop(f"elastomer.{name}", None)
        modulus = UncertainValue(
            figures["calibrated_modulus_kpa"], figures["calibrated_modulus_sigma_kpa"]
        )
        path = "elastomer.young_modulus_kpa"
        fields[path] = RigField.measured(path, modulus, f"free span beside {how}")
    return fields


def _stated(layer: SensorLayer, file: Path) -> dict[str, RigField]:
    """Return all values of the elastomer in a layer file as fields of a rig, by key."""
    stated: dict[str, Any] = layer.elastomer.model_dump(
        mode="json", exclude_none=True, exclude_unset=True
    )
    source = f"stated: {file.name}"
    return {
        key: RigField(f"elastomer.{key}", value, None, source)
        for key, value in stated.items()
        if not isinstance(value, dict)
    }
