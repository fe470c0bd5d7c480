"""Images without stripes: white and black themselves, or bits that do not change within the view.

Names decide where they say it. Otherwise every pair of a white and a black image, one of them, or
none may be meant: taken are those with which the bits that remain contradict one another least,
and of equals those at the end or at the beginning of the sequence.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from reconstruction.capture.image_looks import Look, named
from reconstruction.capture.word_order import MARGIN
from reconstruction.patterns import AXES, Axis

Choice = tuple[int | None, int | None]
# Preferences among choices that contradict the bits alike.
LAST, FIRST, WITHIN, LONE, NONE, NOTHING_TO_COMPARE = 0.0, 0.05, 0.2, 0.3, 0.25, 0.3


@dataclass(frozen=True)
class PlainLooks:
    """What the images without stripes are.

    Parameters
    ----------
    white, black : their indices, None: there is none
    bits : the axis of each of the others, by index: a bit that does not change within the view
    is_certain : no other choice fits the bits about as well
    """

    white: int | None
    black: int | None
    bits: dict[int, Axis]
    is_certain: bool


def choose_plain(
    looks: Sequence[Look],
    striped_bits: dict[int, Axis],
    cost: Callable[[dict[int, Axis]], float],
    *,
    needs_uniform: bool,
) -> PlainLooks:
    """Return which images without stripes are white, black, and bits.

    Parameters
    ----------
    striped_bits : axis of the images that are bits with stripes, by index
    cost : what contradicts the order of all bits, of their axes by index
    needs_uniform : without white and black there would be nothing to compare bits with
    """
    plain = [k for k, one in enumerate(looks) if one.kind in ("white", "black")]
    rated = []
    for choice in _choices(looks, plain):
        rest = {k: _axis(looks, striped_bits, k) for k in plain if k not in choice}
        steady = {k: axis for k, axis in rest.items() if axis is not None}
        preference = _preference(looks, choice, needs_uniform=needs_uniform)
        unused = len(rest) - len(steady)
        rated.append((cost(striped_bits | steady) + preference + unused, choice, steady))
    rated.sort(key=lambda one: one[0])
    best, (white, black), steady = rated[0]
    is_certain = len(rated) == 1 or rated[1][0] > best + MARGIN
    return PlainLooks(white, black, steady, is_certain)


def _choices(looks: Sequence[Look], plain: Sequence[int]) -> Iterator[Choice]:
    """Yield what may be white and black; what names say is not put in question."""
    options: dict[str, list[int | None]] = {}
    for kind in ("white", "black"):
        such = [k for k in plain if looks[k].kind == kind and not named(looks[k]) & set(AXES)]
        by_name = [k for k in such if kind in named(looks[k])]
        options[kind] = [by_name[0]] if by_name else [*such, None]
    is_lone = {
        kind: len([k for k in found if k is not None]) <= 1 for kind, found in options.items()
    }
    for white in options["white"]:
        for black in options["black"]:
            both = white is not None and black is not None
            if not both or all(is_lone.values()) or abs(white - black) == 1:  # type: ignore[operator]
                yield white, black


def _preference(looks: Sequence[Look], choice: Choice, *, needs_uniform: bool) -> float:
    found = [k for k in choice if k is not None]
    lacking = NOTHING_TO_COMPARE if needs_uniform and len(found) < 2 else 0.0
    if not found:
        return NONE + lacking
    is_last, is_first = max(found) == len(looks) - 1, min(found) == 0
    outside = LAST if is_last else FIRST
    return (outside if is_last or is_first else WITHIN) + LONE * (len(found) == 1) + lacking


def _axis(looks: Sequence[Look], striped_bits: dict[int, Axis], k: int) -> Axis | None:
    """Return the axis of a bit without stripes: by its name, or that of the bits that follow."""
    by_name = [axis for axis in AXES if axis in named(looks[k])]
    if len(by_name) == 1:
        return by_name[0]
    after = [n for n in striped_bits if n > k]
    before = [n for n in striped_bits if n < k]
    if after:
        return striped_bits[min(after)]
    return striped_bits[max(before)] if before else None
