"""Content of the live view's scene: surfaces, section, devices and viewpoints, world frame, mm.

The devices are up to 20 times as far from the object as the object is wide. In the views of the
object they are therefore drawn near it, in their true directions, with labels that state the true
distances. The view of the rig shows them at their true places.
"""

from dataclasses import dataclass, replace

import numpy as np
from matplotlib import colormaps

from reconstruction.arrays import FloatArray
from reconstruction.rig.pinhole import Pinhole
from twin.config import Experiment
from twin.config.models import Specimen
from twin.mechanics import PressedElastomer, face_mesh
from twin.optics.rig import true_calibration
from twin.optics.view import SceneSurface
from twin.report.scene import (
    CAMERA_RGB,
    PROJECTOR_RGB,
    SPECIMEN,
    SPECIMEN_RGB,
    field_corners,
)
from twin.report.section import (
    Trace,
    face_profile,
    slab_span,
    specimen_profile,
    touched_profile,
    trace_through_apexes,
)
from twin.specimens import shape_of

COAT = "coat"
_SECTION_POINTS = 401
# Of the elastomer's diagonal: distance at which the devices are drawn in the views of the object.
_NEAR = 0.7
# A frustum's length over the distance of its device from the origin.
_FRUSTUM = 0.125


@dataclass(frozen=True, eq=False)
class SectionProfiles:
    """Profiles in the vertical plane through the apexes of the specimen.

    Attributes
    ----------
    trace : line of the plane in world xy
    s_mm : (n,) positions along the line
    coat_mm, touched_mm, specimen_mm : (n,) world z of the coated face, of the touched face and of
        the specimen's upper side; NaN outside the specimen
    """

    trace: Trace
    s_mm: FloatArray
    coat_mm: FloatArray
    touched_mm: FloatArray
    specimen_mm: FloatArray

    @property
    def faces_mm(self) -> FloatArray:
        """Line segments (2 n - 2, 2, xyz) of the coated and of the touched face in the plane."""
        plan = self.trace.points(self.s_mm)
        faces = [np.column_stack((plan, z_mm)) for z_mm in (self.coat_mm, self.touched_mm)]
        return np.concatenate([np.stack((face[:-1], face[1:]), axis=1) for face in faces])


@dataclass(frozen=True, eq=False)
class SceneDevice:
    """Camera or projector in the scene.

    Attributes
    ----------
    name : "camera" or "projector"
    pinhole : its projection
    pose : (4, 4) transform from the device's frame to the world
    rgb : its colour, 0 to 255
    """

    name: str
    pinhole: Pinhole
    pose: FloatArray
    rgb: tuple[int, int, int]

    @property
    def distance_mm(self) -> float:
        """Distance of the device from the world origin."""
        return float(np.linalg.norm(self.pose[:3, 3]))

    @property
    def label(self) -> str:
        """Name with the true distance."""
        return f"{self.name}, distance {self.distance_mm:.0f} mm"

    @property
    def fov_rad(self) -> float:
        """Vertical field of view."""
        return 2.0 * float(np.arctan(self._half))

    @property
    def aspect(self) -> float:
        """Width over height of the field."""
        return self.pinhole.width_px / self.pinhole.height_px

    def frustum_scale(self, distance_mm: float) -> float:
        """Return the scale of a frustum in Viser, which scales it by its volume.

        The frustum's length is 1/8 of the distance at which the device is drawn.
        """
        return _FRUSTUM * distance_mm * float(np.cbrt(self._half**2 * self.aspect / 3.0))

    def at(self, distance_mm: float) -> FloatArray:
        """Return the point at a distance from the origin in the direction of the device."""
        return np.asarray(self.pose[:3, 3] * (distance_mm / self.distance_mm))

    @property
    def field_mm(self) -> FloatArray:
        """Line segments (4, 2, xyz): the outline of the device's field on z = 0."""
        corners = field_corners(self.pinhole, self.pose)
        return np.stack((corners, np.roll(corners, -1, axis=0)), axis=1)

    @property
    def _half(self) -> float:
        return 0.5 * self.pinhole.height_px / self.pinhole.fy_px


