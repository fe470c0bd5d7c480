"""Phase sets among the images of an unknown set.

- Four or more images that are consecutive by their names are a set if every pixel has equal steps
  of a turn, for any visible part of a fringe.
- Three or more striped images of one axis and one frequency are a set if their phases are equal
  steps of a turn; the phase of each is its cross spectrum with the first.
- A set determines mean A and modulation B of every pixel. Further images that are consecutive by
  their names are steps of a coarser period, possibly with a small part of it in view, if A and B of
  every pixel are the same: bits never have that mean.
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

# Frequencies that differ by less are equal, cycles per line: with few fringes the phase moves the
# peak of the spectrum.
SAME_CYCLES, SAME_OF_FEW, FEW_CYCLES = 0.4, 0.8, 3.0
# Least share of neither dark nor bright pixels of a cosine: with three steps only, a pixel is
# darkest in one step and brightest in another.
SMOOTH = 0.12
# Largest deviation of phases from equal steps, as a share of a step.
EVEN = 0.2
# Two steps of one period may differ by half a turn.
COMPLEMENTARY = -0.8
# A coarser period: largest deviation of mean and modulation from those of the known set, in units
# of the modulation, at this share of the pixels; and the number of its steps.
SAME_MEAN, SAME_MODULATION, SAME_SHARE = 0.2, 0.35, 0.8
# Of consecutive steps: least modulation, u; RMS residual in modulations; share of pixels neither
# dark nor bright; pixels used.
LEAST_MODULATION, MOST_REST, LEAST_SMOOTH, MOST_PIXELS = 0.08, 0.25, 0.25, 4000
MOST_STEPS = 18
# Mean of the unit phasors above which too little of a fringe is in view to measure the steps.
MOST_ONE_PHASE, ROUNDS = 0.5, 6
# Ratios of two frequencies above this are tried as whole numbers, within this share of the ratio of
# the slopes; the mean of unit phasors above which a whole number fits.
WHOLE_FROM, RATIO_ERROR, WHOLE_AGREE = 1.5, 0.2, 0.6
# Ratio by which the phase of a coarse period must increase more along its axis than across.
ACROSS = 2.0


class Phasor(NamedTuple):
    """Mean and complex modulation of a set at the pixels of some lines, (line, sample) each."""

    mean: FloatArray  # of u - 1/2
    z: FloatArray  # complex, its amount is the modulation
    is_lit: BoolImage


def phase_sets(
    features: Sequence[ImageFeatures], axis: Axis
) -> tuple[list[FrameGroup], list[ImageFeatures]]:
    """Return the phase sets among striped images of one axis, and the other images."""
    rest, sets = list(features), []
    for first in features:
        if first not in rest:
            continue
        for step_set in _even_sets([image for image in rest if is_same(image, first)]):
            rest = [image for image in rest if image.file not in step_set.files]
            sets.append(step_set)
    return sets, rest


def _even_sets(same: list[ImageFeatures]) -> Iterator[FrameGroup]:
    """Yield images of one frequency as a set, or split into equal blocks that are sets."""
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
    """Return mean and complex modulation of a set along the lines of an axis."""
    frames = np.stack([image.along[axis] for image in features])
    z = np.tensordot(np.exp(-1j * np.radians(shifts_deg)), frames, axes=1) * 2.0 / len(features)
    return Phasor(frames.mean(axis=0), z, features[0].lit[axis])


def _turns_per_px(fields: Phasor) -> float:
    """Return the phase increment of a set from pixel to pixel, turns.

    In contrast to the peak of a spectrum it is also correct for a single fringe.
    """
    both = fields.is_lit[:, 1:] & fields.is_lit[:, :-1]
    return float(np.angle(np.sum((fields.z[:, 1:] * np.conj(fields.z[:, :-1]))[both]))) / (
        2.0 * np.pi
    )


def is_same(first: ImageFeatures, second: ImageFeatures) -> bool:
    """Whether two images have stripes of one frequency."""
    length = first.lines.shape[1]
    is_few = second.frequency * length < FEW_CYCLES
    difference = abs(first.frequency - second.frequency) * length
    return bool(difference < (SAME_OF_FEW if is_few else SAME_CYCLES))


def even_steps(features: Sequence[ImageFeatures]) -> tuple[float, ...] | None:
    """Return the shifts, degrees, if the phases of these images are equal steps of a turn."""
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
    """Return sets of four or more images that are consecutive by name, in equal steps."""
    pixels = _pixels(features)
    sets: list[FrameGroup] = []
    first = 0
    while first < len(features):
        residuals = {n: _stepped_rest(pixels, first, n) for n in range(4, MOST_STEPS + 1)}
        # With little of a fringe in view, a wrong number of steps fits as well, but worse.
        count = min(residuals, key=lambda n: residuals[n])
        count = count if residuals[count] < MOST_REST else 0
        if count:
            sets.append(_along_its_axis(features[first : first + count])[0])
        first += count or 1
    return sets


def _pixels(features: Sequence[ImageFeatures]) -> FloatArray:
    """Return u - 1/2 at some lit pixels, (image, pixel)."""
    values = [
        np.stack([image.along[axis] for image in features])[:, features[0].lit[axis]]
        for axis in AXES
    ]
    both = np.concatenate(values, axis=1)
    return np.asarray(both[:, :: max(both.shape[1] // MOST_PIXELS, 1)], np.float64)


def _stepped_rest(pixels: FloatArray, first: int, count: int) -> float:
    """Return the RMS residual of A + B cos(phi + 2 pi n / N) at nearly all pixels over B.

    Infinity if fewer pixels follow the cosine, or the steps are not equal.
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
    # The middle frames of three bits in four would fit as well: but bits are dark or bright.
    low, high = (frames - mean)[:, is_clear].min(axis=0), (frames - mean)[:, is_clear].max(axis=0)
    u = ((frames - mean)[:, is_clear] - low) / np.maximum(high - low, 1e-9)
    smooth = np.mean((u > EXTREME) & (u < 1.0 - EXTREME)) if u.size else 0.0
    if np.mean(is_clear) <= SAME_SHARE or smooth <= LEAST_SMOOTH:
        return np.inf
    if not _has_equal_steps(frames[:, is_clear], z[is_clear]):
        return np.inf
    return float(np.median(rest[is_clear] / size[is_clear]))


