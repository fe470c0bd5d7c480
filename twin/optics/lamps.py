"""Lamps of a photometric-stereo sensor as rows of point emitters, and their light in closed form.

Coordinates are in the world frame, mm. The irradiance of the coat by an LED is
I0 cos^m(theta) cos(incidence) exp(-a r) / r^2, up to theta = 90 degrees. r is the distance of the
LED, and theta the angle between its aim and the direction to the coat. a is the absorption
coefficient of the gel. I0 is (m + 1) / 2 pi times the flux of the LED. Light paths from LED to coat
are straight: LEDs couple into the gel through its side, and the window above the gel is assumed to
have the gel's index n.

The window's outer face reflects light that an LED emits upwards: by Fresnel, and totally beyond the
critical angle c, sin c = 1 / n. The reflected light has the direction of light from the mirror
image of the LED in this face. A second reflection at the outer face, after the coat, is not
modelled.

The window's outer face totally reflects the share 1 - 1 / n^2, about 50 %, of the light that the
coat scatters (beyond c). Together with light from the housing it fills the shadows. This fill is
not traced: its radiance is assumed constant at all points and from all directions beyond c, and 0
within c. For a facet with the vertical component n_z of its normal, the view factor of the whole
sky is (1 + n_z) / 2. The view factor of the dark cap within c is n_z / n^2 if the whole cap is
above the facet (tilts up to 90 degrees - c). On slopes of up to 45 degrees the fill equals that on
the undeformed coat.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from reconstruction.arrays import BoolArray, FloatArray
from twin.config.lamps import CHANNELS, Lamp
from twin.config.layers import OuterFace


@dataclass(frozen=True, eq=False)
class Emitters:
    """All LEDs of a sensor, and their images in the window's outer face.

    Attributes
    ----------
    positions_mm : (emitter, xyz) float
    aims : (emitter, xyz) float, unit vectors
    exponents : (emitter,) float; exponent m of the angular distribution cos^m
    intensity : (emitter, channel) float, mW/sr along the aim; red, green, blue
    fill : (channel,) float; irradiance of the undeformed coat by the fill, mW/mm^2
    mirrored : (emitter,) bool; True for mirror images of LEDs: light that the outer face reflects
    ior : refractive index of the coat's medium; 1: the coat is in air, without mirror images
    """

    positions_mm: FloatArray
    aims: FloatArray
    exponents: FloatArray
    intensity: FloatArray
    fill: FloatArray
    mirrored: BoolArray
    ior: float = 1.0

    @property
    def dark_cap(self) -> float:
        """View factor 1 / n^2 of the dark cap of the sky for a horizontal facet.

        n is the refractive index of the coat's medium. The dark cap sends no fill light to the
        coat. The factor is 0 if the coat is in air (n = 1): the fill light is from the whole sky.
        """
        return self.ior**-2.0 if self.ior > 1.0 else 0.0

    def irradiance(
        self, points_mm: FloatArray, normals: FloatArray, absorption: float = 0.0
    ) -> FloatArray:
        """Return the irradiance at surface points in each channel, mW/mm^2, without cast shadows.

        Parameters
        ----------
        points_mm, normals : (..., xyz) float, world
        absorption : Napierian coefficient of the gel, 1/mm

        Returns
        -------
        (..., channel) float
        """
        sky = sky_seen(normals[..., 2:], self.dark_cap)
        total = np.asarray(sky * self.fill, dtype=np.float64)
        for place, aim, exponent, intensity, mirrored in zip(
            self.positions_mm, self.aims, self.exponents, self.intensity, self.mirrored, strict=True
        ):
            to_light = place - points_mm
            r_mm = np.linalg.norm(to_light, axis=-1)
            ahead = np.maximum(-(to_light @ aim) / r_mm, 0.0)
            incidence = np.maximum(np.sum(to_light * normals, axis=-1) / r_mm, 0.0)
            lobe = np.where(ahead > 0.0, ahead**exponent, 0.0)  # 0 ** 0 is 1
            light = lobe * incidence * np.exp(-absorption * r_mm) / r_mm**2
            if mirrored:
                light = light * reflected_within(to_light[..., 2] / r_mm, self.ior)
            total += light[..., np.newaxis] * intensity
        return total


def sky_seen(n_z: Any, dark_cap: float) -> Any:
    """Return the ratio of the fill on a facet to that on the undeformed coat.

    Parameters
    ----------
    n_z : vertical component of the facet's normal; number, array or Dr.Jit variable
    dark_cap : view factor of the dark cap, see `Emitters.dark_cap`
    """
    return (0.5 * (1.0 + n_z) - dark_cap * n_z) / (1.0 - dark_cap)


def reflected_within(cosine: FloatArray, ior: float) -> FloatArray:
    """Return the Fresnel reflectance for unpolarised light from a medium onto its face to air.

    Parameters
    ----------
    cosine : cosine of the angle in the medium to the normal of the face
    ior : refractive index of the medium, relative to air
    """
    inside = np.minimum(np.abs(cosine), 1.0)
    outside = np.sqrt(np.maximum(1.0 - ior**2 * (1.0 - inside**2), 0.0))  # 0: total
    s = (ior * inside - outside) / (ior * inside + outside)
    p = (inside - ior * outside) / (inside + ior * outside)
    return np.asarray((s**2 + p**2) / 2.0)


def emitters_of(
    lamps: Mapping[str, Lamp],
    flux: FloatArray | None = None,
    *,
    face: OuterFace | None = None,
) -> Emitters:
    """Return the LEDs of all lamps, sorted by the lamps' names, followed by their mirror images.

    Parameters
    ----------
    flux : (LED,) float, optional
        Flux of each LED, relative to nominal; None: nominal. The fill of a lamp scales with the
        mean flux of its LEDs.
    face : outer face of the layers that contain the coat; None: the coat is in air
    """
    rows = [lamps[name] for name in sorted(lamps)]
    if flux is None:
        flux = np.ones(sum(lamp.emitters for lamp in rows))
    ends = np.cumsum([lamp.emitters for lamp in rows])
    of_rows = [part.mean() for part in np.split(flux, ends[:-1])]
    parts = [_row(lamp) for lamp in rows]
    counts = [lamp.emitters for lamp in rows]
    leds = Emitters(
        positions_mm=np.concatenate([part[0] for part in parts]),
        aims=np.repeat([part[1] for part in parts], counts, axis=0),
        exponents=np.repeat([lamp.exponent for lamp in rows], counts),
        intensity=flux[:, None] * np.concatenate([_intensity(lamp) for lamp in rows]),
        fill=np.sum(
            [
                share * lamp.fill_mw_per_mm2 * _channel(lamp)
                for share, lamp in zip(of_rows, rows, strict=True)
            ],
            axis=0,
        ),
        mirrored=np.zeros(len(flux), bool),
    )
    return leds if face is None else _with_images(leds, face)


def _with_images(leds: Emitters, face: OuterFace) -> Emitters:
    """Return the LEDs, followed by the mirror image of every LED in the outer face."""
    places = leds.positions_mm * (1.0, 1.0, -1.0) + (0.0, 0.0, 2.0 * face.height_mm)
    return replace(
        leds,
        positions_mm=np.concatenate([leds.positions_mm, places]),
        aims=np.concatenate([leds.aims, leds.aims * (1.0, 1.0, -1.0)]),
        exponents=np.tile(leds.exponents, 2),
        intensity=np.tile(leds.intensity, (2, 1)),
        mirrored=np.repeat([False, True], len(leds.exponents)),
        ior=face.ior,
    )


def drifted_flux(lamps: Mapping[str, Lamp], rng: np.random.Generator) -> FloatArray | None:
    """Draw the flux of each LED in one press, relative to nominal, (LED,); None without drift."""
    rows = [lamps[name] for name in sorted(lamps)]
    if not any(lamp.drift_percent or lamp.led_drift_percent for lamp in rows):
        return None
    drawn = [
        1.0
        + 0.01 * lamp.drift_percent * rng.standard_normal()
        + 0.01 * lamp.led_drift_percent * _deviations(rng.standard_normal(lamp.emitters))
        for lamp in rows
    ]
    return np.maximum(np.concatenate(drawn), 0.0)


def _deviations(drawn: FloatArray) -> FloatArray:
    """Return the draws minus their mean, scaled so that the SD of each remains that of the draws.

    The drift that all LEDs of a lamp share is drawn separately.
    """
    count = len(drawn)
    return np.asarray((drawn - drawn.mean()) * np.sqrt(count / max(count - 1, 1)))


def _row(lamp: Lamp) -> tuple[FloatArray, FloatArray]:
    along, azimuth, down = np.deg2rad([lamp.along_deg, lamp.aim_azimuth_deg, lamp.aim_down_deg])
    middle = np.array([lamp.x_mm, lamp.y_mm, lamp.height_mm])
    steps = _steps(lamp)
    direction = np.array([np.cos(along), np.sin(along), 0.0])
    aim = [np.cos(down) * np.cos(azimuth), np.cos(down) * np.sin(azimuth), -np.sin(down)]
    upwards = lamp.tall_mm * _heights(lamp.emitters)[:, np.newaxis] * (0.0, 0.0, 1.0)
    return middle + lamp.length_mm * steps[:, np.newaxis] * direction + upwards, np.array(aim)


def _heights(count: int) -> FloatArray:
    """Return the relative heights of the LEDs in a tall row, -0.5 to 0.5, (emitter,).

    The heights are evenly distributed, and every part of the row has LEDs at all heights: they are
    ranks of the van der Corput sequence. With the positions along the row they form Hammersley's
    points.
    """
    digits = (np.arange(count)[:, np.newaxis] >> np.arange(8)) & 1
    rank = np.argsort(np.argsort(digits @ 0.5 ** np.arange(1, 9)))
    return np.asarray((rank + 0.5) / count - 0.5)


def _steps(lamp: Lamp) -> FloatArray:
    """Return the relative positions of the LEDs along a row, -0.5 to 0.5, (emitter,).

    The positions are the centres of equal parts of the row; a single LED is in the middle.
    """
    return np.asarray((np.arange(lamp.emitters) + 0.5) / lamp.emitters - 0.5)


def _intensity(lamp: Lamp) -> FloatArray:
    """Return the radiant intensity of each LED along its aim, mW/sr, (emitter, channel)."""
    shares = 1.0 + lamp.taper * (0.5 - 6.0 * _steps(lamp) ** 2)
    even = lamp.flux_mw * (lamp.exponent + 1.0) / (2.0 * np.pi)
    return np.outer(even * shares / shares.sum(), _channel(lamp))


def _channel(lamp: Lamp) -> FloatArray:
    """Return 1 for the lamp's channel and 0 for the others, (channel,)."""
    return np.array([channel == lamp.channel for channel in CHANNELS], dtype=np.float64)
