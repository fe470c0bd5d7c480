"""Write the guessed patterns of unknown images as a capture.toml, which the user corrects."""

import json
import math
from itertools import pairwise
from pathlib import Path
from typing import Any

from reconstruction.capture.frame_list import FrameEntry
from reconstruction.capture.guess import Guess
from reconstruction.capture.image_features import FolderFeatures, FrameGroup
from reconstruction.capture.phase_anchor import word_px, words_per_fringe
from reconstruction.capture.spatial_guess import SPATIAL, assumed_fringes, is_spatial
from reconstruction.errors import CaptureError
from reconstruction.patterns import AXES, Axis

ASSUMED_FULL_WELL_E = 10_000.0
# If fewer fringes of the coarsest period are in view, one fringe is assumed to cover the projector.
MOST_CYCLES = 1.6


def written(guess: Guess, size: tuple[int, int], *, is_known: bool = True) -> str:
    """Return the text of a capture.toml with a comment on each uncertain value.

    Parameters
    ----------
    size : image size of the projector (width, height), px, that was used for the guess
    is_known : whether the user stated this size; False: it is marked as uncertain
    """
    width_px, height_px = size
    lines = [
        "# Guessed from the images; correct the errors, then: twin decode FOLDER -o DIR",
        *(f"# unsure: {text}" for text in guess.unsure),
        'format = "fringe-frames"',
        "version = 1",
        *_depth_lines(guess.folder_features),
        f'code = "{SPATIAL}"  # unsure: if no images are missing' if _is_spatial(guess) else "",
        f"word = {json.dumps(guess.word)}" if guess.word != "reflected" else "",
        "",
        "[projector]" + "  # unsure: not visible in images" * (not is_known),
        f"width_px = {width_px}",
        f"height_px = {height_px}",
    ]
    for group in guess.groups:
        lines += ["", *_group_lines(group, guess, size)]
    return "\n".join(line for line in [*lines, "", *_sensor_lines(guess.folder_features)]) + "\n"


def _depth_lines(folder_features: FolderFeatures) -> list[str]:
    lines = [f"bit_depth = {_depth(folder_features)}"]
    if folder_features.channel:
        lines.append(f'channel = "{folder_features.channel}"  # of colour images; or "red", "blue"')
    return lines


def _depth(folder_features: FolderFeatures) -> int:
    if folder_features.dtype == "uint8":
        return 8
    return min(max(math.ceil(math.log2(folder_features.largest + 1.0)), 8), 16)


def _group_lines(group: FrameGroup, guess: Guess, size: tuple[int, int]) -> list[str]:
    entry = _entry(group, guess, size)
    FrameEntry(**entry)  # raises InputError for an entry that `twin decode` would reject
    remarks = _remarks(group, guess)
    lines = (f"{key} = {_toml(value)}{remarks.get(key, '')}" for key, value in entry.items())
    return ["[[frames]]", *lines]


def _entry(group: FrameGroup, guess: Guess, size: tuple[int, int]) -> dict[str, Any]:
    """Return keys and values of the table [[frames]] (see `FrameEntry`) that describes a group."""
    entry: dict[str, Any] = {"files": list(group.files), "kind": group.kind}
    if group.axis is not None:
        entry["axis"] = group.axis
        if group.kind == "phase" or not _phases(guess, group.axis):
            entry["period_px"] = _period_px(group, guess, size)
    if group.kind == "phase":
        entry["shift_deg"] = [round(shift, 4) for shift in group.shifts_deg]
        entry["sign"] = group.sign or 1
    return entry


def _remarks(group: FrameGroup, guess: Guess) -> dict[str, str]:
    """Return the comments on uncertain values of a table [[frames]], by the keys of the values."""
    bits = ("gray", "inverse")
    same = [g for g in guess.groups if g.axis == group.axis and {g.kind, group.kind} <= {*bits}]
    files = [name for group in (group, *same) for name in group.files]
    remarks = {"period_px": "  # unsure: follows from the size of the projector"}
    if _is_spatial(guess):
        count = assumed_fringes(group, guess.folder_features.features)
        remarks["period_px"] = f"  # unsure: as if {count} fringes covered the projector"
    if any(name in text for text in guess.unsure for name in files):
        remarks["files"] = "  # unsure: see above"
    if group.sign:
        remarks["shift_deg"] = "  # unsure: as the first word starts at projector pixel 0"
    else:
        remarks["shift_deg"] = "  # unsure: of the first image 0 is assumed"
        remarks["sign"] = "  # unsure: -1 if the camera view of the projector is mirrored"
    return remarks


