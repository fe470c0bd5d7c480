"""Mitsuba scene of the coated face, rig for the tracer, and sharp surfaces of a scene."""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import drjit as dr
import mitsuba as mi
import numpy as np

from reconstruction.errors import InputError
from twin.config.layers import Layer, holding_layer, media_of
from twin.config.models import Coating, Experiment
from twin.optics.checks import check_samples
from twin.optics.connection import Rig
from twin.optics.devices import Device
from twin.optics.height_grid import height_grid, is_even, shades_itself
from twin.optics.heights import MarchedHeights
from twin.optics.layers import LayerStack
from twin.optics.materials import (
    COATED_FACE,
    INK_ALBEDO,
    SHADE,
    coated_mesh,
    structure_of,
    updated,
)
from twin.optics.printed_dots import PrintedDots
from twin.optics.rig import ThinLens, irradiance_at_1mm, true_calibration

if TYPE_CHECKING:
    import trimesh

    from twin.mechanics.relief import FaceGrid


class CoatedScene:
    """Scene that contains only a coated face, with the ray queries of a Mitsuba scene.

    If `tree` is False, no tree of bounding boxes is built and ray queries raise RuntimeError. This
    is sufficient if all rays are marched over the face's grid of heights.
    """

    def __init__(
        self, face: "trimesh.Trimesh | FaceGrid", bsdf: dict[str, Any], *, tree: bool = True
    ) -> None:
        self._mesh = mesh = coated_mesh(face, bsdf)
        self._tree = _tree_of(mesh) if tree else None
        self._bsdf = bsdf
        #: `mi.ShapePtr` of the face; opaque, as its number must not be part of a kernel's code
        self.shape = dr.opaque(mi.ShapePtr, mesh)

    def put(self, face: "trimesh.Trimesh | FaceGrid") -> None:
        """Replace the face by another face with the same facets and the same attributes."""
        parameters = mi.traverse(self._mesh)
        for key, values in (("positions", face.vertices), ("normals", face.vertex_normals)):
            parameters[f"vertex_{key}"] = np.asarray(values, np.float32).ravel()
        shaded = INK_ALBEDO in face.vertex_attributes
        if ("vertex_shade" in parameters) != shaded:
            raise ValueError(f"one of the faces has no attribute {INK_ALBEDO}: use seen_face")
        if shaded:
            shade = face.vertex_attributes[INK_ALBEDO]
            parameters["vertex_shade"] = np.asarray(shade, np.float32)
        parameters.update()
        if self._tree is not None:
            self._tree = _tree_of(self._mesh)

    def set_coating(self, coating: Coating) -> None:
        """Replace the coating of the face, without changing its geometry.

        Parameters
        ----------
        coating : any coating. If its BSDF differs from the present BSDF only in numbers, these are
            updated and the compiled kernel is reused; otherwise the BSDF is replaced and another
            kernel is compiled
        """
        bsdf, before = coating.bsdf(), self._bsdf
        if bsdf == before:
            return
        if structure_of(bsdf) != structure_of(before) or not updated(self._mesh, bsdf, before):
            self._mesh.set_bsdf(mi.load_dict(bsdf))
            # Updated numbers are no literals of the kernel, which the next coat can reuse.
            updated(self._mesh, bsdf, bsdf)
        self._bsdf = bsdf

    def shapes(self) -> list[Any]:
        """Return the face, `mi.Mesh`, in a list."""
        return [self._mesh]

    def bbox(self) -> Any:
        """Return the bounding box of the face, `mi.BoundingBox3f`, mm."""
        return self._mesh.bbox()

    def ray_intersect(self, *ray: Any, **how: Any) -> Any:
        """Return the first hits of rays; arguments are those of `mi.Scene.ray_intersect`."""
        return self._planted().ray_intersect(*ray, **how)

    def ray_test(self, *ray: Any, **how: Any) -> Any:
        """Return True for rays that meet the face; arguments are those of `mi.Scene.ray_test`."""
        return self._planted().ray_test(*ray, **how)

    def _planted(self) -> Any:
        # Not built here: while Dr.Jit records a loop of ray queries, no scene may be loaded.
        if self._tree is None:
            raise RuntimeError("the coated face was loaded without a tree: its rays are marched")
        return self._tree


def _tree_of(mesh: Any) -> Any:
    # optimize=False: since 3.7 load_dict merges shapes, which breaks later parameter updates.
    return mi.load_dict({"type": "scene", COATED_FACE: mesh}, optimize=False)


def marched_scene(
    experiment: Experiment, face: "trimesh.Trimesh | FaceGrid", bsdf: dict[str, Any]
) -> CoatedScene:
    """Return the scene of the coated face with the BSDF `bsdf`, for use with `coated_rig`.

    The scene has a tree only if rays are not marched, or if there are bounces.

    Raises
    ------
    InputError : the face protrudes from the layers above it
    """
    check_below_layers(experiment.layers, face)
    grid = height_grid(face)
    tree = experiment.bounces > 0 or grid is None or not is_even(grid)
    return CoatedScene(face, bsdf, tree=tree)


