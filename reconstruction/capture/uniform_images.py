"""Assign images without stripes: white, black, or bits that do not change within the view.

An image is white or black if its name contains the kind. Otherwise a white and a black image, only
one of them, or neither may be present. The choice with the fewest contradictions between the
remaining bits is used (see `word_order`). Of equally good choices the one at the end of the
sequence is preferred, then the one at the start.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from reconstruction.capture.image_features import ImageFeatures, named
from reconstruction.capture.word_order import MARGIN
from reconstruction.patterns import AXES, Axis

Choice = tuple[int | None, int | None]
# Costs that are added to the contradictions between the bits: for the positions of white and black
# in the sequence, for only one of them, for none, and if bits lack a threshold.
LAST, FIRST, WITHIN, LONE, NONE, NOTHING_TO_COMPARE = 0.0, 0.05, 0.2, 0.3, 0.25, 0.3


@dataclass(frozen=True)
class UniformImages:
    """Assignment of the images without stripes.

    Parameters
    ----------
    white, black : index of the white and of the black image; None: there is none
    bits : axis of each image that is a bit which does not change within the view, by index
    is_certain : whether no other choice fits the bits about as well
    """

    white: int | None
    black: int | None
    bits: dict[int, Axis]
    is_certain: bool


def choose_plain(
    features: Sequence[ImageFeatures],
    striped_bits: dict[int, Axis],
    cost: Callable[[dict[int, Axis]], float],
    *,
    needs_uniform: bool,
) -> UniformImages:
    """Return which of the images without stripes are white, black, and bits.

    Parameters
    ----------
    features : all images, in the order of their names
    striped_bits : axis of each image that is a bit with stripes, by index of the image
    cost : function that takes the axis of each bit, by index of its image, and returns the sum of
        the contradictions between these bits
    needs_uniform : whether white and black are needed as threshold of the bits
    """
    plain = [k for k, image in enumerate(features) if image.kind in ("white", "black")]
    rated = []
    for choice in _choices(features, plain):
        rest = {k: _axis(features, striped_bits, k) for k in plain if k not in choice}
        steady = {k: axis for k, axis in rest.items() if axis is not None}
        preference = _preference(features, choice, needs_uniform=needs_uniform)
        unused = len(rest) - len(steady)
        rated.append((cost(striped_bits | steady) + preference + unused, choice, steady))
    rated.sort(key=lambda choice: choice[0])
    best, (white, black), steady = rated[0]
    is_certain = len(rated) == 1 or rated[1][0] > best + MARGIN
    return UniformImages(white, black, steady, is_certain)


def _choices(features: Sequence[ImageFeatures], plain: Sequence[int]) -> Iterator[Choice]:
    """Yield the possible pairs of white and black; a kind in the name of an image is decisive."""
    options: dict[str, list[int | None]] = {}
    for kind in ("white", "black"):
        such = [k for k in plain if features[k].kind == kind and not named(features[k]) & set(AXES)]
        by_name = [k for k in such if kind in named(features[k])]
        options[kind] = [by_name[0]] if by_name else [*such, None]
    is_lone = {
        kind: len([k for k in indices if k is not None]) <= 1 for kind, indices in options.items()
    }
    for white in options["white"]:
        for black in options["black"]:
            both = white is not None and black is not None
            if not both or all(is_lone.values()) or abs(white - black) == 1:  # type: ignore[operator]
                yield white, black


def _preference(features: Sequence[ImageFeatures], choice: Choice, *, needs_uniform: bool) -> float:
    indices = [k for k in choice if k is not None]
    lacking = NOTHING_TO_COMPARE if needs_uniform and len(indices) < 2 else 0.0
    if not indices:
        return NONE + lacking
    is_last, is_first = max(indices) == len(features) - 1, min(indices) == 0
    outside = LAST if is_last else FIRST
    return (outside if is_last or is_first else WITHIN) + LONE * (len(indices) == 1) + lacking


def _axis(features: Sequence[ImageFeatures], striped_bits: dict[int, Axis], k: int) -> Axis | None:
    """Return the axis of bit k without stripes, or None if there are no other bits.

    The axis is that in its name, otherwise that of the next bit with stripes, or of the last one.
    """
    by_name = [axis for axis in AXES if axis in named(features[k])]
    if len(by_name) == 1:
        return by_name[0]
    after = [n for n in striped_bits if n > k]
    before = [n for n in striped_bits if n < k]
    if after:
        return striped_bits[min(after)]
    return striped_bits[max(before)] if before else None
