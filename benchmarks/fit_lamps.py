"""Fit the lamps of a GelSight Mini to what real units show, and write them as a data file.

Targets: means over 3 x 3 tiles of the untouched gel of two units, 8-bit levels, and what 35 presses
of a 6.31 mm ball change on one of them (the set published with GelSLAM, rpl-cmu/gelslam,
example_calibration; contacts found as the calibration finds them): in each tile the change of a
level with the surface's normal, least squares within 1.4 mm of the contact's middle; over all
presses the change on the side of a lamp and on the far side.

Three rows of LEDs and their fill are fitted by weighted least squares to the closed-form shading of
the flat matte coat and of ball caps; the fit knows no shadows, the renderer does
(`benchmarks/gelsight.py` states the rendered residual).

The problem has more unknowns than it can tell apart (a longer row and a wider lobe look alike), so
every unknown is bounded by the housing and held weakly near a plain design.

Last line: {"background_rms_grey": rms over both units, "azimuth_error_deg": worst, ...}.
"""

import argparse
import json
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from reconstruction.arrays import FloatArray
from twin.camera import electrons_per_ms, full_well_e
from twin.config import Experiment, load_experiment
from twin.config.lamps import CHANNELS, Lamp
from twin.config.layers import media_of
from twin.optics.lamps import emitters_of

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
# (channel, tile row, tile col, xyz): levels per unit of the normal's image x (right), y (down), z
SENSITIVITY = np.array(
    [
        [
            [[-1, -50, 8], [-10, -65, 8], [-1, -82, 8]],
            [[5, -129, 4], [-17, -197, 7], [-13, -130, 6]],
            [[10, -83, 4], [-13, -157, 7], [-9, -96, 6]],
        ],
        [
            [[82, 13, 3], [95, 17, 3], [56, 8, 4]],
            [[79, 7, 3], [103, 13, 2], [58, 8, 5]],
            [[67, -3, 4], [89, 2, 1], [64, -2, 2]],
        ],
        [
            [[23, 90, 7], [15, 110, 7], [1, 93, 13]],
            [[23, 81, 9], [10, 110, 11], [-1, 94, 11]],
            [[20, 16, 9], [12, 35, 10], [11, 14, 9]],
        ],
    ],
    dtype=np.float64,
)
# (tile row, tile col, xy): middles of the presses in each tile, world mm
PLACES_MM = np.array(
    [
        [[-5.9, 4.4], [-1.1, 4.4], [6.1, 3.4]],
        [[-6.7, -0.3], [-0.6, 0.1], [5.6, 0.1]],
        [[-7.0, -4.1], [0.3, -3.5], [4.9, -4.3]],
    ]
)
# (channel, side, distance): mean change of level on the side of the lamp and on the far side, at
# 0.6 and 1.2 mm from the contact's middle, within 30 degrees of the lamp's direction
SIDES = np.array(
    [
        [[32.4, 45.8], [-14.4, -42.0]],
        [[20.3, 29.5], [-10.9, -27.4]],
        [[27.6, 32.3], [-3.1, -22.6]],
    ]
)
SIDES_MM, SECTOR_DEG = (0.6, 1.2), 30.0
# A level of background counts as five per unit normal, and as a level of a side.
SENSITIVITY_WEIGHT, SIDES_WEIGHT = 0.2, 1.0
TILE_WEIGHTS = np.ones((3, 3))
BALL_RADIUS_MM, CONTACT_MM = 3.155, 1.4  # 6.31 mm ball, 26 px less the rim
# Where a channel's lamp stands, world x and y
OUTWARD = {"red": (0.0, 1.0), "green": (1.0, 0.0), "blue": (0.0, -1.0)}
# Half the field over which presses are spread, x and y: sensitivities differ by place.
PRESSES_MM = (6.5, 4.5)
CAP_TOP_MM = 0.83  # such a press' depth by Hertz: square of the contact's radius over the ball's
FILE = Path(__file__).parents[1] / "scenes" / "lamps" / "gelsight_mini.toml"


@dataclass(frozen=True)
class Unknown:
    """One fitted number of a lamp: plain design, weak pull towards it, bounds."""

    name: str
    start: float
    spread: float
    low: float
    high: float


