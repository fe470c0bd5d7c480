"""Read the TOML file next to the images of a photometric sensor that describes the presses.

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
    [calibrate.dome]                           # optional, for a domed gel: Dome
    radius_mm = 40.0

    [frame]                                    # optional: crop and resize of camera frames
    crop_share = 0.15
    width_px = 320
    height_px = 240

    [dots]                                     # optional, for a gel with printed dots: DotOptions
    gamma = 1.4

    [options]                                  # optional, see PhotometricOptions
    integration = "corrected"

File names are relative to the folder of the description. In a file name `*` matches any characters,
`?` any single one.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from reconstruction.capture.description import build, read_toml, table_of, take_header
from reconstruction.colour_maps import DEFAULT_MAP, map_named
from reconstruction.errors import CaptureError, InputError, require_integer, require_number
from reconstruction.photometric.calibration_ball import SampleOptions
from reconstruction.photometric.printed_dots import DotOptions
from reconstruction.photometric.rest_surface import RestSurface
from reconstruction.photometric.sensor import PhotometricOptions

Names = tuple[str, ...]

FORMAT, VERSION = "photometric-press", 1


@dataclass(frozen=True)
class Framing:
    """How camera frames are cropped and then resized.

    Parameters
    ----------
    crop_share : share of width and height that is cut off at each side, 0 to 0.45
    width_px, height_px : size to which the cropped frame is resized; both 0: it is not resized
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
    """Names of the calibration images of one reference ball, and its diameter."""

    diameter_mm: float
    images: Names

    def __post_init__(self) -> None:
        require_number("diameter_mm", self.diameter_mm, 0.0, open_low=True)
        object.__setattr__(self, "images", _names("images", self.images))


@dataclass(frozen=True)
class Dome:
    """Undeformed coat of a domed gel, the table [calibrate.dome]: a sphere about the middle.

    Parameters
    ----------
    radius_mm : radius of the coat
    view_distance_mm : distance of the camera's pupil from the apex in air, times the refractive
        index of the gel; 0: the lines of sight are parallel
    """

    radius_mm: float
    view_distance_mm: float = 0.0

    def __post_init__(self) -> None:
        require_number("radius_mm", self.radius_mm, 0.0, open_low=True)
        require_number("view_distance_mm", self.view_distance_mm, 0.0, 10_000.0)


@dataclass(frozen=True)
class Calibrate:
    """Images and options of a calibration, the table [calibrate] of the file.

    The options are those of `calibrate_sensor` and `SampleOptions`; `map` is the kind.
    """

    pitch_mm: float
    balls: tuple[Balls, ...]
    map: str = DEFAULT_MAP
    threshold_levels: float = 15.0
    smoothing_px: int = 3
    marker_level: int = 0
    dome: Dome | None = None

    def __post_init__(self) -> None:
        require_number("pitch_mm", self.pitch_mm, 0.0, open_low=True)
        _ = self.samples, map_named(self.map)

    @property
    def samples(self) -> SampleOptions:
        """Options for collecting samples from the calibration images."""
        return SampleOptions(self.threshold_levels, self.smoothing_px, self.marker_level)

    def rest(self, shape: tuple[int, int]) -> RestSurface | None:
        """Return the undeformed coat of images with these rows and columns; None: it is flat.

        Raises
        ------
        InputError : the dome does not fill the image
        """
        if self.dome is None:
            return None
        dome = self.dome
        return RestSurface.of_sphere(shape, self.pitch_mm, dome.radius_mm, dome.view_distance_mm)


@dataclass(frozen=True)
class PressDescription:
    """Content of a description of presses, see the module docstring.

    The file has exactly one of the keys `image` (a file name) and `images` (a list of names), and
    exactly one of `calibration` (a file name) and `calibrate` (a table). After construction
    `images` also contains the single name of `image`. With the table `dots`, the printed dots are
    masked and tracked.
    """

    image: str = ""
    images: Names = ()
    background: Names = ()
    calibration: str = ""
    calibrate: Calibrate | None = None
    frame: Framing = Framing()
    dots: DotOptions | None = None
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
    """Return the description of presses in a TOML file.

    Raises
    ------
    CaptureError : the file is no TOML or has a wrong format or version, a key is unknown or
        missing, or a value is out of range
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
        if "dots" in values:
            parts["dots"] = build(DotOptions, table_of(values, "dots"), "dots")
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
    parts: dict[str, Any] = {"balls": balls}
    if "dome" in table:
        parts["dome"] = build(Dome, table_of(table, "dome"), "calibrate.dome")
    return build(Calibrate, dict(table) | parts, "calibrate")


def _names(key: str, names: object, least: int = 1) -> Names:
    given = [names] if isinstance(names, str) else names
    is_list = isinstance(given, (list, tuple)) and len(given) >= least
    if not is_list or not all(isinstance(name, str) and name for name in given):  # type: ignore[attr-defined]
        raise InputError(f"{key} is {names!r}; give a list of file names")
    return tuple(given)  # type: ignore[arg-type]
