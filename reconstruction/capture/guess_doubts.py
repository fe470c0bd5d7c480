"""List the doubts about guessed patterns: messages of one line that begin with file names."""

import re
from collections.abc import Iterable, Sequence
from itertools import pairwise

from reconstruction.capture.image_features import CERTAIN, FrameGroup, ImageFeatures, named
from reconstruction.capture.spatial_guess import SEVERAL_FRINGES, SPATIAL
from reconstruction.capture.uniform_images import UniformImages
from reconstruction.capture.word_bits import ArrangedBits
from reconstruction.patterns import AXES, Axis

# Least number of fringes in view with which the steps of a set of three can be checked.
LITTLE_OF_A_FRINGE = 1.2
# Two frequencies that differ by less than this, cycles per line, may be equal.
SAME_PERIOD_CYCLES = 0.25
# Least share of steps of 1 with which names are taken for consecutive numbers.
MOSTLY_CONSECUTIVE = 0.8


def gap_doubts(files: Sequence[str]) -> list[str]:
    """Return a doubt for each gap in the numbers of images whose names differ by the number only.

    Parameters
    ----------
    files : names of all images
    """
    numbered: dict[tuple[str, str], dict[int, str]] = {}
    for file in files:
        if match := re.fullmatch(r"(.*?)([0-9]{1,9})([^0-9]*)", file):
            numbered.setdefault((match[1], match[3]), {})[int(match[2])] = file
    doubts = []
    for names in numbered.values():
        steps = [(low, high) for low, high in pairwise(sorted(names)) if high > low + 1]
        if len(names) < 3 or len(steps) > (1.0 - MOSTLY_CONSECUTIVE) * (len(names) - 1):
            continue
        doubts += [
            f"{names[low]} and {names[high]}: the numbers between them are missing; an image may be"
            " missing"
            for low, high in steps
        ]
    return doubts


def scattered_doubts(features: Sequence[ImageFeatures], phases: Sequence[FrameGroup]) -> list[str]:
    """Return doubts about phase sets of images that are not consecutive by name."""
    place = {image.file: k for k, image in enumerate(features)}
    doubts = []
    for group in phases:
        places = [place[name] for name in group.files]
        if max(places) - min(places) >= len(places):
            doubts.append(
                f"{group.files[0]} ...: the images of this set of {len(places)} steps do not follow"
                " one another by their names"
            )
    return doubts


def anchor_doubts(
    groups: Sequence[FrameGroup], axis: Axis, bits: ArrangedBits, plain: UniformImages
) -> list[str]:
    """Return one doubt if the fringes' shifts along an axis follow from uncertain bits, else []."""
    phases = [group for group in groups if group.kind == "phase" and group.axis == axis]
    if not phases or not bits.groups or (bits.is_confirmed and plain.is_certain):
        return []
    return [f"{phases[0].files[0]} ...: shifts and sign follow from unsure bits"]


def uneven_doubts(phases: Sequence[FrameGroup], features: Sequence[ImageFeatures]) -> list[str]:
    """Return doubts about unequal numbers of steps and about sets with few fringes in view."""
    doubts = []
    if len({len(group.files) for group in phases}) > 1:
        sets = ", ".join(f"{len(group.files)} from {group.files[0]} on" for group in phases)
        doubts.append(f"{sets}: unlike numbers of phase steps; images may be missing")
    for group in phases:
        cycles = group.frequency * features[0].along[group.axis or "column"].shape[1]
        is_only = all(further is group or further.axis != group.axis for further in phases)
        if is_only and cycles < LITTLE_OF_A_FRINGE and len(group.files) == 3:
            doubts.append(
                f"{group.files[0]} ...: {cycles:.1f} of a fringe is in view, too little to make"
                " sure of its steps"
            )
    return doubts