def unknowns(channel: str) -> list[Unknown]:
    """Return what is fitted of one lamp; the strips stand on the pad's edges or just outside."""
    outward = OUTWARD[channel]
    azimuth = {"red": -85.0, "green": 173.0, "blue": 97.0}[channel]  # the light's way
    reach_mm = 13.6 if channel == "green" else 11.4
    across, along = (0, 1) if channel == "green" else (1, 0)
    place = ["x_mm", "y_mm"]
    sign = outward[across]
    edges = sorted((sign * (reach_mm - 1.0), sign * (reach_mm + 4.0)))
    return [
        Unknown(place[across], sign * reach_mm, 1.5, edges[0], edges[1]),
        Unknown(place[along], 0.0, 1.5, -4.0, 4.0),
        Unknown("height_mm", 4.0, 1.5, 0.5, 7.2),
        Unknown("length_mm", 12.0, 4.0, 2.0, 20.0),
        Unknown("aim_azimuth_deg", azimuth, 10.0, azimuth - 40.0, min(azimuth + 40.0, 180.0)),
        Unknown("aim_down_deg", 10.0, 10.0, -25.0, 60.0),
        Unknown("exponent", 4.0, 4.0, 0.0, 60.0),
        Unknown("log_flux", -3.0, 5.0, -12.0, 12.0),
        Unknown("log_fill", -11.0, 5.0, -16.0, 2.0),
    ]


# Drift: so that rendered images show what real presses do beside the contact, as nearly as both can
# be met. SD over presses of the mean level: real 0.56, 0.12, 0.25, rendered 0.50, 0.18, 0.32; of
# its slow change over the field (Gaussian of 12 px): 0.35, 0.24, 0.34 and 0.36, 0.16, 0.22.
FIXED: dict[str, dict[str, Any]] = {
    "red": {
        "along_deg": 0.0, "wavelength_nm": 635.0, "drift_percent": 0.6, "led_drift_percent": 1.1,
    },
    "green": {
        "along_deg": 90.0, "wavelength_nm": 527.0, "drift_percent": 0.0, "led_drift_percent": 0.9,
    },
    "blue": {
        "along_deg": 0.0, "wavelength_nm": 463.0, "drift_percent": 0.0, "led_drift_percent": 1.2,
    },
}  # fmt: skip


def lamp_of(channel: str, values: FloatArray) -> Lamp:
    """Build a lamp from the fitted numbers."""
    found = {u.name: float(v) for u, v in zip(unknowns(channel), values, strict=True)}
    found["flux_mw"] = float(np.exp(found.pop("log_flux")))
    found["fill_mw_per_mm2"] = float(np.exp(found.pop("log_fill")))
    return Lamp.model_validate(found | FIXED[channel] | {"channel": channel})


