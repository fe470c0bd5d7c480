"""What was guessed of an unknown set, as a capture.toml with a list of frames to correct."""

import json
import math
from collections.abc import Sequence
from pathlib import Path

from reconstruction.capture.guess import FrameGroup, Guess, word_px, words_per_fringe
from reconstruction.capture.image_looks import LookedAt
from reconstruction.errors import CaptureError
from reconstruction.patterns import Axis

ASSUMED_FULL_WELL_E = 10_000.0


def written(found: Guess, size: tuple[int, int], *, is_known: bool = True) -> str:
    """Return the content of capture.toml with comments on what was guessed.

    Parameters
    ----------
    size : of the projector, px, as it was guessed with
    is_known : whether anybody stated it
    """
    width_px, height_px = size
    lines = [
        "# Guessed from the images; correct what is wrong, then: twin decode FOLDER -o DIR",
        *(f"# unsure: {text}" for text in found.unsure),
        'format = "fringe-frames"',
        "version = 1",
        *_depth_lines(found.looked),
        f"word = {json.dumps(found.word)}" if found.word != "reflected" else "",
        "",
        "[projector]" + "  # unsure: not to be seen in images" * (not is_known),
        f"width_px = {width_px}",
        f"height_px = {height_px}",
    ]
    for group in found.groups:
        length_px = width_px if group.axis == "column" else height_px
        lines += ["", *_group_lines(group, found.groups, length_px)]
    return "\n".join(line for line in [*lines, "", *_sensor_lines(found.looked)]) + "\n"


def _depth_lines(looked: LookedAt) -> list[str]:
    lines = [f"bit_depth = {_depth(looked)}"]
    if looked.channel:
        lines.append(f'channel = "{looked.channel}"  # of colour images; or "red", "blue"')
    return lines


def _depth(looked: LookedAt) -> int:
    if looked.dtype == "uint8":
        return 8
    return min(max(math.ceil(math.log2(looked.largest + 1.0)), 8), 16)


def _group_lines(group: FrameGroup, groups: Sequence[FrameGroup], length_px: int) -> list[str]:
    lines = ["[[frames]]", f"files = {json.dumps(list(group.files))}", f'kind = "{group.kind}"']
    if group.axis is None:
        return lines
    lines.append(f'axis = "{group.axis}"')
    period_px = _period_px(group, groups, length_px)
    told = "  # unsure: follows from the size of the projector"
    if group.kind == "phase" or not _phases(groups, group.axis):
        lines.append(f"period_px = {period_px:.6g}{told}")
    if group.kind == "phase":
        lines.append(f"shift_deg = {json.dumps([round(shift, 4) for shift in group.shifts_deg])}")
        lines.append(f"sign = {group.sign or 1}")
        if not group.sign:
            lines[-1] += "  # unsure: -1 if the camera sees the projector mirrored"
            lines[-2] += "  # unsure: of the first image 0 is assumed"
    return lines


def _phases(groups: Sequence[FrameGroup], axis: Axis | None) -> list[FrameGroup]:
    return [one for one in groups if one.kind == "phase" and one.axis == axis]


def _period_px(group: FrameGroup, groups: Sequence[FrameGroup], length_px: int) -> float:
    """Return a period, px, with which all of them cover the projector."""
    bits = next((g for g in groups if g.kind == "gray" and g.axis == group.axis), None)
    if bits is not None:
        width_px = word_px(len(bits.files), length_px)
        if group.kind != "phase":
            return width_px
        return words_per_fringe(group, bits) * width_px
    coarsest = min(one.frequency for one in _phases(groups, group.axis))
    return length_px * coarsest / group.frequency


def _sensor_lines(looked: LookedAt) -> list[str]:
    saturation = 2.0 ** _depth(looked) - 1.0
    gain = saturation / ASSUMED_FULL_WELL_E
    return [
        "# unsure: assumed, not measured; sigma is as good as these, see docs/real_rig.md",
        "[sensor]",
        f"gain_dn_per_e = {gain:.6g}",
        f"read_noise_e = {saturation / 255.0 / gain:.6g}",
        f"black_level_dn = {max(min(looked.darkest_dn, 0.2 * saturation), 0.0):.6g}",
        f"saturation_dn = {saturation:.6g}",
    ]


def require_groups(found: Guess, folder: Path) -> None:
    """Raise CaptureError where nothing striped was found."""
    if not any(group.axis for group in found.groups):
        raise CaptureError(f"{folder}: no image shows stripes; give a folder of projected patterns")
