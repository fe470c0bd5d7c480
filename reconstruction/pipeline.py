"""The whole way from a capture to points."""

from dataclasses import dataclass, field

from reconstruction.capture import Capture
from reconstruction.decode import Decoded, DecodeOptions, decode
from reconstruction.triangulate import EpipolarTolerance, PointMap, Use, triangulate


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
