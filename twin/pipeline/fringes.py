"""Measure with fringes: on the coat of a pressed elastomer, or on the bare specimen.

press -> geometry -> view -> trace, photons, tables -> frames -> capture -> reconstruction -> score
-> object. Each stage up to the reconstruction is kept in a memory, and used again for every later
experiment that has the same values in all fields that the stage looked at, and the same earlier
stages. A single measurement is the same way with an empty memory.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from trimesh import Trimesh

from reconstruction.capture.folder import Capture
from reconstruction.errors import InputError, require_instance
from reconstruction.pipeline import Reconstruction, reconstruct
from twin.camera import NoiseFunction, expose
from twin.camera.noise_function import name_of
from twin.config import digest, require_experiment
from twin.config.models import Experiment
from twin.config.sensor_layer import SensorLayer
from twin.mechanics import PressedElastomer, face_mesh
from twin.optics.checks import check_direct_engine, check_stack_size
from twin.optics.light import pattern_set
from twin.optics.rig import true_calibration
from twin.optics.session import renderer_session
from twin.optics.stack import RadianceStack
from twin.output import versions
from twin.pipeline.captures import options_of
from twin.pipeline.memory import CachedResult, Memory
from twin.pipeline.press import PressedFace, press
from twin.pipeline.progress import Stopwatch
from twin.results.figures import Metrics
from twin.results.parts import taken_figures
from twin.results.record import Fringes, Measurement, Recording
from twin.results.score import metrics, order_warnings, score
from twin.results.under_sheet import sheet_compensation

if TYPE_CHECKING:
    from twin.optics.one_trace import Patches
    from twin.pipeline.trace import Geometry, View

Progress = Callable[[float], None]
BoundsOf = Callable[[Experiment, PressedFace, Memory], Callable[[], Metrics]]


@dataclass(frozen=True, eq=False)
class RunContext:
    """How a measurement is made.

    Attributes
    ----------
    memory : results of stages that are reused
    clock : run times of the stages, and the callback that is notified of them
    trial : repetition with new temporal noise
    layer : assumed elastomer and load; None: the experiment's
    noise : function of the user for the camera's noise; None: the experiment's noise model
    """

    memory: Memory
    clock: Stopwatch
    trial: int = 0
    layer: SensorLayer | None = None
    noise: NoiseFunction | None = None

    @classmethod
    def alone(cls, clock: Stopwatch | None = None, trial: int = 0) -> "RunContext":
        """Return a run that neither reads nor writes stored results."""
        return cls(Memory(), clock or Stopwatch(), trial)


def measure_fringes(
    experiment: Experiment, run: RunContext, bounds_of: BoundsOf | None = None
) -> Measurement:
    """Run one measurement, each stage only where no kept result is the same.

    Parameters
    ----------
    bounds_of : traces, and returns a function of further figures that runs during the later stages

    Raises
    ------
    InputError, MissingBackend : as `twin.pipeline.measure`
    """
    pressed, capture = _taken(experiment, run)
    with ThreadPoolExecutor(1) as executor:
        further = None
        if bounds_of is not None and pressed is not None:
            further = executor.submit(bounds_of(experiment, pressed, run.memory))
        with run.clock.stage("reconstruct"):
            points = run.memory.recall(
                "reconstruction",
                experiment,
                capture.token,
                lambda watched: reconstruct(capture.value.capture, options_of(watched.decode)),
            ).value
        with run.clock.stage("score"):
            face = None if pressed is None else pressed.pressed
            done = evaluate(experiment, face, capture.value, points, run.layer, noise=run.noise)
        with run.clock.stage("object"):
            done = done.with_object()
            figures = {} if further is None else further.result()
    return replace(done, metrics={**done.metrics, **figures}, seconds=run.clock.seconds)


def evaluate(
    experiment: Experiment,
    pressed: PressedElastomer | None,
    recording: Recording,
    reconstruction: Reconstruction,
    layer: SensorLayer | None = None,
    *,
    noise: NoiseFunction | None = None,
) -> Measurement:
    """Score a reconstruction against the truth, and put everything into one record.

    Parameters
    ----------
    layer : assumed elastomer and load, by which the object is found; None: the experiment's
    noise : function of the user that the recording was made with; a warning names it
    """
    scored = score(experiment, reconstruction, recording.truth)
    figures = taken_figures(pressed, recording) | metrics(scored)
    figures["warnings"] += noise_warnings(experiment, noise)
    figures["warnings"] += decoding_warnings(experiment)
    figures["warnings"] += order_warnings(experiment, reconstruction, recording.truth)
    return Measurement(
        experiment=experiment,
        images=Fringes(recording.capture, reconstruction, recording.radiance.frames),
        truth=recording.truth,
        score=scored,
        metrics=figures,
        pressed=pressed,
        digest=digest(experiment),
        versions=versions(),
        compensation=sheet_compensation(experiment, reconstruction.point_map, layer),
    )


def take(
    experiment: Experiment, clock: Stopwatch | None = None, trial: int = 0
) -> tuple[PressedElastomer | None, Recording]:
    """Press where the method presses, then record.

    Parameters
    ----------
    trial : repetition with new temporal noise

    Raises
    ------
    InputError : something in the experiment cannot be pressed or rendered
    MissingBackend : no usable Dr.Jit backend
    """
    pressed, capture = _taken(experiment, RunContext.alone(clock, trial))
    return None if pressed is None else pressed.pressed, capture.value


def record(
    experiment: Experiment,
    pressed: PressedElastomer,
    clock: Stopwatch | None = None,
    trial: int = 0,
    memory: Memory | None = None,
) -> Recording:
    """Render the sequence on a face that is pressed already, and expose the camera.

    `memory` holds results of earlier recordings, such as the loaded face; the bytes are the same.

    Raises
    ------
    InputError : the coat is seen through a gel (contact-face layout) that the experiment does not
        describe
    MissingBackend : no usable Dr.Jit backend
    """
    run = RunContext.alone(clock, trial)
    if memory is not None:
        run = replace(run, memory=memory)
    return _recorded(experiment, PressedFace.of(pressed), run).value


def render(
    experiment: Experiment, face: Trimesh, progress: Progress = lambda _: None
) -> RadianceStack:
    """Render all frames of the experiment's sequence, and the truth behind them.

    Parameters
    ----------
    face : coated face in world mm, normals towards the camera
    progress : called with the finished fraction

    Raises
    ------
    MissingBackend : no usable Dr.Jit backend
    InputError : the stock engine cannot express the experiment
    """
    require_experiment(experiment)
    require_instance("face", face, Trimesh, "give a mesh: twin.mechanics.face_mesh(pressed)")
    with renderer_session():
        from twin.pipeline import trace

    memory = Memory()
    geometry = memory.recall(
        "geometry", experiment, (), lambda watched: trace.load_face(watched, face)
    )
    return _lit(experiment, geometry, memory, progress).value


def render_bare(
    experiment: Experiment, progress: Progress = lambda _: None, memory: Memory | None = None
) -> RadianceStack:
    """Render all frames on the bare specimen standing on its stage.

    `memory` holds results of earlier renders, such as the loaded specimen; the bytes are the same.

    Raises
    ------
    InputError : a part has no material, or the stock engine was requested: it renders all parts
        behind clear bodies black
    MissingBackend : no usable Dr.Jit backend
    """
    return _rendered(experiment, None, Memory() if memory is None else memory, progress).value


def expose_capture(
    experiment: Experiment,
    radiance: RadianceStack,
    clock: Stopwatch,
    trial: int,
    noise: NoiseFunction | None = None,
) -> Recording:
    """Expose the camera to a rendered stack; `trial` draws new temporal noise, by `noise`."""
    clock.count_frames("render", len(radiance.frames))
    patterns = pattern_set(experiment.projector, experiment.patterns)
    with clock.stage("expose") as progress:
        brightest = patterns.exposure_frame
        exposed = expose(experiment, radiance.frames, brightest, trial, progress, noise=noise)
    capture = Capture(
        stack=exposed.stack,
        patterns=patterns,
        sensor=exposed.sensor,
        calibration=true_calibration(experiment),
        bit_depth=experiment.camera.bit_depth,
    )
    return Recording(radiance, capture, exposed.exposure_ms)


def decoding_warnings(experiment: Experiment) -> list[str]:
    """Return a warning for each effect that the decoder's settings neglect."""
    if experiment.decode.through_layers or not experiment.layers:
        return []
    return [
        "the decoder takes the layers for air, and its heights, widths and radii are wrong by the "
        "refraction of the rays; set decode.through_layers = true"
    ]