@dataclass(frozen=True, eq=False)
class Shading:
    """Closed-form images: levels of one channel at points of given normal.

    Attributes
    ----------
    tiles : (flat,) int, 0 to 8; tile of each point of the untouched coat
    points_mm, normals : (n, xyz)
        Points of the untouched coat; then of nine ball caps, one in each tile; then of the
        untouched coat below these.
    """

    experiment: Experiment
    tiles: NDArray[np.intp]
    points_mm: FloatArray
    normals: FloatArray

    def image(self, lamp: Lamp) -> "ShadedImage":
        """Return the levels of all points in the light of one lamp, not rounded."""
        camera, media = self.experiment.camera, media_of(self.experiment.layers)
        light = emitters_of({"lamp": lamp}).irradiance(self.points_mm, self.normals)
        irradiance = light[:, CHANNELS.index(lamp.channel)]
        radiance = self.experiment.coating.base_albedo / np.pi * irradiance * _way_out(media)
        rate = electrons_per_ms(camera, lamp.wavelength_nm) * float(camera.exposure_ms)
        gain = getattr(self.experiment.photometric.white_balance, lamp.channel)
        linear = np.clip(gain * radiance * rate / full_well_e(camera), 1e-6, 1.0)
        levels = 255.0 * linear ** (1.0 / self.experiment.photometric.gamma)
        flat, caps, below = np.split(levels, self._parts)
        return ShadedImage(
            np.bincount(self.tiles, flat, 9) / np.bincount(self.tiles, minlength=9),
            (caps - below).reshape(9, -1),
            self.cap_normals,
        )

    def background(self, lamp: Lamp) -> FloatArray:
        """Mean levels of the 3 x 3 tiles."""
        return self.image(lamp).background.reshape(3, 3)

    @property
    def cap_normals(self) -> FloatArray:
        """Normals of one cap, (point, xyz)."""
        first, end = self._parts
        return self.normals[first : first + (end - first) // 9]

    @property
    def _parts(self) -> tuple[int, int]:
        flat = len(self.tiles)
        return flat, (flat + len(self.normals)) // 2


@dataclass(frozen=True, eq=False)
class ShadedImage:
    """What one lamp shows: (9,) mean levels of tiles, and (9, point) changes on a cap in each."""

    background: FloatArray
    changes: FloatArray
    cap_normals: FloatArray

    def sensitivity(self) -> FloatArray:
        """Change of the level per unit of the normal, (tile, xyz)."""
        return np.stack([sensitivity(change, self.cap_normals) for change in self.changes])

    def sides(self, channel: str) -> FloatArray:
        """Mean change on the lamp's side and on the far one, (side, distance)."""
        across = self.cap_normals[:, :2]
        r_mm = BALL_RADIUS_MM * np.linalg.norm(across, axis=1)
        cosine = across @ OUTWARD[channel] * BALL_RADIUS_MM / np.maximum(r_mm, 1e-9)
        within = np.cos(np.deg2rad(SECTOR_DEG))
        return np.array(
            [
                [
                    self.changes[:, (side * cosine > within) & (abs(r_mm - mm) < 0.1)].mean()
                    for mm in SIDES_MM
                ]
                for side in (1.0, -1.0)
            ]
        )


def sensitivity(change: FloatArray, normals: FloatArray) -> FloatArray:
    """Regress changes of level, (n,) or (n, channel), on world normals (n, xyz): image x, y, and z.

    The normal's three components, no constant.
    """
    found = np.linalg.lstsq(normals, change, rcond=None)[0]
    return np.stack([found[0], -found[1], found[2]], axis=-1)


def _way_out(media: Any) -> float:
    """Radiance in air over radiance in the gel, straight up: Fresnel and 1 / n^2."""
    indices = [1.0, *(medium.ior for medium in media)]
    passed = [4 * a * b / (a + b) ** 2 for a, b in pairwise(indices)]
    return float(np.prod(passed)) / indices[-1] ** 2


def shading_of(experiment: Experiment, pitch_mm: float = 0.0634) -> Shading:
    """Place the evaluation points: the image's field, and caps of balls where such were pressed."""
    half_x, half_y = 160 * pitch_mm, 120 * pitch_mm
    x = (np.arange(24) + 0.5) / 24 * 2 - 1
    col, row = np.meshgrid(np.arange(24) // 8, np.arange(24) // 8)
    flat = np.stack(np.meshgrid(x * half_x, -x * half_y), axis=-1).reshape(-1, 2)
    normals = _cap_normals()
    centres = np.repeat(PLACES_MM.reshape(9, 2), len(normals), axis=0)
    below = centres + np.tile(BALL_RADIUS_MM * normals[:, :2], (9, 1))
    cap_z = CAP_TOP_MM - BALL_RADIUS_MM * (1.0 - normals[:, 2])
    height = np.concatenate([np.zeros(len(flat)), np.tile(cap_z, 9), np.zeros(len(below))])
    points = np.column_stack([np.concatenate([flat, below, below]), height])
    up = np.array([0.0, 0.0, 1.0])
    facing = [np.tile(up, (len(flat), 1)), np.tile(normals, (9, 1)), np.tile(up, (len(below), 1))]
    return Shading(experiment, (3 * row + col).ravel(), points, np.concatenate(facing))


def _cap_normals() -> FloatArray:
    grid = np.arange(-CONTACT_MM, CONTACT_MM + 0.01, 0.1)
    across = np.stack(np.meshgrid(grid, grid), axis=-1).reshape(-1, 2)
    across = across[np.hypot(*across.T) <= CONTACT_MM] / BALL_RADIUS_MM
    return np.column_stack([across, np.sqrt(1.0 - np.sum(across**2, axis=1))])


def fit(shading: Shading, channel: str) -> Lamp:
    """Fit one lamp: the channels do not mix."""
    return lamp_of(channel, _solved(shading, channel).x)


def _solved(shading: Shading, channel: str) -> Any:
    number, parts = CHANNELS.index(channel), unknowns(channel)
    start = np.array([u.start for u in parts])
    spread = np.array([u.spread for u in parts])

    def residuals(values: FloatArray) -> FloatArray:
        found = shading.image(lamp_of(channel, values))
        tiles = TILE_WEIGHTS * (found.background.reshape(3, 3) - UNITS[:, number])
        slopes = SENSITIVITY_WEIGHT * (found.sensitivity() - SENSITIVITY[number].reshape(9, 3))
        sides = SIDES_WEIGHT * (found.sides(channel) - SIDES[number])
        parts = (tiles, slopes, sides, (values - start) / spread)
        return np.concatenate([part.ravel() for part in parts])

    bounds = np.array([u.low for u in parts]), np.array([u.high for u in parts])
    return least_squares(residuals, start, bounds=bounds, x_scale=spread)


def figures(shading: Shading, lamps: dict[str, Lamp]) -> dict[str, float]:
    """State the residual of the closed form."""
    images = {c: shading.image(lamps[c]) for c in CHANNELS}
    found = np.stack([images[c].background.reshape(3, 3) for c in CHANNELS])
    slopes = np.stack([images[c].sensitivity().reshape(3, 3, 3) for c in CHANNELS])
    sides = np.stack([images[c].sides(c) for c in CHANNELS])
    print("background\n", np.round(found, 1), "\nsensitivity\n", np.round(slopes))
    print("sides\n", np.round(sides, 1))
    return {
        "background_rms_grey": _rms(UNITS - found),
        "units_apart_rms_grey": _rms(UNITS - UNITS.mean(axis=0)),
        "azimuth_error_deg": azimuth_error_deg(slopes.mean(axis=(1, 2))),
        "sensitivity_rms": _rms((slopes - SENSITIVITY)[..., :2]),
        "sides_rms_grey": _rms(sides - SIDES),
    }


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def azimuth_error_deg(slopes: FloatArray) -> float:
    """Largest angle between found and measured directions of light, (channel, xyz), degrees."""
    angles = [np.arctan2(-s[:, 1], s[:, 0]) for s in (slopes, SENSITIVITY.mean(axis=(1, 2)))]
    turned = np.angle(np.exp(1j * (angles[0] - angles[1])))
    return float(np.degrees(np.abs(turned).max()))


def write(path: Path, lamps: dict[str, Lamp], residual: dict[str, float]) -> None:
    """Write the lamps with the origin of every number."""
    source = (
        "fitted by benchmarks/fit_lamps.py to images of two real units and of 35 presses,"
        f" residual {residual['background_rms_grey']:.1f} grey levels"
    )
    spectrum = "assumed: LEDs of laboratory sensors (630-645, 525-530, 460-465 nm)"
    drift = "light of 67 real presses of one unit, SD of offset and of slow change"
    lines = [
        "# Written by benchmarks/fit_lamps.py. Lamps of a GelSight Mini. The maker publishes none:",
        "# effective rows of LEDs that show the images of real units, no measured geometry.",
        'description = "lamps of a GelSight Mini, fitted"',
    ]
    for name, lamp in lamps.items():
        lines += ["", f"[{name}]", f'channel = "{lamp.channel}"']
        for key, value in lamp.model_dump(exclude={"channel", "emitters"}).items():
            why = {
                "wavelength_nm": spectrum,
                "along_deg": "assumed: along the pad's edge",
                "drift_percent": drift,
                "led_drift_percent": drift,
            }
            text = f"{value:.5g}" if value % 1 else f"{value:.1f}"
            lines.append(f'{key} = {{ value = {text}, source = "{why.get(key, source)}" }}')
        lines.append(f'emitters = {{ value = {lamp.emitters}, source = "assumed" }}')
    path.write_text("\n".join([*lines, ""]), encoding="utf-8")


def main() -> None:
    """Fit, print the residual, and write the data file when asked to."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true", help=f"write {FILE.name}")
    wanted = parser.parse_args().write
    shading = shading_of(load_experiment("examples/gelsight_ball", {"modality": "contact_fpp"}))
    lamps = {channel: fit(shading, channel) for channel in CHANNELS}
    residual = figures(shading, lamps)
    if wanted:
        write(FILE, lamps, residual)
    print(json.dumps({name: round(value, 3) for name, value in residual.items()}))


if __name__ == "__main__":
    main()
