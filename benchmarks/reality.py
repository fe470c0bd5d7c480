"""Files of other programs and real rigs: captures, calibrations, meshes, intervals, two cameras.

    ./run bench reality [--quick]

The figures of `reality_captures`, `reality_calibrations`, `reality_meshes`, `reality_intervals` and
`reality_two_cameras` follow; their docstrings define them. Each can also be run alone, for example
`./run bench reality_captures`.

Last line: {"described_right", "described_unsure", "described_wrong_unmarked", "imports_right",
"calibrations_refused_rightly", "meshes_read", "interval_coverage", "merged_over_alone",
"shadow_ratio", ...}.
"""

from benchmarks._harness import print_figures, quick_parser
from benchmarks.reality_calibrations import reality_calibrations
from benchmarks.reality_captures import reality_captures
from benchmarks.reality_intervals import reality_intervals
from benchmarks.reality_meshes import reality_meshes
from benchmarks.reality_two_cameras import reality_two_cameras

PARTS = (
    reality_captures,
    reality_calibrations,
    reality_meshes,
    reality_intervals,
    reality_two_cameras,
)


def main() -> None:
    parser = quick_parser(__doc__ or "", "fewer sets, files and poses")
    chosen = parser.parse_args()
    figures: dict[str, float] = {}
    for part in PARTS:
        figures |= part(chosen.quick)
    print_figures(figures)


if __name__ == "__main__":
    main()
