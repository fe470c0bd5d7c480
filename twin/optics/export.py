"""Write an experiment as a stock Mitsuba scene: XML, meshes and one pattern texture per frame.

Any Mitsuba 3 renders the scene, one frame at a time. A test compares the result with the project's
renderer.
"""

from collections.abc import Callable
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jinja2
import numpy as np

from reconstruction.errors import InputError
from reconstruction.writing import write_bytes, write_exr_channels, write_text
from twin.config.models import Experiment
from twin.optics.direct import Solid, solids
from twin.optics.materials import COATED_FACE
from twin.optics.rig import perspective_sensor, to_world
from twin.optics.session import renderer_session
from twin.specimens import bodies

if TYPE_CHECKING:
    import trimesh

    from twin.optics.connection import Rig
    from twin.optics.stock import Canvas

SCENE_FILE = "scene.xml"
DOT_FILE = "printed_dots.exr"


def inexpressible(experiment: Experiment) -> list[str]:
    """Return one line of text for each property of the experiment that the exported scene lacks."""
    parts = () if experiment.method.presses else bodies(experiment.specimen, 0.0)
    clear = any(part.material is not None and part.material.is_sharp for part in parts)
    checks = (
        (
            experiment.projector.aperture_mm > 0.0,
            "projector.aperture_mm is left out: a texture has the same blur at every distance, that"
            " of best focus",
        ),
        (
            any(experiment.camera.distortion),
            "camera.distortion is left out: stock sensors have no lens distortion",
        ),
        (
            clear,
            "light transmitted or reflected by smooth bodies is missing: stock integrators cannot"
            " connect them to a projector, and surfaces behind glass are black",
        ),
        (
            bool(experiment.layers),
            "layers are left out: no stock integrator connects a coat below a refracting face to a"
            " projector",
        ),
    )
    return [
        *(line for left_out, line in checks if left_out),
        "sub-pixel positions are random in stock Mitsuba: at few samples they act as phase noise",
        "the camera's noise and bits are not in the scene: its images are linear radiance",
    ]


@renderer_session()
def export_stock(
    experiment: Experiment,
    face: "trimesh.Trimesh | None",
    folder: Path,
    progress: Callable[[float], None] = lambda _: None,
) -> list[str]:
    """Write scene.xml, one PLY per surface and textures/*.exr into `folder`.

    Parameters
    ----------
    experiment : `render.stock_emitter` chooses between `projector` and `spot`
    face : coated face in world mm, with material coordinates if dots are printed on it; None for a
        bare specimen
    folder : an existing folder
    progress : called with the finished fraction

    Returns
    -------
    The lines of `inexpressible`: properties that the scene lacks

    Raises
    ------
    InputError : stock Mitsuba cannot express the coat
    """
    import mitsuba as mi

    from twin.optics.scene import rig_of

    if face is not None and experiment.coating.export_gap:
        raise InputError(f"export: {experiment.coating.export_gap}; export another coating")
    rig = rig_of(experiment)
    canvas = _write_textures(experiment, rig, folder, progress)
    shapes = solids(experiment) if face is None else (_coated(experiment, face, folder),)
    for solid in shapes:
        content = solid.mesh.export(file_type="ply", vertex_normal=True)
        write_bytes(folder / f"{solid.name}.ply", content)
    scene = _template().render(
        title=f"fringe-twin export of {experiment.name}",
        variant=mi.variant(),
        **_devices(experiment, rig, canvas, face is not None),
        solids=shapes,
        kind_of=_kind_of,
    )
    write_text(folder / SCENE_FILE, scene)
    return inexpressible(experiment)


def _coated(experiment: Experiment, face: "trimesh.Trimesh", folder: Path) -> Solid:
    """Return the coated face; write the texture of the dots that are printed on it."""
    from twin.optics import stock_dots

    coat, markers = experiment.coating.bsdf(), experiment.photometric.markers
    if markers is None:
        return Solid(COATED_FACE, face, coat)
    write_exr_channels(folder / DOT_FILE, {"Y": stock_dots.dot_cell(markers)})
    mesh = face.copy()
    across, along = stock_dots.cell_coordinates(markers, face).T.astype(np.float32)
    mesh.vertex_attributes = {"s": across, "t": along}  # names of the PLY format
    texture = stock_dots.cell_texture_in_file(DOT_FILE)
    return Solid(COATED_FACE, mesh, stock_dots.dotted(coat, texture))


def _write_textures(
    experiment: Experiment, rig: "Rig", folder: Path, progress: Callable[[float], None]
) -> "Canvas":
    """Write the projected patterns, one EXR per frame, and return the texture plane they cover."""
    from twin.optics import stock
    from twin.optics.light import light_tables, pattern_set

    patterns = pattern_set(experiment.projector, experiment.patterns)
    in_focus = experiment.projector.model_copy(update={"aperture_mm": 0.0})
    tables = light_tables(in_focus, patterns)
    canvas = stock.canvas_for(rig, experiment.render.stock_emitter)
    (folder / "textures").mkdir()
    for number, frame in enumerate(patterns.frames):
        texture = stock.frame_texture(frame, number, rig, tables, canvas)
        write_exr_channels(folder / "textures" / f"{frame.name}.exr", {"Y": texture})
        progress((number + 1) / len(patterns.frames))
    return canvas


def _devices(experiment: Experiment, rig: "Rig", canvas: "Canvas", pressed: bool) -> dict[str, Any]:
    """Return the template's variables for camera, projector and integrator."""
    from twin.optics import stock
    from twin.optics.bounces import MOST_SHARP
    from twin.optics.light import pattern_set
    from twin.optics.scene import rig_of

    undistorted = experiment.camera.model_copy(update={"distortion": (0.0,) * 5})
    ideal = rig_of(experiment.model_copy(update={"camera": undistorted})).camera
    patterns = pattern_set(experiment.projector, experiment.patterns)
    return {
        "frames": [frame.name for frame in patterns.frames],
        "samples": experiment.render.samples,
        "camera": perspective_sensor(ideal.pinhole, ideal.T_world_from_device, 1, ideal.lens),
        "camera_to_world": _matrix(ideal.T_world_from_device),
        "projector_to_world": _matrix(rig.projector.T_world_from_device),
        "integrator": stock.integrator(experiment.bounces + (0 if pressed else MOST_SHARP)),
        "emitter": stock.emitter_dict(np.zeros((2, 2), np.float32), rig, canvas),
    }


def _kind_of(value: bool | float | str) -> str:
    """Return the tag of Mitsuba's XML for a parameter's value: boolean, string or float."""
    if isinstance(value, bool):
        return "boolean"
    return "string" if isinstance(value, str) else "float"


def _template() -> jinja2.Template:
    text = (files("twin.optics") / "templates" / SCENE_FILE).read_text(encoding="utf-8")
    return jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True
    ).from_string(text)


def _matrix(T_world_from_device: Any) -> str:
    return " ".join(f"{number:.9g}" for number in to_world(T_world_from_device).ravel())
