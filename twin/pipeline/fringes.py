"""Run a virtual measurement by fringes on the coat of a pressed elastomer or on the bare specimen.

The stages are press -> geometry -> view -> trace, photons, tables -> frames -> capture ->
reconstruction -> score -> object. The result of each stage up to the reconstruction is cached in a
memory. It is used again for every later experiment that has the same values in all fields that the
stage read, and the same results of the earlier stages. A single measurement runs the same stages
with an empty memory.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

from trimesh import Trimesh

from reconstruction.capture.folder import Capture
from reconstruction.errors import InputError, require_instance
from reconstruction.pipeline import Reconstruction
from twin.camera import NoiseFunction, expose
from twin.camera.noise_function import name_of
from twin.config import digest, require_experiment
from twin.config.models import Experiment
from twin.config.sensor_layer import SensorLayer
from twin.mechanics import PressedElastomer
from twin.optics.checks import check_stack_size
from twin.optics.light import pattern_set
from twin.optics.rig import true_calibration
from twin.optics.session import renderer_session
from twin.optics.stack import RadianceStack
from twin.output import versions
from twin.pipeline.lit_frames import Progress, lit, rendered
from twin.pipeline.memory import CachedResult, Memory
from twin.pipeline.motion_error import reconstruct_moving, stage_of
from twin.pipeline.press import PressedFace, press
from twin.pipeline.progress import Stopwatch
from twin.results.figures import Metrics
from twin.results.layout import layout_warnings
from twin.results.motion import motion_warnings, predicted_motion_figures
from twin.results.parts import taken_figures
from twin.results.record import Fringes, Measurement, Recording
from twin.results.score import empty_warnings, metrics, order_warnings, score
from twin.results.sequence import sequence_warnings
from twin.results.under_sheet import sheet_compensation

BoundsOf = Callable[[Experiment, PressedFace, Memory], Callable[[], Metrics]]


@dataclass(frozen=True, eq=False)
class RunContext:
    """Everything that a measurement depends on in addition to the experiment.

    Attributes
    ----------
    memory : cache of stage results
    clock : stopwatch that records the run time of each stage and calls the progress callback
    trial : number of the repetition, which selects the temporal noise
    layer : assumed elastomer and load, by which the object is computed; None: the experiment's
    noise : function of the user for the noise of the camera; None: the noise model of the
        experiment
    """

    memory: Memory
    clock: Stopwatch
    trial: int = 0
    layer: SensorLayer | None = None
    noise: NoiseFunction | None = None

    @classmethod
    def alone(cls, clock: Stopwatch | None = None, trial: int = 0) -> "RunContext":
        """Return the context of a single measurement, with an empty cache of its own."""
        return cls(Memory(), clock or Stopwatch(), trial)


def measure_fringes(
    experiment: Experiment, run: RunContext, bounds_of: BoundsOf | None = None
) -> Measurement:
    """Run one measurement by fringes; a stage runs only if its result is not in the cache.

    Parameters
    ----------
    run : cache, clock and options of the measurement
    bounds_of : function that traces a pressed face and returns a function of further figures, which
        another thread calls while the later stages run; None: no further figures

    Raises
    ------
    InputError, MissingBackend : for the reasons of `twin.pipeline.measure`
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
                lambda watched: reconstruct_moving(watched, capture.value.capture),
            ).value
        with run.clock.stage("score"):
            face = None if pressed is None else pressed.pressed
            done = evaluate(experiment, face, capture.value, points, run.layer, noise=run.noise)
        with run.clock.stage("object"):
            done = done.with_object()
            figures = {} if further is None else further.result()
    return done.with_same_object(metrics={**done.metrics, **figures}, seconds=run.clock.seconds)


