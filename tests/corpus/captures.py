"""Folders of images as other programs write captures: seeded, with known patterns and coordinates.

The camera looks at a bump in front of a projector of 320 x 240 px. Each set has its own code,
names, order of files, part of the image that is lit, noise, and faults.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import imageio.v3 as imageio
import numpy as np

from reconstruction.arrays import FloatArray, Levels
from reconstruction.patterns import Axis, PatternSet

SIZE = {"width_px": 320, "height_px": 240}
CAMERA = 120, 160
"""Rows and columns of the camera."""
WORDS: dict[str, Any] = {"steps": 0, "period_px": 4}
CODES: dict[str, dict[str, Any]] = {
    "gray": {**WORDS, "code": "gray"},
    "gray and inverse": {**WORDS, "code": "gray", "inverse": True},
    "binary": {**WORDS, "code": "gray", "word": "binary"},
    "3 steps, gray": {"steps": 3, "period_px": 32, "code": "gray"},
    "4 steps, half-period gray": {"steps": 4, "period_px": 32, "code": "complementary_gray"},
    "8 steps, gray": {"steps": 8, "period_px": 20, "code": "gray"},
    "4 steps of one fringe": {
        "steps": 4, "period_px": 20, "code": "hierarchical", "further_periods_px": (80, 320),
    },
}  # fmt: skip
RELATIVE = "5 steps of one period"
"""Code of sets whose fringe orders are relative; no seed selects it."""
_ALL_CODES = {**CODES, RELATIVE: {"steps": 5, "period_px": 40, "code": "spatial"}}
NEEDS_UNIFORM = "gray", "binary"
NAMES = "numbered", "padded", "time stamps", "no order"
FORMATS = "png", "bmp", "jpg"


@dataclass(frozen=True)
class CapturedSet:
    """A folder of images, with the patterns and the coordinates that the camera observes.

    Parameters
    ----------
    folder : folder of the images
    patterns : patterns of the images
    names : file names in the order of `patterns.frames`
    coordinates_px : projector coordinate (row, col) of each axis of the patterns
    lit : (row, col) bool, pixels on the object
    fault : "" or the reason why no description can be complete: "a frame is missing"
    text : the drawn properties, for messages
    """

    folder: Path
    patterns: PatternSet
    names: tuple[str, ...]
    coordinates_px: dict[Axis, FloatArray]
    lit: np.ndarray[Any, np.dtype[np.bool_]]
    fault: str
    text: str


def write_captured_set(folder: Path, seed: int, code: str = "") -> CapturedSet:
    """Draw a set by its seed, and write its images into a new folder.

    Parameters
    ----------
    code : a code of `CODES`, or `RELATIVE`; empty: a code of `CODES` by the seed
    """
    rng = np.random.default_rng(seed)
    code = code or list(CODES)[seed % len(CODES)]
    naming = str(rng.choice(NAMES, p=[0.35, 0.35, 0.2, 0.1]))
    axes: tuple[Axis, ...] = (("column",), ("row",), ("column", "row"))[rng.integers(3)]
    of_code = _ALL_CODES[code]
    further = {"row_periods_px": (15, 60, 240)} if "further_periods_px" in of_code else {}
    uniform = bool(rng.random() < 0.7) or code in NEEDS_UNIFORM
    patterns = PatternSet(**SIZE, **of_code, **further, axes=axes, uniform=uniform)
    coordinates_px, lit = _surface(rng, is_small=bool(rng.random() < 0.25))
    noise_dn, suffix = float(rng.uniform(0.5, 3.0)), str(rng.choice(FORMATS, p=[0.6, 0.25, 0.15]))
    missing = int(rng.integers(len(patterns.frames))) if rng.random() < 0.1 else -1
    names = _names(naming, len(patterns.frames), suffix, rng)
    folder.mkdir()
    images = _images(patterns, coordinates_px, lit, noise_dn, rng)
    for number, (name, image) in enumerate(zip(names, images, strict=True)):
        if number != missing:
            imageio.imwrite(folder / name, image, **({"quality": 95} if suffix == "jpg" else {}))
    text = f"seed {seed}: {code}, {'+'.join(axes)}, {naming}, {suffix}, noise {noise_dn:.1f} DN"
    text += f", lit {lit.mean():.0%}" + (f", without frame {missing}" if missing >= 0 else "")
    fault = "a frame is missing" if missing >= 0 else ""
    return CapturedSet(folder, patterns, names, coordinates_px, lit, fault, text)


def _surface(
    rng: np.random.Generator, *, is_small: bool
) -> tuple[dict[Axis, FloatArray], np.ndarray[Any, np.dtype[np.bool_]]]:
    """Return the coordinates of the camera's pixels, and the lit pixels."""
    row, col = np.mgrid[0 : CAMERA[0], 0 : CAMERA[1]] / np.array(CAMERA).reshape(2, 1, 1)
    bump = np.exp(-(((row - 0.5) / 0.3) ** 2) - ((col - rng.uniform(0.4, 0.6)) / 0.3) ** 2)
    left, wide = rng.uniform(0.02, 0.15), rng.uniform(0.7, 0.8)
    column_px = SIZE["width_px"] * (left + wide * col + rng.uniform(-0.05, 0.05) * bump)
    row_px = SIZE["height_px"] * (left + wide * row + 0.01 * col)
    radius = 0.23 if is_small else 0.6
    lit = (row - 0.5) ** 2 + (col - 0.5) ** 2 < radius**2
    return {"column": column_px, "row": row_px}, lit


