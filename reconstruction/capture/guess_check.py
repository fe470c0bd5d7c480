"""Check a guessed capture.toml against its images: decode them, and try likely other values.

A correct description decodes most lit pixels, and the projector coordinate is continuous from pixel
to pixel and does not turn back. If it does not, other encodings and orders of the bits are tried,
and an encoding is taken over if it is the only one that passes. The assumed noise of the camera is
compared with the scatter of the phase frames around their sinusoids, which includes harmonics of a
projector with gamma, and flicker between frames.
"""

import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.special import gammaincinv

from reconstruction.arrays import BoolImage
from reconstruction.capture.description import DESCRIPTION_FILE
from reconstruction.capture.folder import read_frames
from reconstruction.capture.frame_list import ListedSet, read_listed
from reconstruction.capture.frame_order import ENOUGH, LEAST_LIT, Sample, sample_of
from reconstruction.capture.guess import Guess
from reconstruction.capture.guess_file import written
from reconstruction.capture.spatial_guess import trial_reference
from reconstruction.decoding import DecodeOptions
from reconstruction.decoding.continuity import (
    DOUBTFUL_SHARE,
    DOUBTFUL_TURN,
    jump_share,
    turned_share,
)
from reconstruction.decoding.decode import decode
from reconstruction.errors import CaptureError, InputError
from reconstruction.patterns import PatternSet
from reconstruction.rig.sensor import SensorNoise
from reconstruction.words import WORDS
from reconstruction.writing import write_text

# Measured over assumed noise within these limits needs no message.
_NOISE_RATIO = 0.5, 2.0
_LEAST_STEPS = 4


@dataclass(frozen=True)
class DecodingCheck:
    """Result of decoding the images by one description.

    Attributes
    ----------
    share : share of the lit pixels with coordinates, 0 to 1
    jumps : largest share of jumps of a coordinate, see `continuity.jump_share`
    turned : largest share of the rarer direction of a coordinate, see `continuity.turned_share`
    noise_ratio : measured over assumed standard deviation of the phase frames; None: not known
    why : why the images cannot be decoded; empty if they can
    """

    share: float = 0.0
    jumps: float = 0.0
    turned: float = 0.0
    noise_ratio: float | None = None
    why: str = ""

    @property
    def passes(self) -> bool:
        """Whether most lit pixels have coordinates, and these are continuous in one direction."""
        is_regular = self.jumps <= DOUBTFUL_SHARE and self.turned <= DOUBTFUL_TURN
        return not self.why and self.share >= ENOUGH and is_regular

    def in_words(self) -> str:
        """Return the result as text."""
        if self.why:
            return f"twin decode would end with: {self.why}"
        text = (
            f"{self.share:.0%} of the lit pixels decode, the coordinate jumps at {self.jumps:.0%}"
        )
        if self.turned <= DOUBTFUL_TURN:
            return text
        return f"{text} and turns back in {self.turned:.0%}; the coarsest bit may be missing"


@dataclass(frozen=True)
class CheckedGuess:
    """Text of a capture.toml that was tested on its images.

    Attributes
    ----------
    guess : the guessed patterns, with the encoding that the test confirmed
    text : text of the file
    lines : one line for each test: passed, or unsure and the change that would pass
    """

    guess: Guess
    text: str
    lines: tuple[str, ...]


def describe_and_test(
    guessed: Guess, folder: Path, size: tuple[int, int], *, is_known: bool = True
) -> CheckedGuess:
    """Write the description of guessed patterns, and test it on the images.

    If it fails, and it passes with one other encoding of the bits only, that encoding is written,
    with a mark.

    Parameters
    ----------
    folder : folder of the images
    size, is_known : as in `written`
    """
    text = written(guessed, size, is_known=is_known)
    listed = _listed(text)
    if isinstance(listed, str):
        return CheckedGuess(guessed, text, (f"unsure: {DecodingCheck(why=listed).in_words()}",))
    check = _tested(listed, folder)
    others = {} if check.passes else {
        change: (other, _tested(other, folder)) for change, other in _others(listed)
    }  # fmt: skip
    passing = {change: item for change, item in others.items() if item[1].passes}
    words = [other.word for other, _ in passing.values() if other.word != guessed.word]
    if len(passing) == len(words) == 1:
        doubt = f'word = "{words[0]}" follows from the test; with "{guessed.word}" '
        better = replace(guessed, word=words[0], unsure=(*guessed.unsure, doubt + check.in_words()))
        return describe_and_test(better, folder, size, is_known=is_known)
    lines = [f"{'tested' if check.passes else 'unsure'}: {check.in_words()}"]
    lines += [f"with {change}: {tested.in_words()}" for change, (_, tested) in passing.items()]
    if check.noise_ratio is not None:
        lines.append(_noise_line(check.noise_ratio))
    return CheckedGuess(guessed, text, tuple(lines))


