"""What decoding says about every camera pixel."""

from dataclasses import dataclass

import numpy as np

from reconstruction.arrays import BoolImage, FloatImage, OrderImage, ReasonImage
from reconstruction.compact import keeps_compact
from reconstruction.mask import Reason


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
    """What the frames along one projector axis say, every field (row, col).

    coordinate_px, order, sigma_px and bias_share are 0 unless the pixel is valid. phase_rad in
    [0, 2 pi) is also given for masked pixels that have a phase. mean_dn and modulation_dn are
    always given. Phase, mean and modulation are those of the single pixel, coordinate and sigma
    are filtered. With a multi-frequency code phase, order, mean and modulation are those of the
    measuring period, while coordinate_px is the weighted mean of all periods.

    residual_dn : RMS of what the fit leaves, with N - 3 degrees of freedom; 0 with three frames
    order_error : probability that the order is wrong, given wherever there is a phase
    bias_share : share of sigma_px squared that is relief which the filter may have taken, not noise

    Notes
    -----
    The decoder keeps all but coordinate_px in 16 bits: phases in steps of 1e-4 rad, the others in
    half precision, 0.05 % of the value; shares in steps of 1 / 255. Reading one of them makes a
    new array, float32 (order: int16): keep it in a variable when it is needed again.
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
    """Both projector coordinates of every camera pixel, and why a pixel has none."""

    column: AxisDecode
    row: AxisDecode
    mask_reason: ReasonImage

    @property
    def valid(self) -> BoolImage:
        """Where both coordinates are known, (row, col) bool."""
        return np.equal(self.mask_reason, Reason.VALID)
