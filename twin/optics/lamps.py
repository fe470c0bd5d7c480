"""Lamps of a photometric-stereo sensor as rows of point emitters, and their light in closed form.

World frame, mm. An LED at distance r, whose aim makes the angle theta with the way to the coat,
gives the irradiance I0 cos^m(theta) cos(incidence) exp(-a r) / r^2 up to theta = 90 degrees;
(m + 1) / 2 pi times its flux is I0. Light runs straight from LED to coat: LEDs couple into the gel
through its side, and what they cross above it (window) is taken to have the gel's index.

The coat scatters half of its light so flat that the window's outer face reflects it totally (1 -
1 / n^2 beyond the critical angle); with what the housing throws back it fills the shadows. This
fill is not traced: it is taken as an even sky, that a facet of normal n sees by (1 + n_z) / 2, at
every place alike.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from reconstruction.arrays import FloatArray
from twin.config.lamps import CHANNELS, Lamp


@dataclass(frozen=True, eq=False)
class Emitters:
    """All LEDs of a sensor.

    Attributes
    ----------
    positions_mm : (emitter, xyz) float
    aims : (emitter, xyz) float, unit vectors
    exponents : (emitter,) float
    intensity : (emitter, channel) float, mW/sr along the aim; red, green, blue
    fill : (channel,) float, mW/mm^2 on the untouched coat
    """

    positions_mm: FloatArray
    aims: FloatArray
    exponents: FloatArray
    intensity: FloatArray
    fill: FloatArray

    def irradiance(
        self, points_mm: FloatArray, normals: FloatArray, absorption: float = 0.0
    ) -> FloatArray:
        """Return the irradiance of each channel, mW/mm^2, without cast shadows.

        Parameters
        ----------
        points_mm, normals : (..., xyz) float, world
        absorption : Napierian coefficient of the gel, 1/mm

        Returns
        -------
        (..., channel) float
        """
        sky = 0.5 * (1.0 + normals[..., 2:])
        total = np.asarray(sky * self.fill, dtype=np.float64)
        for place, aim, exponent, intensity in zip(
            self.positions_mm, self.aims, self.exponents, self.intensity, strict=True
        ):
            way = place - points_mm
            r_mm = np.linalg.norm(way, axis=-1)
            ahead = np.maximum(-(way @ aim) / r_mm, 0.0)
            incidence = np.maximum(np.sum(way * normals, axis=-1) / r_mm, 0.0)
            lobe = np.where(ahead > 0.0, ahead**exponent, 0.0)  # 0 ** 0 is 1
            light = lobe * incidence * np.exp(-absorption * r_mm) / r_mm**2
            total += light[..., np.newaxis] * intensity
        return total


def emitters_of(lamps: Mapping[str, Lamp], flux: FloatArray | None = None) -> Emitters:
    """Place the LEDs of all rows, sorted by the rows' names.

    Parameters
    ----------
    flux : (emitter,) float, optional
        Of each LED over its usual one; the fill of a row follows the mean of its LEDs.
    """
    rows = [lamps[name] for name in sorted(lamps)]
    if flux is None:
        flux = np.ones(sum(lamp.emitters for lamp in rows))
    ends = np.cumsum([lamp.emitters for lamp in rows])
    of_rows = [part.mean() for part in np.split(flux, ends[:-1])]
    parts = [_row(lamp) for lamp in rows]
    counts = [lamp.emitters for lamp in rows]
    return Emitters(
        positions_mm=np.concatenate([part[0] for part in parts]),
        aims=np.repeat([part[1] for part in parts], counts, axis=0),
        exponents=np.repeat([lamp.exponent for lamp in rows], counts),
        intensity=flux[:, None] * np.repeat([_intensity(lamp) for lamp in rows], counts, axis=0),
        fill=np.sum(
            [
                share * lamp.fill_mw_per_mm2 * _channel(lamp)
                for share, lamp in zip(of_rows, rows, strict=True)
            ],
            axis=0,
        ),
    )


def drifted_flux(lamps: Mapping[str, Lamp], rng: np.random.Generator) -> FloatArray | None:
    """Draw the flux of each LED in one press over its usual one, (emitter,); None without drift."""
    rows = [lamps[name] for name in sorted(lamps)]
    if not any(lamp.drift_percent or lamp.led_drift_percent for lamp in rows):
        return None
    drawn = [
        1.0
        + 0.01 * lamp.drift_percent * rng.standard_normal()
        + 0.01 * lamp.led_drift_percent * rng.standard_normal(lamp.emitters)
        for lamp in rows
    ]
    return np.maximum(np.concatenate(drawn), 0.0)


def _row(lamp: Lamp) -> tuple[FloatArray, FloatArray]:
    along, azimuth, down = np.deg2rad([lamp.along_deg, lamp.aim_azimuth_deg, lamp.aim_down_deg])
    middle = np.array([lamp.x_mm, lamp.y_mm, lamp.height_mm])
    # Centres of equal parts of the row: one LED stands in its middle.
    steps = (np.arange(lamp.emitters) + 0.5) / lamp.emitters - 0.5
    direction = np.array([np.cos(along), np.sin(along), 0.0])
    aim = [np.cos(down) * np.cos(azimuth), np.cos(down) * np.sin(azimuth), -np.sin(down)]
    return middle + lamp.length_mm * steps[:, np.newaxis] * direction, np.array(aim)


def _intensity(lamp: Lamp) -> FloatArray:
    """Intensity along the aim of one LED, mW/sr; (channel,)."""
    one = lamp.flux_mw / lamp.emitters * (lamp.exponent + 1.0) / (2.0 * np.pi)
    return one * _channel(lamp)


def _channel(lamp: Lamp) -> FloatArray:
    """1 at the lamp's channel, 0 at the others."""
    return np.array([channel == lamp.channel for channel in CHANNELS], dtype=np.float64)
