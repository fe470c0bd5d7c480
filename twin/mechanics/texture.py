"""Texture of the coat: random heights of airbrush grain and flakes that move with the elastomer.

Z(X, Y) is a random field over the material coordinates X and Y. It is white noise on a lattice,
blurred and interpolated by cubic B-splines: smooth (C2), standard normal and stationary, with the
autocorrelation exp(-(lag / L0)^2). Its value at a point does not depend on the other points that
are evaluated. Heights follow from Z by a `Johnson` distribution. L0 is chosen so that the
autocorrelation of the heights, not of Z, is 1/e at the specified length.

The displacement of the coated face in its own plane moves the texture. Never move the nodes of the
relief by this displacement. Linear contact is solved at fixed world positions: the solved height at
(x, y) is the height of the face there, wherever its material was before the press. If the nodes
were moved sideways as well, the error against a large-strain solution would increase from 12 to
49 um, for a ball of 4 mm pressed 1 mm into a 4 mm layer (measured on our prototype).

The distribution belongs to Johnson's unbounded system, which has any skewness, and for each
skewness any kurtosis above that of the log-normal distribution. X = (sinh(a Z + b) - mean) / spread
is a monotone function of a standard normal Z and has mean 0 and variance 1 (Johnson, Biometrika 36,
149 (1949); on rough surfaces Hu and Tonder, Int. J. Machine Tools and Manufacture 32, 83 (1992)).
With w = exp(a^2) all moments are closed forms,

    mean = w^(1/2) sinh b,  spread^2 = (w - 1) (w cosh 2b + 1) / 2,

and so is the correlation of two X if their Z have the correlation r:

    ((w^(1 + r) cosh 2b - w^(1 - r)) / 2 - mean^2) / spread^2
"""

from dataclasses import dataclass, replace
from functools import lru_cache
from math import ceil, exp, floor

import numpy as np
from scipy import ndimage
from scipy.optimize import brentq

from reconstruction.arrays import FloatArray, IntArray
from twin.config.digest import keyed_sequence
from twin.config.models import Elastomer, Press, Texture
from twin.mechanics.layer import BondedLayer, FreeSlab
from twin.mechanics.layouts import layer_on, preload_of, touched_at_nodes, wrapped
from twin.mechanics.models import model_of
from twin.mechanics.press import PressedElastomer
from twin.mechanics.relief import face_normals
from twin.mechanics.shear import InPlane, ShearedLayer

Extent = tuple[float, float, float, float]
Stream = tuple[str, int]
"""Name of a random quantity, and its seed."""

# Lattice cells per L0: between the lattice's points the variance of Z is 3e-4 below 1 at most.
_CELLS_PER_LENGTH = 4
# Variances, cells^2: of Z's kernel (standard deviation L0 / 2), and of a cubic B-spline, its part.
_KERNEL_VARIANCE = (_CELLS_PER_LENGTH / 2) ** 2
_SPLINE_VARIANCE = 1 / 3
_SPLINE_AT_POINTS = np.array([1.0, 4.0, 1.0]) / 6
# Taps of the blur on either side: 6 standard deviations.
_REACH = 12
# Displacements are rounded to whole nanometres: another modulus changes only later digits, and
# faces that are equal after rounding are rendered once.
_DISPLACEMENT_DECIMALS = 6


# Relative distance from the bracket's ends, where cosh 2b is infinite, or less than 1 by rounding.
_OFF_END = 1e-9


@dataclass(frozen=True)
class Johnson:
    """Distribution of Johnson's unbounded system with mean 0 and variance 1; a = 0: normal."""

    a: float = 0.0
    b: float = 0.0

    def of_normal(self, normal: FloatArray) -> FloatArray:
        """Transform standard normal numbers (...) to numbers of this distribution."""
        if self.a == 0.0:
            return normal
        return np.asarray((np.sinh(self.a * normal + self.b) - self._mean) / self._spread)

    def correlation(self, of_normals: float) -> float:
        """Return the correlation of two numbers of this distribution.

        `of_normals` is the correlation of the two normal numbers that are transformed to them.
        """
        if self.a == 0.0:
            return of_normals
        w = self._w
        product = (w ** (1 + of_normals) * np.cosh(2 * self.b) - w ** (1 - of_normals)) / 2
        return float((product - self._mean**2) / self._spread**2)

    def correlation_of_normals(self, target: float) -> float:
        """Return the correlation of normal numbers for which `correlation` returns `target`."""
        return float(brentq(lambda r: self.correlation(r) - target, 0.0, 1.0, xtol=1e-14))

    @property
    def _w(self) -> float:
        return float(np.exp(self.a**2))

    @property
    def _mean(self) -> float:
        return float(np.exp(self.a**2 / 2) * np.sinh(self.b))

    @property
    def _spread(self) -> float:
        w = self._w
        return float(np.sqrt((w - 1) * (w * np.cosh(2 * self.b) + 1) / 2))