def _listed(text: str) -> ListedSet | str:
    """Return the list of frames of a capture.toml, or why `twin decode` would reject it."""
    with tempfile.TemporaryDirectory() as place:
        file = Path(place) / DESCRIPTION_FILE
        write_text(file, text)
        try:
            return read_listed(file)
        except CaptureError as error:
            return str(error).removeprefix(f"{file}: ")


def _noise_line(ratio: float) -> str:
    low, high = _NOISE_RATIO
    is_close = low <= ratio <= high
    return (
        f"{'tested' if is_close else 'unsure'}: [sensor]: the phase frames scatter by {ratio:.2g} "
        "times the assumed noise around their sinusoids"
    )


def _others(listed: ListedSet) -> Iterator[tuple[str, ListedSet]]:
    """Yield other descriptions: another encoding of the bits, and their opposite order."""
    if not any(entry.kind in ("gray", "inverse") for entry in listed.frames):
        return
    for word in WORDS.names():
        if word != listed.word:
            yield f'word = "{word}"', replace(listed, word=word)
    reverse = tuple(
        replace(entry, bits="fine_first") if entry.kind in ("gray", "inverse") else entry
        for entry in listed.frames
    )
    if reverse != listed.frames:
        yield 'bits = "fine_first"', replace(listed, frames=reverse)


def _tested(listed: ListedSet, folder: Path) -> DecodingCheck:
    try:
        recorded = listed.recorded(folder)
        stack, _ = read_frames(recorded)
    except CaptureError as error:
        return DecodingCheck(why=str(error).removeprefix(f"{folder}: "))
    patterns, sensor = recorded.patterns, recorded.sensor
    sample = sample_of(stack, patterns, sensor, None)
    if np.count_nonzero(sample.is_lit) < LEAST_LIT:
        return DecodingCheck(why="too few pixels are lit")
    reference = trial_reference(stack, patterns, _lit_pixels(sample, stack.shape[1:]))
    options = DecodeOptions(filter_taps=0, frame_gains=False, reference=reference)
    try:
        decoded = decode(stack, patterns, sensor, options)
    except InputError as error:
        return DecodingCheck(why=str(error))
    valid = decoded.valid[:: sample.stride, :: sample.stride][sample.is_lit]
    coordinates = {axis: getattr(decoded, axis).coordinate_px for axis in patterns.axes}
    jumps = [
        jump_share(
            coordinate_px,
            decoded.valid,
            patterns.period_along(axis),
            is_word=patterns.steps == 0,
        )
        for axis, coordinate_px in coordinates.items()
    ]
    turned = max(turned_share(x_px, decoded.valid) for x_px in coordinates.values())
    ratio = _noise_ratio(sample.stack[:, sample.is_lit].astype(np.float64), patterns, sensor)
    return DecodingCheck(float(np.mean(valid)), max(jumps), turned, ratio)


def _lit_pixels(sample: Sample, shape: tuple[int, ...]) -> BoolImage:
    """Return the lit pixels of a sample at the size of the image, (row, col) bool."""
    whole = sample.is_lit.repeat(sample.stride, axis=0).repeat(sample.stride, axis=1)
    return np.asarray(whole[: shape[0], : shape[1]])


def _noise_ratio(
    pixels: np.ndarray[tuple[int, ...], np.dtype[np.float64]],
    patterns: PatternSet,
    sensor: SensorNoise,
) -> float | None:
    """Return the measured over the assumed standard deviation of the phase frames; None: too few.

    Parameters
    ----------
    pixels : (frame, pixel), DN, of lit pixels
    """
    if patterns.steps < _LEAST_STEPS:
        return None
    phase = np.exp(2j * np.pi * np.arange(patterns.steps) / patterns.steps)
    # The median of chi-square, as `scipy.stats` has it, which takes 0.5 s to import.
    expected = 2.0 * gammaincinv((patterns.steps - 3) / 2.0, 0.5)
    ratios = []
    for axis in patterns.axes:
        for span in patterns.step_sets(axis):
            values = pixels[span]
            mean = values.mean(axis=0)
            amplitude = 2.0 / patterns.steps * phase.conj() @ values
            fitted = mean + np.real(phase[:, np.newaxis] * amplitude)
            square = ((values - fitted) ** 2).sum(axis=0) / sensor.variance_dn2(mean)
            ratios.append(np.sqrt(np.median(square) / expected))
    return float(np.median(ratios))
