"""Draw the live view's scene in the browser: coat, specimen, section, camera and projector.

The methods send the content of `twin.viewer.scene` to a Viser server. A part that is drawn again
replaces the earlier one of the same name.
"""

from typing import Any

import numpy as np

from reconstruction.arrays import FloatArray, Levels
from twin.config import Experiment
from twin.config.models import Specimen
from twin.mechanics import PressedElastomer
from twin.optics.view import SceneSurface
from twin.report.scene import rig_lines
from twin.report.section import Trace
from twin.viewer.scene import (
    SceneDevice,
    SectionProfiles,
    Viewpoint,
    behind,
    coat_surface,
    devices,
    front_mm,
    near_mm,
    specimen_surface,
    viewpoints,
)

VIEWS = ("object", "section", "rig")
_SECTION_RGB, _SECTION_PX = (200, 0, 80), 3.0
_LINE_PX = 1.5


class ScenePicture:
    """The scene in the browser, in one of three views: object, section or rig."""

    def __init__(self, server: Any, experiment: Experiment) -> None:
        self._server, self._scene = server, server.scene
        self._shown = VIEWS[0]
        self._specimen: Specimen | None = None
        self._specimen_parts: tuple[Any, ...] = ()
        self._scene.set_up_direction("+z")
        self._scene.world_axes.visible = False
        self._viewpoints = viewpoints(experiment)
        first = self._viewpoints[self._shown]
        server.initial_camera.position, server.initial_camera.look_at = (
            first.position,
            first.look_at,
        )
        for name in (*VIEWS, "surfaces", "near"):
            self._scene.add_frame(f"/{name}", show_axes=False)
        self._show_parts()

    def show(self, view: str) -> None:
        """Show the parts of a view, and move all viewers to its viewpoint."""
        self._shown = view
        self._show_parts()
        for client in self._server.get_clients().values():
            self._move(client.camera, self._viewpoints[view])

    def draw_press(
        self, experiment: Experiment, pressed: PressedElastomer, section: SectionProfiles
    ) -> None:
        """Draw coat and specimen, whole and cut by the section, and the section's line."""
        self._draw_halves(coat_surface(pressed), section.trace)
        if self._specimen != experiment.specimen:  # its mesh may take longer than the press
            self._specimen = experiment.specimen
            drawn = self._draw_halves(specimen_surface(experiment.specimen), section.trace)
            self._specimen_parts = drawn
        for part in self._specimen_parts:
            part.position = (0.0, 0.0, front_mm(experiment, pressed))
        self._scene.add_line_segments(
            "/section_line",
            section.faces_mm,
            _SECTION_RGB,
            thickness=_SECTION_PX,
            thickness_units="screen",
        )

    def _draw_halves(self, surface: SceneSurface, trace: Trace) -> tuple[Any, Any]:
        """Draw a surface, and the half behind the section; return both handles."""
        cut = behind(surface, trace)
        whole = self.draw_surface(f"/surfaces/{surface.name}", surface)
        return whole, self.draw_surface(f"/{cut.name}", cut)

    def draw_surface(self, name: str, surface: SceneSurface) -> Any:
        """Draw a surface, and return its handle, with which it can be hidden."""
        rgb = np.rint(255 * surface.rgb).astype(np.uint8)
        if rgb.ndim == 1:
            mesh = surface.vertices_mm, surface.triangles
            return self._scene.add_mesh_simple(
                name, *mesh, color=tuple(rgb.tolist()), side="double"
            )
        from trimesh import Trimesh

        linear = np.rint(255 * _linear(surface.rgb)).astype(np.uint8)
        body = Trimesh(surface.vertices_mm, surface.triangles, vertex_colors=linear, process=False)
        return self._scene.add_mesh_trimesh(name, body)

    def draw_rig(self, experiment: Experiment, image: Levels) -> None:
        """Draw camera and projector: near the object, and at their true places.

        Parameters
        ----------
        image : (row, col, rgb) picture in the frustum of the camera
        """
        for lines in rig_lines(experiment, elastomer=False):
            ends_mm = np.asarray(lines.ends_mm, np.float64).reshape(-1, 2, 3)
            self._draw_lines(f"/rig/{lines.name}", ends_mm, lines.rgb)
        for device in devices(experiment):
            shown = image if device.name == "camera" else None
            self._draw_device(f"/rig/{device.name}", device, device.distance_mm, shown)
            near = near_mm(experiment)
            self._draw_device(f"/near/{device.name}", device, near, shown)
            axis = np.stack((device.at(near), np.zeros(3)))[np.newaxis]
            outline = np.concatenate((device.field_mm, axis))
            self._draw_lines(f"/near/{device.name} field", outline, device.rgb)

    def _draw_lines(self, name: str, ends_mm: FloatArray, rgb: tuple[int, int, int]) -> None:
        self._scene.add_line_segments(
            name, ends_mm, rgb, thickness=_LINE_PX, thickness_units="screen"
        )

    def _draw_device(
        self, name: str, device: SceneDevice, distance_mm: float, image: Levels | None
    ) -> None:
        place = device.at(distance_mm)
        self._scene.add_camera_frustum(
            name,
            fov=device.fov_rad,
            aspect=device.aspect,
            scale=device.frustum_scale(distance_mm),
            color=device.rgb,
            image=image,
            wxyz=_quaternion(device.pose[:3, :3]),
            position=place,
            thickness=2.0,
            thickness_units="screen",
        )
        self._scene.add_label(f"{name} label", device.label, position=place, anchor="bottom-center")

    def _show_parts(self) -> None:
        visible = {
            "/surfaces": self._shown != "section",
            "/section": self._shown == "section",
            "/near": self._shown != "rig",
            "/rig": self._shown == "rig",
        }
        for name, is_visible in visible.items():
            self._scene.get_handle_by_name(name).visible = is_visible

    def _move(self, camera: Any, viewpoint: Viewpoint) -> None:
        camera.position, camera.look_at = viewpoint.position, viewpoint.look_at


def _linear(rgb: FloatArray) -> FloatArray:
    """Return linear values, 0 to 1, of sRGB colours: glTF stores vertex colours linearly."""
    return np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)


def _quaternion(rotation: FloatArray) -> tuple[float, float, float, float]:
    """Return a rotation matrix (3, 3) as unit quaternion (w, x, y, z)."""
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_matrix(rotation).as_quat()
    return float(w), float(x), float(y), float(z)
