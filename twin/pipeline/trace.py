"""Run the one-trace renderer in steps, so that the result of each step can be cached separately.

Loaded surfaces are valid for all coats, cameras and projectors. Traced rays and photons are valid
for all patterns, frames for any noise of the camera. Each step receives the experiment, of which it
reads only its own fields, and the results of earlier steps. This module must be imported within a
`renderer_session`.
"""

import gc
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from reconstruction.arrays import FloatImage
from twin.config.digest import seed_sequence
from twin.config.models import Experiment
from twin.mechanics.relief import FaceGrid
from twin.optics.albedo import albedo_of
from twin.optics.bounces import Bounces
from twin.optics.checks import check_focus, check_stock
from twin.optics.connection import Rig, axial_range_mm
from twin.optics.direct import direct_scene
from twin.optics.glinting import with_glints
from twin.optics.light import LightTable, light_tables, pattern_set
from twin.optics.materials import coated_mesh
from twin.optics.one_trace import Patches, maps_of, trace_patches, trace_stack, trace_truth
from twin.optics.photons import Photons, StageLight, map_photons, trace_photons
from twin.optics.scene import Surfaces, coated_rig, coating_in_layer, marched_scene, rig_of
from twin.optics.session import renderer_session
from twin.optics.stack import RadianceStack, TraceMaps, Truth
from twin.optics.stock import render_stack
from twin.optics.stock_dots import cell_coordinates, cell_texture, dotted

if TYPE_CHECKING:
    import trimesh

# Coat of a loaded face; each step that depends on the coat first sets that of its experiment.
_BARE = {"type": "diffuse"}


@dataclass(frozen=True, eq=False)
class Geometry:
    """Loaded scene: a pressed face with an exchangeable coat, or a bare specimen on its stage.

    Attributes
    ----------
    scene : scene of the renderer
    surfaces : clear and polished bodies of the scene, and the table under the specimen (`Stage`),
        which receives their light
    face : mesh of the pressed face; None for a bare specimen
    """

    scene: Any
    surfaces: Surfaces
    face: "trimesh.Trimesh | FaceGrid | None" = None


@dataclass(frozen=True, eq=False)
class View:
    """Camera and projector placed about a scene, and the true surface at every camera pixel.

    Attributes
    ----------
    rig : camera and projector
    axial_mm : nearest and farthest distance of the scene along the projector's axis
    truth : true surface at the camera pixels
    """

    rig: Rig
    axial_mm: tuple[float, float]
    truth: Truth


@dataclass(frozen=True, eq=False)
class Traced:
    """Traced light from which frames are computed.

    Attributes
    ----------
    patches : rays of the camera
    photons : light by way of clear and polished bodies; None if there are no such bodies
    tables : light of the patterns along the two axes of the projector, by name of the axis
    """

    patches: Patches
    photons: Photons | None
    tables: dict[str, LightTable]


@renderer_session()
def load_face(experiment: Experiment, face: "trimesh.Trimesh | FaceGrid") -> Geometry:
    """Return the scene of a pressed face.

    Parameters
    ----------
    face : mesh of the coated face, world, mm

    Raises
    ------
    InputError : the face intersects the layers through which it is seen
    """
    if not isinstance(face, FaceGrid):
        # A mesh of trimesh has reference cycles: the previous face, up to 70 MB, would remain in
        # memory until Python's next collection of cycles, which takes 0.1 s.
        gc.collect()
    return Geometry(marched_scene(experiment, face, _BARE), Surfaces(), face)


@renderer_session()
def load_bare(experiment: Experiment) -> Geometry:
    """Return the scene of the bare specimen on its stage.

    Raises
    ------
    InputError : a part of the specimen has no material
    """
    built = direct_scene(experiment)
    return Geometry(built.scene, built.surfaces)


@renderer_session()
def view_of(experiment: Experiment, geometry: Geometry) -> View:
    """Return camera and projector placed about a scene, and the true surface at the pixels."""
    scene, face = geometry.scene, geometry.face
    rig = rig_of(experiment) if face is None else coated_rig(experiment, face)
    axial_mm = axial_range_mm(scene, rig)
    return View(rig, axial_mm, trace_truth(scene, rig, geometry.surfaces))


@renderer_session()
def patches_of(experiment: Experiment, geometry: Geometry, view: View) -> Patches:
    """Return the traced rays of all camera pixels, which are independent of the patterns.

    They include the glints of the coat.
    """
    dress(experiment, geometry)
    rays = trace_patches(geometry.scene, view.rig, experiment.render.samples).evaluate()
    if geometry.face is None:
        return rays
    return with_glints(experiment, geometry.face, view.rig, view.truth, rays)


