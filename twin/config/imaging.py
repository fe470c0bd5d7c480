"""Closed forms of a thin lens and of the triangle of camera, coat and projector.

| symbol | meaning |
|---|---|
| f, N | focal length, mm; f-number, focal length / diameter of the pupil |
| u | distance from the principal plane to the object in focus, mm |
| m = f / (u - f) | magnification, image / object |
| c | largest permitted circle of confusion on the sensor, mm |

An object at distance s has the circle of confusion c = f^2 |s - u| / (N s (u - f)). It is permitted
from near = u f^2 / (f^2 + N c (u - f)) to far = u f^2 / (f^2 - N c (u - f)).
"""

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class SensorArea:
    """Image sensor of a camera: width and height, mm, and size of a binned pixel, mm."""

    width_mm: float
    height_mm: float
    pixel_mm: float

    @classmethod
    def of(cls, width_px: float, height_px: float, pitch_um: float, binning: float) -> "SensorArea":
        """Return the sensor of a camera with this number of pixels before binning."""
        pitch_mm = 1e-3 * pitch_um
        return cls(width_px * pitch_mm, height_px * pitch_mm, pitch_mm * binning)

    @property
    def diagonal_mm(self) -> float:
        """Diagonal of the sensor."""
        return math.hypot(self.width_mm, self.height_mm)

    def magnification_of(self, field_mm: tuple[float, float]) -> float:
        """Return the largest magnification at which a field (width, height), mm, is imaged."""
        return min(self.width_mm / field_mm[0], self.height_mm / field_mm[1])

    def field_at(self, magnification: float) -> tuple[float, float]:
        """Return the imaged field (width, height), mm."""
        return self.width_mm / magnification, self.height_mm / magnification


def magnification_at(focal_mm: float, distance_mm: float) -> float:
    """Return the magnification f / (u - f) of a lens that is focused at a distance u."""
    return focal_mm / (distance_mm - focal_mm)


def distance_of(focal_mm: float, magnification: float) -> float:
    """Return the object distance u = f (1 + 1 / m), mm."""
    return focal_mm * (1.0 + 1.0 / magnification)


def focal_length_of(magnification: float, distance_mm: float) -> float:
    """Return the focal length f = u m / (1 + m), mm, that images with a magnification."""
    return distance_mm * magnification / (1.0 + magnification)


def depth_limits_mm(
    focal_mm: float, f_number: float, distance_mm: float, circle_mm: float
) -> tuple[float, float]:
    """Return the nearest and the farthest distance with a permitted circle of confusion, mm.

    The farthest distance is infinite from the hyperfocal distance on.
    """
    square, spread = focal_mm**2, f_number * circle_mm * (distance_mm - focal_mm)
    far_mm = distance_mm * square / (square - spread) if square > spread else math.inf
    return distance_mm * square / (square + spread), far_mm


def f_number_for(focal_mm: float, depth_mm: float, distance_mm: float, circle_mm: float) -> float:
    """Return the least f-number at which `depth_mm`, centred on the focus, is permitted.

    The near half decides: its circle of confusion is larger than that of the far half. The result
    is infinite if the near half reaches the lens.
    """
    near_mm = distance_mm - depth_mm / 2.0
    if near_mm <= 0.0:
        return math.inf
    return focal_mm**2 * (depth_mm / 2.0) / (near_mm * circle_mm * (distance_mm - focal_mm))


def depth_for(focal_mm: float, f_number: float, distance_mm: float, circle_mm: float) -> float:
    """Return the depth, centred on the focus, that an f-number permits, mm; see `f_number_for`."""
    return 2.0 * (distance_mm - depth_limits_mm(focal_mm, f_number, distance_mm, circle_mm)[0])


def angle_of_baseline(baseline_mm: float, camera_mm: float, projector_mm: float) -> float | None:
    """Return the angle at the coat, degrees, of a triangle with three sides, mm.

    None if no triangle has these sides: the distances of camera and projector, and the baseline.
    """
    cosine = (camera_mm**2 + projector_mm**2 - baseline_mm**2) / (2.0 * camera_mm * projector_mm)
    return math.degrees(math.acos(cosine)) if -1.0 <= cosine < 1.0 else None


def polar_of_angle(
    angle_deg: float, camera_polar_deg: float, azimuth_between_deg: float
) -> float | None:
    """Return the polar angle, degrees, of a device at a given angle from the camera.

    With the camera at polar angle p and the azimuth d between both devices, the angle t obeys
    cos t = cos p cos q + sin p sin q cos d, which is solved for q. Of two solutions the larger q is
    returned. None if no q from 0 to below 90 degrees is a solution.

    Parameters
    ----------
    azimuth_between_deg : azimuth of the device minus that of the camera
    """
    p, d = math.radians(camera_polar_deg), math.radians(azimuth_between_deg)
    along, across = math.cos(p), math.sin(p) * math.cos(d)
    cosine = math.cos(math.radians(angle_deg)) / math.hypot(along, across)
    if cosine < -1.0 or cosine > 1.0:
        return None
    middle, half = math.atan2(across, along), math.acos(cosine)
    both = (round(math.degrees(angle), 12) for angle in (middle + half, middle - half))
    return next((polar_deg for polar_deg in both if 0.0 <= polar_deg < 90.0), None)
