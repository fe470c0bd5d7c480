"""Options and result of decoding: projector coordinates, their sigma and a reason per pixel.

Needs no compiled code.
"""

from dataclasses import dataclass

import numpy as np

from reconstruction.arrays import BoolImage, FloatImage, OrderImage, Reason, ReasonImage
from reconstruction.compact import keeps_compact
from reconstruction.errors import require_integer, require_number
from reconstruction.patterns import AXES, Axis


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
    """Maps that are decoded from the frames along one projector axis, every field (row, col).

    coordinate_px, order, sigma_px and bias_share are 0 unless the pixel is valid. phase_rad in
    [0, 2 pi) is also given for masked pixels that have a phase. mean_dn and modulation_dn are
    always given. Phase, mean and modulation are those of the single pixel, coordinate and sigma
    are filtered. With a multi-frequency code phase, order, mean and modulation are those of the
    measuring period, while coordinate_px is the weighted mean of all periods.

    residual_dn : RMS residual of the fit, with N - 3 degrees of freedom; 0 with three frames
    order_error : probability that the order is wrong, given for every pixel with a phase
    bias_share : share of sigma_px squared that is possible bias of relief by the filter, not noise

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
class Decoded:
    """Both projector coordinates of every camera pixel, and the reason why a pixel has none.

    axes : axes along which patterns were projected; all fields of a missing axis are 0
    """

    column: AxisDecode
    row: AxisDecode
    mask_reason: ReasonImage
    axes: tuple[Axis, ...] = AXES

    @property
    def valid(self) -> BoolImage:
        """Where the coordinates of all `axes` are known, (row, col) bool."""
        return np.equal(self.mask_reason, Reason.VALID)


@dataclass(frozen=True)
class DecodeOptions:
    """Options of the filter and thresholds of the masks.

    Parameters
    ----------
    filter_taps : width of the Gaussian on the coordinate, px; 0 switches it off. An even width is
        averaged over both anchors (one tap more), so that the result is not shifted by half a
        pixel. The relief that the Gaussian removes is restored, see `_filter`
    filter_sigma_px : its standard deviation; the paper states only 8 x 8
    min_modulation_dn : mask a smaller fringe contrast; None: only max_phase_sigma_rad limits it
    max_phase_sigma_rad : mask a larger predicted phase sigma of the single pixel
    dark_sigmas : white must exceed black by this many sigmas of their difference
    gray_sigmas : a Gray level closer to its threshold than this many sigmas is doubtful
    max_condition : clipped or lost frames of a pixel are excluded from its fit; mask a larger
        condition number of the remaining frames (1: all frames are valid)
    max_order_error : mask a larger probability of a wrong fringe order; 1: only certain errors
    """

    filter_taps: int = 8
    filter_sigma_px: float = 1.5
    min_modulation_dn: float | None = None
    max_phase_sigma_rad: float = 0.1
    dark_sigmas: float = 3.0
    gray_sigmas: float = 4.0
    max_condition: float = 100.0
    max_order_error: float = 0.01

    def __post_init__(self) -> None:
        require_integer("filter_taps", self.filter_taps, 0, 63)
        require_number("filter_sigma_px", self.filter_sigma_px, 0.0, open_low=True)
        if self.min_modulation_dn is not None:
            require_number("min_modulation_dn", self.min_modulation_dn, 0.0)
        require_number("max_phase_sigma_rad", self.max_phase_sigma_rad, 0.0, open_low=True)
        require_number("dark_sigmas", self.dark_sigmas, 0.0)
        require_number("gray_sigmas", self.gray_sigmas, 0.0)
        require_number("max_condition", self.max_condition, 1.0)
        require_number("max_order_error", self.max_order_error, 0.0, 1.0)
