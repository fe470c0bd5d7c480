"""The one-trace renderer in steps; a step is reused if the fields that it reads are the same.

Surfaces serve all coats and devices; rays to them, and photons, all patterns; frames
all cameras' noise. Each step takes the experiment for the fields it reads itself and the earlier
steps' results for the rest. Import within a `renderer_session`.
"""

import gc
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from twin.config.digest import seed_sequence
from twin.config.models import Experiment
from twin.optics.bounces import Bounces
from twin.optics.checks import check_focus, check_stock
from twin.optics.connection import Rig, axial_range_mm
from twin.optics.direct import direct_scene
from twin.optics.light import LightTable, light_tables, pattern_set
from twin.optics.materials import coated_mesh
from twin.optics.one_trace import Patches, maps_of, trace_patches, trace_stack, trace_truth
from twin.optics.photons import Photons, StageLight, map_photons, trace_photons
from twin.optics.scene import Surfaces, coated_rig, coating_in_layer, marched_scene, rig_of
from twin.optics.session import renderer_session
from twin.optics.stack import RadianceStack, TraceMaps, Truth
from twin.optics.stock import render_stack

if TYPE_CHECKING:
    import trimesh

# Any coat: each step that looks at the coat sets its own first.
_BARE = {"type": "diffuse"}


@dataclass(frozen=True, eq=False)
class Geometry:
    """Loaded surfaces: a pressed face with a changing coat, or a bare specimen.

    Attributes
    ----------
    face : None where the bare specimen is seen
    """

    scene: Any
    surfaces: Surfaces
    face: "trimesh.Trimesh | None" = None


@dataclass(frozen=True, eq=False)
class View:
    """Devices about a scene, its largest distance from the projector, and its true geometry."""

    rig: Rig
    axial_mm: tuple[float, float]
    truth: Truth


@dataclass(frozen=True, eq=False)
class Traced:
    """Input of the frames: rays of the camera, those of clear bodies, and the patterns."""

    patches: Patches
    photons: Photons | None
    tables: dict[str, LightTable]


@renderer_session()
def load_face(experiment: Experiment, face: "trimesh.Trimesh") -> Geometry:
    """Load a pressed face.

    Raises
    ------
    InputError : the face pokes through the layers that it is seen through
    """
    # A mesh of trimesh and a traversal of Mitsuba hold themselves: the face before this one, up to
    # 70 MB, would stay until Python looks for such cycles by itself.
    gc.collect()
    return Geometry(marched_scene(experiment, face, _BARE), Surfaces(), face)


@renderer_session()
def load_bare(experiment: Experiment) -> Geometry:
    """Load the bare specimen on its stage.

    Raises
    ------
    InputError : a part of the specimen has no material
    """
    built = direct_scene(experiment)
    return Geometry(built.scene, built.surfaces)


@renderer_session()
def view_of(experiment: Experiment, geometry: Geometry) -> View:
    """Place the devices and trace the truth behind every camera pixel."""
    scene, face = geometry.scene, geometry.face
    rig = rig_of(experiment) if face is None else coated_rig(experiment, face)
    axial_mm = axial_range_mm(scene, rig)
    return View(rig, axial_mm, trace_truth(scene, rig, geometry.surfaces))


@renderer_session()
def patches_of(experiment: Experiment, geometry: Geometry, view: View) -> Patches:
    """Trace all camera rays, for all patterns."""
    dress(experiment, geometry)
    return trace_patches(geometry.scene, view.rig, experiment.render.samples).evaluate()


@renderer_session()
def maps_of_patches(patches: Patches, view: View) -> TraceMaps:
    """Return the surface points at the camera's rays, as images."""
    return maps_of(patches, view.rig.camera.pinhole)


@renderer_session()
def photons_of(experiment: Experiment, geometry: Geometry, view: View) -> Photons | None:
    """Trace the light that clear and polished bodies throw on the stage; None without such.

    Raises
    ------
    InputError : blur that increases with the distance
    """
    if not geometry.surfaces.sharp:
        return None
    check_focus(experiment)
    count, (seed, _) = experiment.render.photons, _direct_seeds(experiment)
    return trace_photons(geometry.scene, geometry.surfaces, view.rig, count=count, seed=seed)


@renderer_session()
def tables_of(experiment: Experiment, view: View) -> dict[str, LightTable]:
    """Return the light of the experiment's patterns along both axes of the projector."""
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
    """Light the traced scene with the experiment's sequence."""
    # Pixels at edges, and bounces, trace on: they need the coat.
    dress(experiment, geometry)
    bounces = _bounces(experiment, geometry, traced)
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
    """Render every frame of a pressed face by stock Mitsuba.

    Raises
    ------
    InputError : stock Mitsuba cannot express the experiment
    """
    check_stock(experiment)
    assert geometry.face is not None
    patterns = pattern_set(experiment.projector, experiment.patterns)
    seeds = seed_sequence(experiment, "stock").generate_state(len(patterns.frames)).tolist()
    frames = render_stack(
        coated_mesh(geometry.face, experiment.coating.bsdf()),
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


@renderer_session()
def dress(experiment: Experiment, geometry: Geometry) -> None:
    """Give a loaded face the experiment's coat."""
    if geometry.face is not None:
        geometry.scene.set_coating(coating_in_layer(experiment))


def _bounces(experiment: Experiment, geometry: Geometry, traced: Traced) -> Bounces | None:
    """Light between surfaces; None on a coat that is seen without it."""
    if geometry.face is None:
        photons = traced.photons
        received = None if photons is None else StageLight(map_photons(photons, traced.tables))
        most, paths = experiment.bounces, experiment.render.bounce_paths
        return Bounces(most, paths, _direct_seeds(experiment)[1], geometry.surfaces, received)
    if not experiment.bounces:
        return None
    seed = int(seed_sequence(experiment, "bounces").generate_state(1)[0])
    return Bounces(experiment.bounces, experiment.render.bounce_paths, seed)


def _direct_seeds(experiment: Experiment) -> tuple[int, int]:
    """Seeds of the photons and of the paths."""
    photons, paths = seed_sequence(experiment, "direct").generate_state(2).tolist()
    return photons, paths
