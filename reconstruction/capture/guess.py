"""Guess the patterns that images of unknown content show.

- Sets of equal phase steps are detected by their content, see `phase_steps`.
- Other striped images are bits, in the order of their names unless the images clearly contradict
  this order. Two complementary images are a bit and its inverse. Code words are binary, not Gray,
  if several bits change at the same place. See `word_bits`.
- Images without stripes are white, black, or bits that do not change within the view, see
  `uniform_images`. Grey images next to the bits are the finest bits, which the camera does not
  resolve.
- If bits number the fringes, the phase at the borders of the code words determines the shift of the
  first phase frame. The direction in which the words increase determines the sign of the shifts.
  See `phase_anchor`.
- The width of a stripe in projector pixels is not visible in the images. It is assumed, see
  `guess_file`.

Every uncertain value is listed in a message, called doubt. A guess without a doubt must be right.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from reconstruction.arrays import FloatImage
from reconstruction.capture.guess_doubts import (
    anchor_doubts,
    content_doubts,
    gap_doubts,
    left_out_doubts,
    plain_doubts,
    repeated_doubts,
    scattered_doubts,
    uneven_doubts,
    unnumbered_doubts,
)
from reconstruction.capture.image_features import (
    CERTAIN,
    FolderFeatures,
    FrameGroup,
    ImageFeatures,
    analyse_folder,
    peak,
)
from reconstruction.capture.phase_anchor import NumberedLines, anchored
from reconstruction.capture.phase_steps import (
    coarse_sets,
    lone_fringes,
    phase_sets,
    phasor,
    stepped_sets,
    with_whole_ratios,
)
from reconstruction.capture.uniform_images import UniformImages, choose_plain
from reconstruction.capture.word_bits import ArrangedBits, Bits, arranged, bits_of
from reconstruction.patterns import AXES, Axis

# Grey images within this distance after a bit, in the order of names, are bits or inverses.
NEAR_NAMES = 2
# With fewer bits than this the choice of white and black is uncertain.
FEW_BITS = 3


@dataclass(frozen=True)
class Guess:
    """Guessed patterns of the images in a folder.

    Parameters
    ----------
    groups : groups of images of equal kind, in the order of the tables [[frames]]
    word : encoding of the code words, "reflected" or "binary"
    unsure : doubts: messages of one line about values that the user should check
    folder_features : features of the images
    words : code words along each axis that has bits
    """

    groups: tuple[FrameGroup, ...]
    word: str
    unsure: tuple[str, ...]
    folder_features: FolderFeatures
    words: tuple[NumberedLines, ...] = ()


def guess(folder: Path, size: tuple[int, int]) -> Guess:
    """Guess the patterns that the images in a folder and its subfolders show.

    Parameters
    ----------
    size : image size of the projector (width, height), px

    Raises
    ------
    CaptureError : there are too few images, one is damaged, or all are equal
    """
    folder_features = analyse_folder(folder)
    features = _with_axes(folder_features.features)
    phases, striped, fringe_doubts = _fringes(features)
    bits, plain, is_needed = _words(features, phases, striped)
    scattered = scattered_doubts(features, phases)
    if scattered:
        plain = replace(plain, is_certain=False)
    along = [_along(axis, features, phases, bits[axis], size) for axis in AXES]
    groups = [group for along_axis in along for group in along_axis.groups] + _plain_groups(
        features, plain
    )
    doubts = [
        *(f"{name}: has another size, left out" for name in folder_features.left_out),
        *gap_doubts([image.file for image in features]),
        *fringe_doubts,
        *(doubt for axis in AXES for doubt in bits[axis].doubts),
        *scattered,
        *plain_doubts(features, plain, is_needed=is_needed),
        *(doubt for along_axis in along for doubt in along_axis.doubts),
        *(doubt for axis in AXES for doubt in anchor_doubts(groups, axis, bits[axis], plain)),
    ]
    doubts += left_out_doubts(features, groups, doubts) + content_doubts(features, groups)
    words = tuple(along_axis.words for along_axis in along if along_axis.words)
    kinds = sorted({numbered.word for numbered in words})
    if len(kinds) > 1:
        doubts.append("word: Gray and binary bits along different axes; list one axis only")
    return Guess(tuple(groups), (*kinds, "reflected")[0], tuple(doubts), folder_features, words)


@dataclass(frozen=True, eq=False)
class _AlongAxis:
    """Groups of images along one axis, code words that number its fringes (or None), and doubts."""

    groups: tuple[FrameGroup, ...]
    words: NumberedLines | None
    doubts: tuple[str, ...]


def _along(
    axis: Axis,
    features: Sequence[ImageFeatures],
    phases: Sequence[FrameGroup],
    bits: ArrangedBits,
    size: tuple[int, int],
) -> _AlongAxis:
    own = [group for group in phases if group.axis == axis]
    if not bits.groups:
        doubts = unnumbered_doubts(own[0], features) if len(own) == 1 else []
        return _AlongAxis(tuple(own), None, tuple(doubts))
    words = NumberedLines.of(features, bits.groups, bits.word, _mean(features, phases, axis))
    anchored_sets = [anchored(group, words, features, size[AXES.index(axis)]) for group in own]
    groups = *(group for group, _ in anchored_sets), *bits.groups
    return _AlongAxis(groups, words, tuple(doubt for _, doubt in anchored_sets if doubt))


def _plain_groups(features: Sequence[ImageFeatures], plain: UniformImages) -> list[FrameGroup]:
    shown = (("white", plain.white), ("black", plain.black))
    return [FrameGroup(kind, None, (features[k].file,)) for kind, k in shown if k is not None]


def _words(
    features: Sequence[ImageFeatures], phases: Sequence[FrameGroup], striped: dict[int, Axis]
) -> tuple[dict[Axis, ArrangedBits], UniformImages, bool]:
    """Return the bits along each axis, white and black, and if white and black are needed.

    They are needed as threshold of the bits if there are neither phase frames nor inverses.

    Parameters
    ----------
    striped : axis of each image with stripes that is no phase frame, by index of the image
    """
    taken = {name for group in phases for name in group.files}
    striped = _with_grey(features, striped, taken)
    means = {axis: _mean(features, phases, axis) for axis in AXES}

    def bits_along(axes: dict[int, Axis], axis: Axis) -> Bits:
        return bits_of(features, sorted(k for k in axes if axes[k] == axis), axis, means[axis])

    def cost(axes: dict[int, Axis]) -> float:
        return sum(bits_along(axes, axis).cost for axis in set(axes.values()))

    # A coarse phase step may resemble white or black.
    candidates = [
        replace(image, kind="phase") if image.file in taken else image for image in features
    ]
    is_paired = any(bits_along(striped, axis).inverses for axis in set(striped.values()))
    is_needed = bool(striped) and not (phases or is_paired)
    plain = choose_plain(candidates, striped, cost, needs_uniform=is_needed)
    bits = {axis: arranged(bits_along(striped | plain.bits, axis)) for axis in AXES}
    number = sum(len(axis_bits.groups[0].files) for axis_bits in bits.values() if axis_bits.groups)
    if not all(axis_bits.is_by_names for axis_bits in bits.values()) or 0 < number < FEW_BITS:
        plain = replace(plain, is_certain=False)
    return bits, plain, is_needed


def _with_axes(features: Sequence[ImageFeatures]) -> list[ImageFeatures]:
    """Return the images; an uncertain axis is replaced by that of the neighbours by name.

    The neighbours are the next images before and after with a certain axis.
    """
    result = list(features)
    certain = [
        k for k, image in enumerate(features) if _is_striped(image) and image.certainty >= CERTAIN
    ]
    for k, image in enumerate(features):
        if not _is_striped(image) or image.certainty >= CERTAIN:
            continue
        near = [n for n in certain if n < k][-1:] + [n for n in certain if n > k][:1]
        axes = {features[n].axis for n in near}
        if len(axes) == 1 and image.axis not in axes:
            axis = axes.pop()
            result[k] = replace(image, axis=axis, frequency=peak(image.along[axis]))
    return result


def _is_striped(image: ImageFeatures) -> bool:
    return image.kind in ("striped", "faint")


def _fringes(
    features: Sequence[ImageFeatures],
) -> tuple[list[FrameGroup], dict[int, Axis], list[str]]:
    """Return the phase sets, the axis of each image that is a bit by its index, and doubts."""
    phases = stepped_sets(features)
    taken = {name for group in phases for name in group.files}
    for axis in AXES:
        striped = [o for o in features if _is_striped(o) and o.axis == axis and o.file not in taken]
        phases += phase_sets(striped, axis)[0]
    taken = {name for group in phases for name in group.files}
    coarse, doubts = coarse_sets(features, phases, taken)
    phases = with_whole_ratios(features, [*phases, *coarse])
    taken |= {name for group in coarse for name in group.files}
    rest = [image for image in features if image.file not in taken and image.kind == "striped"]
    lone = [
        image
        for axis in AXES
        for image in lone_fringes([striped for striped in rest if striped.axis == axis])
    ]
    if lone:
        names = ", ".join(image.file for image in lone)
        doubts.append(
            f"{names}: look like fringes, but are no equal steps of a turn, left out; one may be"
            " missing"
        )
    doubts += uneven_doubts(phases, features) + repeated_doubts(phases, features)
    excluded = {image.file for image in lone}
    bits = {
        k: image.axis
        for k, image in enumerate(features)
        if image.kind == "striped" and image.file not in taken | excluded
    }
    return phases, bits, doubts


def _mean(
    features: Sequence[ImageFeatures], phases: Sequence[FrameGroup], axis: Axis
) -> FloatImage | None:
    by_file = {image.file: image for image in features}
    first = next((group for group in phases if group.axis == axis), None)
    if first is None:
        return None
    return np.asarray(
        phasor([by_file[name] for name in first.files], first.shifts_deg, axis).mean, np.float32
    )


def _with_grey(
    features: Sequence[ImageFeatures], bits: dict[int, Axis], taken: set[str]
) -> dict[int, Axis]:
    """Return the axes of `bits` and of hardly resolved images that follow a bit by name.

    Both are by index of the image. `taken` has the files of phase frames.
    """
    with_grey = dict(bits)
    for k, image in enumerate(features):
        if image.kind in ("faint", "grey") and image.file not in taken:
            near = [n for n in with_grey if 0 < k - n <= NEAR_NAMES]
            if near:
                with_grey[k] = with_grey[max(near)]
    return with_grey
