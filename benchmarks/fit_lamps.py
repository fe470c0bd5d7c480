"""Fit the lamps of a GelSight Mini to images of real units, and write them as a data file.

Targets: the spots of 67 presses of balls on one unit, before and during the press
(`real_presses`), and means over 3 x 3 tiles of the gel without contact of that unit and another.

Three rows of LEDs per channel, and their fill, are fitted by weighted least squares to the
closed-form shading of the flat coat and of ball caps; the coating defines how much light its ink
transmits. The fit has no shadows, the renderer has (`benchmarks/gelsight.py` states the rendered
residual). One row per channel gives a 10 % larger residual of the held-out changes by presses.

Several unknowns are correlated (a longer row and a wider lobe have the same effect), so every
unknown is bounded by the housing and has a weak prior at a plain design.

Last line: {"background_rms_grey": rms over both units, "before_rms_grey", "change_rms_grey": rms
over all spots}.
"""

import argparse
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import chain, pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.progress import track
from scipy.optimize import least_squares

from benchmarks._harness import print_figures
from benchmarks.real_presses import (
    HEIGHT_PX,
    PITCH_MM,
    VIEW_MM,
    WIDTH_PX,
    RealPresses,
    read_presses,
)
from reconstruction.arrays import FloatArray
from twin.camera import electrons_per_ms, full_well_e
from twin.config import Experiment, load_experiment
from twin.config.lamps import CHANNELS, Lamp
from twin.config.layers import media_of, outer_face
from twin.optics.lamps import emitters_of
from twin.pipeline.colour_images import image_pinhole

# (unit, channel, row, col), rows from the top
UNITS = np.array(
    [
        [
            [[51, 65, 44], [97, 135, 88], [81, 111, 75]],
            [[96, 108, 92], [98, 110, 95], [87, 97, 85]],
            [[112, 129, 106], [123, 142, 115], [82, 99, 81]],
        ],
        [
            [[52, 67, 43], [92, 128, 81], [71, 99, 66]],
            [[93, 107, 90], [96, 112, 93], [85, 97, 81]],
            [[101, 123, 100], [116, 142, 112], [81, 97, 76]],
        ],
    ],
    dtype=np.float64,
)
# Weight of a level of a tile and of all spots of a press together: 1; of spots before it: 0.5.
BEFORE_WEIGHT = 0.5
TILE_WEIGHTS = 2.0 * np.ones((3, 3))
UP = np.array([0.0, 0.0, 1.0])
# Direction of a channel's lamp, world x and y
OUTWARD = {"red": (0.0, 1.0), "green": (1.0, 0.0), "blue": (0.0, -1.0)}
# Initial heights of the rows of a channel.
ROWS_MM = (5.0, 6.0, 7.0)
# Above it all LEDs of a tall row are above the relief; lower rows give the same misfit to 2 %, and
# their grazing light increases the run time of an image by up to a factor of three.
LEAST_HEIGHT_MM = 4.0
FILE = Path(__file__).parents[1] / "scenes" / "lamps" / "gelsight_mini.toml"

Rows = dict[str, Lamp]
"""Rows of LEDs by their names."""


@dataclass(frozen=True)
class Unknown:
    """One fitted parameter of a row: plain design, SD of its weak prior, bounds."""

    name: str
    start: float
    spread: float
    low: float
    high: float


def unknowns(channel: str, height_mm: float) -> list[Unknown]:
    """Return the unknowns of one row, which is at the pad's edge or outside."""
    outward = OUTWARD[channel]
    azimuth = {"red": -85.0, "green": 173.0, "blue": 97.0}[channel]  # direction of the light
    reach_mm = 13.6 if channel == "green" else 11.4
    across, along = (0, 1) if channel == "green" else (1, 0)
    place = ["x_mm", "y_mm"]
    sign = outward[across]
    edges = sorted((sign * (reach_mm - 1.0), sign * (reach_mm + 9.0)))
    return [
        Unknown(place[across], sign * reach_mm, 3.0, edges[0], edges[1]),
        Unknown(place[along], 0.0, 2.0, -5.0, 5.0),
        Unknown("height_mm", height_mm, 3.0, LEAST_HEIGHT_MM, 8.2),
        Unknown("length_mm", 14.0, 8.0, 2.0, 30.0),
        Unknown("aim_azimuth_deg", azimuth, 12.0, azimuth - 45.0, azimuth + 45.0),
        Unknown("aim_down_deg", 15.0, 20.0, -60.0, 70.0),
        Unknown("exponent", 6.0, 10.0, 0.0, 80.0),
        Unknown("taper", 0.3, 0.5, 0.0, 1.0),
        Unknown("log_flux", -4.0, 3.0, -14.0, 2.0),
    ]


