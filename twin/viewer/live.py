"""Live view in a browser: scene, sliders, camera image, error map and figures.

The package viser displays the view. Its threads only store the latest slider values. The main
thread computes the images, so that a signal ends the command.
"""

import io
import threading
import time
from collections.abc import Iterable
from contextlib import redirect_stdout
from importlib import import_module
from typing import Any

from reconstruction.errors import InputError
from reconstruction.evaluate.surface import surface_mesh
from twin.config import Experiment
from twin.extras import missing
from twin.optics.view import SceneSurface
from twin.results.folder import deviation_of
from twin.results.record import Measurement
from twin.viewer.picture import VIEWS, ScenePicture
from twin.viewer.preview import Preview, PreviewPicture
from twin.viewer.results import ResultPanel, rgb
from twin.viewer.scene import section_of
from twin.viewer.sliders import EXPOSURE, GROUPS, SliderRange, slider_ranges
from twin.viewer.texts import command_line, deviation_scale, height_scale, press_line

# Offset of the measured surface above the coat of the preview, which would intersect it.
_RAISED_MM = (0.0, 0.0, 0.05)
_MOST_VERTICES = 200_000
_PANEL_PX = 300
# Without a change of a slider for this time, the experiment is measured.
_REST_S = 0.3


class _SliderMovedError(Exception):
    """A slider was moved during a measurement, which is then out of date."""


def viser_module() -> Any:
    """Return the module of the package viser.

    Raises
    ------
    InputError : viser is not installed
    """
    try:
        return import_module("viser")
    except ModuleNotFoundError:
        raise missing("view", "viser", "view") from None


class LiveView:
    """Live view of an experiment: the scene in the browser and the latest slider values."""

    def __init__(
        self,
        experiment: Experiment,
        measured: Measurement | None,
        host: str,
        port: int,
        source: str = "",
    ) -> None:
        viser = viser_module()
        self._preview = Preview(experiment)
        self._experiment, self._source = experiment, source or experiment.name
        self._changes: dict[str, float] = {}
        self._sliders: dict[str, tuple[SliderRange, Any]] = {}
        self._moved = threading.Event()
        self._moved.set()
        with redirect_stdout(io.StringIO()):  # viser prints a banner
            self._server = viser.ViserServer(host, port, label="fringe-twin", verbose=False)
        gui = self._server.gui
        gui.configure_theme(show_logo=False, show_share_button=False, control_width="small")
        self._picture = ScenePicture(self._server, experiment)
        self._status = gui.add_markdown("pressing ...")
        self._heights = gui.add_html("")
        self._add_views()
        self._folders = {group: gui.add_folder(group) for group in GROUPS}
        self._add_sliders(slider_ranges(experiment))
        gui.add_button("reset").on_click(self._reset)
        self._command = gui.add_markdown(self._command_line({}))
        self._results = ResultPanel(self._server)
        gui.main_panel.dock_left()
        gui.main_panel.set_width(_PANEL_PX)
        if measured is not None:
            self._add_measured(measured)

    @property
    def address(self) -> str:
        """URL at which a browser shows the view."""
        return f"http://{self._server.get_host()}:{self._server.get_port()}"

    @property
    def server(self) -> Any:
        """The Viser server, with scene and panels."""
        return self._server

    def serve(self) -> None:
        """Recompute the view for new slider values, until a signal ends the process."""
        at_rest = False
        while True:
            # With a time limit: on some systems a wait without one does not handle signals.
            if self._moved.wait(_REST_S):
                self.update()
                at_rest = False
            elif not at_rest:
                at_rest = self.measure()

    def close(self) -> None:
        """Stop the server of the view."""
        self._server.stop()

    def update(self) -> None:
        """Show the latest slider values at reduced size."""
        self._moved.clear()
        changes, start = dict(self._changes), time.perf_counter()
        self._command.content = self._command_line(changes)
        try:
            shown = self._preview.show(changes)
        except InputError as error:
            self._status.content = f"**not possible:** {error}"
            return
        self._show(shown)
        self._status.content = (
            f"{press_line(shown.pressed)}; picture in {time.perf_counter() - start:.2f} s"
        )
        if EXPOSURE not in self._sliders:
            self._add_sliders(slider_ranges(self._experiment, shown.exposure_ms))

    def measure(self) -> bool:
        """Measure with the latest slider values, and show figures and error map.

        Returns
        -------
        False if a slider was moved, which ends the measurement
        """
        changes = dict(self._changes)
        self._results.begin()
        try:
            done = self._preview.measure(changes, self._watch)
            shown = self._preview.show(changes)
        except _SliderMovedError:
            return False
        except InputError as error:
            self._results.fail(str(error))
            return True
        self._show(shown)
        self._results.show(done)
        self._status.content = press_line(shown.pressed)
        return True

    def _command_line(self, changes: dict[str, float]) -> str:
        return command_line(self._source, changes, self._preview.measured_binning)

    def _watch(self, stage: str, fraction: float, /) -> None:
        if self._moved.is_set():
            raise _SliderMovedError
        self._results.progress(stage, fraction)

    def _show(self, shown: PreviewPicture) -> None:
        section = section_of(shown.experiment, shown.pressed)
        self._heights.content = height_scale(shown.pressed)
        self._results.picture(shown, section)
        self._picture.draw_press(shown.experiment, shown.pressed, section)
        self._picture.draw_rig(shown.experiment, rgb(shown.fringes))

    def _add_views(self) -> None:
        buttons = self._server.gui.add_button_group("view", VIEWS)
        buttons.on_click(lambda _: self._picture.show(buttons.value))

    def _add_sliders(self, sliders: Iterable[SliderRange]) -> None:
        for slider in sliders:
            if slider.key not in self._sliders:
                with self._folders[slider.group]:
                    self._sliders[slider.key] = slider, self._slider(slider)
        used = {slider.group for slider, _ in self._sliders.values()}
        for group, folder in self._folders.items():
            folder.visible = group in used

    def _slider(self, slider: SliderRange) -> Any:
        handle = self._server.gui.add_slider(
            slider.label,
            min=slider.low,
            max=slider.high,
            step=slider.step,
            initial_value=slider.value,
            hint=slider.key,
        )

        def move(_: Any) -> None:
            if handle.value == slider.value:  # also that of an automatic exposure
                self._changes.pop(slider.key, None)
            else:
                self._changes[slider.key] = float(handle.value)
            self._moved.set()

        handle.on_update(move)
        return handle

    def _reset(self, _: Any) -> None:
        for slider, handle in self._sliders.values():
            handle.value = slider.value

    def _add_measured(self, measured: Measurement) -> None:
        """Add the measured surface, coloured by its deviation from the true surface."""
        measured_surface = measured.fringes.reconstruction.point_map
        mesh, deviation = surface_mesh(measured_surface), deviation_of(measured)
        if len(mesh.vertices_mm) > _MOST_VERTICES:
            raise InputError(
                f"view: {len(mesh.vertices_mm)} points, at most {_MOST_VERTICES} are shown live; "
                "measure with camera.binning = 4, or open surface.ply in a mesh viewer"
            )
        raised_mm, rgb = mesh.vertices_mm + _RAISED_MM, deviation.rgb[measured_surface.valid]
        surface = SceneSurface("measured", raised_mm, mesh.triangles, rgb / 255.0)
        handle = self._picture.draw_surface("/measured", surface)
        box = self._server.gui.add_checkbox("surface of the folder", initial_value=True)
        self._server.gui.add_html(deviation_scale(deviation))

        def show(_: Any) -> None:
            handle.visible = box.value

        box.on_update(show)
