"""Displacement of the printed dots of a photometric sensor: from its images to mm on the gel.

The dots hide the gel, and their place in the image depends on the height of the gel below them: a
dot that is raised by h towards the camera appears at r D / (D - h) instead of r from the middle of
the image, where D is the distance of the camera from the gel. The measured height removes this.
"""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from reconstruction.arrays import BoolImage, FloatArray, FloatImage, IntArray, Levels
from reconstruction.errors import InputError, require_number
from reconstruction.markers import (
    DotPattern,
    DotTracks,
    MotionField,
    covered_pixels,
    find_pattern,
    linear_light,
    track,
)
from reconstruction.photometric.height_map import HeightMap
from reconstruction.photometric.press_doubts import untouched_drift_mm
from reconstruction.photometric.rest_surface import RestSurface

# Distance of neighbouring samples of the smooth field, px.
_EVERY = 4


@dataclass(frozen=True)
class DotOptions:
    """How printed dots are tracked, the table [dots] of a description of presses.

    Parameters
    ----------
    gamma : exponent of the camera's driver: levels are proportional to light ** (1 / gamma)
    view_distance_mm : apparent distance of the camera's pupil from the gel, which is the distance
        in air times the refractive index of the gel; 0: unknown, displacements are those that
        appear in the image
    sequence : the images are consecutive frames of one press: displacements may have any size, if
        they change by less than half the spacing of the dots from one frame to the next

    Raises
    ------
    InputError : a value is out of range
    """

    gamma: float = 1.0
    view_distance_mm: float = 0.0
    sequence: bool = False

    def __post_init__(self) -> None:
        if not isinstance(self.sequence, bool):
            raise InputError(f"sequence is {self.sequence!r}; give true or false")
        require_number("gamma", self.gamma, 0.3, 4.0)
        require_number("view_distance_mm", self.view_distance_mm, 0.0, 10_000.0)


@dataclass(frozen=True, eq=False)
class SensorDots:
    """Printed dots of a sensor, from the background without contact.

    Attributes
    ----------
    pattern : detected dots
    options : how images are read
    background : (row, col) bool, pixels that the dots of the background cover
    margin_px : distance from a dot at which smoothed colours contain its light
    """

    pattern: DotPattern
    options: DotOptions
    background: BoolImage
    margin_px: float

    @classmethod
    def of(cls, background: FloatImage, options: DotOptions, smoothing_px: int) -> "SensorDots":
        """Return the dots of a background (row, col, 3), levels.

        Parameters
        ----------
        smoothing_px : side of the square over which the decoder averages colours

        Raises
        ------
        FitError : the background has fewer than six similar dots
        """
        light, margin_px = linear_light(background, options.gamma), smoothing_px / 2.0
        pattern = find_pattern(light)
        return cls(pattern, options, covered_pixels(light, pattern, margin_px), margin_px)

    def covered(self, image: Levels) -> BoolImage:
        """Return the pixels that dots cover in the image of a press or in the background."""
        light = linear_light(image, self.options.gamma)
        return self.background | covered_pixels(light, self.pattern, self.margin_px)

    def tracked(
        self,
        image: Levels,
        height_map: HeightMap,
        untouched: BoolImage,
        previous: "GelMotion | None" = None,
    ) -> "GelMotion":
        """Return the displacements of the dots in the image of a press (row, col, 3).

        The standard uncertainty of the heights is the RMS height of undeformed gel.

        Parameters
        ----------
        untouched : (row, col) bool, pixels of undeformed gel
        previous : displacements in the frame before of a sequence; None: there is none
        """
        before = None if previous is None else previous.tracks
        tracks = track(self.pattern, linear_light(image, self.options.gamma), before)
        drift_mm = untouched_drift_mm(height_map, untouched) or 0.0
        return gel_motion(tracks, height_map, self.options.view_distance_mm, drift_mm)


