"""Define options and result of decoding: projector coordinates, their sigma, a reason per pixel.

Importing this module compiles no code. `sigma` is a predicted standard deviation everywhere.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from reconstruction.arrays import BoolImage, FloatArray, FloatImage, OrderImage, Reason, ReasonImage
from reconstruction.codes import Expected
from reconstruction.compact import keeps_compact
from reconstruction.errors import InputError, require_integer, require_number
from reconstruction.patterns import AXES, Axis
from reconstruction.spatial_unwrapping import ISLANDS, Islands

IslandImages = NDArray[np.uint16]
Expect = Callable[[Axis, Mapping[Axis, FloatArray]], Expected | None]
"""Function of an axis, and of the coordinates, px, along axes that are already known."""

Weights = Literal["equal", "modulation"]
WEIGHTS: tuple[Weights, ...] = ("equal", "modulation")


@keeps_compact(
    "phase_rad",
    "order",
    "mean_dn",
    "modulation_dn",
    "sigma_px",
    "residual_dn",
    "order_error",
    "bias_share",
)
@dataclass(frozen=True, eq=False)
class AxisDecode:
    """Maps decoded from the patterns along one projector axis; every field is (row, col).

    coordinate_px, order, sigma_px and bias_share are 0 unless the pixel is valid. phase_rad in
    [0, 2 pi) is also given for masked pixels that have a phase. mean_dn and modulation_dn are
    always given. Phase, mean and modulation are those of the single pixel, coordinate and sigma
    are filtered. With a multi-frequency code phase, order, mean and modulation are those of the
    measuring period, while coordinate_px is the weighted mean of all periods.

    coordinate_px : projector column or row from which the pixel is lit; whole at pixel centres
    phase_rad : fringe phase
    order : number of the fringe period, so that coordinate = period (order + phase / 2 pi)
    mean_dn, modulation_dn : mean and amplitude of the fringe, DN
    sigma_px : predicted standard deviation of coordinate_px by camera noise, filter bias, glints
        (filtered coordinates only), the uncertainty of `FrameGains.relative`, and the uncertainty
        of the projector's response, if one is given
    residual_dn : RMS residual of the sine fit, with N - 3 degrees of freedom for N frames; 0 if N
        is 3
    order_error : probability that the order is wrong, given for every pixel with a phase
    bias_share : share of sigma_px squared that is possible bias, because the filter removes relief
        or, with `weights` "modulation", glints move the result

    Notes
    -----
    The decoder stores all maps but coordinate_px in 16 bits: phases in steps of 1e-4 rad, others in
    half precision, 0.05 % of the value; shares in steps of 1 / 255. Every access expands the map to
    a new array, float32 (order: int16): assign it to a variable if it is used again.
    """

    coordinate_px: FloatImage
    phase_rad: FloatImage
    order: OrderImage
    mean_dn: FloatImage
    modulation_dn: FloatImage
    sigma_px: FloatImage
    residual_dn: FloatImage
    order_error: FloatImage
    bias_share: FloatImage


@dataclass(frozen=True, eq=False)
class FrameGains:
    """Light of the phase frames relative to the mean of their fringe set, see `gains`.

    relative : (axis, set, step), 1 for sets without a significant difference
    ripple_rad : (axis, set), phase error, RMS, that the levels had before they were divided by
        `relative`; 0 for sets without a significant difference
    variances : (axis, 2) of the sums E_1 and E_2 of the measuring period's light, see `gains`
    dark_dn : (axis, set), level without light of the projector, DN, which was not divided
    """

    relative: FloatArray
    ripple_rad: FloatArray
    variances: FloatArray
    dark_dn: FloatArray


@dataclass(frozen=True, eq=False)
class Decoded:
    """Both projector coordinates of every camera pixel, and the reason why a pixel has none.

    column, row : maps of the projector columns and of the projector rows
    mask_reason : (row, col) reason code of each pixel, `Reason.VALID` for a valid one
    axes : axes along which patterns were projected; all fields of a missing axis are 0
    gains : relative light of the phase frames, by which their levels were divided; None: they were
        not divided
    islands : (axis, row, col) uint16, number of the island of continuous phase, 1 for the largest;
        0: none. None: the pattern code has no islands
    """

    column: AxisDecode
    row: AxisDecode
    mask_reason: ReasonImage
    axes: tuple[Axis, ...] = AXES
    gains: FrameGains | None = None
    islands: IslandImages | None = None

    @property
    def valid(self) -> BoolImage:
        """Pixels with known coordinates along all `axes`, (row, col) bool."""
        return np.equal(self.mask_reason, Reason.VALID)

    @property
    def intensity_dn(self) -> FloatImage:
        """Mean pixel value over the phase frames of the first of `axes`, (row, col), DN."""
        return self.row.mean_dn if self.axes == ("row",) else self.column.mean_dn


@dataclass(frozen=True)
class PhaseReference:
    """Knowledge by which relative fringe orders become absolute, see the code `spatial`.

    Parameters
    ----------
    pixels : marked pixels, each camera column, camera row, projector column and, if it is known,
        projector row, px
    z_mm : world z of the surface; it needs a calibration; None: unknown
    sigma_mm : standard deviation of z_mm, including the relief of the surface
    islands : islands that are numbered, see `Expected`
    """

    pixels: tuple[tuple[float, ...], ...] = ()
    z_mm: float | None = None
    sigma_mm: float = 0.2
    islands: Islands = "mask"

    def __post_init__(self) -> None:
        if any(len(pixel) not in (3, 4) for pixel in self.pixels):
            raise InputError(
                f"reference_pixels is {self.pixels}; give camera column, camera row, projector"
                " column and, if it is known, projector row of each pixel"
            )
        if self.z_mm is not None:
            require_number("reference_z_mm", self.z_mm, -1e6, 1e6)
        require_number("reference_sigma_mm", self.sigma_mm, 0.0, open_low=True)
        if self.islands not in ISLANDS:
            raise InputError(f"islands is {self.islands!r}; allowed are {', '.join(ISLANDS)}")


@dataclass(frozen=True)
class DecodeOptions:
    """Options of the coordinate filter, and thresholds of the masks.

    Parameters
    ----------
    filter_taps : width of the Gaussian on the coordinate, px; 0 switches it off. An even width is
        averaged over both anchors (one tap more), so that the result is not shifted by half a
        pixel. The relief that the Gaussian removes is restored, see `_filter`
    filter_sigma_px : standard deviation of the Gaussian; the paper states only 8 x 8 taps
    weights : weights of the pixels in the Gaussian. "equal": glints cannot move the result, and the
        relief that the Gaussian removes is restored; "modulation": Gaussian on the complex phasor,
        as in published decoders
    min_modulation_dn : a pixel with a smaller modulation is masked; None: only max_phase_sigma_rad
        limits the modulation
    max_phase_sigma_rad : a pixel with a larger predicted sigma of its own phase is masked
    dark_sigmas : a pixel is masked unless white exceeds black by this many sigmas of their
        difference
    gray_sigmas : a Gray level closer to its threshold than this many sigmas makes the fringe order
        uncertain if the order depends on it
    max_condition : clipped or lost frames of a pixel are excluded from its fit; a pixel with a
        larger condition number of the remaining frames is masked. With all frames it is 1
    max_order_error : a pixel with a larger probability of a wrong fringe order is masked; pixels
        with the probability 1 are always masked
    frame_gains : estimate the relative light of the phase frames from the frames, and divide their
        levels by it if it differs from 1 significantly; needs four steps or more
    reference : source of absolute fringe orders for a code with relative ones; None: none
    """

    filter_taps: int = 8
    filter_sigma_px: float = 1.5
    weights: Weights = "equal"
    min_modulation_dn: float | None = None
    max_phase_sigma_rad: float = 0.1
    dark_sigmas: float = 3.0
    gray_sigmas: float = 4.0
    max_condition: float = 100.0
    max_order_error: float = 0.01
    max_residual_sigmas: float | None = None
    frame_gains: bool = True
    reference: PhaseReference | None = None

    def __post_init__(self) -> None:
        require_integer("filter_taps", self.filter_taps, 0, 63)
        require_number("filter_sigma_px", self.filter_sigma_px, 0.0, open_low=True)
        if self.weights not in WEIGHTS:
            raise InputError(f"weights is {self.weights!r}; allowed are {', '.join(WEIGHTS)}")
        if self.min_modulation_dn is not None:
            require_number("min_modulation_dn", self.min_modulation_dn, 0.0)
        require_number("max_phase_sigma_rad", self.max_phase_sigma_rad, 0.0, open_low=True)
        require_number("dark_sigmas", self.dark_sigmas, 0.0)
        require_number("gray_sigmas", self.gray_sigmas, 0.0)
        require_number("max_condition", self.max_condition, 1.0)
        require_number("max_order_error", self.max_order_error, 0.0, 1.0)
        if self.max_residual_sigmas is not None:
            require_number("max_residual_sigmas", self.max_residual_sigmas, 0.0, open_low=True)
        if not isinstance(self.frame_gains, bool):
            raise InputError(f"frame_gains is {self.frame_gains!r}; give true or false")
