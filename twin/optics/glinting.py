"""Put the glints of a coat's flakes into a trace, as a weight of the trace's specular part.

The trace of a pixel contains the share s of light from flakes, by the coat's smooth BSDF. This
share is multiplied by the ratio of `glints`, and its projector position is the mean position of the
glinting flakes. No further ray is traced, and all frames use the same glints.

Approximations: the share s and the directions are those of the pixel's centre; shadows inside a
pixel are not those of single flakes; the footprint is that of a pixel in focus. In a layer, the
pupils appear under the solid angle that refraction at its plane interface gives.
"""

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import drjit as dr
import mitsuba as mi
import numpy as np
from scipy import ndimage

from reconstruction.arrays import FloatArray, FloatImage
from twin.config.coatings import Coating, DiscreteFacets
from twin.config.models import Experiment
from twin.mechanics.relief import MATERIAL_MM, FaceGrid
from twin.optics.connection import Connection, Rig, direction_to
from twin.optics.devices import Device
from twin.optics.flakes import FlakeProcess
from twin.optics.glints import GlintMaps, PixelMaps, glint_maps
from twin.optics.one_trace import GlintLight, Patches
from twin.optics.pupil_cone import Cone
from twin.optics.scene import coating_in_layer
from twin.optics.stack import Truth

if TYPE_CHECKING:
    import trimesh


def with_glints(
    experiment: Experiment,
    face: "FaceGrid | trimesh.Trimesh",
    rig: Rig,
    truth: Truth,
    patches: Patches,
) -> Patches:
    """Return the trace with the glints of the experiment's coat; unchanged for a smooth coat.

    Parameters
    ----------
    face : coated face. Its material coordinates are those of `MATERIAL_MM`, else world x and y
    """
    coating = coating_in_layer(experiment)
    facets = coating.facets()
    if facets is None:
        return patches
    maps = pixel_maps(experiment, facets, face, rig, truth)
    process, cone = FlakeProcess.of(facets, experiment.seed), cone_of(experiment, facets, rig)
    light = glint_maps(process, facets.share, cone, maps)
    share = np.where(light.valid, _flake_share(coating, facets, maps), 0.0)
    return _merged(patches, share, light)


def cone_of(experiment: Experiment, facets: DiscreteFacets, rig: Rig) -> Cone:
    """Return the cone of the rig's pupils and one flake, for a point at the world origin in air."""
    return Cone.of(*_pupils(experiment, rig), _scatter(facets))


def _scatter(facets: DiscreteFacets) -> float:
    """Return the standard deviation of the directions reflected by a flake, rad.

    The incidence is along the normal. At the angle of incidence theta the deviation across the
    plane of incidence is smaller by cos(theta).
    """
    return 2.0 * facets.glints.facet_roughness


def _pupils(experiment: Experiment, rig: Rig) -> tuple[float, float]:
    """Return the radii of the two pupils over their distances from the world origin, in air."""
    camera, projector = experiment.camera, experiment.projector
    radii_mm = camera.focal_length_mm / camera.f_number / 2.0, projector.aperture_mm / 2.0
    camera_mm, projector_mm = (
        float(np.linalg.norm(device.T_world_from_device[:3, 3]))
        for device in (rig.camera, rig.projector)
    )
    return radii_mm[0] / camera_mm, radii_mm[1] / projector_mm


def pixel_maps(
    experiment: Experiment,
    facets: DiscreteFacets,
    face: "FaceGrid | trimesh.Trimesh",
    rig: Rig,
    truth: Truth,
) -> PixelMaps:
    """Return the geometry at the centres of all camera pixels."""
    points_mm, pupils = truth.points_world_mm, _pupils(experiment, rig)
    to_eye, to_light = (_directions(rig, of, points_mm) for of in (rig.camera, rig.projector))
    projector_px = np.stack([truth.column_px, truth.row_px], axis=-1)
    parts = (_material(face, points_mm), projector_px, truth.normals_world, points_mm)
    return PixelMaps(
        valid=truth.measured,
        fields=np.concatenate(parts, axis=-1, dtype=np.float32),
        to_eye=to_eye,
        to_light=to_light,
        widening=_widening(rig, pupils, _scatter(facets), points_mm, (to_eye, to_light)),
    )