FILL = Unknown("log_fill", -11.0, 5.0, -16.0, 2.0)
"""One per channel, stored in its first row."""


# Drift outside the contact in real presses, SD over presses of the mean level: 0.56, 0.12, 0.25; of
# its slow change over the field (Gaussian of 12 px): 0.37, 0.25, 0.36.
FIXED: dict[str, dict[str, Any]] = {
    "red": {
        "along_deg": 0.0, "wavelength_nm": 635.0, "drift_percent": 1.4, "led_drift_percent": 0.9,
    },
    "green": {
        "along_deg": 90.0, "wavelength_nm": 527.0, "drift_percent": 0.3, "led_drift_percent": 1.7,
    },
    "blue": {
        "along_deg": 0.0, "wavelength_nm": 463.0, "drift_percent": 0.5, "led_drift_percent": 1.9,
    },
}  # fmt: skip
ALIKE = {"tall_mm": 2.0, "emitters": 5}


def unknowns_of(channel: str) -> list[Unknown]:
    """Return the unknowns of a channel: its rows, then its fill."""
    rows = (unknowns(channel, height_mm) for height_mm in ROWS_MM)
    return [*chain.from_iterable(rows), FILL]


def rows_of(channel: str, values: FloatArray) -> Rows:
    """Build the rows of a channel from the fitted values."""
    parts = np.split(values[:-1], len(ROWS_MM))
    fills = [float(np.exp(values[-1]))] + [0.0] * (len(parts) - 1)
    return {
        f"{channel}_{number}": _row(channel, part, fill)
        for number, (part, fill) in enumerate(zip(parts, fills, strict=True), start=1)
    }


def _row(channel: str, values: FloatArray, fill: float) -> Lamp:
    names = [one.name for one in unknowns(channel, 0.0)]
    values_by_name = dict(zip(names, map(float, values), strict=True)) | FIXED[channel] | ALIKE
    values_by_name["flux_mw"] = float(np.exp(values_by_name.pop("log_flux")))
    values_by_name["aim_azimuth_deg"] = (values_by_name["aim_azimuth_deg"] + 180.0) % 360.0 - 180.0
    return Lamp.model_validate(values_by_name | {"channel": channel, "fill_mw_per_mm2": fill})


@dataclass(frozen=True, eq=False)
class Shading:
    """Closed-form levels of the undeformed coat and of the spots of real presses.

    Attributes
    ----------
    presses : the fitted spots
    flat_mm : (point, xyz), the undeformed coat all over the image; tiles : index of 9 tiles
    contact_ratio : brightness of the ink in contact over elsewhere
    """

    experiment: Experiment
    presses: RealPresses
    flat_mm: FloatArray
    tiles: NDArray[np.intp]
    contact_ratio: float

    def image(self, rows: Rows) -> "ShadedImage":
        """Return the levels in the light of the rows of one channel, not rounded."""
        spots = len(self.presses.of_press)
        flat, before, during = np.split(self._levels(rows), np.cumsum([len(self.flat_mm), spots]))
        tiles = np.bincount(self.tiles, flat, 9) / np.bincount(self.tiles, minlength=9)
        return ShadedImage(tiles, before, during)

    def background(self, rows: Rows) -> FloatArray:
        """Mean levels of the 3 x 3 tiles."""
        return self.image(rows).tiles.reshape(3, 3)

    @cached_property
    def points_mm(self) -> FloatArray:
        """All places, (point, xyz): the undeformed coat, spots before and during their press."""
        presses = self.presses
        return np.concatenate([self.flat_mm, presses.untouched_mm, presses.points_mm])

    @cached_property
    def normals(self) -> FloatArray:
        """Normals of the coat there, (point, xyz)."""
        pressed = self.presses.normals
        flat = np.broadcast_to(UP, (len(self.flat_mm) + len(pressed), 3))
        return np.concatenate([flat, pressed])

    @cached_property
    def _sensitivity(self) -> FloatArray:
        """Light on the sensor over irradiance, (point,): contact, vignetting, refraction."""
        contact = len(self.points_mm) - len(self.presses.of_press)
        brighter = np.where(np.arange(len(self.points_mm)) < contact, 1.0, self.contact_ratio)
        radiance = self.experiment.coating.base_albedo / np.pi * brighter
        passed = _transmittance(media_of(self.experiment.layers))
        return radiance * passed * _vignetting(self.experiment, self.points_mm)

    def _levels(self, rows: Rows) -> FloatArray:
        experiment, lamp = self.experiment, next(iter(rows.values()))
        camera, photometric = experiment.camera, experiment.photometric
        irradiance = np.sum([_irradiance(self, row) for row in rows.values()], axis=0)
        rate = electrons_per_ms(camera, lamp.wavelength_nm) * float(camera.exposure_ms)
        gain = getattr(photometric.white_balance, lamp.channel)
        seen = gain * rate * self._sensitivity * irradiance
        linear = np.clip(seen / full_well_e(camera), 1e-6, 1.0)
        return np.asarray(255.0 * linear ** (1.0 / photometric.gamma))


