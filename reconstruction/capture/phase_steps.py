"""Detect sets of phase frames ("phase sets") among images of unknown content.

Images are phase sets in three cases:

- Four or more images, consecutive by name, have equal steps of a turn at nearly all pixels. Any
  part of a fringe may be in view.
- Three or more striped images of equal axis and frequency have phases in equal steps of a turn. The
  phase of an image is that of its cross spectrum with the first image.
- A set of consecutive images has the mean A and the modulation B of a phase set that was detected
  before, at nearly all pixels. It has a coarser period, of which only a small part may be in view.
  Bits never have this mean.

Images are normalised to levels u from 0 to 1, see `image_features`.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from reconstruction.arrays import BoolImage, FloatArray
from reconstruction.capture.image_features import (
    EXTREME,
    PADDED,
    FrameGroup,
    ImageFeatures,
    spectrum,
)
from reconstruction.patterns import AXES, Axis

# Frequencies are equal if they differ by less than this number of cycles per line. The limit is
# SAME_OF_FEW below FEW_CYCLES, because with few fringes the phase moves the peak of the spectrum.
SAME_CYCLES, SAME_OF_FEW, FEW_CYCLES = 0.4, 0.8, 3.0
# Least share of pixels of a cosine image that are neither dark nor bright. With three steps only, a
# pixel is darkest in one step and brightest in another.
SMOOTH = 0.12
# Largest deviation of phases from equal steps, as a share of a step.
EVEN = 0.2
# Correlation of two images below which they are complementary.
COMPLEMENTARY = -0.8
# Set of a coarser period: largest deviation of mean and modulation from those of the known set, in
# units of the modulation, and least share of the pixels within these limits.
SAME_MEAN, SAME_MODULATION, SAME_SHARE = 0.2, 0.35, 0.8
# Consecutive steps: least modulation in u, largest RMS residual in units of the modulation, least
# share of pixels that are neither dark nor bright, largest number of pixels used.
LEAST_MODULATION, MOST_REST, LEAST_SMOOTH, MOST_PIXELS = 0.08, 0.25, 0.25, 4000
MOST_STEPS = 18
# If the mean of the unit phasors is larger, too little of a fringe is in view to measure the steps.
MOST_ONE_PHASE, ROUNDS = 0.5, 6
# Frequency ratios above the first value are compared with whole numbers that differ from them by at
# most the second share. A whole number fits if the mean of unit phasors exceeds the third value.
WHOLE_FROM, RATIO_ERROR, WHOLE_AGREE = 1.5, 0.2, 0.6
# Least ratio of the phase increments of a coarse period along its axis and across it.
ACROSS = 2.0


class Phasor(NamedTuple):
    """Mean and complex modulation of a phase set at each sample of some lines.

    All fields are (line, sample). `is_lit` is True for samples with enough light.
    """

    mean: FloatArray  # of u - 1/2
    z: FloatArray  # complex: its magnitude is the modulation, its argument the phase
    is_lit: BoolImage


def phase_sets(
    features: Sequence[ImageFeatures], axis: Axis
) -> tuple[list[FrameGroup], list[ImageFeatures]]:
    """Return the phase sets among striped images of one axis, and the images in no set."""
    rest, sets = list(features), []
    for first in features:
        if first not in rest:
            continue
        for step_set in _even_sets([image for image in rest if is_same(image, first)]):
            rest = [image for image in rest if image.file not in step_set.files]
            sets.append(step_set)
    return sets, rest


def _even_sets(same: list[ImageFeatures]) -> Iterator[FrameGroup]:
    """Yield the phase sets that images of one frequency form: one, several of equal size, none."""
    shifts = even_steps(same)
    if shifts is not None:
        yield _group(same, shifts)
        return
    for count in range(len(same) // 2, 2, -1):
        blocks = [same[k : k + count] for k in range(0, len(same), count)]
        shifts_of_blocks = [even_steps(block) for block in blocks]
        if len(same) % count == 0 and all(shifts is not None for shifts in shifts_of_blocks):
            yield from (
                _group(a, b) for a, b in zip(blocks, shifts_of_blocks, strict=True) if b is not None
            )
            return


def _group(features: Sequence[ImageFeatures], shifts: tuple[float, ...]) -> FrameGroup:
    axis = features[0].axis
    turns = abs(_turns_per_px(phasor(features, shifts, axis)))
    return FrameGroup("phase", axis, tuple(image.file for image in features), shifts, turns)


def phasor(
    features: Sequence[ImageFeatures], shifts_deg: Sequence[float] | FloatArray, axis: Axis
) -> Phasor:
    """Return mean and complex modulation of a phase set along the lines of an axis.

    Parameters
    ----------
    features : images of the set
    shifts_deg : phase shift of each image
    axis : axis along which the lines are
    """
    frames = np.stack([image.along[axis] for image in features])
    z = np.tensordot(np.exp(-1j * np.radians(shifts_deg)), frames, axes=1) * 2.0 / len(features)
    return Phasor(frames.mean(axis=0), z, features[0].lit[axis])


def _turns_per_px(fields: Phasor) -> float:
    """Return the mean phase increment of a phase set from pixel to pixel, turns.

    In contrast to the peak of a spectrum it is also correct if only one fringe is in view.
    """
    both = fields.is_lit[:, 1:] & fields.is_lit[:, :-1]
    return float(np.angle(np.sum((fields.z[:, 1:] * np.conj(fields.z[:, :-1]))[both]))) / (
        2.0 * np.pi
    )


def is_same(first: ImageFeatures, second: ImageFeatures) -> bool:
    """Return True if the stripes of two images have equal frequencies."""
    length = first.lines.shape[1]
    is_few = second.frequency * length < FEW_CYCLES
    difference = abs(first.frequency - second.frequency) * length
    return bool(difference < (SAME_OF_FEW if is_few else SAME_CYCLES))


def even_steps(features: Sequence[ImageFeatures]) -> tuple[float, ...] | None:
    """Return the shift of each image, degrees, or None if they are not equal steps of a turn."""
    count = len(features)
    if count < 3 or np.median([image.smooth for image in features]) < SMOOTH:
        return None
    at = round(
        float(np.median([image.frequency for image in features]))
        * PADDED
        * features[0].lines.shape[1]
    )
    values = [spectrum(image.lines)[:, max(at - PADDED, 1) : at + PADDED + 1] for image in features]
    phases = [float(np.angle(np.sum(value * np.conj(values[0])))) for value in values]
    steps = np.array(phases) * count / (2.0 * np.pi)
    whole = np.rint(steps)
    is_even = bool(np.all(np.abs(steps - whole) < EVEN)) and len(set(whole % count)) == count
    return tuple(float(k % count) * 360.0 / count for k in whole) if is_even else None


def stepped_sets(features: Sequence[ImageFeatures]) -> list[FrameGroup]:
    """Return the phase sets of four or more images that are consecutive by name."""
    pixels = _pixels(features)
    sets: list[FrameGroup] = []
    first = 0
    while first < len(features):
        residuals = {n: _stepped_rest(pixels, first, n) for n in range(4, MOST_STEPS + 1)}
        # If little of a fringe is in view, a wrong number of steps fits, too, but less well.
        count = min(residuals, key=lambda n: residuals[n])
        count = count if residuals[count] < MOST_REST else 0
        if count:
            sets.append(_along_its_axis(features[first : first + count])[0])
        first += count or 1
    return sets


def _pixels(features: Sequence[ImageFeatures]) -> FloatArray:
    """Return u - 1/2 of all images, (image, pixel), at about MOST_PIXELS lit pixels."""
    values = [
        np.stack([image.along[axis] for image in features])[:, features[0].lit[axis]]
        for axis in AXES
    ]
    both = np.concatenate(values, axis=1)
    return np.asarray(both[:, :: max(both.shape[1] // MOST_PIXELS, 1)], np.float64)


def _stepped_rest(pixels: FloatArray, first: int, count: int) -> float:
    """Return the median residual of A + B cos(phi + 2 pi n / N), in units of B.

    The residual of a pixel is the RMS over the N = `count` images from image `first` on. The result
    is infinity if too few pixels follow the cosine, or if the steps are not equal.
    """
    frames = pixels[first : first + count]
    if len(frames) < count or not frames.size:
        return np.inf
    angles = 2.0 * np.pi * np.arange(count) / count
    mean, z = frames.mean(axis=0), np.exp(-1j * angles) @ frames * 2.0 / count
    size = np.abs(z)
    fit = mean + np.real(z * np.exp(1j * angles)[:, np.newaxis])
    rest = np.sqrt(np.sum((frames - fit) ** 2, axis=0) / (count - 3))
    is_clear = (size > LEAST_MODULATION) & (rest < MOST_REST * size)
    # Consecutive bits may fit a cosine, too. But most pixels of bits are either dark or bright.
    low, high = (frames - mean)[:, is_clear].min(axis=0), (frames - mean)[:, is_clear].max(axis=0)
    u = ((frames - mean)[:, is_clear] - low) / np.maximum(high - low, 1e-9)
    smooth = np.mean((u > EXTREME) & (u < 1.0 - EXTREME)) if u.size else 0.0
    if np.mean(is_clear) <= SAME_SHARE or smooth <= LEAST_SMOOTH:
        return np.inf
    if not _has_equal_steps(frames[:, is_clear], z[is_clear]):
        return np.inf
    return float(np.median(rest[is_clear] / size[is_clear]))


def _has_equal_steps(frames: FloatArray, z: FloatArray) -> bool:
    """Return True if the measured phase steps of the frames are equal steps of a turn.

    The test is needed because 11 of 12 equal steps fit 11 equal steps nearly as well. Two least
    squares fits alternate: over the frames for mean and modulation of each pixel, and over the
    pixels for the phase of each frame (Wang and Han, Opt. Lett. 29, 1671 (2004)). If only a small
    part of a fringe is in view, the two fits are not independent, and the result is True.

    Parameters
    ----------
    frames : (step, pixel) u - 1/2
    z : (pixel,) complex modulation, computed for equal steps
    """
    if abs(np.mean(z / np.abs(z))) > MOST_ONE_PHASE:
        return True
    stated = 2.0 * np.pi * np.arange(len(frames)) / len(frames)
    steps = stated
    for _ in range(ROUNDS):
        design = np.stack([np.ones_like(steps), np.cos(steps), -np.sin(steps)], axis=1)
        mean, real, imaginary = np.linalg.lstsq(design, frames)[0]
        cosine, sine = np.linalg.lstsq(np.stack([real, -imaginary], axis=1), (frames - mean).T)[0]
        steps = np.arctan2(sine, cosine)
    difference = np.exp(1j * (steps - stated))
    off = np.angle(difference / np.mean(difference))
    return bool(np.max(np.abs(off)) * len(frames) / (2.0 * np.pi) < EVEN)


def coarse_sets(
    features: Sequence[ImageFeatures], known: Sequence[FrameGroup], taken: set[str]
) -> tuple[list[FrameGroup], list[str]]:
    """Return phase sets with a period too coarse to be visible as stripes, and doubts about them.

    Parameters
    ----------
    features : all images, in the order of their names
    known : phase sets of finer periods
    taken : files of the known sets

    Returns
    -------
    the sets, and messages about uncertain values
    """
    by_file = {image.file: image for image in features}
    references = [
        (len(fine.files), _reference([by_file[name] for name in fine.files], fine.shifts_deg))
        for fine in known
    ]
    # Besides white and black there are at most three images, which may be the steps of one set.
    is_three = sum(image.kind not in ("white", "black") for image in features) <= 3
    plain = [
        k
        for k in range(len(features) - 1)
        if {features[k].kind, features[k + 1].kind} == {"white", "black"}
    ]
    if not known and plain and is_three:
        # White and black, as two steps of opposite phase, have the mean and modulation of fringes.
        references.append((3, _reference(features[plain[-1] : plain[-1] + 2], (0.0, 180.0))))
    sets: list[FrameGroup] = []
    doubts: list[str] = []
    names = [image.file for image in features]
    places = [sorted(names.index(name) for name in fine.files) for fine in known]
    in_row = all(some[-1] - some[0] == len(some) - 1 for some in places)
    for count, reference in references:
        for first in range(len(features) - count + 1):
            block = features[first : first + count]
            is_free = not any(image.file in taken for image in block)
            if is_free and _has_same_light(block, reference):
                step_set, doubt = _along_its_axis(block)
                if not in_row:
                    doubt = [
                        *doubt,
                        f"{step_set.files[0]} ...: taken for steps of a coarse fringe by the"
                        " order of their names, which is not that of the fine fringes",
                    ]
                sets.append(step_set)
                doubts += doubt
                taken = taken | set(step_set.files)
    return sets, doubts


def _reference(
    features: Sequence[ImageFeatures], shifts_deg: Sequence[float]
) -> dict[Axis, Phasor]:
    scale = 0.5 if len(features) == 2 else 1.0  # with two frames the sum is twice the modulation
    phasors = {axis: phasor(features, shifts_deg, axis) for axis in AXES}
    return {
        axis: phasor_of_axis._replace(z=scale * phasor_of_axis.z)
        for axis, phasor_of_axis in phasors.items()
    }


def _has_same_light(block: Sequence[ImageFeatures], reference: dict[Axis, Phasor]) -> bool:
    """Return True if, as a phase set, images have the mean and modulation of a known set.

    This must be true at nearly all pixels.
    """
    agree, total = 0, 0
    for axis, fine in reference.items():
        coarse = phasor(block, 360.0 * np.arange(len(block)) / len(block), axis)
        size, modulation = np.abs(coarse.z), np.maximum(np.abs(fine.z), 1e-3)
        is_same_light = (np.abs(coarse.mean - fine.mean) < SAME_MEAN * modulation) & (
            np.abs(size / modulation - 1.0) < SAME_MODULATION
        )
        agree += int(np.count_nonzero(is_same_light & fine.is_lit))
        total += int(np.count_nonzero(fine.is_lit))
    return agree > SAME_SHARE * total > 0


def _along_its_axis(block: Sequence[ImageFeatures]) -> tuple[FrameGroup, list[str]]:
    """Return consecutive images as a phase set, and doubts about its axis.

    The axis is that along which the phase changes most. The sign of the shifts is chosen such that
    the phase increases along the lines of this axis.
    """
    shifts = 360.0 * np.arange(len(block)) / len(block)
    turns = {axis: _turns_per_px(phasor(block, shifts, axis)) for axis in AXES}
    axis = max(AXES, key=lambda name_of_axis: abs(turns[name_of_axis]))
    files = tuple(image.file for image in block)
    across = turns[AXES[1 - AXES.index(axis)]]
    doubts = []
    if abs(turns[axis]) < ACROSS * abs(across):
        doubts.append(f"{files[0]} ...: fringes along {axis} are hardly clearer than across")
    if turns[axis] < 0.0:
        shifts = -shifts % 360.0
    return FrameGroup("phase", axis, files, tuple(shifts.tolist()), abs(turns[axis])), doubts


def with_whole_ratios(
    features: Sequence[ImageFeatures], sets: Sequence[FrameGroup]
) -> list[FrameGroup]:
    """Return the phase sets, with frequencies replaced by whole multiples R of the coarsest one.

    A frequency is replaced if R phi_coarse - phi_fine is equal at all pixels. R is exact, in
    contrast to a ratio of measured frequencies.
    """
    by_file = {image.file: image for image in features}
    result = []
    for fringe_set in sets:
        same = [step_set for step_set in sets if step_set.axis == fringe_set.axis]
        coarsest = min(same, key=lambda step_set: step_set.frequency)
        ratio = fringe_set.frequency / max(coarsest.frequency, 1e-9)
        whole = _whole_ratio(by_file, coarsest, fringe_set, ratio) if ratio > WHOLE_FROM else None
        result.append(
            replace(fringe_set, frequency=whole * coarsest.frequency) if whole else fringe_set
        )
    return result


def _whole_ratio(
    by_file: dict[str, ImageFeatures], coarsest: FrameGroup, fine: FrameGroup, ratio: float
) -> int | None:
    axis = fine.axis or "column"
    slow, fast = (
        phasor([by_file[name] for name in fringe_set.files], fringe_set.shifts_deg, axis)
        for fringe_set in (coarsest, fine)
    )
    phase, step = np.angle(slow.z[slow.is_lit]), np.angle(fast.z[slow.is_lit])
    low, high = (round(ratio * (1.0 + sign * RATIO_ERROR)) for sign in (-1.0, 1.0))
    # Only positive ratios are tried. The ratio would be negative if one phase increases along the
    # lines and the other decreases.
    agree = {n: abs(np.mean(np.exp(1j * (step - n * phase)))) for n in range(max(low, 2), high + 1)}
    best = max(agree, key=lambda n: agree[n], default=0)
    return best if best and agree[best] > WHOLE_AGREE else None


def lone_fringes(features: Sequence[ImageFeatures]) -> list[ImageFeatures]:
    """Return images that look like fringes of equal frequency but have no equal phase steps.

    An image of their set may be missing. Two complementary images are left out, because they are
    more likely a bit and its inverse.
    """
    lone = []
    for image in features:
        same = [
            candidate
            for candidate in features
            if is_same(candidate, image) and candidate.smooth > SMOOTH
        ]
        is_pair = len(same) == 2 and are_opposite(same[0], same[1])
        if image in same and len(same) > 1 and not is_pair:
            lone.append(image)
    return lone


def are_opposite(first: ImageFeatures, second: ImageFeatures) -> bool:
    """Return True if two images are complementary: each is bright where the other is dark.

    The criterion is a correlation of the levels u - 1/2 below COMPLEMENTARY over the samples that
    are lit in both images. The result is False if the two images vary along different axes.
    """
    both = (
        first.is_lit & second.is_lit if first.axis == second.axis else np.zeros_like(first.is_lit)
    )
    if not both.any():
        return False
    a, b = first.lines[both], second.lines[both]
    size = float(np.sqrt(np.sum(a * a) * np.sum(b * b)))
    return bool(float(np.sum(a * b)) < COMPLEMENTARY * size)