@dataclass(frozen=True)
class Viewpoint:
    """Position of the viewer and the point in the middle of the view, world mm."""

    position: tuple[float, float, float]
    look_at: tuple[float, float, float]


def coat_surface(pressed: PressedElastomer) -> SceneSurface:
    """Return the coat at the end of the press; its colour shows its height."""
    coat = face_mesh(pressed)
    low, high = heights_mm(pressed)
    share = (np.asarray(coat.vertices)[:, 2] - low) / (high - low)
    return SceneSurface.of_mesh(COAT, coat, colormaps["viridis"](share)[:, :3])


def specimen_surface(specimen: Specimen) -> SceneSurface:
    """Return the specimen in its pose, with its foremost point at z = 0: see `front_mm`."""
    mesh = shape_of(specimen).mesh(0.0)
    return SceneSurface.of_mesh(SPECIMEN, mesh, np.divide(SPECIMEN_RGB, 255.0))


def front_mm(experiment: Experiment, pressed: PressedElastomer) -> float:
    """Return world z of the specimen's foremost point at the end of the press, mm."""
    return float(experiment.elastomer.touched_plane_mm + pressed.depth_mm)


def heights_mm(pressed: PressedElastomer) -> tuple[float, float]:
    """Return the lowest and the highest z of the coat, mm: the ends of its height scale."""
    low, high = float(pressed.face_z_mm.min()), float(pressed.face_z_mm.max())
    return low, max(high, low + 1e-9)


def section_of(experiment: Experiment, pressed: PressedElastomer) -> SectionProfiles:
    """Return the profiles of coat, touched face and specimen in the plane through the apexes."""
    trace = trace_through_apexes(experiment)
    s_mm = np.linspace(*slab_span(experiment, trace), _SECTION_POINTS)
    specimen = specimen_profile(experiment, pressed, trace, s_mm)
    return SectionProfiles(
        trace,
        s_mm,
        face_profile(pressed, trace, s_mm),
        touched_profile(experiment, pressed, trace, s_mm),
        np.where(np.isfinite(specimen), specimen, np.nan),
    )


def behind(surface: SceneSurface, trace: Trace) -> SceneSurface:
    """Return the part of a surface behind the section, on the side of positive offsets."""
    offset = trace.offset(surface.vertices_mm[:, 0], surface.vertices_mm[:, 1])
    kept = (offset[surface.triangles] >= 0).all(axis=1)
    return replace(surface, name=f"section/{surface.name}", triangles=surface.triangles[kept])


def devices(experiment: Experiment) -> tuple[SceneDevice, SceneDevice]:
    """Return camera and projector of an experiment."""
    rig = true_calibration(experiment)
    return (
        SceneDevice("camera", rig.camera, rig.T_world_from_cam, CAMERA_RGB),
        SceneDevice("projector", rig.projector, rig.T_world_from_proj, PROJECTOR_RGB),
    )


def near_mm(experiment: Experiment) -> float:
    """Return the distance at which the devices are drawn in the views of the object, mm."""
    return _NEAR * _diagonal_mm(experiment)


def viewpoints(experiment: Experiment) -> dict[str, Viewpoint]:
    """Return the viewpoints of the scene by name: of the object, of the section, of the rig."""
    size = _diagonal_mm(experiment)
    reach = max(device.distance_mm for device in devices(experiment))
    trace = trace_through_apexes(experiment)
    along, middle = trace.direction, trace.origin_mm
    front = np.array([along[1], -along[0]])  # opposite to the part that remains
    x, y = middle + 0.75 * size * front
    return {
        "object": Viewpoint((0.25 * size, -0.85 * size, 0.75 * size), (0.0, 0.0, 0.17 * size)),
        "section": Viewpoint(
            (float(x), float(y), 0.25 * size), (float(middle[0]), float(middle[1]), 0.0)
        ),
        "rig": Viewpoint(
            (0.3 * reach, -1.15 * reach, 0.7 * reach), (0.1 * reach, 0.0, 0.42 * reach)
        ),
    }


def _diagonal_mm(experiment: Experiment) -> float:
    return float(np.hypot(experiment.elastomer.length_x_mm, experiment.elastomer.length_y_mm))
