"""Stages from a pressed face or a bare specimen to the radiance of all frames, each cached.

The stages are geometry -> view -> trace, photons, tables -> frames; see `twin.pipeline.fringes` for
the cache, and `twin.pipeline.trace` for the computation of each stage. A scene in motion has one
stage from the view to the frames (`twin.pipeline.moving`).
"""

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

from reconstruction.arrays import FloatImage
from reconstruction.errors import InputError
from twin.config import digest
from twin.config.digest import content_digest
from twin.config.instant import elastic_at
from twin.config.models import Experiment
from twin.mechanics.relief import MATERIAL_MM, FaceGrid, face_grid
from twin.optics.checks import check_direct_engine, check_motion
from twin.optics.session import renderer_session
from twin.optics.stack import RadianceStack
from twin.pipeline.memory import CachedResult, Memory
from twin.pipeline.press import PressedFace, material_mm, press

if TYPE_CHECKING:
    from twin.optics.one_trace import Patches
    from twin.pipeline.trace import Geometry, View

Progress = Callable[[float], None]


def check_layers(experiment: Experiment) -> None:
    """Check that the gel in front of a coat is among the layers of the experiment.

    Raises
    ------
    InputError : the layout is contact-face, and the experiment has no layers
    """
    if experiment.elastomer.layout == "contact_face" and not experiment.layers:
        raise InputError(
            "layers: found none, elastomer.layout = 'contact_face' is seen through its gel; add "
            f"[layers.gel] with bottom_mm = 0, thickness_mm = {experiment.elastomer.thickness_mm:g}"
            " and ior, or use twin press"
        )


def rendered(
    experiment: Experiment, pressed: PressedFace | None, memory: Memory, progress: Progress
) -> CachedResult[RadianceStack]:
    """Return the radiance of all frames on a pressed face, or on the bare specimen (None)."""
    return lit(experiment, loaded(experiment, pressed, memory), memory, progress)


def loaded(
    experiment: Experiment, pressed: PressedFace | None, memory: Memory
) -> "CachedResult[Geometry]":
    """Return the loaded surfaces of a scene: a pressed face, or the bare specimen on its stage.

    Parameters
    ----------
    pressed : pressed face; None: the bare specimen

    Raises
    ------
    InputError : the scene cannot be rendered
    MissingBackend : there is no usable Dr.Jit backend
    """
    check = check_direct_engine if pressed is None else check_layers
    check(experiment)
    check_motion(experiment)
    with renderer_session():
        from twin.pipeline import trace

    if pressed is None:
        return memory.recall("geometry", experiment, (), trace.load_bare)
    material = material_mm(experiment, pressed.pressed)
    attributes = {} if material is None else {MATERIAL_MM: material}
    return memory.recall(
        "geometry",
        experiment,
        (pressed.face_digest, content_digest(*attributes.values())),
        lambda watched: trace.load_face(
            watched, replace(face_grid(pressed.pressed), vertex_attributes=attributes)
        ),
    )


def viewed(
    experiment: Experiment, geometry: "CachedResult[Geometry]", memory: Memory
) -> "CachedResult[View]":
    """Return camera and projector placed about a scene, and the true surface at every pixel."""
    from twin.pipeline import trace

    return memory.recall(
        "view", experiment, geometry.token, lambda watched: trace.view_of(watched, geometry.value)
    )


def traced(
    experiment: Experiment,
    geometry: "CachedResult[Geometry]",
    view: "CachedResult[View]",
    memory: Memory,
) -> "CachedResult[Patches]":
    """Return the traced rays of the camera, which are independent of the patterns."""
    from twin.pipeline import trace

    return memory.recall(
        "trace",
        experiment,
        view.token,
        lambda watched: trace.patches_of(watched, geometry.value, view.value),
    )


def albedo(experiment: Experiment, pressed: PressedFace | None, memory: Memory) -> FloatImage:
    """Return the albedo (row, col) of the surface at every camera pixel.

    It is the reflectance at normal incidence, diffuse and specular light together.

    Parameters
    ----------
    pressed : pressed face; None: the bare specimen

    Raises
    ------
    InputError, MissingBackend : for the reasons of `loaded`
    """
    from twin.pipeline import trace

    geometry = loaded(experiment, pressed, memory)
    view = viewed(experiment, geometry, memory)
    return trace.surface_albedo(experiment, geometry.value, view.value)


def lit(
    experiment: Experiment, geometry: "CachedResult[Geometry]", memory: Memory, progress: Progress
) -> CachedResult[RadianceStack]:
    """Return the radiance of all frames of the experiment's sequence on a loaded scene."""
    from twin.pipeline import trace

    scene, view = geometry.value, viewed(experiment, geometry, memory)
    if experiment.motion.moves:
        return _lit_in_motion(experiment, geometry, view, memory, progress)
    # Without an aperture blur is equal at all distances, so the tables do not depend on the view.
    depth = view.token if experiment.projector.aperture_mm else ()
    tables = memory.recall(
        "tables", experiment, depth, lambda watched: trace.tables_of(watched, view.value)
    )
    if experiment.render.engine == "stock":
        return memory.recall(
            "frames",
            experiment,
            (view.token, tables.token),
            lambda watched: trace.light_with_stock(
                watched, scene, view.value, tables.value, progress
            ),
        )
    rays = traced(experiment, geometry, view, memory)
    photons = memory.recall(
        "photons",
        experiment,
        view.token,
        lambda watched: trace.photons_of(watched, scene, view.value),
    )
    light = trace.Traced(rays.value, photons.value, tables.value)
    return memory.recall(
        "frames",
        experiment,
        (rays.token, photons.token, tables.token),
        lambda watched: trace.light(watched, scene, view.value, light, progress),
    )


def _lit_in_motion(
    experiment: Experiment,
    geometry: "CachedResult[Geometry]",
    view: "CachedResult[View]",
    memory: Memory,
    progress: Progress,
) -> CachedResult[RadianceStack]:
    with renderer_session():
        from twin.pipeline import moving

    def face_at(time_s: float) -> FaceGrid:
        return face_grid(press(elastic_at(experiment, time_s), Memory()).pressed)

    # A press at another time reads further fields of the experiment, which identify the frames.
    inputs = view.token if geometry.value.face is None else (view.token, digest(experiment))
    return memory.recall(
        "frames",
        experiment,
        inputs,
        lambda watched: moving.light_moving(watched, geometry.value, view.value, face_at, progress),
    )
