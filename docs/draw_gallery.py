"""Draw docs/gallery: what each shipped experiment presses, what its camera sees, what is measured.

.venv/bin/python docs/draw_gallery.py [NAME ...]

Without names every experiment of scenes/examples and scenes/paper is measured with few pixels,
which takes a quarter of an hour. `tests/docs` checks that no experiment is without a picture.
"""

import io
import sys
from pathlib import Path

import numpy as np
from draw_specimens import oblique, shade
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image
from shipped import experiments, picture_of

import twin
from twin.specimens import shape_of

FEW_PIXELS = {"camera.binning": 4}
PALE = "#d9d9d9"


def main(names: list[str]) -> None:
    """Write the picture of each experiment."""
    for name in names or [shipped.name for shipped in experiments()]:
        file = picture_of(name)
        draw(twin.load_experiment(name), file)
        sys.stdout.write(f"wrote {file}\n")
        sys.stdout.flush()


def draw(experiment: twin.Experiment, file: Path) -> None:
    """Put specimen, camera image and measured heights side by side."""
    figure = Figure(figsize=(9.0, 2.5), facecolor="white", layout="constrained")
    panels = figure.subplots(1, 3, width_ratios=[1.0, 1.3, 1.5])
    shade(panels[0], oblique(shape_of(experiment.specimen).mesh(0.0), below=False))
    panels[0].set_title("specimen", fontsize=10)
    if can_be_seen(experiment):
        fringes = experiment.method.fringes
        done = twin.measure(twin.vary(experiment, FEW_PIXELS if fringes else {}))
        panels[1].imshow(done.picture, cmap="gray", vmin=0, vmax=255)
        panels[1].set_title("camera", fontsize=10)
        height_mm = np.where(done.points.valid, done.points.world_mm[..., 2], np.nan)
        heights(figure, panels[2], height_mm, "measured heights")
    else:
        pressed = twin.press(experiment)
        heights(figure, panels[2], pressed.face_z_mm[::-1], "pressed coat")
    for axes in panels:
        axes.set_xticks([])
        axes.set_yticks([])
    for axes in panels[:2]:
        axes.set_axis_off()
    drawn = io.BytesIO()
    figure.savefig(drawn, dpi=80)
    Image.open(drawn).convert("RGB").save(file, quality=80, optimize=True)


def can_be_seen(experiment: twin.Experiment) -> bool:
    """Return True if the scene can be rendered: light must reach the coat through known layers."""
    behind_gel = experiment.elastomer.layout == "contact_face"
    return bool(experiment.layers) or not (behind_gel and experiment.method.fringes)


def heights(figure: Figure, axes: Axes, z_mm: NDArray[np.floating], title: str) -> None:
    """Draw z as the camera sees it; pixels without a point are grey."""
    lowest, highest = np.nanpercentile(z_mm, [0.5, 99.5])
    axes.set_facecolor(PALE)
    shown = axes.imshow(z_mm, cmap="viridis", vmin=lowest, vmax=highest)
    axes.set_title(title, fontsize=10)
    figure.colorbar(shown, ax=axes, label="z / mm")


if __name__ == "__main__":
    main(sys.argv[1:])