_NORMAL = Johnson()


def johnson_of(skewness: float, excess_kurtosis: float) -> Johnson:
    """Return the distribution with the given third and fourth standardised moments.

    Parameters
    ----------
    skewness, excess_kurtosis : both 0, or a kurtosis above that of the log-normal distribution of
        this skewness

    Notes
    -----
    For a given w the kurtosis is a quadratic equation in cosh 2b; its root gives a skewness. As w
    increases from that of the log-normal to that of the symmetric distribution, this skewness
    decreases to 0: w is the only root in this bracket (after Tuenter, Journal of Statistical
    Computation and Simulation 70, 325 (2001)).
    """
    if excess_kurtosis == 0.0:
        return Johnson()
    kurtosis = excess_kurtosis + 3
    symmetric_w = np.sqrt(np.sqrt(2 * kurtosis - 2) - 1)
    if skewness == 0.0:
        return Johnson(a=float(np.sqrt(np.log(symmetric_w))))
    # The log-normal distribution of that kurtosis is the limit of large b.
    log_normal_w = brentq(lambda w: _log_normal_kurtosis(w) - kurtosis, 1.0, kurtosis, xtol=1e-14)
    w = brentq(
        lambda w: _skewness(w, _cosh_2b(w, kurtosis)) - abs(skewness),
        log_normal_w * (1 + _OFF_END),
        symmetric_w * (1 + _OFF_END),
        xtol=1e-14,
    )
    b = np.arccosh(_cosh_2b(w, kurtosis)) / 2
    return Johnson(a=float(np.sqrt(np.log(w))), b=float(np.copysign(b, skewness)))


def _log_normal_kurtosis(w: float) -> float:
    return w**4 + 2 * w**3 + 3 * w**2 - 3


def _cosh_2b(w: float, kurtosis: float) -> float:
    """Return cosh 2b at which the distribution of a given w has the given kurtosis."""
    longest = _log_normal_kurtosis(w)
    square = 2 * w**2 * (longest - kurtosis)
    half = 2 * w * (w * (w + 2) - kurtosis)
    rest = 3 * (2 * w + 1) - w**2 * longest - 2 * kurtosis
    return max(1.0, float((np.sqrt(half**2 - square * rest) - half) / square))


def _skewness(w: float, cosh_2b: float) -> float:
    b = np.arccosh(cosh_2b) / 2
    third = np.sqrt(w) * (w - 1) ** 2 * (w * (w + 2) * np.sinh(3 * b) + 3 * np.sinh(b)) / 4
    return float(third / ((w - 1) * (w * cosh_2b + 1) / 2) ** 1.5)


@dataclass(frozen=True, eq=False)
class Field:
    """Texture of one coat as a function of the material coordinates, made by `texture_field`."""

    rms_mm: float
    distribution: Johnson
    #: pitch of the lattice; its point in row 0 and column 0 is the material point (0, 0)
    pitch_mm: float
    #: row and column of the lattice at which coefficients[0, 0] is
    first: tuple[int, int]
    #: (row, col) B-spline coefficients of Z
    coefficients: FloatArray

    def height_mm(self, X_mm: FloatArray, Y_mm: FloatArray) -> FloatArray:
        """Return the height of the coat over the smooth face, along its normal.

        Parameters
        ----------
        X_mm, Y_mm : (...) float, mm; material coordinates: world positions of the points in the
            flat, unloaded elastomer. They must be within the field's extent.

        Returns
        -------
        (...) float, mm; positive along the normal that points to +z

        Raises
        ------
        ValueError : a point is outside the extent
        """
        cells = [
            np.asarray(along) / self.pitch_mm - first
            for along, first in zip((Y_mm, X_mm), self.first, strict=True)
        ]
        for along, count in zip(cells, self.coefficients.shape, strict=True):
            if along.min() < 1 or along.max() > count - 2:
                raise ValueError("texture: a material point is outside the field's extent")
        normal: FloatArray = ndimage.map_coordinates(
            self.coefficients, cells, order=3, prefilter=False
        )
        return self.rms_mm * self.distribution.of_normal(normal)


