"""The one-trace renderer in steps, each of which serves every experiment that it does not look at.

Face and BVH serve all coats and devices; rays to the coat all patterns; frames all cameras' noise.
Each step takes the experiment for what it reads itself and the earlier steps' results for the rest;
together they give the same bytes as `render`. Import after `backend.activate()`.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from twin.config.models import Coating, Experiment
from twin.optics.coat import set_coating
from twin.optics.connection import Rig, axial_range_mm
from twin.optics.light import light_tables, pattern_set
from twin.optics.one_trace import Patches, light_stack, trace_patches, trace_truth
from twin.optics.render import bounces_of
from twin.optics.scene import coated_rig, coating_in_layer, face_scene
from twin.optics.stack import Frames, Truth

if TYPE_CHECKING:
    import trimesh

# Any matte coat: each step that looks at the coat sets its own first.
_BARE = Coating(
    base_albedo=0.5, flake_fraction=0.0, flake_roughness=0.5, flake_ior=1.0, flake_extinction=1.0
)


@dataclass(frozen=True, eq=False)
class Geometry:
    """A pressed face, loaded; which coat it wears changes from step to step."""

    scene: Any
    face: "trimesh.Trimesh"


@dataclass(frozen=True, eq=False)
class View:
    """Devices about a face, how far from the projector it reaches, and what they truly see."""

    rig: Rig
    axial_mm: tuple[float, float]
    truth: Truth


def load_geometry(experiment: Experiment, face: "trimesh.Trimesh") -> Geometry:
    """Load a face and build its BVH.

    Raises
    ------
    InputError
        The face pokes through the layers that it is seen through.
    """
    return Geometry(face_scene(experiment, face, _BARE), face)


def view_of(experiment: Experiment, geometry: Geometry) -> View:
    """Place the devices and trace the truth behind every camera pixel."""
    rig = coated_rig(experiment, geometry.face)
    axial_mm = axial_range_mm(geometry.scene, rig)
    return View(rig, axial_mm, trace_truth(geometry.scene, rig))


def patches_of(experiment: Experiment, geometry: Geometry, view: View) -> Patches:
    """Trace the coat for all patterns."""
    set_coating(geometry.scene, coating_in_layer(experiment))
    return trace_patches(geometry.scene, view.rig, experiment.render.samples).evaluate()


def frames_of(experiment: Experiment, geometry: Geometry, view: View, patches: Patches) -> Frames:
    """Light the patches with the experiment's sequence."""
    # Pixels at edges, and bounces, trace on: they need the coat.
    set_coating(geometry.scene, coating_in_layer(experiment))
    patterns = pattern_set(experiment.projector, experiment.patterns)
    tables = light_tables(experiment.projector, patterns, view.axial_mm)
    return light_stack(geometry.scene, view.rig, tables, patches, bounces=bounces_of(experiment))