def noise_warnings(experiment: Experiment, noise: NoiseFunction | None) -> list[str]:
    """Return a warning if a result contains noise other than that of EMVA 1288."""
    camera = experiment.camera
    if noise is not None:
        source = f"by the function {name_of(noise)}, which the experiment does not contain"
    elif camera.noise and not camera.noise_model.is_emva1288:
        source = f"of the kind {camera.noise_model.kind}"
    else:
        return []
    return [
        f"camera noise {source}; standard deviations of points and bounds are those of the EMVA "
        "1288 model"
    ]


def check_layers(experiment: Experiment) -> None:
    """Raise InputError if a coat is behind a gel that the experiment does not describe.

    Raises
    ------
    InputError
    """
    if experiment.elastomer.layout == "contact_face" and not experiment.layers:
        raise InputError(
            "layers: found none, elastomer.layout = 'contact_face' is seen through its gel; add "
            f"[layers.gel] with bottom_mm = 0, thickness_mm = {experiment.elastomer.thickness_mm:g}"
            " and ior, or use twin press"
        )


def _taken(
    experiment: Experiment, run: RunContext
) -> tuple[PressedFace | None, CachedResult[Recording]]:
    if not experiment.method.fringes:
        raise InputError(
            f"modality = '{experiment.modality}' takes one colour image and no fringe stack; use"
            " twin measure, or measure in Python"
        )
    check_stack_size(experiment)
    if not experiment.method.presses:
        return None, _recorded(experiment, None, run)
    with run.clock.stage("press") as progress:
        pressed = press(experiment, run.memory, progress)
    return pressed, _recorded(experiment, pressed, run)


