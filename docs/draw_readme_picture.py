"""Draw the README's picture from a finished measurement.

twin measure examples/wrapped_group -o out
.venv/bin/python docs/draw_readme_picture.py out

Text is at least 12 px high at the 838 px that a README is wide.
"""

import sys
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from reconstruction.capture.folder import read_capture
from reconstruction.netcdf import read_arrays

PICTURE = Path(__file__).with_name("two_balls.png")
CELLS_APART = 4
"""Spacing of the drawn facets of the relief, in cells of the height map."""
RELIEF_BOX = (1.2, 1.0, 0.28)
"""Ratio of the drawn lengths of x, y and z: z is enlarged."""


def main(folder: Path) -> None:
    """Put one fringe frame, the reconstructed relief and its height map side by side."""
    capture = read_capture(folder)
    fringes = capture.stack[capture.patterns.index("phase", "column").start]
    x_mm, y_mm, z_mm = heights_of(folder / "height_map.nc")
    figure = Figure(figsize=(12, 3.6), facecolor="white", layout="constrained")
    grid = figure.add_gridspec(1, 3, width_ratios=[1.15, 1.2, 1.15])
    left, right = figure.add_subplot(grid[0]), figure.add_subplot(grid[2])
    left.imshow(fringes, cmap="gray", vmin=0, vmax=fringes.max())
    left.set_axis_off()
    draw_relief(figure.add_subplot(grid[1], projection="3d"), x_mm, y_mm, z_mm)
    extent = (x_mm[0], x_mm[-1], y_mm[-1], y_mm[0])
    picture = right.imshow(z_mm, extent=extent, cmap="viridis")
    right.set_xticks([-10, 0, 10], ["−10", "0", "10 mm"], fontsize=14)
    right.set_yticks([-5, 0, 5], ["−5", "0", "5"], fontsize=14)
    bar = figure.colorbar(picture, ax=right, ticks=[0, 1], shrink=0.75)
    bar.ax.set_yticklabels(["0", "1 mm"], fontsize=14)
    titles = ("camera image", "measured relief, z enlarged", "height z")
    for axes, title in zip((left, figure.axes[2], right), titles, strict=True):
        axes.set_title(title, fontsize=17)
    figure.savefig(PICTURE, dpi=100, metadata={"Software": None})
    sys.stdout.write(f"wrote {PICTURE}\n")


def heights_of(file: Path) -> tuple[Any, Any, Any]:
    """Return x (col,), y (row,) and z (row, col), mm; z is NaN in cells without a point."""
    arrays = read_arrays(file)
    z_mm, valid = (arrays.variables[name][1] for name in ("z_mm", "valid"))
    x_mm, y_mm = (arrays.coords[name][1] for name in "xy")
    return x_mm, y_mm, np.where(valid, z_mm, np.nan)


def draw_relief(axes: Any, x_mm: Any, y_mm: Any, z_mm: Any) -> None:
    """Draw the heights as a surface, without axes."""
    z = z_mm[::CELLS_APART, ::CELLS_APART]
    x, y = np.meshgrid(x_mm[::CELLS_APART], y_mm[::CELLS_APART])
    fine = {"rcount": 400, "ccount": 400, "linewidth": 0, "antialiased": False}
    axes.plot_surface(x, y, z, cmap="viridis", **fine)
    axes.set_box_aspect(RELIEF_BOX, zoom=1.2)
    axes.view_init(elev=38, azim=-60)
    axes.set_axis_off()


if __name__ == "__main__":
    main(Path(sys.argv[1]))
