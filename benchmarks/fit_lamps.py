"""Fit the lamps of a GelSight Mini to what two real units show, and write them as a data file.

Targets, from published images of two units (means over 3 x 3 tiles of the untouched gel, 8-bit
levels) and of 37 presses of balls (change of a level per unit of the surface normal, least squares
inside the contact, and the darkest levels). Three rows of LEDs and their fill are fitted by
weighted least squares on closed-form shading of the flat coat and of ball caps; the fit knows no
shadows, the renderer does (`benchmarks/gelsight.py` states the rendered residual).

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
# (channel, 2): levels per unit of the normal's image x (right) and y (down)
SENSITIVITY = np.array([[-13.0, -140.0], [93.0, 12.0], [12.0, 107.0]])
# Darkest levels in those presses: what is left where the lamp's own light does not reach. A bound
# from above for the fill of shadows, taken as its value.
DARKEST = np.array([21.0, 61.0, 50.0])
SENSITIVITY_WEIGHT = 0.5  # a level of background counts as two per unit normal
BALL_RADIUS_MM, CONTACT_MM = 3.155, 1.4  # 6.31 mm ball, 26 px less the rim
# Half the field over which presses are spread, x and y: sensitivities differ by place.
PRESSES_MM = (6.5, 4.5)
CAP_MM = 0.5  # mean height of such a cap when the ball is 0.7 mm deep
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
    outward = {"red": (0.0, 1.0), "green": (1.0, 0.0), "blue": (0.0, -1.0)}[channel]
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


# Drift: SD over real presses of the mean level, 0.54 / 0.08 / 0.23 of some 82 / 98 / 115 levels,
# and of its slow change over the field, 0.30 / 0.20 / 0.23; a level's relative change is the
# flux's over gamma. One LED of eight lights most of its place by itself: twice the slow change.
FIXED: dict[str, dict[str, Any]] = {
    "red": {
        "along_deg": 0.0, "wavelength_nm": 635.0, "drift_percent": 1.4, "led_drift_percent": 1.6,
    },
    "green": {
        "along_deg": 90.0, "wavelength_nm": 527.0, "drift_percent": 0.2, "led_drift_percent": 0.9,
    },
    "blue": {
        "along_deg": 0.0, "wavelength_nm": 463.0, "drift_percent": 0.4, "led_drift_percent": 0.9,
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
    """Closed-form images: levels of one channel at points of given normal."""

    experiment: Experiment
    #: (n, 3) evaluation points of the untouched coat, and their tile, 0 to 8
    points_mm: FloatArray
    tiles: NDArray[np.intp]
    #: (m, 3) points and normals of ball caps
    cap_points_mm: FloatArray
    cap_normals: FloatArray

    def levels(self, lamp: Lamp, points_mm: FloatArray, normals: FloatArray) -> FloatArray:
        """8-bit levels, not rounded, of matte ink in the light of one lamp."""
        camera, media = self.experiment.camera, media_of(self.experiment.layers)
        light = emitters_of({"lamp": lamp}).irradiance(points_mm, normals)
        irradiance = light[:, CHANNELS.index(lamp.channel)]
        radiance = self.experiment.coating.base_albedo / np.pi * irradiance * _way_out(media)
        rate = electrons_per_ms(camera, lamp.wavelength_nm) * float(camera.exposure_ms)
        gain = getattr(self.experiment.photometric.white_balance, lamp.channel)
        linear = np.clip(gain * radiance * rate / full_well_e(camera), 1e-6, 1.0)
        return np.asarray(255.0 * linear ** (1.0 / self.experiment.photometric.gamma))

    def background(self, lamp: Lamp) -> FloatArray:
        """Mean levels of the 3 x 3 tiles."""
        up = np.broadcast_to([0.0, 0.0, 1.0], self.points_mm.shape)
        levels = self.levels(lamp, self.points_mm, up)
        sums = np.bincount(self.tiles, levels, minlength=9)
        return (sums / np.bincount(self.tiles, minlength=9)).reshape(3, 3)

    def darkest(self, lamp: Lamp) -> float:
        """Level of the untouched coat in the fill alone."""
        alone = lamp.model_copy(update={"flux_mw": 0.0})
        return float(self.levels(alone, np.zeros((1, 3)), np.array([[0.0, 0.0, 1.0]]))[0])

    def sensitivity(self, lamp: Lamp) -> FloatArray:
        """Change of the level per unit normal, image x and y, over all caps."""
        up = np.broadcast_to([0.0, 0.0, 1.0], self.cap_points_mm.shape)
        change = self.levels(lamp, self.cap_points_mm, self.cap_normals)
        change = change - self.levels(lamp, self.cap_points_mm, up)
        return sensitivity(change, self.cap_normals)


def sensitivity(change: FloatArray, normals: FloatArray) -> FloatArray:
    """Regress changes of level, (n,) or (n, channel), on world normals (n, 3): image x and y.

    As for the published figures: the normal's three components, no constant.
    """
    found = np.linalg.lstsq(normals, change, rcond=None)[0]
    return np.stack([found[0], -found[1]], axis=-1)


def _way_out(media: Any) -> float:
    """Radiance in air over radiance in the gel, straight up: Fresnel and 1 / n^2."""
    indices = [1.0, *(medium.ior for medium in media)]
    passed = [4 * a * b / (a + b) ** 2 for a, b in pairwise(indices)]
    return float(np.prod(passed)) / indices[-1] ** 2


def shading_of(experiment: Experiment, pitch_mm: float = 0.0634) -> Shading:
    """Place the evaluation points: the image's field, and caps of balls on 3 x 3 places in it."""
    half_x, half_y = 160 * pitch_mm, 120 * pitch_mm
    x = (np.arange(24) + 0.5) / 24 * 2 - 1
    col, row = np.meshgrid(np.arange(24) // 8, np.arange(24) // 8)
    places = np.stack(np.meshgrid(x * half_x, -x * half_y), axis=-1).reshape(-1, 2)
    flat = np.column_stack([places, np.zeros(len(places))])
    grid = np.arange(-CONTACT_MM, CONTACT_MM + 0.01, 0.2)
    cap = np.stack(np.meshgrid(grid, grid), axis=-1).reshape(-1, 2)
    cap = cap[np.hypot(*cap.T) <= CONTACT_MM] / BALL_RADIUS_MM
    normals = np.column_stack([cap, np.sqrt(1.0 - np.sum(cap**2, axis=1))])
    # Middles of nine equal parts: the mean over presses that lie anywhere with equal chance.
    step_x, step_y = (2 / 3 * half_mm for half_mm in PRESSES_MM)
    centres = [(i * step_x, j * step_y, CAP_MM) for i in (-1, 0, 1) for j in (-1, 0, 1)]
    caps = np.concatenate([normals * BALL_RADIUS_MM * [1, 1, 0] + centre for centre in centres])
    tiles = (3 * row + col).ravel()
    return Shading(experiment, flat, tiles, caps, np.tile(normals, (len(centres), 1)))


def fit(shading: Shading, channel: str) -> Lamp:
    """Fit one lamp: the channels do not mix."""
    number, parts = CHANNELS.index(channel), unknowns(channel)
    start = np.array([u.start for u in parts])
    spread = np.array([u.spread for u in parts])

    def residuals(values: FloatArray) -> FloatArray:
        lamp = lamp_of(channel, values)
        tiles = (shading.background(lamp) - UNITS[:, number]).ravel()
        slopes = SENSITIVITY_WEIGHT * (shading.sensitivity(lamp) - SENSITIVITY[number])
        shadow = [shading.darkest(lamp) - DARKEST[number]]
        return np.concatenate([tiles, slopes, shadow, (values - start) / spread])

    bounds = np.array([u.low for u in parts]), np.array([u.high for u in parts])
    return lamp_of(channel, least_squares(residuals, start, bounds=bounds, x_scale=spread).x)


def figures(shading: Shading, lamps: dict[str, Lamp]) -> dict[str, float]:
    """State the residual of the closed form."""
    found = np.stack([shading.background(lamps[c]) for c in CHANNELS])
    slopes = np.stack([shading.sensitivity(lamps[c]) for c in CHANNELS])
    print("background\n", np.round(found, 1), "\nsensitivity\n", np.round(slopes, 1))
    return {
        "background_rms_grey": float(np.sqrt(np.mean((UNITS - found) ** 2))),
        "units_apart_rms_grey": float(np.sqrt(np.mean((UNITS - UNITS.mean(axis=0)) ** 2))),
        "azimuth_error_deg": azimuth_error_deg(slopes),
        "sensitivity_error": float(np.abs(np.linalg.norm(slopes - SENSITIVITY, axis=1)).max()),
    }


def azimuth_error_deg(slopes: FloatArray) -> float:
    """Largest angle between found and published directions of light, (channel, 2)."""
    angles = [np.arctan2(-s[:, 1], s[:, 0]) for s in (slopes, SENSITIVITY)]
    turned = np.angle(np.exp(1j * (angles[0] - angles[1])))
    return float(np.degrees(np.abs(turned).max()))


def write(path: Path, lamps: dict[str, Lamp], residual: dict[str, float]) -> None:
    """Write the lamps with the origin of every number."""
    source = (
        "fitted by benchmarks/fit_lamps.py to the published background tables and slope"
        f" sensitivities of real units, residual {residual['background_rms_grey']:.1f} grey levels"
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