def _recorded(
    experiment: Experiment, pressed: PressedFace | None, run: RunContext
) -> CachedResult[Recording]:
    with run.clock.stage("render") as progress:
        radiance = _rendered(experiment, pressed, run.memory, progress)
    return run.memory.recall(
        "capture",
        experiment,
        (radiance.token, run.trial, run.noise),
        lambda watched: expose_capture(watched, radiance.value, run.clock, run.trial, run.noise),
    )


def _rendered(
    experiment: Experiment, pressed: PressedFace | None, memory: Memory, progress: Progress
) -> CachedResult[RadianceStack]:
    return _lit(experiment, loaded(experiment, pressed, memory), memory, progress)


def loaded(
    experiment: Experiment, pressed: PressedFace | None, memory: Memory
) -> "CachedResult[Geometry]":
    """Return the surfaces that are seen: a pressed face, or the bare specimen.

    Raises
    ------
    InputError : the view cannot be rendered
    MissingBackend : no usable Dr.Jit backend
    """
    check = check_direct_engine if pressed is None else check_layers
    check(experiment)
    with renderer_session():
        from twin.pipeline import trace

    if pressed is None:
        return memory.recall("geometry", experiment, (), trace.load_bare)
    return memory.recall(
        "geometry",
        experiment,
        pressed.face_digest,
        lambda watched: trace.load_face(watched, face_mesh(pressed.pressed)),
    )


def viewed(
    experiment: Experiment, geometry: "CachedResult[Geometry]", memory: Memory
) -> "CachedResult[View]":
    """Return the devices about a scene, and the truth behind every pixel."""
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
    """Return the camera's rays, for all patterns."""
    from twin.pipeline import trace

    return memory.recall(
        "trace",
        experiment,
        view.token,
        lambda watched: trace.patches_of(watched, geometry.value, view.value),
    )


def _lit(
    experiment: Experiment, geometry: "CachedResult[Geometry]", memory: Memory, progress: Progress
) -> CachedResult[RadianceStack]:
    from twin.pipeline import trace

    scene, view = geometry.value, viewed(experiment, geometry, memory)
    # Without an aperture blur is the same at every distance, and no view changes the tables.
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
    lit = trace.Traced(rays.value, photons.value, tables.value)
    return memory.recall(
        "frames",
        experiment,
        (rays.token, photons.token, tables.token),
        lambda watched: trace.light(watched, scene, view.value, lit, progress),
    )