def _is_spatial(guess: Guess) -> bool:
    return is_spatial(guess.groups, guess.folder_features.features)


def _toml(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else json.dumps(value)


def _phases(guess: Guess, axis: Axis | None) -> list[FrameGroup]:
    return [group for group in guess.groups if group.kind == "phase" and group.axis == axis]


def _period_px(group: FrameGroup, guess: Guess, size: tuple[int, int]) -> float:
    """Return the fringe period or word width of a group, projector px.

    It is assumed that all code words, or one fringe of the coarsest period, cover the projector.
    With code `spatial` the fringes in view do.
    """
    length_px = size[AXES.index(group.axis or "column")]
    if _is_spatial(guess):
        return length_px / assumed_fringes(group, guess.folder_features.features)
    bits = next((g for g in guess.groups if g.kind == "gray" and g.axis == group.axis), None)
    if bits is not None:
        width_px = _word_px(bits, guess, size)
        if group.kind != "phase":
            return width_px
        return words_per_fringe(group, bits, guess.word) * width_px
    return length_px * _covering(guess, group.axis) / group.frequency


def _word_px(bits: FrameGroup, guess: Guess, size: tuple[int, int]) -> float:
    """Return the assumed width of a code word, projector px.

    It is a power of two. In two cases it is length / 2^bits instead: if with the power of two the
    largest word in view would be outside the projector; or if no word in view is near the end of
    the projector, and all fringes are then whole numbers of pixels wide.
    """
    length_px = size[AXES.index(bits.axis or "column")]
    power_px = word_px(len(bits.files), length_px)
    last = next((numbered.last for numbered in guess.words if numbered.axis == bits.axis), 0)
    if last * power_px >= length_px:
        return length_px / 2.0 ** len(bits.files)
    if (last + 2) * power_px >= length_px:
        return power_px
    exact_px = _whole_fringes(guess, size)
    return exact_px.get(bits.axis, power_px)


def _whole_fringes(guess: Guess, size: tuple[int, int]) -> dict[Axis | None, float]:
    """Return the word width length / 2^bits along each axis, px.

    The result is empty unless the fringes along all axes are then whole numbers of pixels wide.
    """
    widths: dict[Axis | None, float] = {}
    for bits in (bits_group for bits_group in guess.groups if bits_group.kind == "gray"):
        width_px = size[AXES.index(bits.axis or "column")] / 2.0 ** len(bits.files)
        widths[bits.axis] = width_px
        fringes = [
            words_per_fringe(g, bits, guess.word) * width_px for g in _phases(guess, bits.axis)
        ]
        if not fringes or any(period_px != round(period_px) for period_px in fringes):
            return {}
    return widths


def _covering(guess: Guess, axis: Axis | None) -> float:
    """Return the frequency, cycles per camera pixel, of which one cycle covers the projector.

    It is the frequency of the coarsest period. For two or three periods, each with several fringes
    in view, it is the frequency of their coarsest beat: the periods are assumed to be heterodyne.
    """
    rates = sorted(phase.frequency for phase in _phases(guess, axis))
    cycles = rates[0] * guess.folder_features.features[0].along[axis or "column"].shape[1]
    if cycles < MOST_CYCLES or not 2 <= len(rates) <= 3:
        return rates[0]
    beats = [b - a for a, b in pairwise(rates)]
    beat = beats[0] if len(beats) == 1 else abs(beats[1] - beats[0])
    return beat if beat > 0.0 else rates[0]


def _sensor_lines(folder_features: FolderFeatures) -> list[str]:
    saturation = 2.0 ** _depth(folder_features) - 1.0
    gain = saturation / ASSUMED_FULL_WELL_E
    return [
        "# unsure: assumed, not measured; sigma is as good as these, see docs/real_rig.md",
        "[sensor]",
        f"gain_dn_per_e = {gain:.6g}",
        f"read_noise_e = {saturation / 255.0 / gain:.6g}",
        f"black_level_dn = {max(min(folder_features.darkest_dn, 0.2 * saturation), 0.0):.6g}",
        f"saturation_dn = {saturation:.6g}",
    ]


def require_groups(guess: Guess, folder: Path) -> None:
    """Raise CaptureError if no group has an axis, because no image shows stripes."""
    if not any(group.axis for group in guess.groups):
        raise CaptureError(f"{folder}: no image shows stripes; give a folder of projected patterns")
