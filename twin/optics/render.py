"""From the pressed face to linear radiance: choose the engine, render the whole sequence."""

from collections.abc import Callable, Iterable, Iterator
from typing import TYPE_CHECKING

from reconstruction.errors import InputError
from twin.config.digest import seed_sequence
from twin.config.models import Coating, Experiment
from twin.optics.backend import activate
from twin.optics.checks import check_stock
from twin.optics.stack import RadianceStack

if TYPE_CHECKING:
    import trimesh

    from twin.optics.bounces import Bounces


def render(
    experiment: Experiment,
    face: "trimesh.Trimesh",
    progress: Callable[[float], None] = lambda _: None,
) -> RadianceStack:
    """Render all frames of the experiment's sequence and the truth behind them.

    Parameters
    ----------
    experiment : Experiment
    face : trimesh.Trimesh
        Coated face in world mm, normals towards the camera.
    progress : callable
        Called with the finished fraction.

    Raises
    ------
    MissingBackend
        No usable Dr.Jit backend.
    InputError
        The stock engine cannot express the experiment.
    """
    activate()
    # Mitsuba may be imported only now: the backend's library is chosen when it loads.
    from twin.optics import one_trace, stock
    from twin.optics.coat import coated_mesh, coating_bsdf
    from twin.optics.connection import axial_range_mm
    from twin.optics.light import light_tables, pattern_set
    from twin.optics.scene import coated_rig, coated_scene

    scene, rig = coated_scene(experiment, face), coated_rig(experiment, face)
    patterns = pattern_set(experiment.projector, experiment.patterns)
    tables = light_tables(experiment.projector, patterns, axial_range_mm(scene, rig))
    samples = experiment.render.samples
    if experiment.render.engine == "one_trace":
        frames = one_trace.trace_stack(
            scene, rig, tables, samples, bounces=bounces_of(experiment), progress=progress
        )
    else:
        check_stock(experiment)
        seeds = seed_sequence(experiment, "stock").generate_state(len(patterns.frames)).tolist()
        mesh = coated_mesh(face, coating_bsdf(experiment.coating))
        frames = stock.render_stack(
            mesh,
            rig,
            patterns,
            tables,
            emitter=experiment.render.stock_emitter,
            samples=samples,
            bounces=experiment.bounces,
            seeds=seeds,
            progress=progress,
        )
    truth = one_trace.trace_truth(scene, rig)
    progress(1.0)
    return RadianceStack(frames, truth)


def render_coatings(
    experiment: Experiment, face: "trimesh.Trimesh", coatings: Iterable[Coating]
) -> Iterator[RadianceStack]:
    """Render one pressed face under several coatings; the same bytes as one `render` each.

    Geometry is loaded, and the truth traced, once for all. Each stack is made when it is asked for:
    at full size it has 600 MB.

    Parameters
    ----------
    experiment : Experiment
        Its own coating is not used.
    face : trimesh.Trimesh
        Coated face in world mm, normals towards the camera.
    coatings : iterable of Coating

    Raises
    ------
    MissingBackend
        No usable Dr.Jit backend.
    InputError
        The experiment asks for the stock engine.
    """
    if experiment.render.engine != "one_trace":
        raise InputError(
            f"render.engine: found '{experiment.render.engine}', coatings are swept by 'one_trace'"
            " alone; set it, or render each coating by itself"
        )
    activate()
    from twin.optics import one_trace
    from twin.optics.coat import set_coating
    from twin.optics.connection import axial_range_mm
    from twin.optics.light import light_tables, pattern_set
    from twin.optics.scene import coated_rig, coated_scene, coating_in_layer

    scene, rig = coated_scene(experiment, face), coated_rig(experiment, face)
    patterns = pattern_set(experiment.projector, experiment.patterns)
    tables = light_tables(experiment.projector, patterns, axial_range_mm(scene, rig))
    truth = one_trace.trace_truth(scene, rig)
    for coating in coatings:
        set_coating(scene, coating_in_layer(experiment.model_copy(update={"coating": coating})))
        frames = one_trace.trace_stack(
            scene, rig, tables, experiment.render.samples, bounces=bounces_of(experiment)
        )
        yield RadianceStack(frames, truth)


def bounces_of(experiment: Experiment) -> "Bounces | None":
    """Light between surfaces as the experiment asks for it; None when it is left out."""
    from twin.optics.bounces import Bounces

    if not experiment.bounces:
        return None
    seed = int(seed_sequence(experiment, "bounces").generate_state(1)[0])
    return Bounces(experiment.bounces, experiment.render.bounce_paths, seed)