@dataclass(frozen=True, eq=False)
class GelMotion:
    """Displacements of printed dots in the plane of the gel.

    Attributes
    ----------
    tracks : displacements in the image, with the status of each dot
    places_mm : (dot, xy) places without contact; x right, y up, from the middle of the image
    moved_mm : (dot, xy) displacements; 0 for a dot that is LOST
    sigma_mm : (dot, xy) standard uncertainties, from those of the centres and of the height
    pitch_mm : distance of neighbouring pixels on the gel
    shape : rows and columns of the images
    view_distance_mm : see `DotOptions`
    height_sigma_mm : standard uncertainty of the heights
    rest : undeformed coat of a domed gel; None: the gel is flat
    """

    tracks: DotTracks
    places_mm: FloatArray
    moved_mm: FloatArray
    sigma_mm: FloatArray
    pitch_mm: float
    shape: tuple[int, int]
    view_distance_mm: float = 0.0
    height_sigma_mm: float = 0.0
    rest: RestSurface | None = None

    def field(self) -> "GelMotionField":
        """Return the smooth field of the tracked dots at every fourth row and column.

        The error of the height changes over some spacings of the dots, as the height itself. Dots
        around a point share it, so their mean contains it in full: it is added to the sigma of the
        smooth field, in which errors of dots are independent.

        Raises
        ------
        FitError : fewer than six dots are tracked
        """
        tracked = self.tracks.tracked
        smooth = MotionField.of(
            self.places_mm[tracked], self.moved_mm[tracked], self.sigma_mm[tracked]
        )
        rows, cols = (np.arange(_EVERY // 2, size, _EVERY) for size in self.shape)
        grid = np.stack(np.meshgrid(rows, cols, indexing="ij"), axis=-1)
        places = grid.reshape(-1, 2).astype(np.float64)
        on_gel = _on_gel_mm(places, self.shape, self.pitch_mm)
        if self.rest is not None:
            on_gel = _interpolated(self.rest.points_mm[..., :2], places)
        moved, sigma = smooth.at(on_gel)
        shared = _per_height(places, on_gel, self.view_distance_mm, self.rest)
        sigma = np.hypot(sigma, self.height_sigma_mm * shared)
        arrays = (of.reshape(rows.size, cols.size, 2) for of in (on_gel, moved, sigma))
        return GelMotionField(rows, cols, *arrays)


@dataclass(frozen=True, eq=False)
class GelMotionField:
    """Displacement field on a grid of pixels, with standard uncertainties.

    Attributes
    ----------
    rows, cols : image rows and columns of the grid
    places_mm : (row, col, xy) places without contact
    moved_mm, sigma_mm : (row, col, xy) displacement and its standard uncertainty
    """

    rows: IntArray
    cols: IntArray
    places_mm: FloatArray
    moved_mm: FloatArray
    sigma_mm: FloatArray


def gel_motion(
    tracks: DotTracks,
    height_map: HeightMap,
    view_distance_mm: float,
    height_sigma_mm: float = 0.0,
) -> GelMotion:
    """Return the displacements in mm on the gel; on a dome, along x and y of the imaged points.

    Parameters
    ----------
    view_distance_mm : see `DotOptions`; the lines of sight of a dome replace it
    height_sigma_mm : standard uncertainty of the heights; it has no effect on the displacements
        that appear in the image, without `view_distance_mm`
    """
    pitch_mm, shape = height_map.pitch_mm, height_map.height_mm.shape
    before, after = tracks.places_px, tracks.places_px + tracks.moved_px
    if height_map.rest is not None:
        imaged = height_map.rest.points_at(height_map.height_mm)[..., :2]
        places_mm = _interpolated(height_map.rest.points_mm[..., :2], before)
        moved = _interpolated(imaged, after) - places_mm
    else:
        nearer = np.zeros((len(before), 1))
        places_mm = _on_gel_mm(before, shape, pitch_mm)
        if view_distance_mm:
            nearer = _interpolated(height_map.height_mm[..., None], after) / view_distance_mm
        moved = _on_gel_mm(after, shape, pitch_mm) * (1.0 - nearer) - places_mm
    per_height = _per_height(after, places_mm, view_distance_mm, height_map.rest)
    sigma_mm = np.hypot(pitch_mm * tracks.sigma_px[:, ::-1], height_sigma_mm * per_height)
    lost = tracks.sigma_px[:, 0] == 0.0
    moved[lost] = sigma_mm[lost] = 0.0
    rows, cols = shape
    return GelMotion(
        tracks,
        places_mm,
        moved,
        sigma_mm,
        pitch_mm,
        (rows, cols),
        view_distance_mm,
        height_sigma_mm,
        height_map.rest,
    )


def _per_height(
    places_px: FloatArray,
    on_gel_mm: FloatArray,
    view_distance_mm: float,
    rest: RestSurface | None,
) -> FloatArray:
    """Return the error of displacements along x and y (n, 2) per error of the height.

    Parameters
    ----------
    places_px, on_gel_mm : (n, 2), row and column, and x and y, of the same points
    """
    if rest is not None:
        down, right = (_interpolated(part[..., None], places_px)[:, 0] for part in rest.sight)
        return np.column_stack([right, down])
    if not view_distance_mm:
        return np.zeros_like(on_gel_mm)
    return on_gel_mm / view_distance_mm


def _interpolated(image: FloatArray | FloatImage, places_px: FloatArray) -> FloatArray:
    """Return the channels (n, channel) of an image (row, col, channel) at places (n, 2)."""
    channels = np.moveaxis(image.astype(np.float64), -1, 0)
    values = [
        ndimage.map_coordinates(channel, places_px.T, order=1, mode="nearest")
        for channel in channels
    ]
    return np.stack(values, axis=-1)


def _on_gel_mm(places_px: FloatArray, shape: tuple[int, ...], pitch_mm: float) -> FloatArray:
    """Return x and y, mm, of places (n, 2) row and col: the frame of `HeightMap.points_mm`."""
    rows, cols = shape
    x, y = places_px[:, 1] - 0.5 * (cols - 1), 0.5 * (rows - 1) - places_px[:, 0]
    return pitch_mm * np.column_stack([x, y])
