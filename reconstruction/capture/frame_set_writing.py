"""Write frames as a rig owner has them: one image per frame and a short capture.toml."""

from dataclasses import asdict
from pathlib import Path

import numpy as np

from reconstruction.arrays import Stack
from reconstruction.capture.description import assignments
from reconstruction.capture.frame_set import FORMAT, VERSION
from reconstruction.capture.pattern_files import MANIFEST_FILE, file_names, write_manifest
from reconstruction.checks import require_integer
from reconstruction.errors import CaptureError
from reconstruction.patterns import PatternSet
from reconstruction.rig.sensor import SensorNoise

FILES = "{index:03d}_{name}.png"


def write_frame_set(
    folder: Path | str,
    stack: Stack,
    patterns: PatternSet,
    sensor: SensorNoise,
    bit_depth: int,
) -> None:
    """Write images, manifest and description into an existing folder; no calibration file.

    Parameters
    ----------
    stack : (frame, row, col) uint8 or uint16, DN; images have its type
    patterns : what was projected
    sensor : noise of these images
    bit_depth : 8 to 16

    Raises
    ------
    CaptureError : the stack does not fit the patterns, or holds no integers
    """
    import imageio.v3 as imageio  # 0.1 s that reading need not pay

    folder = Path(folder)
    require_integer("bit_depth", bit_depth, 8, 16)
    if len(stack) != len(patterns.frames) or stack.dtype not in (np.uint8, np.uint16):
        raise CaptureError(
            f"stack is {stack.dtype} {stack.shape}; images need uint8 or uint16 of "
            f"{len(patterns.frames)} frames"
        )
    for name, frame in zip(file_names(patterns), stack, strict=True):
        imageio.imwrite(folder / name, frame)
    write_manifest(folder / MANIFEST_FILE, patterns)
    header = {
        "format": FORMAT,
        "version": VERSION,
        "files": FILES,
        "bit_depth": bit_depth,
        "patterns_file": MANIFEST_FILE,
        "calibration_file": "calibration.yaml",
    }
    lines = [*assignments(header), "", "[sensor]", *assignments(asdict(sensor))]
    (folder / "capture.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")
