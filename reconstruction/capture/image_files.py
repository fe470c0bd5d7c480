"""Read the frames of a real camera from image files into one checked stack.

PNG, JPEG, TIFF and BMP files are read by imageio, EXR by OpenEXR, PGM and NPY by `raw_images`. EXR
files have DN as floating-point numbers. Of a colour image the channel is read that capture.toml
names. A dark frame D is subtracted from each image I as I - D + black level. This change is
constant for a pixel and does not change the phase. It changes merged exposures, and thresholds from
white and black.

A pattern sequence that was recorded with several exposures is merged into one stack before
decoding. For each pixel the longest exposure without a saturated frame is used (Zhang and Yau, Opt.
Eng. 48, 033604 (2009)). Its DN above the black level are scaled to the longest of all exposures by
s = t_max / t. The variance is then (s K sigma_d)^2 + s K (mean - black) + s^2 / 12, which `decode`
uses if it gets s.
"""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from reconstruction.arrays import FloatImage, ReasonImage, Stack
from reconstruction.capture.raw_images import read_npy, read_pgm
from reconstruction.capture.recorded import CHANNELS, Channel, RecordedFrames
from reconstruction.errors import CaptureError, InputError, one_line, require_number
from reconstruction.machine import threads
from reconstruction.native import quiet
from reconstruction.reading import MOST_IMAGE_BYTES, read_pixels, regular_file
from reconstruction.rig.sensor import SensorNoise

Image = NDArray[Any]
TYPES = ("uint8", "uint16", "float32")
# Largest factor between the ratio of brightness and that of exposure time of two sets; if it is
# larger, the sets look exchanged.
EXPOSURE_FACTOR = 1.5


def read_exposures(recorded: RecordedFrames) -> list[Stack]:
    """Return the stack of each exposure, with the dark frame subtracted if there is one.

    Raises
    ------
    CaptureError : missing or damaged images, unequal sizes or types, values beyond the bit depth
    """
    channel = recorded.channel
    sets = [read_stack_of_images(files, recorded.bit_depth, channel) for files in recorded.files]
    if recorded.dark_file is None:
        return sets
    dark = _read_dark(recorded.dark_file, sets[0].shape[1:], channel)
    return [subtract_dark(stack, dark, recorded.sensor) for stack in sets]


def with_file_names(message: str, recorded: RecordedFrames) -> str:
    """Return a message in which each frame name is followed by the name of its image file.

    The file name is left out if it contains the frame name.
    """
    for frame, path in zip(recorded.patterns.frames, (recorded.files or ((),))[0], strict=False):
        if frame.name not in path.name:
            message = message.replace(f"({frame.name})", f"({frame.name}: {path.name})")
    return message


def read_stack_of_images(files: Sequence[Path], bit_depth: int, channel: Channel = "") -> Stack:
    """Return the images of the files as one stack (frame, row, col) of the type of the files.

    Raises
    ------
    CaptureError : an image is damaged, differs from the first one in size or type, or has values
        beyond `bit_depth`
    """
    first = read_image(files[0], channel)
    stack = np.zeros((len(files), *first.shape), first.dtype)

    def load(number: int) -> None:
        image = read_image(files[number], channel)
        if image.shape != first.shape or image.dtype != first.dtype:
            raise CaptureError(
                f"{files[number]}: is {_described(image)}, {files[0].name} is {_described(first)}; "
                "all frames must be recorded alike"
            )
        _check_depth(files[number], image, bit_depth)
        stack[number] = image

    with ThreadPoolExecutor(threads()) as pool:
        for _ in pool.map(load, range(len(files))):
            pass
    return stack