@lru_cache(maxsize=8)  # a step of the fit moves one row of three
def _irradiance(shading: Shading, row: Lamp) -> FloatArray:
    emitters = emitters_of({"row": row}, face=outer_face(shading.experiment.layers))
    light = emitters.irradiance(shading.points_mm, shading.normals)
    return light[:, CHANNELS.index(row.channel)]


@dataclass(frozen=True, eq=False)
class ShadedImage:
    """Levels of a channel: (9,) means of tiles; (spot,) before and during a press."""

    tiles: FloatArray
    before: FloatArray
    during: FloatArray


def _vignetting(experiment: Experiment, points_mm: FloatArray) -> FloatArray:
    """Light on the sensor over that on the axis, at apparent places on the undeformed coat."""
    device, (x_mm, y_mm, z_mm) = image_pinhole(experiment), points_mm.T
    seen_px = np.hypot(x_mm / device.fx_px, y_mm / device.fy_px) / PITCH_MM
    off_axis = seen_px / (1.0 - z_mm / VIEW_MM)
    power = -experiment.photometric.vignetting_exponent / 2.0
    return np.asarray((1.0 + off_axis**2) ** power)


def _transmittance(media: Any) -> float:
    """Radiance in air over radiance in the gel, straight up: Fresnel and 1 / n^2."""
    indices = [1.0, *(medium.ior for medium in media)]
    passed = [4 * a * b / (a + b) ** 2 for a, b in pairwise(indices)]
    return float(np.prod(passed)) / indices[-1] ** 2


