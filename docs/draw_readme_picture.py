"""Draw the README's picture from a finished measurement.

./run twin measure examples/pressurised -o out/pressurised
.venv/bin/python docs/draw_readme_picture.py out/pressurised
"""

import sys
from pathlib import Path

import matplotlib.image
from matplotlib.figure import Figure

from reconstruction.capture import read_capture

PICTURE = Path(__file__).with_name("two_balls.png")


def main(folder: Path) -> None:
    """Put one fringe frame and the reconstructed relief side by side."""
    capture = read_capture(folder)
    fringes = capture.stack[capture.patterns.index("phase", "column").start]
    relief = matplotlib.image.imread(folder / "figures" / "relief.png")
    figure = Figure(figsize=(12, 4.6), facecolor="white", layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=[1, 1.45])
    left.imshow(fringes, cmap="gray", vmin=0, vmax=2**capture.bit_depth - 1)
    left.set_title("what the camera records", fontsize=11)
    right.imshow(relief)
    right.set_title("what is reconstructed (z enlarged)", fontsize=11)
    for axes in (left, right):
        axes.set_axis_off()
    figure.savefig(PICTURE, dpi=90, metadata={"Software": None})
    sys.stdout.write(f"wrote {PICTURE}\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
