"""The coat's texture: airbrush grain and flakes as random heights that the sheet carries along.

Z(X, Y) is white noise on a lattice, blurred and seen through cubic B-splines: smooth (C2), standard
normal, stationary, with the autocorrelation exp(-(lag / L0)^2), and the same wherever and however
densely it is asked for. Heights follow from Z by a distribution of `johnson`; L0 is chosen so that
the autocorrelation of the heights themselves falls to 1/e at the wanted length.

The displacement of the coated face in its own plane carries the texture. Never move the nodes of
the relief by it. Linear contact is solved at fixed world positions: the height found over (x, y) is
the face's height there, wherever its material came from. Moving the nodes sideways as well makes
the shape four times worse against large strain, 49 instead of 12 um for a ball of 4 mm pressed 1 mm
into a 4 mm layer (measured on our prototype).
"""

from dataclasses import dataclass, replace
from math import ceil, exp, floor

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from reconstruction.arrays import FloatArray
from twin.config.digest import keyed_sequence
from twin.config.models import Elastomer, Press, Texture
from twin.mechanics.johnson import Johnson, johnson_of
from twin.mechanics.layer import BondedLayer, FreeSlab
from twin.mechanics.layouts import layer_on, preload_of
from twin.mechanics.press import PressedElastomer
from twin.mechanics.refine import touched_at_nodes, wrapped
from twin.mechanics.relief import face_normals

Extent = tuple[float, float, float, float]

# Lattice cells per L0: between the lattice's points the variance of Z is 3e-4 below 1 at most.
_CELLS_PER_LENGTH = 4
# Of Z's kernel, whose standard deviation is L0 / 2; of a cubic B-spline, which is its last part.
_KERNEL_VARIANCE = (_CELLS_PER_LENGTH / 2) ** 2
_SPLINE_VARIANCE = 1 / 3
_SPLINE_AT_POINTS = np.array([1.0, 4.0, 1.0]) / 6
# Taps on either side, 6 standard deviations.
_REACH = 12
# Whole nanometres: the modulus alone moves the last digits, and equal faces are rendered once.
_DISPLACEMENT_DECIMALS = 6


@dataclass(frozen=True, eq=False)
class Field:
    """The texture of one coat, see `texture_field`."""

    rms_mm: float
    distribution: Johnson
    #: of the lattice, of which a point lies at the material point (0, 0)
    pitch_mm: float
    #: row and column of coefficients[0, 0], counted from that point
    first: tuple[int, int]
    #: (row, col) B-spline coefficients of Z
    coefficients: FloatArray

    def height_mm(self, X_mm: FloatArray, Y_mm: FloatArray) -> FloatArray:
        """Return the height of the coat over the smooth face, along its normal.

        Parameters
        ----------
        X_mm, Y_mm : (...) float, mm; material coordinates: where in the world the points lie while
            the elastomer is flat and untouched. Within the field's extent.

        Returns
        -------
        (...) float, mm; positive along the normal that points to +z

        Raises
        ------
        ValueError : a point lies outside the extent
        """
        cells = [
            np.asarray(along) / self.pitch_mm - first
            for along, first in zip((Y_mm, X_mm), self.first, strict=True)
        ]
        for along, count in zip(cells, self.coefficients.shape, strict=True):
            if along.min() < 1 or along.max() > count - 2:
                raise ValueError("texture: a material point lies outside the field's extent")
        normal: FloatArray = ndimage.map_coordinates(
            self.coefficients, cells, order=3, prefilter=False
        )
        return self.rms_mm * self.distribution.of_normal(normal)


def texture_field(texture: Texture, seed: int, extent_mm: Extent) -> Field:
    """Draw the texture of one coat.

    Parameters
    ----------
    seed : root seed of the experiment: one seed, one coat
    extent_mm : (x_low, x_high, y_low, y_high) float, mm; material coordinates that will be asked
        for. But for rounding, heights do not depend on it.
    """
    distribution = johnson_of(texture.skewness, texture.excess_kurtosis)
    at_length = distribution.correlation_of_normals(exp(-1))
    pitch_mm = texture.correlation_mm / np.sqrt(-np.log(at_length)) / _CELLS_PER_LENGTH
    cols, rows = (_lattice(*ends, pitch_mm) for ends in (extent_mm[:2], extent_mm[2:]))
    blurred = _white_noise(seed, rows, cols)
    for axis in (0, 1):
        blurred = ndimage.convolve1d(blurred, _taps(), axis=axis)
    return Field(
        rms_mm=1e-3 * texture.rms_um,
        distribution=distribution,
        pitch_mm=float(pitch_mm),
        first=(int(rows[_REACH]), int(cols[_REACH])),
        coefficients=blurred[_REACH:-_REACH, _REACH:-_REACH].copy(),
    )


def textured(
    pressed: PressedElastomer, elastomer: Elastomer, load: Press, texture: Texture, seed: int
) -> PressedElastomer:
    """Lay the coat's texture on a smooth pressed face; contact, pressure and force stay.

    Returns
    -------
    With the textured `face_z_mm`, and `texture_mm`, which is what was added to it

    Notes
    -----
    z grows by the height times sqrt(1 + slope^2) of the smooth face: first order in the height over
    the face's radius of curvature. The material point at a node is the node less its displacement
    in the plane, which the spectral model and the sheet know; under the others the texture is
    not stretched.
    """
    X_mm, Y_mm = _material_points(pressed, elastomer, load)
    extent = (float(X_mm.min()), float(X_mm.max()), float(Y_mm.min()), float(Y_mm.max()))
    height_mm = texture_field(texture, seed, extent).height_mm(X_mm, Y_mm)
    added = height_mm / face_normals(pressed)[..., 2]
    return replace(pressed, face_z_mm=pressed.face_z_mm + added, texture_mm=added)


