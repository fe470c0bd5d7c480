"""The whole way from a capture to points."""

from dataclasses import dataclass, field

import numpy as np

from reconstruction.arrays import BoolImage
from reconstruction.capture.folder import Capture
from reconstruction.decoding.decode import Decoded, DecodeOptions, decode
from reconstruction.triangulation.triangulate import EpipolarTolerance, PointMap, Use, triangulate


@dataclass(frozen=True)
class ReconstructOptions:
    """Options of both stages; see `DecodeOptions`, `triangulate`, `EpipolarTolerance`."""

    decode: DecodeOptions = field(default_factory=DecodeOptions)
    use: Use = "column"
    tolerance: EpipolarTolerance = field(default_factory=EpipolarTolerance)


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """Result of both stages."""

    decoded: Decoded
    point_map: PointMap


def reconstruct(capture: Capture, options: ReconstructOptions | None = None) -> Reconstruction:
    """Decode and triangulate a capture.

    Raises
    ------
    InputError : stack, patterns and calibration do not fit each other
    """
    chosen = options or ReconstructOptions()
    decoded = decode(capture.stack, capture.patterns, capture.sensor, chosen.decode, capture.scale)
    point_map = triangulate(decoded, capture.calibration, chosen.use, chosen.tolerance)
    return Reconstruction(decoded, point_map)


def filter_bias(found: Reconstruction, use: Use, where: BoolImage) -> tuple[float, float]:
    """Tell how much of the relief the filter may have taken; needs no truth.

    Parameters
    ----------
    use : the coordinate that gave the depth; the larger share of both counts for "both"
    where : (row, col), valid points to count, at least one

    Returns
    -------
    RMS of the predicted bias of world z, um, and the share of the points where it exceeds the
    predicted noise; both are part of sigma
    """
    axes = (found.decoded.column, found.decoded.row)
    chosen = axes if use == "both" else (axes[use == "row"],)
    share = np.max([axis.bias_share[where] for axis in chosen], axis=0)
    variance_um2 = 1e6 * found.point_map.sigma_z_mm[where].astype(np.float64) ** 2
    return float(np.sqrt(np.mean(variance_um2 * share))), float(np.mean(share > 0.5))