def _images(
    patterns: PatternSet,
    coordinates_px: dict[Axis, FloatArray],
    lit: np.ndarray[Any, np.dtype[np.bool_]],
    noise_dn: float,
    rng: np.random.Generator,
) -> Iterator[Levels]:
    row, col = np.mgrid[0 : CAMERA[0], 0 : CAMERA[1]] / CAMERA[1]
    coat = lit * (0.45 + 0.55 * np.cos(2.0 * (col - 0.4)) ** 2 * np.cos(row) ** 2)
    for frame in patterns.frames:
        image = patterns.image(frame).astype(np.float64)
        light = _sampled(image, coordinates_px["row"], coordinates_px["column"])
        dn = 10.0 + 190.0 * coat * light / 255.0 + rng.normal(0.0, noise_dn, coat.shape)
        yield np.clip(np.rint(dn), 0, 255).astype(np.uint8)


def _sampled(image: FloatArray, row_px: FloatArray, column_px: FloatArray) -> FloatArray:
    """Interpolate a pattern bilinearly: a camera pixel is as wide as a projector pixel."""
    top, left = np.floor(row_px).astype(int), np.floor(column_px).astype(int)
    down, right = row_px - top, column_px - left
    rows = [np.clip(top + k, 0, image.shape[0] - 1) for k in (0, 1)]
    cols = [np.clip(left + k, 0, image.shape[1] - 1) for k in (0, 1)]
    upper = (1 - right) * image[rows[0], cols[0]] + right * image[rows[0], cols[1]]
    lower = (1 - right) * image[rows[1], cols[0]] + right * image[rows[1], cols[1]]
    return np.asarray((1 - down) * upper + down * lower)


def _names(naming: str, count: int, suffix: str, rng: np.random.Generator) -> tuple[str, ...]:
    if naming == "no order":
        order = rng.permutation(count)
        return tuple(f"scan_{chr(97 + k // 26)}{chr(97 + k % 26)}.{suffix}" for k in order)
    if naming == "time stamps":
        seconds = np.cumsum(rng.integers(1, 3, count)) + 3600 * 9 + 60 * 12
        return tuple(
            f"IMG_20261127_{s // 3600:02d}{s // 60 % 60:02d}{s % 60:02d}.{suffix}" for s in seconds
        )
    first = int(rng.integers(2))
    pattern = "{}.{}" if naming == "numbered" else "frame_{:03d}.{}"
    return tuple(pattern.format(first + k, suffix) for k in range(count))