def texture_figures(pressed: PressedElastomer) -> dict[str, float]:
    """Measure the texture on a face: its RMS, and the lag at which its autocorrelation is 1/e.

    Returns
    -------
    Empty for a smooth coat. The lag is the mean of those along x and y, in plan, over the face
    """
    if pressed.texture_mm is None:
        return {}
    smooth = replace(pressed, face_z_mm=pressed.face_z_mm - pressed.texture_mm)
    height_mm = pressed.texture_mm * face_normals(smooth)[..., 2]
    lags_mm = [
        _correlation_lag(height_mm) * (pressed.face_x_mm[1] - pressed.face_x_mm[0]),
        _correlation_lag(height_mm.T) * (pressed.face_y_mm[1] - pressed.face_y_mm[0]),
    ]
    return {
        "texture_rms_um": 1e3 * float(height_mm.std()),
        "texture_correlation_mm": float(np.mean(lags_mm)),
    }


def _material_points(
    pressed: PressedElastomer, elastomer: Elastomer, load: Press
) -> tuple[FloatArray, FloatArray]:
    X_mm, Y_mm = np.meshgrid(pressed.face_x_mm, pressed.face_y_mm)
    if pressed.sheet is not None:
        return pressed.sheet.material_x_mm, pressed.sheet.material_y_mm
    if pressed.model != "spectral":
        return X_mm, Y_mm
    u_x, u_y = in_plane_displacement(pressed, elastomer, load)
    decimals = _DISPLACEMENT_DECIMALS
    return X_mm - u_x.round(decimals), Y_mm - u_y.round(decimals)


def _lattice(low_mm: float, high_mm: float, pitch_mm: float) -> npt.NDArray[np.int64]:
    """Return the lattice's numbers along one axis, with what splines and blur need beyond."""
    margin = 2 + _REACH
    first, last = floor(low_mm / pitch_mm) - margin, ceil(high_mm / pitch_mm) + margin
    return np.arange(first, last + 1)


def _white_noise(seed: int, rows: npt.NDArray[np.int64], cols: npt.NDArray[np.int64]) -> FloatArray:
    """Draw standard normal numbers (row, col): one stream per row, from the middle outwards.

    So the number at a lattice point depends on seed, row and column alone.
    """
    streams, places = _outwards(rows), _outwards(cols)
    count = int(places.max()) + 1
    noise = np.zeros((rows.size, cols.size))
    for row, stream in enumerate(streams.tolist()):
        rng = np.random.default_rng(keyed_sequence(seed, "texture", stream))
        noise[row] = rng.standard_normal(count)[places]
    return noise


def _outwards(numbers: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    """Give 0, -1, 1, -2, 2, ... the numbers 0, 1, 2, 3, 4, ...; none is negative."""
    return np.where(numbers >= 0, 2 * numbers, -2 * numbers - 1)


def _taps() -> FloatArray:
    """Return the blur that, seen through the B-spline, gives Z the variance 1."""
    offsets = np.arange(-_REACH, _REACH + 1)
    taps = np.exp(-(offsets**2) / (2 * (_KERNEL_VARIANCE - _SPLINE_VARIANCE)))
    kernel = np.convolve(taps, _SPLINE_AT_POINTS)
    return np.asarray(taps / np.sqrt(np.sum(kernel**2)))


def _correlation_lag(heights: FloatArray) -> float:
    """Return the lag along x, in nodes, at which the autocorrelation falls to 1/e."""
    deviation = heights - heights.mean()
    variance, wanted, before = float(np.mean(deviation**2)), exp(-1), 1.0
    for lag in range(1, heights.shape[1]):
        here = float(np.mean(deviation[:, lag:] * deviation[:, :-lag])) / variance
        if here <= wanted:
            return lag - (wanted - here) / (before - here)
        before = here
    return float(heights.shape[1])


def in_plane_displacement(
    pressed: PressedElastomer, elastomer: Elastomer, load: Press
) -> tuple[FloatArray, FloatArray]:
    """Return how far the coat's material moves sideways under contact, back pressure and weight.

    Parameters
    ----------
    pressed : a press of the spectral model

    Returns
    -------
    u_x, u_y : (row, col) float, mm
        At the nodes of the coated face, along world x and y. For texture and markers only.
    """
    layer = layer_on(elastomer, pressed.x_mm, pressed.y_mm, pressed.young_modulus_kpa)
    pressure = pressed.pressure_kpa / pressed.young_modulus_kpa
    if isinstance(layer, FreeSlab):
        preload = preload_of(elastomer, load, pressed.young_modulus_kpa)
        rows, cols = pressed.face_y_mm.size - 1, pressed.face_x_mm.size - 1
        loaded = pressure + preload.touched
        return layer.opposite_in_plane_at_nodes(loaded, rows, cols, preload.coated)
    return _bonded(layer, pressure, pressed)


def _bonded(
    layer: BondedLayer, pressure: FloatArray, pressed: PressedElastomer
) -> tuple[FloatArray, FloatArray]:
    nodes = pressed.face_y_mm, pressed.face_x_mm
    free = np.full((nodes[0].size, nodes[1].size), -np.inf)
    u_x, u_y = (
        touched_at_nodes(*wrapped(u, (layer.y_mm, layer.x_mm)), nodes, free)
        for u in layer.in_plane(pressure)
    )
    return u_x, u_y
