"""Images without stripes: white and black, or bits that do not change within the view.

Names decide if they contain the kind. Otherwise a white and a black image, only one of them, or
neither may be present. The choice with the fewest contradictions between the remaining bits is
used, among equal choices that at the end or at the start of the sequence.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from reconstruction.capture.image_features import ImageFeatures, named
from reconstruction.capture.word_order import MARGIN
from reconstruction.patterns import AXES, Axis

Choice = tuple[int | None, int | None]
# Preferences among choices with equal contradictions between the bits.
LAST, FIRST, WITHIN, LONE, NONE, NOTHING_TO_COMPARE = 0.0, 0.05, 0.2, 0.3, 0.25, 0.3


@dataclass(frozen=True)
class UniformImages:
    """Assignment of the images without stripes.

    Parameters
    ----------
    white, black : their indices, None: there is none
    bits : axis of each remaining image, by index: a bit that does not change within the view
    is_certain : no other choice fits the bits about as well
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
    """Return which images without stripes are white, black, and bits.

    Parameters
    ----------
    striped_bits : axis of the images that are bits with stripes, by index
    cost : sum of contradictions in the order of all bits, from their axes by index
    needs_uniform : without white and black the bits would have no threshold
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
    """Yield the candidates for white and black; the names are not questioned."""
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
    """Return the axis of a bit without stripes: from its name, or that of the bits after it."""
    by_name = [axis for axis in AXES if axis in named(features[k])]
    if len(by_name) == 1:
        return by_name[0]
    after = [n for n in striped_bits if n > k]
    before = [n for n in striped_bits if n < k]
    if after:
        return striped_bits[min(after)]
    return striped_bits[max(before)] if before else None