def _has_equal_steps(frames: FloatArray, z: FloatArray) -> bool:
    """Whether the phase of each frame (step, pixel) is its step: 11 steps of 12 fit nearly as well.

    Least squares over the pixels for the phase of each frame and over the frames for mean and
    modulation of each pixel, in turns (Wang and Han, Opt. Lett. 29, 1671 (2004)). In a view of a
    small part of a fringe these are not independent: equal steps are not tested there.

    Parameters
    ----------
    z : (pixel,) complex modulation as measured with equal steps
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
    """Return sets with a period too coarse to be visible as stripes, and doubts about them.

    Parameters
    ----------
    features : all images, in the order of their names
    known : sets of finer periods
    taken : files of the known sets
    """
    by_file = {image.file: image for image in features}
    references = [
        (len(fine.files), _reference([by_file[name] for name in fine.files], fine.shifts_deg))
        for fine in known
    ]
    # Only three steps, white and black.
    is_three = sum(image.kind not in ("white", "black") for image in features) <= 3
    plain = [
        k
        for k in range(len(features) - 1)
        if {features[k].kind, features[k + 1].kind} == {"white", "black"}
    ]
    if not known and plain and is_three:
        # Opposite in phase, white and black have mean and modulation of all fringes.
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
    """Whether images have mean and modulation of a known set at nearly all pixels."""
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
    """Return a set of steps in the order of the names, with a phase that increases along lines."""
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
    """Return the sets, with frequencies that are whole multiples of the coarsest if they fit.

    If so, R phi_coarse - phi_fine is the same for all pixels. R is exact, in contrast to slopes.
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
    # A coarsest set with a phase that decreases against the fine one would need a negative ratio.
    agree = {n: abs(np.mean(np.exp(1j * (step - n * phase)))) for n in range(max(low, 2), high + 1)}
    best = max(agree, key=lambda n: agree[n], default=0)
    return best if best and agree[best] > WHOLE_AGREE else None


def lone_fringes(features: Sequence[ImageFeatures]) -> list[ImageFeatures]:
    """Return smooth images that share a frequency, but are no equal steps: one may be missing.

    Two complementary images are rather a bit and its inverse.
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
    """Whether two images are each other's complement."""
    both = (
        first.is_lit & second.is_lit if first.axis == second.axis else np.zeros_like(first.is_lit)
    )
    if not both.any():
        return False
    a, b = first.lines[both], second.lines[both]
    size = float(np.sqrt(np.sum(a * a) * np.sum(b * b)))
    return bool(float(np.sum(a * b)) < COMPLEMENTARY * size)
