"""Run one virtual measurement by the method that the experiment names; check it beforehand."""

from dataclasses import replace
from pathlib import Path
from types import NoneType

from reconstruction.errors import InputError, require_instance, require_integer
from twin.camera import NoiseFunction
from twin.config import Experiment, require_experiment
from twin.config.instant import elastic_at
from twin.config.sensor_layer import SensorLayer
from twin.mechanics import check_press
from twin.optics.checks import check_renderable
from twin.optics.frame_times import sequence_ends_s
from twin.pipeline.bound import bounds_of
from twin.pipeline.colours import check_sensor, measure_colours
from twin.pipeline.compensation import with_compensation
from twin.pipeline.fringes import RunContext, measure_fringes
from twin.pipeline.lit_frames import check_layers
from twin.pipeline.memory import Memory
from twin.pipeline.press import press_specimen
from twin.pipeline.progress import ProgressCallback, Stopwatch, no_progress
from twin.results.folder import as_stored, write_measurement
from twin.results.names import compensates_at_once
from twin.results.quantities import check_measurands
from twin.results.record import Measurement

_MOST_TRIALS = 2**31


def measure(
    experiment: Experiment,
    watch: ProgressCallback = no_progress,
    memory: Memory | None = None,
    trial: int = 0,
    bound: bool = False,
    *,
    layer: SensorLayer | None = None,
    noise: NoiseFunction | None = None,
) -> Measurement:
    """Run one virtual measurement, and return its record.

    Parameters
    ----------
    watch : progress callback
    memory : cache of stage results, which this measurement reads and extends; None: no cache. The
        result has the same bytes with and without a cache
    trial : number of the repetition, which selects the temporal noise
    bound : whether the figures include, for each fitted dimension, the Cramer-Rao lower bound and
        the predicted value of its standard deviation by noise, see `twin.results.bound`
    layer : elastomer and load that are assumed when the object under a thin sheet is computed from
        the coat; None: those of the experiment
    noise : function (mean electrons (row, col), random generator) -> electrons (row, col) that
        replaces the noise model of the experiment, see `twin.camera.NoiseFunction`; only for
        methods with fringes; None: the noise model of the experiment

    Raises
    ------
    InputError : an argument has a wrong type, or something in the experiment cannot be pressed,
        rendered or fitted
    MissingBackend : there is no usable Dr.Jit backend
    """
    require_experiment(experiment)
    require_instance("memory", memory, (Memory, NoneType), "give a twin.Memory(), or none")
    require_integer("trial", trial, 0, _MOST_TRIALS)
    check_measurands(experiment)
    run = RunContext(Memory() if memory is None else memory, Stopwatch(watch), trial, layer, noise)
    if not experiment.method.fringes:
        if noise is not None:
            raise InputError(
                f"noise: found a function, allowed for methods with fringes; modality = "
                f"'{experiment.modality}' calibrates its sensor with camera.noise_model"
            )
        return measure_colours(experiment, run)
    return measure_fringes(experiment, run, bounds_of if bound else None)


def measure_into(
    folder: Path,
    command: str,
    experiment: Experiment,
    watch: ProgressCallback = no_progress,
    memory: Memory | None = None,
) -> Measurement:
    """Measure an experiment, and write all files of the result into an empty folder.

    The returned measurement is equal to the result of `read_measurement` for the folder.

    Parameters
    ----------
    command : name of the calling command, for result.json
    watch, memory : as in `measure`

    Raises
    ------
    InputError, MissingBackend : for the reasons of `measure`
    """
    done = measure_whole(experiment, watch, memory)
    watch("write", 0.0)
    write_measurement(folder, command, done)
    watch("write", 1.0)
    return as_stored(folder, done)


def measure_whole(
    experiment: Experiment, watch: ProgressCallback = no_progress, memory: Memory | None = None
) -> Measurement:
    """Measure an experiment with all figures of a result folder.

    In addition to those of `measure` these are the bounds, and the figures of the object behind the
    coat. The object under a slab is not computed, because its fit takes several seconds; the
    command `twin compensate` computes it.

    Of a moving press it has the presses at both ends of the sequence.

    Raises
    ------
    InputError, MissingBackend : for the reasons of `measure`
    """
    done = measure(experiment, watch, memory, bound=True)
    if done.pressed is not None and compensates_at_once(experiment):
        watch("compensate", 0.0)
        done = with_compensation(done)
        watch("compensate", 1.0)
    if done.pressed is not None and experiment.motion.moves:
        ends = (elastic_at(experiment, time_s) for time_s in sequence_ends_s(experiment))
        done = replace(done, pressed_at_ends=tuple(press_specimen(end) for end in ends))
    return done


def check_measurable(experiment: Experiment) -> None:
    """Check, without measuring, that an experiment can be measured.

    The checks are those that a measurement runs first. Errors that occur only during the press or
    the rendering, such as a force that needs too large a depth, are not detected.

    Raises
    ------
    InputError : a part of the experiment cannot be pressed or rendered; the message names the part
        and the necessary change
    """
    method = experiment.method
    if method.presses:
        check_press(
            experiment.mechanics, experiment.specimen, experiment.elastomer, experiment.press
        )
        check = check_layers if method.fringes else check_sensor
        check(experiment)
    check_measurands(experiment)
    check_renderable(experiment)