def texture_field(texture: Texture, seed: int, extent_mm: Extent) -> Field:
    """Return the random texture of one coat.

    Parameters
    ----------
    seed : root seed of the experiment; the same seed gives the same coat
    extent_mm : (x_low, x_high, y_low, y_high) float, mm; range of the material coordinates.
        Heights do not depend on this range, except for rounding.
    """
    distribution = johnson_of(texture.skewness, texture.excess_kurtosis)
    at_length = distribution.correlation_of_normals(exp(-1))
    length_mm = texture.correlation_mm / np.sqrt(-np.log(at_length))
    rms_mm = 1e-3 * texture.rms_um
    return random_field(("texture", seed), length_mm, extent_mm, rms_mm, distribution)


def random_field(
    stream: Stream,
    length_mm: float,
    extent_mm: Extent,
    rms_mm: float = 1.0,
    distribution: Johnson = _NORMAL,
) -> Field:
    """Return a random field whose Z has the autocorrelation exp(-(lag / length)^2).

    Parameters
    ----------
    stream : name of the quantity and seed; fields of different streams are independent
    """
    pitch_mm = length_mm / _CELLS_PER_LENGTH
    cols, rows = (_lattice(*ends, pitch_mm) for ends in (extent_mm[:2], extent_mm[2:]))
    ends = (int(rows[0]), int(rows[-1])), (int(cols[0]), int(cols[-1]))
    return Field(
        rms_mm=rms_mm,
        distribution=distribution,
        pitch_mm=float(pitch_mm),
        first=(int(rows[_REACH]), int(cols[_REACH])),
        coefficients=_blurred_noise(stream, *ends),
    )


@lru_cache(maxsize=2)  # one coat is pressed repeatedly, mostly with the same lattice
def _blurred_noise(stream: Stream, rows: tuple[int, int], cols: tuple[int, int]) -> FloatArray:
    """Return blurred noise (row, col); `rows` and `cols` are first and last index of a lattice.

    The outermost `_REACH` rows and columns are cut off: the blur needs them as a margin. The array
    is read-only, because the cache returns the same array again.
    """
    lattice = (np.arange(first, last + 1) for first, last in (rows, cols))
    blurred = _white_noise(stream, *lattice)
    for axis in (0, 1):
        blurred = ndimage.convolve1d(blurred, _taps(), axis=axis)
    inner = blurred[_REACH:-_REACH, _REACH:-_REACH].copy()
    inner.flags.writeable = False
    return inner


def textured(
    pressed: PressedElastomer, elastomer: Elastomer, load: Press, texture: Texture, seed: int
) -> PressedElastomer:
    """Add the coat's texture to a smooth pressed face; contact, pressure and force do not change.

    Returns
    -------
    Pressed elastomer with the textured `face_z_mm`; `texture_mm` is the height that was added

    Notes
    -----
    z increases by the height times sqrt(1 + slope^2) of the smooth face. The error is of second
    order in the height over the face's radius of curvature. The material point at a node is the
    node's position minus its displacement in the plane. The spectral model and the sheet compute
    this displacement; in the other models it is neglected, so that the texture is not stretched.
    """
    X_mm, Y_mm = material_points(pressed, elastomer, load)
    extent = (float(X_mm.min()), float(X_mm.max()), float(Y_mm.min()), float(Y_mm.max()))
    height_mm = texture_field(texture, seed, extent).height_mm(X_mm, Y_mm)
    added = height_mm / face_normals(pressed)[..., 2]
    return replace(pressed, face_z_mm=pressed.face_z_mm + added, texture_mm=added)