def bsdf_on(face: "trimesh.Trimesh | FaceGrid", coating: Coating) -> dict[str, Any]:
    """Return a coat's BSDF for `mi.load_dict`; a face with `INK_ALBEDO` has a texture as albedo."""
    shaded = INK_ALBEDO in face.vertex_attributes
    return coating.bsdf_with_ink(SHADE) if shaded else coating.bsdf()


def heights_of(face: "trimesh.Trimesh | FaceGrid") -> MarchedHeights | None:
    """Return the heights of a face for ray marching; None if its vertices are no uniform grid."""
    grid = height_grid(face)
    return None if grid is None else MarchedHeights.of_grid(grid)


def rig_of(experiment: Experiment) -> Rig:
    """Return the devices, radiometric scale and layers of an experiment, as input of the tracer.

    Raises
    ------
    InputError : depth of field with one sample per pixel, which uses only one point of the lens
    """
    calibration = true_calibration(experiment)
    lens = ThinLens.of(experiment.camera, calibration.T_world_from_cam)
    check_samples(experiment)
    return Rig(
        camera=Device(calibration.camera, calibration.T_world_from_cam, lens=lens),
        projector=Device(calibration.projector, calibration.T_world_from_proj),
        irradiance_at_1mm=irradiance_at_1mm(experiment.projector, calibration.projector),
        layers=layer_stack(experiment),
    )


def coated_rig(experiment: Experiment, face: "trimesh.Trimesh | FaceGrid") -> Rig:
    """Return the rig for a scene of only the coated face, with the dots printed on it.

    Rays are marched if the vertices of the face are a uniform grid of heights.
    """
    rig, grid = rig_of(experiment), height_grid(face)
    rig = replace(rig, dots=PrintedDots.on(experiment.photometric.markers, face))
    if grid is None:
        return rig
    position_mm = rig.projector.T_world_from_device[:3, 3]
    shadows = rig.layers is not None or shades_itself(grid, position_mm)
    return replace(rig, shadows=shadows, heights=MarchedHeights.of_grid(grid))


def layer_stack(experiment: Experiment) -> LayerStack | None:
    """Return the clear layers between both devices and the coat; None: there is only air."""
    return LayerStack(media_of(experiment.layers)) if experiment.layers else None


def coating_in_layer(experiment: Experiment) -> Coating:
    """Return the coat with refractive indices relative to the medium around it, not to air.

    Raises
    ------
    InputError : the model of the coat is not valid in that medium
    """
    holder = holding_layer(experiment.layers)
    return experiment.coating if holder is None else experiment.coating.in_medium(holder.ior)


def check_below_layers(layers: dict[str, Layer], face: "trimesh.Trimesh | FaceGrid") -> None:
    """Raise InputError if a coated face reaches the lowest interface of the layers.

    Raises
    ------
    InputError : a vertex of the face (world mm) is at the height of this interface or higher
    """
    if not layers:
        return
    highest_mm, floor_mm = face.vertices[:, 2].max(), media_of(layers)[-1].top_mm
    if highest_mm >= floor_mm:
        raise InputError(
            f"layers: the coated face reaches z = {highest_mm:.4g} mm, allowed below "
            f"{floor_mm:.4g} mm, the bottom of the next layer; press less or move the layer"
        )


@dataclass(frozen=True)
class Sharp:
    """A clear or polished body, which refracts or reflects light into sharp directions."""

    #: `mi.Shape` of the body
    shape: Any
    #: Napierian absorption coefficient inside, 1/mm
    absorption_per_mm: float = 0.0


@dataclass(frozen=True)
class Surfaces:
    """The sharp bodies of a scene, and the stage that receives light from them.

    Attributes
    ----------
    sharp : bodies that refract or reflect light into sharp directions
    stage : mi.Shape, horizontal matte plane; None: the scene has no stage
    """

    sharp: tuple[Sharp, ...] = ()
    stage: Any = None

    def is_sharp(self, hit: Any) -> Any:
        """Return True for hits on a clear or polished body (one of `sharp`), `mi.Bool`."""
        sharp = dr.zeros(mi.Bool, dr.width(hit.t))
        for body in self.sharp:
            sharp |= hit.shape == dr.opaque(mi.ShapePtr, body.shape)
        return sharp

    def is_stage(self, hit: Any) -> Any:
        """Return True for hits on the stage, `mi.Bool`."""
        if self.stage is None:
            return dr.zeros(mi.Bool, dr.width(hit.t))
        return hit.shape == dr.opaque(mi.ShapePtr, self.stage)

    def on_stage(self, hit: Any) -> Any:
        """Return True for hits on the upper side of the stage, `mi.Bool`."""
        return self.is_stage(hit) & (hit.wi.z > 0.0)

    def transmittance(self, hit: Any, inside: Any) -> Any:
        """Return the transmittance (Beer-Lambert) of the last path segment, which ends at `hit`.

        It is 1 where the segment is not `inside` a body. The body is the one hit at the end of the
        segment, because bodies do not overlap.
        """
        absorption = mi.Float(0.0)
        for body in self.sharp:
            if body.absorption_per_mm:
                here = hit.shape == dr.opaque(mi.ShapePtr, body.shape)
                absorption = dr.select(here, body.absorption_per_mm, absorption)
        return dr.select(inside, dr.exp(-absorption * hit.t), 1.0)
