"""Run one virtual measurement by whichever method the experiment names: the one place to choose."""

from pathlib import Path
from types import NoneType

from reconstruction.errors import InputError, require_instance, require_integer
from twin.camera import NoiseFunction
from twin.config import Experiment, require_experiment
from twin.config.sensor_layer import SensorLayer
from twin.mechanics import check_press
from twin.optics.checks import check_renderable
from twin.pipeline.bound import bounds_of
from twin.pipeline.colours import check_sensor, measure_colours
from twin.pipeline.compensation import with_compensation
from twin.pipeline.fringes import RunContext, check_layers, measure_fringes
from twin.pipeline.memory import Memory
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
    """Run one virtual measurement.

    Parameters
    ----------
    memory : cache of earlier measurements' stages, extended by this one; the bytes are the same
    trial : repetition with new temporal noise
    bound : also give the bound of each dimension's uncertainty among the figures, see
        `twin.results.bound`
    layer : assumed elastomer and load, by which the object under a thin sheet is found; None:
        those of the experiment
    noise : function (mean electrons (row, col), random generator) -> electrons (row, col), in the
        place of the experiment's noise model, see `twin.camera.NoiseFunction`; for methods with
        fringes

    Raises
    ------
    InputError : an argument of another type, or something in the experiment cannot be pressed,
        rendered or fitted
    MissingBackend : no usable Dr.Jit backend
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
    """Measure, and write all files into an empty folder; `command` is the calling command.

    The result equals that of `read_measurement` for that folder.

    Raises
    ------
    InputError, MissingBackend : as `measure`
    """
    done = measure_whole(experiment, watch, memory)
    watch("write", 0.0)
    write_measurement(folder, command, done)
    watch("write", 1.0)
    return as_stored(folder, done)


def measure_whole(
    experiment: Experiment, watch: ProgressCallback = no_progress, memory: Memory | None = None
) -> Measurement:
    """Measure, with the figures that a result folder holds: bounds, and the object behind the coat.

    Where the object is a fit of its own, under a slab, `twin compensate` makes it.

    Raises
    ------
    InputError, MissingBackend : as `measure`
    """
    done = measure(experiment, watch, memory, bound=True)
    if done.pressed is not None and compensates_at_once(experiment):
        watch("compensate", 0.0)
        done = with_compensation(done)
        watch("compensate", 1.0)
    return done


def check_measurable(experiment: Experiment) -> None:
    """Raise InputError if it is known without measuring that an experiment cannot be measured.

    The checks are those of the measurement itself; errors that only the press or the image shows,
    such as the depth that a force needs, are not included.

    Raises
    ------
    InputError : the part that cannot be pressed or rendered, and the change that is needed
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
