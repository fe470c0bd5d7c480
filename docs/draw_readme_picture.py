"""Draw the README's picture from a finished measurement.

./run demo
.venv/bin/python docs/draw_readme_picture.py out/demo
"""

import sys
from pathlib import Path

import matplotlib.image
from matplotlib.figure import Figure

from reconstruction.capture.folder import read_capture

PICTURE = Path(__file__).with_name("two_balls.png")


def main(folder: Path) -> None:
    """Put one fringe frame, the reconstructed relief and its height map side by side."""
    capture = read_capture(folder)
    fringes = capture.stack[capture.patterns.index("phase", "column").start]
    relief, heights = (
        matplotlib.image.imread(folder / "figures" / f"{name}.png")
        for name in ("relief", "height_map")
    )
    figure = Figure(figsize=(15, 4.1), facecolor="white", layout="constrained")
    panels = figure.subplots(1, 3, width_ratios=[1.1, 1.5, 1.1])
    panels[0].imshow(fringes, cmap="gray", vmin=0, vmax=2**capture.bit_depth - 1)
    panels[1].imshow(relief)
    panels[2].imshow(heights)
    titles = ("what the camera records", "what is reconstructed (z enlarged)", "its heights")
    for axes, title in zip(panels, titles, strict=True):
        axes.set_title(title, fontsize=11)
        axes.set_axis_off()
    figure.savefig(PICTURE, dpi=80, metadata={"Software": None})
    sys.stdout.write(f"wrote {PICTURE}\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