def texture_figures(pressed: PressedElastomer) -> dict[str, float]:
    """Return the texture's RMS, um, and the lag, mm, at which its autocorrelation is 1/e.

    Returns
    -------
    Both values by name, `texture_rms_um` and `texture_correlation_mm`; empty for a smooth coat. The
    lag is measured in plan; it is the mean of the lags along x and along y.
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


def material_points(
    pressed: PressedElastomer, elastomer: Elastomer, load: Press
) -> tuple[FloatArray, FloatArray]:
    """Return the material coordinates X and Y at the nodes of the coated face, (row, col) mm.

    They are the positions of the material in the flat, unloaded elastomer. Models that compute no
    displacement in the plane of the coat return the positions of the nodes.
    """
    X_mm, Y_mm = np.meshgrid(pressed.face_x_mm, pressed.face_y_mm)
    if pressed.sheet is not None:
        return pressed.sheet.material_x_mm, pressed.sheet.material_y_mm
    if not model_of(pressed.model).is_linear_slab:
        return X_mm, Y_mm
    u_x, u_y = in_plane_displacement(pressed, elastomer, load)
    decimals = _DISPLACEMENT_DECIMALS
    return X_mm - u_x.round(decimals), Y_mm - u_y.round(decimals)


def _lattice(low_mm: float, high_mm: float, pitch_mm: float) -> IntArray:
    """Return the indices of the lattice points along one axis, with a margin for the blur."""
    margin = 2 + _REACH
    first, last = floor(low_mm / pitch_mm) - margin, ceil(high_mm / pitch_mm) + margin
    return np.arange(first, last + 1)


def _white_noise(stream: Stream, rows: IntArray, cols: IntArray) -> FloatArray:
    """Return standard normal random numbers (row, col) at the points of a lattice.

    Each row has its own stream of numbers, which is assigned from column 0 outwards. The number at
    a lattice point therefore depends only on seed, row and column.
    """
    name, seed = stream
    streams, places = _outwards(rows), _outwards(cols)
    count = int(places.max()) + 1
    noise = np.zeros((rows.size, cols.size))
    for row, number in enumerate(streams.tolist()):
        rng = np.random.default_rng(keyed_sequence(seed, name, number))
        noise[row] = rng.standard_normal(count)[places]
    return noise


def _outwards(numbers: IntArray) -> IntArray:
    """Map the indices 0, -1, 1, -2, 2, ... to 0, 1, 2, 3, 4, ..., so that none is negative."""
    return np.where(numbers >= 0, 2 * numbers, -2 * numbers - 1)


def _taps() -> FloatArray:
    """Return the taps (n,) of the blur with which Z has variance 1 at the lattice points."""
    offsets = np.arange(-_REACH, _REACH + 1)
    taps = np.exp(-(offsets**2) / (2 * (_KERNEL_VARIANCE - _SPLINE_VARIANCE)))
    kernel = np.convolve(taps, _SPLINE_AT_POINTS)
    return np.asarray(taps / np.sqrt(np.sum(kernel**2)))


def _correlation_lag(heights: FloatArray) -> float:
    """Return the lag along x, in nodes, at which the autocorrelation of heights is 1/e.

    If the autocorrelation is nowhere that low, it returns the number of columns.
    """
    deviation = heights - heights.mean()
    variance, target, before = float(np.mean(deviation**2)), exp(-1), 1.0
    for lag in range(1, heights.shape[1]):
        here = float(np.mean(deviation[:, lag:] * deviation[:, :-lag])) / variance
        if here <= target:
            return lag - (target - here) / (before - here)
        before = here
    return float(heights.shape[1])


def in_plane_displacement(
    pressed: PressedElastomer, elastomer: Elastomer, load: Press
) -> tuple[FloatArray, FloatArray]:
    """Return the coat's displacements in its plane under contact, slide, back pressure and weight.

    Parameters
    ----------
    pressed : a press of the spectral model

    Returns
    -------
    u_x, u_y : (row, col) float, mm
        At the nodes of the coated face, along world x and y. They displace texture and markers;
        the nodes of the relief do not move.
    """
    layer = layer_on(elastomer, pressed.x_mm, pressed.y_mm, pressed.young_modulus_kpa)
    pressure = pressed.pressure_kpa / pressed.young_modulus_kpa
    if isinstance(layer, FreeSlab):
        preload = preload_of(elastomer, load, pressed.young_modulus_kpa)
        rows, cols = pressed.face_y_mm.size - 1, pressed.face_x_mm.size - 1
        loaded = pressure + preload.touched
        return layer.opposite_in_plane_at_nodes(loaded, rows, cols, preload.coated)
    nodes = pressed.face_y_mm, pressed.face_x_mm
    free = np.full((nodes[0].size, nodes[1].size), -np.inf)
    u_x, u_y = (
        touched_at_nodes(*wrapped(u, (layer.y_mm, layer.x_mm)), nodes, free)
        for u in _bonded(layer, pressure, pressed)
    )
    return u_x, u_y


def _bonded(
    layer: BondedLayer, pressure: FloatArray, pressed: PressedElastomer
) -> tuple[FloatArray, FloatArray]:
    """Return u_x and u_y, (row, col) mm, at the cells by pressure and, after a slide, traction."""
    u_x, u_y = layer.in_plane(pressure)
    if pressed.shear is None:
        return u_x, u_y
    traction = InPlane(pressed.shear.traction_x_kpa, pressed.shear.traction_y_kpa)
    sheared = ShearedLayer(layer).displace(
        InPlane(*(part / pressed.young_modulus_kpa for part in traction))
    )
    return u_x + sheared.x, u_y + sheared.y