def read_image(path: Path, channel: Channel = "") -> Image:
    """Return a grey image, or one channel of a colour image, (row, col) uint8, uint16 or float32.

    Raises
    ------
    CaptureError : the image is missing, damaged or of another type, or has colours although no
        channel is given
    """
    try:
        image = _READERS.get(path.suffix.lower(), read_pixels)(path)
    except InputError as error:
        raise CaptureError(f"the image {error}") from None
    if channel and image.ndim == 3 and image.shape[2] in (3, 4):
        image = np.ascontiguousarray(image[..., CHANNELS.index(channel) - 1])
    has_alpha_only = image.ndim == 3 and image.shape[2] == 2
    if has_alpha_only or (image.ndim == 3 and np.all(image[..., :3] == image[..., :1])):
        image = np.ascontiguousarray(image[..., 0])
    if image.ndim != 2 or image.dtype.name not in TYPES:
        raise CaptureError(
            f"{path}: is {_described(image)}; record grey images of {', '.join(TYPES)}, or name the"
            ' channel of colour images ("red", "green" or "blue"): the three are not one intensity'
        )
    return image


def _read_exr(path: Path) -> Image:
    import OpenEXR  # 0.1 s that are not needed for other captures

    regular_file(path, MOST_IMAGE_BYTES)
    try:
        with quiet(), OpenEXR.File(str(path), separate_channels=True) as file:
            # By name they are in the order B, G, R.
            channels = sorted(file.channels().items(), key=lambda item: "RGBA".find(item[0][-1]))
            values = [np.asarray(channel.pixels, np.float32) for _, channel in channels]
            return values[0].copy() if len(values) == 1 else np.stack(values, axis=-1)
    # The binding raises errors of Python and of C++: RuntimeError, TypeError, KeyError ...
    except Exception as error:
        raise InputError(f"{path}: is no complete image ({one_line(error)})") from error


_READERS = {".exr": _read_exr, ".npy": read_npy, ".pgm": read_pgm}


def _check_depth(path: Path, image: Image, bit_depth: int) -> None:
    largest = 2**bit_depth - 1
    if image.dtype == np.uint8 and bit_depth > 8:
        raise CaptureError(
            f"{path}: holds 8 bits, capture.toml has bit_depth = {bit_depth}; store 16-bit images "
            "or set bit_depth = 8"
        )
    # A NaN is an error as well; a float between the last two levels is not clipped.
    if not image.max() < largest + 1:
        step = int(np.gcd.reduce(image.ravel())) if image.dtype.kind == "u" else 1
        shifted = f"; all values are multiples of {step}: the bits are left-aligned" * (step > 1)
        raise CaptureError(
            f"{path}: holds the value {image.max()}, {bit_depth} bits end at {largest}{shifted}; "
            "correct bit_depth and with it [sensor]"
        )


def _described(image: Image) -> str:
    size = f"{image.shape[1]} x {image.shape[0]} px" if image.ndim > 1 else f"{image.shape}"
    colours = f" with {image.shape[2]} channels" if image.ndim == 3 else ""
    return f"{size} of {image.dtype}{colours}"


def _read_dark(path: Path, shape: tuple[int, ...], channel: Channel) -> Image:
    dark = read_image(path, channel)
    if dark.shape != shape:
        raise CaptureError(
            f"{path}: the dark frame is {dark.shape[1]} x {dark.shape[0]} px, the frames are "
            f"{shape[1]} x {shape[0]} px; record it with the same region of the sensor"
        )
    return dark


def subtract_dark(stack: Stack, dark: Image, sensor: SensorNoise) -> Stack:
    """Return the frames minus the dark frame plus the black level, (frame, row, col) float32.

    Clipped pixels and lost pixels (0) keep their values, by which `decode` detects them. A pixel
    with a low dark value may increase to `clipped_from_dn` or more; `decode` then treats it as
    clipped.

    Parameters
    ----------
    stack : (frame, row, col), DN
    dark : (row, col), DN, image without light
    """
    black_dn = np.float32(sensor.black_level_dn)
    offset = dark.astype(np.float32) - black_dn
    result = stack.astype(np.float32)
    for frame in result:
        keeps = (frame >= sensor.clipped_from_dn) | ((frame == 0.0) & (black_dn > 0.0))
        frame -= np.where(keeps, np.float32(0.0), offset)
        np.minimum(frame, np.float32(sensor.saturation_dn), out=frame)
    return result


