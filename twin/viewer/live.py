"""Live view in a browser: rig, coat, specimen, camera image and sliders.

The package viser (extra `view`) displays the view. Its threads only store the latest slider values.
The main thread computes the images, so that a signal ends the command.
"""

import gc
import io
import threading
import time
from contextlib import redirect_stdout
from importlib import import_module
from typing import Any

import numpy as np

from reconstruction.arrays import FloatArray, Levels
from reconstruction.colouring import Deviation
from reconstruction.errors import InputError
from reconstruction.evaluate.surface import surface_mesh
from reconstruction.rig.pinhole import Pinhole
from twin.config import Experiment
from twin.extras import missing
from twin.mechanics import PressedElastomer
from twin.optics.rig import true_calibration
from twin.optics.view import SceneSurface
from twin.report.scene import CAMERA_RGB, PROJECTOR_RGB, rig_lines
from twin.results.folder import deviation_of
from twin.results.record import Measurement
from twin.viewer.preview import Preview, PreviewPicture, SliderRange, slider_ranges

_STEPS = 100
# Offset of the measured surface above the coat of the preview, which would intersect it.
_RAISED_MM = (0.0, 0.0, 0.05)
_MOST_VERTICES = 200_000


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
        self, experiment: Experiment, measured: Measurement | None, host: str, port: int
    ) -> None:
        viser = viser_module()
        self._preview = Preview(experiment)
        self._changes: dict[str, float] = {}
        self._pressed: PressedElastomer | None = None
        self._moved = threading.Event()
        self._moved.set()
        with redirect_stdout(io.StringIO()):  # viser prints a banner
            self._server = viser.ViserServer(host, port, label="fringe-twin", verbose=False)
        self._server.scene.set_up_direction("+z")
        reach = experiment.camera.pose.standoff_mm
        self._server.initial_camera.position = (0.25 * reach, -0.5 * reach, 0.45 * reach)
        self._server.initial_camera.look_at = (0.0, 0.0, 0.0)
        blank: Levels = np.zeros((8, 8, 3), np.uint8)
        gui = self._server.gui
        self._status = gui.add_markdown("pressing ...")
        self._fringes = gui.add_image(blank, label="camera image: fringes")
        self._white = gui.add_image(blank, label="camera image: white light")
        for control in slider_ranges(experiment):
            self._add_slider(control)
        if measured is not None:
            self._add_measured(measured)

    @property
    def address(self) -> str:
        """URL at which a browser shows the view."""
        return f"http://{self._server.get_host()}:{self._server.get_port()}"

    def serve(self) -> None:
        """Recompute the view for new slider values, until a signal ends the process."""
        while True:
            # With a time limit: on some systems a wait without one does not handle signals.
            if self._moved.wait(0.2):
                self._moved.clear()
                self._update(dict(self._changes))
                if not gc.get_freeze_count():
                    # Objects that exist now are excluded from later collections, which the renderer
                    # runs before each picture and which take 50 % of its time.
                    gc.collect()
                    gc.freeze()

    def close(self) -> None:
        """Stop the server of the view."""
        self._server.stop()

    def _add_slider(self, control: SliderRange) -> None:
        step = (control.high - control.low) / _STEPS
        slider = self._server.gui.add_slider(
            control.label, min=control.low, max=control.high, step=step, initial_value=control.value
        )

        def move(_: Any) -> None:
            self._changes[control.key] = float(slider.value)
            self._moved.set()

        slider.on_update(move)

    def _update(self, changes: dict[str, float]) -> None:
        start = time.perf_counter()
        try:
            shown = self._preview.show(changes)
        except InputError as error:
            self._status.content = f"**not possible:** {error}"
            return
        self._fringes.image, self._white.image = _rgb(shown.fringes), _rgb(shown.white)
        pressed = shown.pressed
        self._status.content = (
            f"force {pressed.force_n:.3g} N, travel {pressed.depth_mm:.3g} mm, coat up to "
            f"{pressed.face_z_mm.max():.3g} mm; picture in {time.perf_counter() - start:.2f} s"
        )
        if self._pressed is None or not np.array_equal(self._pressed.face_z_mm, pressed.face_z_mm):
            for surface in shown.surfaces:
                self._draw_surface(surface)
            self._pressed = pressed
        self._draw_rig(shown)

    def _draw_surface(self, surface: SceneSurface) -> Any:
        """Add a surface to the scene, and return its handle, with which it can be hidden."""
        rgb, name = np.rint(255 * surface.rgb).astype(np.uint8), f"/{surface.name}"
        if rgb.ndim == 1:
            mesh = surface.vertices_mm, surface.triangles
            return self._server.scene.add_mesh_simple(name, *mesh, color=tuple(rgb.tolist()))
        from trimesh import Trimesh

        body = Trimesh(surface.vertices_mm, surface.triangles, vertex_colors=rgb, process=False)
        return self._server.scene.add_mesh_trimesh(name, body)

    def _draw_rig(self, shown: PreviewPicture) -> None:
        for lines in rig_lines(shown.experiment, elastomer=False):
            ends_mm, scene = lines.ends_mm.reshape(-1, 2, 3), self._server.scene
            scene.add_line_segments(f"/{lines.name}", ends_mm, lines.rgb, thickness=0.2)
        rig, visible = true_calibration(shown.experiment), _rgb(shown.fringes)
        self._add_device("/camera", rig.camera, rig.T_world_from_cam, CAMERA_RGB, visible)
        self._add_device("/projector", rig.projector, rig.T_world_from_proj, PROJECTOR_RGB, None)

    def _add_device(
        self,
        name: str,
        device: Pinhole,
        pose: FloatArray,
        rgb: tuple[int, int, int],
        image: Levels | None,
    ) -> None:
        half = 0.5 * device.height_px / device.fy_px
        aspect = device.width_px / device.height_px
        # Viser scales a frustum by its volume: with this scale its length is 1/8 of the distance
        # from the device to the origin.
        depth_mm = float(np.linalg.norm(pose[:3, 3])) / 8.0
        self._server.scene.add_camera_frustum(
            name,
            fov=2.0 * float(np.arctan(half)),
            aspect=aspect,
            scale=depth_mm * float(np.cbrt(half * half * aspect / 3.0)),
            color=rgb,
            image=image,
            wxyz=_quaternion(pose[:3, :3]),
            position=pose[:3, 3],
            thickness=0.4,
        )

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
        handle = self._draw_surface(
            SceneSurface("measured", raised_mm, mesh.triangles, rgb / 255.0)
        )
        box = self._server.gui.add_checkbox(_told_of(deviation), initial_value=True)

        def show(_: Any) -> None:
            handle.visible = box.value

        box.on_update(show)


def _told_of(deviation: Deviation) -> str:
    limit = deviation.limit_um
    return f"measured; blue -{limit:.3g} um, red +{limit:.3g} um"


def _rgb(levels: Levels) -> Levels:
    return np.repeat(levels[..., np.newaxis], 3, axis=-1)


def _quaternion(rotation: FloatArray) -> tuple[float, float, float, float]:
    """Return a rotation matrix (3, 3) as unit quaternion (w, x, y, z)."""
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_matrix(rotation).as_quat()
    return float(w), float(x), float(y), float(z)
