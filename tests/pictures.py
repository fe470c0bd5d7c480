"""Content of a drawn picture: its figure before it is written, and colours at known points."""

from contextlib import contextmanager
from pathlib import Path

import imageio.v3 as imageio
import numpy as np
from matplotlib.colors import to_rgb

SCREEN_DPI = 130


def rgb(colour):
    """Return a named colour as 8-bit levels."""
    return np.rint(255.0 * np.array(to_rgb(colour)))


def picture(path):
    """Read a picture, (row, col, rgb)."""
    return imageio.imread(path)[..., :3].astype(float)


def count_of(path, colour, within=6.0):
    """Return how many pixels of a picture have a colour."""
    return int((np.abs(picture(path) - rgb(colour)).max(axis=-1) <= within).sum())


def colour_at(path, axes, x, y):
    """Return the levels at data coordinates of axes of the figure that was written to `path`."""
    shown = picture(path)
    figure = axes.get_figure()
    place = axes.transData.transform((x, y)) / (figure.get_size_inches() * figure.dpi)
    return shown[int((1.0 - place[1]) * shown.shape[0]), int(place[0] * shown.shape[1])]


def is_drawn(path, width_in, height_in):
    """Return True if a picture has its size, is mostly white, and has ink in every quarter."""
    shown = picture(path)
    ink = np.abs(shown - 255.0).max(axis=-1) > 100.0
    quarters = [part for half in np.array_split(ink, 2) for part in np.array_split(half, 2, axis=1)]
    size = SCREEN_DPI * np.array([height_in, width_in])
    is_sized = np.abs(shown.shape[:2] - size).max() < 1.0
    return bool(is_sized and all(3e-3 < part.mean() < 0.9 for part in quarters))


def kept_figures(monkeypatch, *modules):
    """Record the figures that modules draw, by file name; they are written as usual."""
    figures = {}
    for module in modules:
        real = module.drawing

        @contextmanager
        def keeping(path, *size, real=real):
            with real(path, *size) as figure:
                figures[Path(path).name] = figure
                yield figure

        monkeypatch.setattr(module, "drawing", keeping)
    return figures
