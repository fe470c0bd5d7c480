"""Keys of the camera that follow from the table [optics]: focal length, distance, f-number.

| stated in [optics] | key that follows |
|---|---|
| lens | camera.focal_length_mm; telecentric: also the next two |
| field_mm or working_distance_mm | camera.pose.standoff_mm |
| depth_mm | camera.f_number |

A telecentric lens has its entrance pupil at infinity. It is simulated by a lens of equal
magnification and equal aperture at the object whose pinhole is `REMOTE_MM` away. Its chief rays are
inclined by up to atan(half the field / `REMOTE_MM`), 0.3 degrees for 10 mm.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from twin.config import imaging
from twin.config.base import ConfigError
from twin.config.bounds import F_NUMBER_RANGE, LENGTH_RANGE_MM
from twin.config.imaging import SensorArea
from twin.config.optics import FixedFocal, Optics, Telecentric
from twin.config.quantities import value_at

REMOTE_MM = 1000.0
# Assumed tolerance of the working distance of a telecentric lens: 3 %.
_CLOSE, _DISTANCE_TOLERANCE = 1e-9, 0.03

Values = Mapping[str, Any]


class UnmetError(ConfigError):
    """Error of a request in [optics] that no rig meets, or two requests that contradict."""


class LensError(UnmetError):
    """Error of a request in [optics] that the stated lens does not meet; another one may."""


@dataclass(frozen=True)
class Derived:
    """Value of a key that follows from [optics], and the reason as the source of the value."""

    value: float
    source: str


def number_at(values: Values, path: str, default: float | None = None) -> float | None:
    """Return the number at a dotted path; `default` if absent, None if it is no number."""
    value = value_at(dict(values), path)
    if value is None:
        return default
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    return float(value) if is_number and math.isfinite(value) else None


def sensor_of(values: Values) -> SensorArea | None:
    """Return the camera's sensor; None if one of its numbers is missing or invalid."""
    names = ("width_px", "height_px", "pixel_pitch_um")
    width, height, pitch_um = (number_at(values, f"camera.{name}") for name in names)
    binning = number_at(values, "camera.binning", 1.0)
    if not (width and height and pitch_um and binning) or min(width, height, pitch_um) <= 0.0:
        return None
    return SensorArea.of(width, height, pitch_um, binning)


@dataclass(frozen=True)
class _Imaging:
    """Focal length and object distance, mm, of a camera, and the lens that has them."""

    focal_mm: float
    distance_mm: float
    lens: FixedFocal | Telecentric | None

    @property
    def magnification(self) -> float:
        return imaging.magnification_at(self.focal_mm, self.distance_mm)

    @property
    def is_in_range(self) -> bool:
        """Whether a lens images from this distance, and no pinhole is farther than allowed."""
        return self.focal_mm < self.distance_mm <= LENGTH_RANGE_MM[1]

    @property
    def name(self) -> str:
        return f"a lens of {self.focal_mm:.4g} mm" if self.lens is None else self.lens.model


def camera_keys(optics: Optics, sensor: SensorArea, values: Values) -> dict[str, Derived]:
    """Return the keys of the camera that follow from [optics], by dotted path.

    Raises
    ------
    UnmetError : a request cannot be met; the message starts with the key in [optics]
    """
    _require_image_circle(optics, sensor)
    if optics.extension_mm and optics.lens is None:
        raise UnmetError(
            f"extension_mm: found {optics.extension_mm:g} without a lens, whose limits it changes; "
            "state [optics.lens] or remove it"
        )
    if isinstance(optics.lens, Telecentric):
        return _telecentric_keys(optics, optics.lens, sensor, values)
    keys: dict[str, Derived] = {}
    setting, request = _imaging_of(optics, sensor, values), _request(optics)
    if setting is None or (optics.lens is None and not request and not setting.is_in_range):
        return keys  # the validation of the camera reports its own numbers
    _require_in_reach(optics, setting, sensor)
    if optics.lens is not None or (optics.field_mm and optics.working_distance_mm):
        source = optics.lens.model if optics.lens else request
        keys["camera.focal_length_mm"] = Derived(setting.focal_mm, f"derived: {source}")
    if optics.field_mm or optics.working_distance_mm:
        source = f"derived: {request} with {setting.name}"
        keys["camera.pose.standoff_mm"] = Derived(setting.distance_mm, source)
    return keys | _aperture_keys(optics, setting, sensor, values)