def check_exposures(sets: Sequence[Stack], recorded: RecordedFrames) -> None:
    """Raise CaptureError unless white minus black is about proportional to the exposure time.

    Each set is compared with the first set. The ratio of white minus black (median over the lit,
    unclipped pixels) must agree with the ratio of exposure times within the factor
    EXPOSURE_FACTOR. Nothing is checked if the patterns have no white and black frames.
    """
    times_ms, patterns, sensor = recorded.exposures_ms, recorded.patterns, recorded.sensor
    if not patterns.uniform:
        return
    white, black = patterns.index("white").start, patterns.index("black").start
    first = sets[0][white].astype(np.float64) - sets[0][black]
    for number in range(1, len(sets)):
        light = sets[number][white].astype(np.float64) - sets[number][black]
        below = np.maximum(sets[0][white], sets[number][white]) < sensor.clipped_from_dn
        is_lit = below & (np.maximum(first, light) > 0.1 * sensor.saturation_dn)
        if not is_lit.any():
            continue
        ratio = float(np.median(light[is_lit])) / max(float(np.median(first[is_lit])), 1e-9)
        expected = times_ms[number] / times_ms[0]
        if not 1.0 / EXPOSURE_FACTOR < ratio / expected < EXPOSURE_FACTOR:
            raise CaptureError(
                f"set {number} is {ratio:.2g} times as bright as set 0, exposures_ms give "
                f"{expected:.2g}; the sets or their exposures look exchanged"
            )


@dataclass(frozen=True, eq=False)
class MergedExposures:
    """One stack merged from several exposures.

    Parameters
    ----------
    stack : (frame, row, col) float32, DN of the longest exposure; may exceed `saturation_dn`
    scale : (row, col) float32, factor s >= 1 by which the pixel was scaled; an input of `decode`
    chosen : (row, col) uint8, index of the exposure that is used at the pixel
    exposure_ms : longest exposure time, to which the stack is scaled
    """

    stack: Stack
    scale: FloatImage
    chosen: ReasonImage
    exposure_ms: float


def merge_exposures(
    stacks: Sequence[Stack], exposures_ms: Sequence[float], sensor: SensorNoise
) -> MergedExposures:
    """Merge exposures: take each pixel from its longest exposure without a saturated frame.

    A pixel that is saturated in all exposures is taken from the shortest one; `decode` ignores its
    clipped frames.

    Parameters
    ----------
    stacks : stacks of equal shape (frame, row, col), DN, one for each exposure
    exposures_ms : exposure time of each stack, all different
    sensor : camera noise; DN above its black level must be proportional to the exposure time

    Raises
    ------
    InputError : stacks and exposures are inconsistent
    """
    _check(stacks, exposures_ms)
    order = sorted(range(len(stacks)), key=lambda i: exposures_ms[i])
    longest_ms = float(exposures_ms[order[-1]])
    black = np.float32(sensor.black_level_dn)
    merged = np.zeros(stacks[0].shape, np.float32)
    scale = np.ones(merged.shape[1:], np.float32)
    chosen = np.zeros(merged.shape[1:], np.uint8)
    for rank, i in enumerate(order):
        # In this form NaN counts as saturated.
        takes = np.asarray(stacks[i].max(axis=0) < sensor.clipped_from_dn) | (rank == 0)
        s = np.float32(longest_ms / exposures_ms[i])
        scale[takes], chosen[takes] = s, i
        for target, frame in zip(merged, stacks[i], strict=True):
            target[takes] = black + s * (frame[takes].astype(np.float32) - black)
    return MergedExposures(merged, scale, chosen, longest_ms)


def _check(stacks: Sequence[Stack], exposures_ms: Sequence[float]) -> None:
    if not stacks or len(stacks) != len(exposures_ms) or len(stacks) > 255:
        raise InputError(
            f"there are {len(stacks)} stacks and {len(exposures_ms)} exposures; give one of each,"
            " 1 to 255"
        )
    for value in exposures_ms:
        require_number("exposures_ms", value, 0.0, open_low=True)
    if len(set(exposures_ms)) != len(exposures_ms):
        raise InputError(f"exposures_ms are {list(exposures_ms)}; each may occur once")
    shapes = {stack.shape for stack in stacks}
    if len(shapes) != 1 or stacks[0].ndim != 3:
        raise InputError(f"stacks have the shapes {sorted(shapes)}; all must be (frame, row, col)")