def repeated_doubts(phases: Sequence[FrameGroup], features: Sequence[ImageFeatures]) -> list[str]:
    """Return doubts about phase sets of equal axis that may have equal periods."""
    doubts = []
    for number, group in enumerate(phases):
        for earlier in phases[:number]:
            length = features[0].along[group.axis or "column"].shape[1]
            difference = abs(group.frequency - earlier.frequency) * length
            if group.axis == earlier.axis and difference < SAME_PERIOD_CYCLES:
                doubts.append(
                    f"{group.files[0]} ...: has the period of {earlier.files[0]} ...; the same set"
                    " twice, or two periods that this view does not resolve"
                )
    return doubts


def unnumbered_doubts(phase: FrameGroup, features: Sequence[ImageFeatures]) -> list[str]:
    """Return a doubt if the only phase set along an axis has several fringes in view.

    Then neither bits nor another period number the fringes.
    """
    cycles = phase.frequency * features[0].along[phase.axis or "column"].shape[1]
    if cycles < SEVERAL_FRINGES:
        return []
    return [
        f"{phase.files[0]} ...: about {cycles:.0f} fringes of one period along {phase.axis} and"
        " no word or period that numbers them; images may be missing. Otherwise the surface must be"
        f" continuous (code = '{SPATIAL}'), and a reference is needed (--reference-pixels or"
        " --reference-z-mm)"
    ]


def plain_doubts(
    features: Sequence[ImageFeatures], plain: UniformImages, *, is_needed: bool
) -> list[str]:
    """Return doubts about the images without stripes: white, black, and bits.

    Parameters
    ----------
    is_needed : whether white and black are needed as threshold of the bits
    """
    doubts = []
    shown = [k for k in (plain.white, plain.black) if k is not None]
    if plain.bits and not plain.is_certain:
        names = ", ".join(features[k].file for k in sorted(plain.bits))
        doubts.append(f"{names}: without stripes, taken for bits that do not change in this view")
    if shown and not plain.is_certain:
        names = " and ".join(features[k].file for k in shown)
        doubts.append(f"{names}: taken for white and black, may be bits as well")
    if len(shown) == 1:
        lacking = "black" if plain.black is None else "white"
        doubts.append(f"{features[shown[0]].file}: there is no {lacking} image to it, needs both")
    if is_needed and len(shown) < 2:
        doubts.append(
            "gray: neither inverse images nor white and black, so the bits have no threshold"
        )
    return doubts


def left_out_doubts(
    features: Sequence[ImageFeatures], groups: Sequence[FrameGroup], doubts: Sequence[str]
) -> list[str]:
    """Return a message for each image that is in no group and not yet reported as left out."""
    listed = {name for group in groups for name in group.files}
    plain = {group.kind: group.files[0] for group in groups if group.axis is None}
    named_before = {name for doubt in doubts if "left out" in doubt for name in _files(doubt)}
    result = []
    for image in features:
        if image.file in listed | named_before:
            continue
        like = f"{image.kind} like {plain[image.kind]}" if image.kind in plain else image.kind
        if image.kind in ("grey", "faint"):
            like = "uniform, but neither white nor black"
        result.append(f"{image.file}: {like}, left out")
    return result


def _files(doubt: str) -> list[str]:
    return doubt.split(": ")[0].split(", ")


def content_doubts(features: Iterable[ImageFeatures], groups: Sequence[FrameGroup]) -> list[str]:
    """Return doubts about images of unclear content, and about names that contradict it."""
    shown = {name: group for group in groups for name in group.files}
    doubts = []
    for image in features:
        group = shown.get(image.file)
        if group is None:
            continue
        stated = named(image)
        content = group.axis or group.kind
        if stated & set(AXES) and group.axis and group.axis not in stated:
            doubts.append(
                f"{image.file}: looks like {content}, its name says {' and '.join(sorted(stated))}"
            )
        if not group.axis and stated and group.kind not in stated:
            doubts.append(
                f"{image.file}: looks like {content}, its name says {' and '.join(sorted(stated))}"
            )
        if group.kind != "phase" and image.kind == "striped" and image.certainty < CERTAIN:
            doubts.append(
                f"{image.file}: stripes along {image.axis} are hardly clearer than across"
            )
    return doubts