def _imaging_of(optics: Optics, sensor: SensorArea, values: Values) -> _Imaging | None:
    """Return focal length and distance from the two that are stated; None if one is missing."""
    lens = optics.lens if isinstance(optics.lens, FixedFocal) else None
    focal_mm = lens.focal_length_mm if lens else number_at(values, "camera.focal_length_mm")
    front_mm = lens.principal_plane_mm if lens else 0.0
    distance_mm = number_at(values, "camera.pose.standoff_mm")
    if optics.working_distance_mm is not None:
        distance_mm = optics.working_distance_mm + front_mm
    if optics.field_mm is not None:
        wanted = sensor.magnification_of(optics.field_mm)
        if optics.working_distance_mm is None:
            distance_mm = focal_mm and imaging.distance_of(focal_mm, wanted)
        elif lens is None:
            focal_mm = distance_mm and imaging.focal_length_of(wanted, distance_mm)
        else:
            at_mm = imaging.distance_of(lens.focal_length_mm, wanted) - front_mm
            raise UnmetError(
                f"working_distance_mm: found {optics.working_distance_mm:g} with lens and field_mm,"
                f" of which two determine the third: {lens.model} images {_size(optics.field_mm)} "
                f"from {at_mm:.4g} mm; remove one"
            )
    return _Imaging(focal_mm, distance_mm, lens) if focal_mm and distance_mm else None


def _request(optics: Optics) -> str:
    stated = [f"field {_size(optics.field_mm)}"] if optics.field_mm else []
    if optics.working_distance_mm is not None:
        stated.append(f"working distance {optics.working_distance_mm:g} mm")
    return ", ".join(stated)


def _size(field_mm: tuple[float, float]) -> str:
    return f"{field_mm[0]:.4g} x {field_mm[1]:.4g} mm"


def _require_image_circle(optics: Optics, sensor: SensorArea) -> None:
    lens = optics.lens
    if lens is not None and sensor.diagonal_mm > lens.image_circle_mm:
        raise LensError(
            f"lens: {lens.model} has an image circle of {lens.image_circle_mm:g} mm, the sensor a "
            f"diagonal of {sensor.diagonal_mm:.4g} mm; use a lens for this sensor"
        )


def _require_in_reach(optics: Optics, setting: _Imaging, sensor: SensorArea) -> None:
    """Check distance and magnification against focal length, lens and ring."""
    request = _request(optics)
    key = ("field_mm" if optics.field_mm else "working_distance_mm") if request else "lens"
    distance_mm = setting.distance_mm
    if distance_mm <= setting.focal_mm:
        raise UnmetError(
            f"{key}: found {distance_mm:.4g} mm, allowed more than the focal length, "
            f"{setting.focal_mm:.4g} mm; use a larger distance or a shorter lens"
        )
    if distance_mm > LENGTH_RANGE_MM[1]:
        raise LensError(
            f"{key}: {request} needs {distance_mm:.4g} mm with {setting.name}, allowed up to "
            f"{LENGTH_RANGE_MM[1]:g} mm; use a shorter lens or a smaller field"
        )
    if isinstance(setting.lens, FixedFocal):
        _require_focus(setting.lens, setting, optics.extension_mm, sensor, key)


def _require_focus(
    lens: FixedFocal, setting: _Imaging, ring_mm: float, sensor: SensorArea, key: str
) -> None:
    """Check that the lens, with a ring of this length, focuses at the distance."""
    magnification, focal_mm = setting.magnification, setting.focal_mm
    largest = lens.largest_magnification(ring_mm)
    if magnification > largest * (1.0 + _CLOSE):
        longer_mm = ring_mm + (magnification - largest) * focal_mm
        raise LensError(
            f"{key}: {lens.model} images {_size(sensor.field_at(magnification))} from "
            f"{setting.distance_mm - lens.principal_plane_mm:.4g} mm, its nearest distance is "
            f"{lens.nearest_mm:g} mm, with {_size(sensor.field_at(largest))}; use "
            f"optics.extension_mm = {math.ceil(10.0 * longer_mm - 1e-6) / 10.0:g} or a larger field"
        )
    if magnification < ring_mm / focal_mm * (1.0 - _CLOSE):
        raise LensError(
            f"extension_mm: found {ring_mm:g}, allowed up to {magnification * focal_mm:.4g}: with "
            f"it {lens.model} images no larger field than "
            f"{_size(sensor.field_at(ring_mm / focal_mm))}; use a shorter ring"
        )


def _aperture_keys(
    optics: Optics, setting: _Imaging, sensor: SensorArea, values: Values
) -> dict[str, Derived]:
    """Return the f-number for the requested depth; check the f-number against the lens."""
    lens = setting.lens if isinstance(setting.lens, FixedFocal) else None
    widest, smallest = lens.f_numbers if lens else F_NUMBER_RANGE
    if optics.depth_mm is None:
        stated = number_at(values, "camera.f_number")
        if lens is not None and stated is not None and not widest <= stated <= smallest:
            raise LensError(
                f"lens: {lens.model} has f-numbers {widest:g} to {smallest:g}, camera.f_number is "
                f"{stated:g}; change it, or state optics.depth_mm"
            )
        return {}
    depth_mm = _axial_depth(optics.depth_mm, setting, sensor, values)
    at = setting.distance_mm, sensor.pixel_mm
    needed = imaging.f_number_for(setting.focal_mm, depth_mm, *at)
    if needed > smallest:
        least_mm = imaging.depth_for(setting.focal_mm, smallest, *at)
        raise LensError(_too_deep(optics.depth_mm, depth_mm, f"f/{smallest:g}", least_mm))
    source = f"derived: depth {optics.depth_mm:g} mm with a blur of at most one pixel"
    return {"camera.f_number": Derived(max(needed, widest), source)}


