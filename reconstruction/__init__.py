"""Decode, triangulate and evaluate fringe captures, real or rendered.

    from reconstruction import read_capture, reconstruct

    result = reconstruct(read_capture("my_capture"))
    points_mm = result.point_map.points_world_mm  # (row, col, xyz), world frame

| name | content |
|---|---|
| `PatternSet` | the images that the projector shows and that the decoder expects |
| `Capture`, `read_capture`, `write_capture` | folder of frames, patterns, calibration and noise |
| `SensorNoise`, `Pinhole`, `Calibration` | camera noise, camera model, geometry of the rig |
| `decode`, `DecodeOptions` | projector coordinates, their sigma and a reason code of each pixel |
| `triangulate` | points in the world frame, mm, from projector coordinates |
| `reconstruct`, `ReconstructOptions` | decoding and triangulation in one call |
| `CODES`, `PatternCode` | pattern codes by name; base class of a user's code (module `codes`) |
| `calibrate` | a calibrated rig from images of a board (see subpackage `calibration`) |
| `calibration`, `evaluate`, `photometric` | subpackages with public names of their own |

A submodule is imported when one of its names is first used.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from reconstruction import calibration, evaluate, photometric
    from reconstruction.calibration import calibrate
    from reconstruction.capture.folder import Capture, read_capture, write_capture
    from reconstruction.codes import CODES, PatternCode
    from reconstruction.decoding import DecodeOptions
    from reconstruction.decoding.decode import decode
    from reconstruction.patterns import PatternSet
    from reconstruction.pipeline import ReconstructOptions, reconstruct
    from reconstruction.rig.calibration import Calibration
    from reconstruction.rig.pinhole import Pinhole
    from reconstruction.rig.sensor import SensorNoise
    from reconstruction.triangulation import triangulate

__all__ = [
    "CODES",
    "Calibration",
    "Capture",
    "DecodeOptions",
    "PatternCode",
    "PatternSet",
    "Pinhole",
    "ReconstructOptions",
    "SensorNoise",
    "calibrate",
    "calibration",
    "decode",
    "evaluate",
    "photometric",
    "read_capture",
    "reconstruct",
    "triangulate",
    "write_capture",
]

# A function must not have the name of a subpackage: importing the subpackage would replace it.
_ROOMS = ("calibration", "evaluate", "photometric")
_MODULE_OF = {
    "CODES": "codes",
    "Calibration": "rig.calibration",
    "Capture": "capture.folder",
    "DecodeOptions": "decoding",
    "PatternCode": "codes",
    "PatternSet": "patterns",
    "Pinhole": "rig.pinhole",
    "ReconstructOptions": "pipeline",
    "SensorNoise": "rig.sensor",
    "calibrate": "calibration",
    "decode": "decoding.decode",
    "read_capture": "capture.folder",
    "reconstruct": "pipeline",
    "triangulate": "triangulation",
    "write_capture": "capture.folder",
}


def __getattr__(name: str) -> Any:
    if name in _ROOMS:
        return import_module(f"{__name__}.{name}")
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULE_OF[name]}"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