def evaluate(
    experiment: Experiment,
    pressed: PressedElastomer | None,
    recording: Recording,
    reconstruction: Reconstruction,
    layer: SensorLayer | None = None,
    *,
    noise: NoiseFunction | None = None,
) -> Measurement:
    """Score a reconstruction against the truth, and return the record of the measurement.

    Parameters
    ----------
    pressed : pressed elastomer; None for a bare specimen
    layer : assumed elastomer and load, by which the object is computed; None: the experiment's
    noise : function of the user by which the recording's noise was computed, named in a warning;
        None: EMVA 1288
    """
    scored = score(experiment, reconstruction, recording.truth)
    figures = taken_figures(experiment, pressed, recording) | metrics(scored)
    figures |= predicted_motion_figures(experiment, reconstruction, recording.truth)
    figures["warnings"] += noise_warnings(experiment, noise)
    figures["warnings"] += decoding_warnings(experiment)
    figures["warnings"] += dots_warnings(experiment)
    figures["warnings"] += layout_warnings(experiment)
    figures["warnings"] += motion_warnings(experiment, recording.radiance.motion)
    figures["warnings"] += sequence_warnings(experiment, recording.exposure_ms)
    figures["warnings"] += empty_warnings(experiment, reconstruction, recording.truth)
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
    """Press, if the method has a press, then render and expose all frames.

    Parameters
    ----------
    clock : stopwatch that records the run time of each stage; None: run times are not recorded
    trial : number of the repetition, which selects the temporal noise

    Returns
    -------
    the pressed elastomer, None for a bare specimen, and the recording

    Raises
    ------
    InputError : something in the experiment cannot be pressed or rendered
    MissingBackend : there is no usable Dr.Jit backend
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
    """Render the sequence on a face that was pressed before, and expose the camera.

    Parameters
    ----------
    clock : stopwatch that records the run time of each stage; None: run times are not recorded
    trial : number of the repetition, which selects the temporal noise
    memory : cache of earlier recordings' stages, such as the loaded face; the result has the same
        bytes without a cache

    Raises
    ------
    InputError : the coat is seen through a gel (contact-face layout) that the experiment does not
        describe, or the specimen moves
    MissingBackend : there is no usable Dr.Jit backend
    """
    _check_given_face(experiment)
    run = RunContext.alone(clock, trial)
    if memory is not None:
        run = replace(run, memory=memory)
    return _recorded(experiment, PressedFace.of(pressed), run).value


def render(
    experiment: Experiment, face: Trimesh, progress: Progress = lambda _: None
) -> RadianceStack:
    """Return the radiance of all frames on a coated face, and the true surface at the pixels.

    Parameters
    ----------
    face : mesh of the coated face, world, mm, with normals towards the camera
    progress : function that is called with the finished fraction, 0 to 1

    Raises
    ------
    MissingBackend : there is no usable Dr.Jit backend
    InputError : depth of field with one sample per pixel; or `render.engine` is "stock" (unmodified
        Mitsuba), and the experiment has lens distortion or a projector aperture, which that engine
        cannot represent
    """
    require_experiment(experiment)
    require_instance("face", face, Trimesh, "give a mesh: twin.mechanics.face_mesh(pressed)")
    _check_given_face(experiment)
    with renderer_session():
        from twin.pipeline import trace

    memory = Memory()
    geometry = memory.recall(
        "geometry", experiment, (), lambda watched: trace.load_face(watched, face)
    )
    return lit(experiment, geometry, memory, progress).value


def render_bare(
    experiment: Experiment, progress: Progress = lambda _: None, memory: Memory | None = None
) -> RadianceStack:
    """Return the radiance of all frames on the bare specimen on its stage, and the true surface.

    Parameters
    ----------
    progress : function that is called with the finished fraction, 0 to 1
    memory : cache of earlier renders' stages, such as the loaded specimen; the result has the same
        bytes without a cache

    Raises
    ------
    InputError : a part has no material, or the stock engine was requested, which renders all parts
        behind clear bodies black
    MissingBackend : there is no usable Dr.Jit backend
    """
    return rendered(experiment, None, Memory() if memory is None else memory, progress).value


def expose_capture(
    experiment: Experiment,
    radiance: RadianceStack,
    clock: Stopwatch,
    trial: int,
    noise: NoiseFunction | None = None,
) -> Recording:
    """Return the recording of a camera that is exposed to a rendered stack.

    Parameters
    ----------
    trial : number of the repetition, which selects the temporal noise
    noise : function of the user for the noise; None: EMVA 1288
    """
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
        stage=stage_of(experiment),
    )
    return Recording(radiance, capture, exposed.exposure_ms)


def decoding_warnings(experiment: Experiment) -> list[str]:
    """Return warnings about refraction that is neglected, and about relief that one frame loses."""
    warnings = []
    if experiment.layers and not experiment.decode.through_layers:
        warnings.append(
            "the decoder takes the layers for air, and its heights, widths and radii are wrong by"
            " the refraction of the rays; set decode.through_layers = true"
        )
    if experiment.patterns.stepping == "single":
        warnings.append(
            "the Fourier transform of a single frame smooths relief finer than about 2.5 fringes,"
            " and standard deviations do not include it; choose a shorter patterns.period_px"
        )
    return warnings


def dots_warnings(experiment: Experiment) -> list[str]:
    """Return a warning about points at edges of dots, or about dots stated without a coat."""
    if experiment.photometric.markers is None:
        return []
    if experiment.method.presses:
        return [
            "points at the edges of printed dots are displaced towards the brighter part of their "
            "pixel, and standard deviations do not include it; use smaller pixels, or a larger "
            "photometric.markers.relative_albedo"
        ]
    return [
        f"photometric.markers has no effect with modality = '{experiment.modality}': dots are "
        "printed on a coat; remove [photometric.markers], or set modality = 'contact_fpp'"
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


def _check_given_face(experiment: Experiment) -> None:
    if experiment.motion.moves:
        raise InputError(
            "motion: found a motion, allowed a scene at rest with a face that was pressed before; "
            "remove [motion], or measure the experiment (twin measure), which presses each moment"
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
        radiance = rendered(experiment, pressed, run.memory, progress)
    return run.memory.recall(
        "capture",
        experiment,
        (radiance.token, run.trial, run.noise),
        lambda watched: expose_capture(watched, radiance.value, run.clock, run.trial, run.noise),
    )