def _widening(
    rig: Rig,
    pupils: tuple[float, float],
    scatter: float,
    points_mm: FloatImage,
    directions: tuple[FloatImage, FloatImage],
) -> FloatImage:
    """Return the widths of the cone at each pixel over that of its table, by their variances.

    The last axis has the widths along the plane of incidence and across it.
    """
    cosine = 0.5 + 0.5 * np.sum(directions[0] * directions[1], axis=-1)
    variance = scatter**2 * np.stack([np.ones_like(cosine), cosine], axis=-1)
    devices = zip((rig.camera, rig.projector), pupils, directions, strict=True)
    for device, radius, direction in devices:
        position_mm = device.T_world_from_device[:3, 3]
        nearness = np.linalg.norm(position_mm) / np.linalg.norm(points_mm - position_mm, axis=-1)
        pupil = 0.25 * (radius * nearness) ** 2 * refracted(rig, direction)
        variance += pupil[..., None]
    of_table = scatter**2 + 0.25 * (pupils[0] ** 2 + pupils[1] ** 2)
    return np.asarray(np.sqrt(variance / of_table), np.float32)


def _directions(rig: Rig, device: Device, points_mm: FloatImage) -> FloatImage:
    """Return the unit vectors from surface points to a device, in the medium around the points."""
    points = mi.Point3f(points_mm.reshape(-1, 3).T)
    direction = np.array(direction_to(rig, device, points), np.float32)
    return np.ascontiguousarray(direction.T).reshape(points_mm.shape)


def _material(face: "FaceGrid | trimesh.Trimesh", points_mm: FloatImage) -> FloatArray:
    """Return the material coordinates of surface points, (row, col, 2), by linear interpolation."""
    places = points_mm[..., :2].astype(np.float64)
    if not isinstance(face, FaceGrid) or MATERIAL_MM not in face.vertex_attributes:
        return places
    material = face.vertex_attributes[MATERIAL_MM]
    grid = face.vertices.reshape(*face.shape, 3)
    corner, last = grid[0, 0, :2].astype(np.float64), grid[-1, -1, :2].astype(np.float64)
    nodes = np.array(face.shape[::-1]) - 1
    x, y = np.moveaxis((places - corner) * nodes / (last - corner), -1, 0)
    displaced = (material - face.vertices[:, :2]).reshape(*face.shape, 2)
    for k in range(2):
        places[..., k] += ndimage.map_coordinates(
            displaced[..., k], [y, x], order=1, mode="nearest"
        )
    return places


def refracted(rig: Rig, direction: FloatImage) -> Any:
    """Return the solid angle of a narrow cone in the last layer over that in air."""
    if rig.layers is None:
        return 1.0
    index, cosine = rig.layers.media[-1].ior, np.abs(direction[..., 2])
    in_air = np.sqrt(np.maximum(1.0 - index**2 * (1.0 - cosine**2), 0.0))
    return np.asarray(in_air / (index**2 * np.maximum(cosine, 1e-6)))


def _flake_share(coating: Coating, facets: DiscreteFacets, maps: PixelMaps) -> FloatArray:
    """Return the share of the reflected light that is from flakes, by the smooth BSDFs."""
    normal, eye, light = (
        mi.Vector3f(np.ascontiguousarray(vectors.reshape(-1, 3).T))
        for vectors in (maps.normals, maps.to_eye, maps.to_light)
    )
    frame, hit = mi.Frame3f(normal), dr.zeros(mi.SurfaceInteraction3f, dr.width(normal))
    hit.wi = frame.to_local(eye)
    flakes, coat = (
        np.array(mi.load_dict(bsdf).eval(mi.BSDFContext(), hit, frame.to_local(light))[0])
        for bsdf in (facets.bsdf, coating.bsdf())
    )
    share = np.divide(facets.share * flakes, coat, out=np.zeros_like(coat), where=coat > 0.0)
    return np.asarray(np.clip(share, 0.0, 1.0)).reshape(maps.valid.shape)


def _merged(patches: Patches, share: FloatArray, glints: GlintMaps) -> Patches:
    """Return the trace with the flakes' share of each weight replaced by the light of glints."""
    kept = mi.Float(1.0 - share.ravel())
    glinting = mi.Float((share * glints.ratio).ravel()) * patches.weight
    column, row = (mi.Float(glints.projector_px[..., k].ravel()) for k in range(2))
    lit = patches.weight > 0.0
    axial_mm = patches.weighted_axial_mm * dr.select(lit, dr.rcp(patches.weight), 0.0)
    light = Connection(column, row, glinting, glinting > 0.0, axial_mm)
    return replace(
        patches,
        weight=patches.weight * kept + glinting,
        weighted_column=patches.weighted_column * kept + glinting * column,
        weighted_row=patches.weighted_row * kept + glinting * row,
        weighted_axial_mm=patches.weighted_axial_mm * kept + glinting * axial_mm,
        glints=GlintLight(kept, light),
    ).evaluate()
