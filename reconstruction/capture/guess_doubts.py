"""What is not sure about a guess: one line each, with the files it is about."""

from collections.abc import Iterable, Sequence

from reconstruction.capture.image_looks import CERTAIN, FrameGroup, Look, named
from reconstruction.capture.plain_looks import PlainLooks
from reconstruction.capture.word_looks import ArrangedBits
from reconstruction.patterns import AXES, Axis

# From so many fringes in view on one period is not taken for a single fringe.
SEVERAL_FRINGES = 1.5
# Less than this of a fringe in view leaves the three steps of a set without a check.
LITTLE_OF_A_FRINGE = 1.2
# Difference of two frequencies, cycles per line, below which they may be one.
SAME_PERIOD_CYCLES = 0.25


def scattered_doubts(looks: Sequence[Look], phases: Sequence[FrameGroup]) -> list[str]:
    """Return doubts about phase sets whose images do not follow one another by their names."""
    place = {one.file: k for k, one in enumerate(looks)}
    doubts = []
    for one in phases:
        places = [place[name] for name in one.files]
        if max(places) - min(places) >= len(places):
            doubts.append(
                f"{one.files[0]} ...: the images of this set of {len(places)} steps do not follow"
                " one another by their names"
            )
    return doubts


def anchor_doubts(
    groups: Sequence[FrameGroup], axis: Axis, bits: ArrangedBits, plain: PlainLooks
) -> list[str]:
    """Return a doubt about the shifts of fringes whose bits are not sure."""
    phases = [one for one in groups if one.kind == "phase" and one.axis == axis]
    if not phases or not bits.groups or (bits.is_confirmed and plain.is_certain):
        return []
    return [f"{phases[0].files[0]} ...: shifts and sign follow from unsure bits"]


def uneven_doubts(phases: Sequence[FrameGroup], looks: Sequence[Look]) -> list[str]:
    """Return doubts about unlike numbers of steps, and about sets of which little is in view."""
    doubts = []
    if len({len(one.files) for one in phases}) > 1:
        sets = ", ".join(f"{len(one.files)} from {one.files[0]} on" for one in phases)
        doubts.append(f"{sets}: unlike numbers of phase steps; images may be missing")
    for one in phases:
        cycles = one.frequency * looks[0].along[one.axis or "column"].shape[1]
        is_only = all(other is one or other.axis != one.axis for other in phases)
        if is_only and cycles < LITTLE_OF_A_FRINGE and len(one.files) == 3:
            doubts.append(
                f"{one.files[0]} ...: {cycles:.1f} of a fringe is in view, too little to make sure"
                " of its steps"
            )
    return doubts


def repeated_doubts(phases: Sequence[FrameGroup], looks: Sequence[Look]) -> list[str]:
    """Return doubts about sets of one axis whose periods can hardly be told from each other."""
    doubts = []
    for number, one in enumerate(phases):
        for other in phases[:number]:
            length = looks[0].along[one.axis or "column"].shape[1]
            difference = abs(one.frequency - other.frequency) * length
            if one.axis == other.axis and difference < SAME_PERIOD_CYCLES:
                doubts.append(
                    f"{one.files[0]} ...: has the period of {other.files[0]} ...; the same set"
                    " twice, or two periods that this view does not resolve"
                )
    return doubts


def unnumbered_doubts(phase: FrameGroup, looks: Sequence[Look]) -> list[str]:
    """Return a doubt about the only phase set along an axis if it has several fringes in view."""
    cycles = phase.frequency * looks[0].along[phase.axis or "column"].shape[1]
    if cycles < SEVERAL_FRINGES:
        return []
    return [
        f"{phase.files[0]} ...: about {cycles:.0f} fringes of one period along {phase.axis} and"
        " nothing that numbers them; images may be missing"
    ]


def plain_doubts(looks: Sequence[Look], plain: PlainLooks, *, is_needed: bool) -> list[str]:
    """Return doubts about white, black, and bits without stripes.

    Parameters
    ----------
    is_needed : without white and black there is nothing to compare the bits with
    """
    doubts = []
    shown = [k for k in (plain.white, plain.black) if k is not None]
    if plain.bits and not plain.is_certain:
        names = ", ".join(looks[k].file for k in sorted(plain.bits))
        doubts.append(f"{names}: without stripes, taken for bits that do not change in this view")
    if shown and not plain.is_certain:
        names = " and ".join(looks[k].file for k in shown)
        doubts.append(f"{names}: taken for white and black, may be bits as well")
    if len(shown) == 1:
        lacking = "black" if plain.black is None else "white"
        doubts.append(f"{looks[shown[0]].file}: there is no {lacking} image to it, needs both")
    if is_needed and len(shown) < 2:
        doubts.append(
            "gray: neither inverse images nor white and black, nothing to compare the bits with"
        )
    return doubts


def left_out_doubts(
    looks: Sequence[Look], groups: Sequence[FrameGroup], doubts: Sequence[str]
) -> list[str]:
    """Return a line for each image that is in no group and no doubt so far."""
    listed = {name for group in groups for name in group.files}
    plain = {group.kind: group.files[0] for group in groups if group.axis is None}
    named_before = {name for doubt in doubts if "left out" in doubt for name in _files(doubt)}
    result = []
    for one in looks:
        if one.file in listed | named_before:
            continue
        like = f"{one.kind} like {plain[one.kind]}" if one.kind in plain else one.kind
        if one.kind in ("grey", "faint"):
            like = "uniform, but neither white nor black"
        result.append(f"{one.file}: {like}, left out")
    return result


def _files(doubt: str) -> list[str]:
    return doubt.split(": ")[0].split(", ")


def look_doubts(looks: Iterable[Look], groups: Sequence[FrameGroup]) -> list[str]:
    """Say where content is not clear, or names say something else."""
    shown = {name: group for group in groups for name in group.files}
    doubts = []
    for one in looks:
        group = shown.get(one.file)
        if group is None:
            continue
        says = named(one)
        seen = group.axis or group.kind
        if says & set(AXES) and group.axis and group.axis not in says:
            doubts.append(
                f"{one.file}: looks like {seen}, its name says {' and '.join(sorted(says))}"
            )
        if not group.axis and says and group.kind not in says:
            doubts.append(
                f"{one.file}: looks like {seen}, its name says {' and '.join(sorted(says))}"
            )
        if group.kind != "phase" and one.kind == "striped" and one.certainty < CERTAIN:
            doubts.append(f"{one.file}: stripes along {one.axis} are hardly clearer than across")
    return doubts
