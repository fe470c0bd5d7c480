"""Panel of the live view with the results: images, section, error map, figures."""

from typing import Any

import numpy as np

from reconstruction.arrays import Levels
from twin.results.folder import deviation_of
from twin.results.record import Measurement
from twin.viewer.drawing import section_drawing
from twin.viewer.preview import PreviewPicture
from twin.viewer.scene import SectionProfiles
from twin.viewer.texts import deviation_scale, figure_list, paragraphs

_PANEL_PX = 330
_IMAGE_PX = 250


class ResultPanel:
    """Panel at the right edge: the picture at once, and figures after the measurement."""

    def __init__(self, server: Any) -> None:
        gui, blank = server.gui, np.full((8, 8, 3), 255, np.uint8)
        panel = gui.add_panel()
        with panel.add_tab("results"):
            self._figures = gui.add_html(paragraphs("no figures yet"))
            self._fringes = gui.add_image(blank, label="camera image: fringes")
            self._errors = gui.add_image(blank, label="error map of the coat")
            self._errors_scale = gui.add_html("")
            self._section = gui.add_html("")
        with panel.add_tab("white light"):
            self._white = gui.add_image(blank, label="camera image: white light")
        panel.dock_right()
        panel.set_width(_PANEL_PX)

    def picture(self, shown: PreviewPicture, section: SectionProfiles) -> None:
        """Show images and section of a preview."""
        self._fringes.image, self._white.image = rgb(shown.fringes), rgb(shown.white)
        self._section.content = section_drawing(section)

    def begin(self) -> None:
        """State that the figures are not those of the current picture."""
        self._figures.content = paragraphs("measuring ...")

    def progress(self, stage: str, fraction: float) -> None:
        """Show the running stage of the measurement."""
        self._figures.content = paragraphs(f"measuring: {stage} {100 * fraction:.0f} %")

    def show(self, measured: Measurement) -> None:
        """Show the figures and the error map of a measurement."""
        deviation = deviation_of(measured)
        self._figures.content = figure_list(measured)
        self._errors.image = _of_width(deviation.rgb, _IMAGE_PX)
        self._errors_scale.content = deviation_scale(deviation)

    def fail(self, reason: str) -> None:
        """Show why there are no figures."""
        self._figures.content = paragraphs(f"not measured: {reason}")


def _of_width(image: Levels, width_px: int) -> Levels:
    """Return every n-th pixel of an image, whose width is then about `width_px`."""
    step = max(1, round(image.shape[1] / width_px))
    return np.ascontiguousarray(image[::step, ::step])


def rgb(levels: Levels) -> Levels:
    """Return grey levels (row, col) as an image (row, col, 3)."""
    return np.repeat(levels[..., np.newaxis], 3, axis=-1)