def shading_of(experiment: Experiment, presses: RealPresses | None = None) -> Shading:
    """Place the evaluation points: the image's field, and the spots of real presses."""
    half_x, half_y = WIDTH_PX / 2 * PITCH_MM, HEIGHT_PX / 2 * PITCH_MM
    x = (np.arange(12) + 0.5) / 12 * 2 - 1
    col, row = np.meshgrid(np.arange(12) // 4, np.arange(12) // 4)
    flat = np.stack(np.meshgrid(x * half_x, -x * half_y), axis=-1).reshape(-1, 2)
    return Shading(
        experiment,
        presses or read_presses(),
        np.column_stack([flat, np.zeros(len(flat))]),
        (3 * row + col).ravel(),
        _brighter_on_steel(experiment),
    )


def _brighter_on_steel(experiment: Experiment) -> float:
    """Return the coat's albedo in contact with the reference ball, over that elsewhere."""
    coating, steel = experiment.coating, experiment.photometric.presses.material
    touching, free = (coating.albedo_over(r) for r in (steel.normal_reflectance, 0.0))
    return 1.0 if touching is None or free is None else touching / free


def fit(shading: Shading, channel: str, tolerance: float = 1e-8) -> Rows:
    """Fit the rows of one channel; channels are independent.

    The fit ends at a step that decreases the sum of squares by less than the relative `tolerance`.
    """
    return rows_of(channel, _solved(shading, channel, tolerance).x)


def _solved(shading: Shading, channel: str, tolerance: float) -> Any:
    number, parts = CHANNELS.index(channel), unknowns_of(channel)
    start, spread, low, high = (
        np.array([getattr(u, key) for u in parts]) for key in ("start", "spread", "low", "high")
    )
    presses = shading.presses
    per_spot = 1.0 / np.sqrt(np.bincount(presses.of_press)[presses.of_press])

    def residuals(values: FloatArray) -> FloatArray:
        image = shading.image(rows_of(channel, values))
        tiles = TILE_WEIGHTS * (image.tiles.reshape(3, 3) - UNITS[:, number])
        before = image.before - presses.before[:, number]
        change = image.during - image.before - presses.change[:, number]
        own = BEFORE_WEIGHT * per_spot * before, per_spot * change, (values - start) / spread
        return np.concatenate([tiles.ravel(), *own])

    return least_squares(residuals, start, bounds=(low, high), x_scale=spread, ftol=tolerance)


def figures(shading: Shading, lamps: dict[str, Rows]) -> dict[str, float]:
    """Return the residual of the closed form."""
    images, presses = {c: shading.image(lamps[c]) for c in CHANNELS}, shading.presses
    background = np.stack([images[c].tiles.reshape(3, 3) for c in CHANNELS])
    before = np.stack([images[c].before for c in CHANNELS], axis=-1)
    during = np.stack([images[c].during for c in CHANNELS], axis=-1)
    change = during - before - presses.change
    print("background\n", np.round(background, 1))
    for name, part in (("before", before - presses.before), ("change", change)):
        print(name, "residual by channel", np.sqrt(np.mean(part**2, axis=0)).round(2))
    return {
        "background_rms_grey": _rms(UNITS - background),
        "units_apart_rms_grey": _rms(UNITS - UNITS.mean(axis=0)),
        "before_rms_grey": _rms(before - presses.before),
        "change_rms_grey": _rms(change),
    }


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def write(path: Path, lamps: Rows, residual: dict[str, float]) -> None:
    """Write the lamps with the origin of every number."""
    fitted = (
        "fitted by benchmarks/fit_lamps.py to images of two real units and of 67 presses,"
        f" residual {residual['background_rms_grey']:.1f} grey levels"
    )
    drift = "light of 67 real presses of one unit, SD of offset and of slow change"
    sources = {
        "wavelength_nm": "assumed: LEDs of laboratory sensors (630-645, 525-530, 460-465 nm)",
        "along_deg": "assumed: along the pad's edge",
        "tall_mm": "assumed: shadows beside real contacts have no edge",
        "drift_percent": drift,
        "led_drift_percent": drift,
    }
    lines = [
        "# Written by benchmarks/fit_lamps.py. Lamps of a GelSight Mini. The maker publishes none:",
        "# effective rows of LEDs that show the images of real units, no measured geometry.",
        'description = "lamps of a GelSight Mini, fitted"',
    ]
    for name, lamp in lamps.items():
        lines += ["", f"[{name}]", f'channel = "{lamp.channel}"']
        for key, value in lamp.model_dump(exclude={"channel", "emitters"}).items():
            text = f"{value:.5g}" if value % 1 else f"{value:.1f}"
            lines.append(f'{key} = {{ value = {text}, source = "{sources.get(key, fitted)}" }}')
        lines.append(f'emitters = {{ value = {lamp.emitters}, source = "assumed" }}')
    path.write_text("\n".join([*lines, ""]), encoding="utf-8")


def main() -> None:
    """Fit, print the residual, and write the data file if requested."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true", help=f"write {FILE.name}")
    to_write = parser.parse_args().write
    shading = shading_of(load_experiment("examples/gelsight_ball", {"modality": "contact_fpp"}))
    lamps = {channel: fit(shading, channel) for channel in track(CHANNELS, "fitting")}
    residual = figures(shading, lamps)
    if to_write:
        write(FILE, {name: row for rows in lamps.values() for name, row in rows.items()}, residual)
    print_figures(residual)


if __name__ == "__main__":
    main()
