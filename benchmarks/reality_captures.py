"""Captures that `twin describe` describes: right, unsure, or wrong without a mark.

    ./run bench reality_captures [--quick]

220 generated folders (--quick: 23) of `tests/corpus/captures.py`, and the public captures of other
programs where a folder holds them. The last 20 show several fringes of one period. A set is
described with the projector's size, and decoded by this description without corrections.

- `described_right`: share of the sets of which at least 90 % of the lit pixels have the right
  coordinates along all axes, up to offset and scale, because images cannot show the size of a
  projector pixel. A set with a missing frame is right if this is marked.
- `described_unsure`: share of the sets that are not right and have a mark `unsure` at a frame or
  at the result of the test.
- `described_wrong_unmarked`: number of the other sets. Target: 0.

Last line: {"described_right", "described_unsure", "described_wrong_unmarked", "described_sets"}.
"""

import tempfile
from pathlib import Path

import numpy as np

from benchmarks._harness import print_figures, quick_parser
from reconstruction.arrays import FloatArray
from reconstruction.capture.folder import read_frames
from reconstruction.capture.frame_list import read_listed
from reconstruction.capture.guess import guess
from reconstruction.capture.guess_check import describe_and_test
from reconstruction.capture.guess_file import require_groups
from reconstruction.capture.spatial_guess import trial_reference
from reconstruction.decoding.decode import DecodeOptions, decode
from reconstruction.errors import InputError
from reconstruction.writing import write_text
from tests.corpus.captures import RELATIVE, CapturedSet, write_captured_set

SETS, QUICK_SETS = 200, 21
RELATIVE_SETS, QUICK_RELATIVE_SETS = 20, 2
RIGHT_SHARE = 0.9
CLOSE_PX = 1.5
"""Largest error of a right coordinate from phases."""
CLOSE_BITS = 1.0
"""Largest error of a coordinate from bits, in widths of a word: half a word, and the neighbouring
word at its blurred edges. Two exchanged bits cause errors of two words and more."""


def main() -> None:
    parser = quick_parser(__doc__ or "", "23 generated sets")
    print_figures(reality_captures(parser.parse_args().quick))


def reality_captures(quick: bool) -> dict[str, float]:
    """Describe and decode generated sets."""
    verdicts = []
    with tempfile.TemporaryDirectory() as folder:
        drawn = [(seed, "") for seed in range(QUICK_SETS if quick else SETS)]
        drawn += [
            (seed, RELATIVE) for seed in range(QUICK_RELATIVE_SETS if quick else RELATIVE_SETS)
        ]
        for seed, code in drawn:
            captured = write_captured_set(Path(folder) / f"set_{seed}{code}", seed, code)
            verdicts.append(verdict_of(captured))
            if verdicts[-1] != "right":
                print(f"{captured.text}: {verdicts[-1]}", flush=True)
    return {
        "described_right": verdicts.count("right") / len(verdicts),
        "described_unsure": verdicts.count("unsure") / len(verdicts),
        "described_wrong_unmarked": verdicts.count("wrong"),
        "described_sets": len(verdicts),
    }


def verdict_of(captured: CapturedSet) -> str:
    """Return "right", "unsure" or "wrong" for the description of a set."""
    size = captured.patterns.width_px, captured.patterns.height_px
    file = captured.folder / "capture.toml"
    try:
        guessed = guess(captured.folder, size)
        require_groups(guessed, captured.folder)
    except InputError:
        return "right" if captured.fault else "unsure"
    described = describe_and_test(guessed, captured.folder, size)
    write_text(file, described.text)
    marks = [line for line in described.lines if line.startswith("unsure")]
    is_marked = bool(described.guess.unsure or marks)
    if captured.fault:
        return "right" if is_marked else "wrong"
    if _right_share(captured, file) >= RIGHT_SHARE:
        return "right"
    return "unsure" if is_marked else "wrong"


def _right_share(captured: CapturedSet, file: Path) -> float:
    """Return the share of the lit pixels with the right coordinates along all axes."""
    try:
        recorded = read_listed(file).recorded(captured.folder)
        stack, _ = read_frames(recorded)
        reference = trial_reference(stack, recorded.patterns, captured.lit)
        options = DecodeOptions(filter_taps=0, reference=reference)
        decoded = decode(stack, recorded.patterns, recorded.sensor, options)
    except InputError:
        return 0.0
    if decoded.axes != captured.patterns.axes:
        return 0.0
    usable = captured.lit & decoded.valid
    if usable.sum() < RIGHT_SHARE * captured.lit.sum():
        return 0.0
    shares = [
        _share(
            (decoded.row if axis == "row" else decoded.column).coordinate_px[usable],
            captured.coordinates_px[axis][usable],
            CLOSE_PX if captured.patterns.steps else CLOSE_BITS * captured.patterns.period_px,
        )
        for axis in decoded.axes
    ]
    return min(shares)


def _share(decoded_px: FloatArray, true_px: FloatArray, close_px: float) -> float:
    """Return the share of the coordinates on the line through the lower and the upper quarter."""
    low, high = true_px <= np.quantile(true_px, 0.25), true_px >= np.quantile(true_px, 0.75)
    ends = [(np.median(decoded_px[part]), np.median(true_px[part])) for part in (low, high)]
    rise = ends[1][0] - ends[0][0]
    if abs(rise) < close_px:
        return 0.0
    slope = (ends[1][1] - ends[0][1]) / rise
    left = true_px - ends[0][1] - slope * (decoded_px - ends[0][0])
    return float(np.mean(np.abs(left - np.median(left)) <= close_px))


if __name__ == "__main__":
    main()
