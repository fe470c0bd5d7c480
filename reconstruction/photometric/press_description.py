"""Presses of a photometric sensor, described by a small TOML file next to their images.

    format = "photometric-press"
    version = 1
    image = "coin.png"                         # the press; or images = ["coin_*.png"]
    background = ["still_0.png", "still_1.png"]  # undeformed gel; optional with `calibration`
    calibration = "mini.npz"                   # existing file; or the table [calibrate]

    [calibrate]
    pitch_mm = 0.0634
    [[calibrate.balls]]
    diameter_mm = 6.31
    images = ["ball_00.png", "ball_01.png"]

    [frame]                                    # optional: crop and resize of camera frames
    crop_share = 0.15
    width_px = 320
    height_px = 240

    [options]                                  # optional, see PhotometricOptions
    integration = "corrected"

File names are relative to the folder of the description; `*` and `?` in them match any letters.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from reconstruction.capture.description import build, read_toml, table_of, take_header
from reconstruction.colour_maps import DEFAULT_MAP, map_named
from reconstruction.errors import CaptureError, InputError, require_integer, require_number
from reconstruction.photometric.calibration_ball import SampleOptions
from reconstruction.photometric.sensor import PhotometricOptions

Names = tuple[str, ...]

FORMAT, VERSION = "photometric-press", 1


@dataclass(frozen=True)
class Framing:
    """Crop and resize of camera frames; width and height 0 keep the size.

    Parameters
    ----------
    crop_share : part of width and height cut off at each side, 0 to 0.45
    width_px, height_px : size after the crop; both 0, or both given
    """

    crop_share: float = 0.0
    width_px: int = 0
    height_px: int = 0

    def __post_init__(self) -> None:
        require_number("crop_share", self.crop_share, 0.0, 0.45)
        require_integer("width_px", self.width_px, 0, 100_000)
        require_integer("height_px", self.height_px, 0, 100_000)
        if (self.width_px == 0) != (self.height_px == 0):
            raise InputError(
                f"width_px is {self.width_px} and height_px {self.height_px}; give both or neither"
            )


@dataclass(frozen=True)
class Balls:
    """Images of one reference ball."""

    diameter_mm: float
    images: Names

    def __post_init__(self) -> None:
        require_number("diameter_mm", self.diameter_mm, 0.0, open_low=True)
        object.__setattr__(self, "images", _names("images", self.images))


@dataclass(frozen=True)
class Calibrate:
    """Images and options of a calibration; see `calibrate_sensor`."""

    pitch_mm: float
    balls: tuple[Balls, ...]
    map: str = DEFAULT_MAP
    threshold_levels: float = 15.0
    smoothing_px: int = 3
    marker_level: int = 0

    def __post_init__(self) -> None:
        require_number("pitch_mm", self.pitch_mm, 0.0, open_low=True)
        _ = self.samples, map_named(self.map)

    @property
    def samples(self) -> SampleOptions:
        """Options of the sampling."""
        return SampleOptions(self.threshold_levels, self.smoothing_px, self.marker_level)


@dataclass(frozen=True)
class PressDescription:
    """Content of the file.

    Exactly one of `image` (a name) and `images` is given, and one of `calibration` (a file name)
    and `calibrate`. `images` contains the single name, too.
    """

    image: str = ""
    images: Names = ()
    background: Names = ()
    calibration: str = ""
    calibrate: Calibrate | None = None
    frame: Framing = Framing()
    options: PhotometricOptions = field(default_factory=PhotometricOptions)

    def __post_init__(self) -> None:
        if (self.image == "") == (self.images == ()):
            raise InputError("give either the key image (a name) or the key images (a list)")
        object.__setattr__(self, "images", _names("images", self.images or [self.image]))
        object.__setattr__(self, "background", _names("background", self.background, least=0))
        if (self.calibration == "") == (self.calibrate is None):
            raise InputError("give either the key calibration (a file) or the table [calibrate]")
        if self.calibrate is not None and not self.background:
            raise InputError("background is empty; [calibrate] needs images of the undeformed gel")


def read_press_description(path: Path | str) -> PressDescription:
    """Read the TOML file.

    Raises
    ------
    CaptureError : no TOML, wrong format or version, unknown or missing key, value out of range
    """
    path = Path(path)
    values = read_toml(path)
    try:
        take_header(values, (FORMAT, VERSION))
        parts: dict[str, Any] = {}
        if "calibrate" in values:
            parts["calibrate"] = _calibrate(table_of(values, "calibrate"))
        if "frame" in values:
            parts["frame"] = build(Framing, table_of(values, "frame"), "frame")
        if "options" in values:
            parts["options"] = build(PhotometricOptions, table_of(values, "options"), "options")
        return build(PressDescription, values | parts, path.name)
    except InputError as error:
        raise CaptureError(f"{path}: {error}") from error


def _calibrate(table: Mapping[str, Any]) -> Calibrate:
    given = table.get("balls")
    if not isinstance(given, list) or not given or not all(isinstance(b, dict) for b in given):
        raise CaptureError("[[calibrate.balls]] is missing; give a diameter_mm and its images")
    balls = tuple(build(Balls, ball, "calibrate.balls") for ball in given)
    return build(Calibrate, dict(table) | {"balls": balls}, "calibrate")


def _names(key: str, names: object, least: int = 1) -> Names:
    given = [names] if isinstance(names, str) else names
    is_list = isinstance(given, (list, tuple)) and len(given) >= least
    if not is_list or not all(isinstance(name, str) and name for name in given):  # type: ignore[attr-defined]
        raise InputError(f"{key} is {names!r}; give a list of file names")
    return tuple(given)  # type: ignore[arg-type]