@renderer_session()
def surface_albedo(experiment: Experiment, geometry: Geometry, view: View) -> FloatImage:
    """Return the albedo (row, col) of the surface at every camera pixel, see `albedo_of`."""
    dress(experiment, geometry)
    return albedo_of(geometry.scene, view.rig)


@renderer_session()
def maps_of_patches(patches: Patches, view: View) -> TraceMaps:
    """Return sums over the rays of each camera pixel as images (row, col), see `TraceMaps`."""
    return maps_of(patches, view.rig.camera.pinhole)


@renderer_session()
def photons_of(experiment: Experiment, geometry: Geometry, view: View) -> Photons | None:
    """Return the projector's light on the table under the specimen by way of sharp bodies.

    Sharp bodies are clear or polished bodies. None if the scene has no such bodies.

    Raises
    ------
    InputError : the blur of the projector depends on the distance
    """
    if not geometry.surfaces.sharp:
        return None
    check_focus(experiment)
    count, (seed, _) = experiment.render.photons, _direct_seeds(experiment)
    return trace_photons(geometry.scene, geometry.surfaces, view.rig, count=count, seed=seed)


@renderer_session()
def tables_of(experiment: Experiment, view: View) -> dict[str, LightTable]:
    """Return the light of the patterns as tables along each axis of the projector, by axis name."""
    patterns = pattern_set(experiment.projector, experiment.patterns)
    return light_tables(experiment.projector, patterns, view.axial_mm)


@renderer_session()
def light(
    experiment: Experiment,
    geometry: Geometry,
    view: View,
    traced: Traced,
    progress: Callable[[float], None],
) -> RadianceStack:
    """Return the radiance of all frames of the experiment's sequence from the traced light.

    Parameters
    ----------
    progress : function that is called with the finished fraction, 0 to 1
    """
    # Pixels at edges, and reflections between surfaces, are traced here, and depend on the coat.
    dress(experiment, geometry)
    bounces = bounces_of(experiment, geometry, traced.photons, traced.tables)
    frames = trace_stack(
        geometry.scene,
        view.rig,
        traced.tables,
        traced.patches,
        bounces=bounces,
        progress=progress,
    )
    return RadianceStack(frames, view.truth)


@renderer_session()
def light_with_stock(
    experiment: Experiment,
    geometry: Geometry,
    view: View,
    tables: dict[str, LightTable],
    progress: Callable[[float], None],
) -> RadianceStack:
    """Return the radiance of all frames on a pressed face, each rendered by stock Mitsuba.

    Parameters
    ----------
    progress : function that is called with the finished fraction, 0 to 1

    Raises
    ------
    InputError : stock Mitsuba cannot represent the experiment
    """
    check_stock(experiment)
    assert geometry.face is not None
    patterns = pattern_set(experiment.projector, experiment.patterns)
    seeds = seed_sequence(experiment, "stock").generate_state(len(patterns.frames)).tolist()
    frames = render_stack(
        _stock_mesh(experiment, geometry.face),
        view.rig,
        patterns,
        tables,
        emitter=experiment.render.stock_emitter,
        samples=experiment.render.samples,
        bounces=experiment.bounces,
        seeds=seeds,
        progress=progress,
    )
    return RadianceStack(frames, view.truth)


def _stock_mesh(experiment: Experiment, face: "trimesh.Trimesh | FaceGrid") -> Any:
    coat, markers = experiment.coating.bsdf(), experiment.photometric.markers
    if markers is None:
        return coated_mesh(face, coat)
    return coated_mesh(face, dotted(coat, cell_texture(markers)), cell_coordinates(markers, face))


@renderer_session()
def dress(experiment: Experiment, geometry: Geometry) -> None:
    """Set the coat of a loaded face to that of the experiment; a bare specimen is unchanged."""
    if geometry.face is not None:
        geometry.scene.set_coating(coating_in_layer(experiment))


def bounces_of(
    experiment: Experiment,
    geometry: Geometry,
    photons: Photons | None,
    tables: dict[str, LightTable],
) -> Bounces | None:
    """Return the settings of light reflected between surfaces.

    None if the experiment requests no such reflections, and there are no sharp bodies, whose light
    is always traced.
    """
    if not (experiment.bounces or geometry.surfaces.sharp):
        return None
    if geometry.face is None:
        received = None if photons is None else StageLight(map_photons(photons, tables))
        most, paths = experiment.bounces, experiment.render.bounce_paths
        return Bounces(most, paths, _direct_seeds(experiment)[1], geometry.surfaces, received)
    seed = int(seed_sequence(experiment, "bounces").generate_state(1)[0])
    return Bounces(experiment.bounces, experiment.render.bounce_paths, seed)


def _direct_seeds(experiment: Experiment) -> tuple[int, int]:
    """Return the random seeds of the photons and of the paths for a bare specimen."""
    photons, paths = seed_sequence(experiment, "direct").generate_state(2).tolist()
    return photons, paths