def _too_deep(depth_mm: float, axial_mm: float, aperture: str, allowed_mm: float) -> str:
    tilted = f" ({axial_mm:.3g} mm along the tilted axis)" if axial_mm > 1.001 * depth_mm else ""
    return (
        f"depth_mm: found {depth_mm:g}{tilted}, allowed up to {allowed_mm:.3g} at {aperture} along "
        "the axis; use a larger field or pixel (camera.binning), or a camera nearer to the vertical"
    )


def _axial_depth(depth_mm: float, setting: _Imaging, sensor: SensorArea, values: Values) -> float:
    """Return the depth along the camera's axis that contains a height range over the whole field.

    The coat is inclined to the plane of focus by the polar angle p of the camera. A point of height
    z in the image of position x (in the plane of focus, along the tilt) is in front of this plane
    by a = (z + x sin p) / (cos p + x sin p / u), with the distance u of the camera. At the near end
    z = depth / 2 and x is half the extent of the field; there the blur is largest. The depth is
    2 a.
    """
    polar = math.radians(number_at(values, "camera.pose.polar_deg", 0.0) or 0.0)
    half_mm = _extent_along_tilt(setting.magnification, sensor, values, polar) / 2.0
    inclined_mm = half_mm * math.sin(polar)
    return (depth_mm + 2.0 * inclined_mm) / (math.cos(polar) + inclined_mm / setting.distance_mm)


def _extent_along_tilt(
    magnification: float, sensor: SensorArea, values: Values, polar: float
) -> float:
    """Return the extent of the field, mm, in the plane of focus along the tilt of the camera.

    In the image of a camera as in `twin.optics.rig.world_from_device`, the direction of the tilt is
    at the angle atan2(cos(polar) sin(azimuth), cos(azimuth)) + roll to the rows.
    """
    azimuth = math.radians(number_at(values, "camera.pose.azimuth_deg", 0.0) or 0.0)
    roll = math.radians(number_at(values, "camera.pose.roll_deg", 0.0) or 0.0)
    angle = math.atan2(math.cos(polar) * math.sin(azimuth), math.cos(azimuth)) + roll
    width_mm, height_mm = sensor.field_at(magnification)
    return width_mm * abs(math.cos(angle)) + height_mm * abs(math.sin(angle))


def _telecentric_keys(
    optics: Optics, lens: Telecentric, sensor: SensorArea, values: Values
) -> dict[str, Derived]:
    field_mm, focal_mm = (
        sensor.field_at(lens.magnification),
        imaging.focal_length_of(lens.magnification, REMOTE_MM),
    )
    f_number = lens.working_f_number / (1.0 + lens.magnification)
    requested_mm = optics.field_mm or field_mm
    if any(
        requested > imaged * (1.0 + _CLOSE)
        for requested, imaged in zip(requested_mm, field_mm, strict=True)
    ):
        raise LensError(
            f"field_mm: found {_size(requested_mm)}, {lens.model} images {_size(field_mm)} on this "
            "sensor; use a smaller field or a lower magnification"
        )
    at_mm = optics.working_distance_mm or lens.working_distance_mm
    if abs(at_mm - lens.working_distance_mm) > _DISTANCE_TOLERANCE * lens.working_distance_mm:
        raise LensError(
            f"working_distance_mm: found {at_mm:g}, {lens.model} is in focus at "
            f"{lens.working_distance_mm:g} mm only; remove the key or use another lens"
        )
    if optics.extension_mm:
        raise LensError(f"extension_mm: {lens.model} is telecentric and takes no ring; remove it")
    if optics.depth_mm is not None:
        setting = _Imaging(focal_mm, REMOTE_MM, lens)
        depth_mm = _axial_depth(optics.depth_mm, setting, sensor, values)
        allowed_mm = imaging.depth_for(focal_mm, f_number, REMOTE_MM, sensor.pixel_mm)
        if depth_mm > allowed_mm:
            aperture = f"working f/{lens.working_f_number:g}"
            raise LensError(_too_deep(optics.depth_mm, depth_mm, aperture, allowed_mm))
    source = f"derived: {lens.model}, telecentric: its pupil is at infinity, {REMOTE_MM:g} mm here"
    values_by_key = (focal_mm, REMOTE_MM, f_number)
    names = ("camera.focal_length_mm", "camera.pose.standoff_mm", "camera.f_number")
    return {key: Derived(x, source) for key, x in zip(names, values_by_key, strict=True)}
