"""Take one sample of a data set in a worker process: press, render, expose, decode if needed."""

import io
import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from reconstruction.capture.folder import Capture
from reconstruction.evaluate.samples import CALIBRATION_JSON
from reconstruction.pipeline import reconstruct
from reconstruction.rig.pinhole import Pinhole
from reconstruction.writing import write_bytes, write_png
from twin.config import Experiment
from twin.config.dataset import SampleContent
from twin.dataset.methods import MethodPart, check_content, parts_of, together
from twin.dataset.quantities import SAMPLE_QUANTITIES, needs_albedo, needs_decoding, quantity_of
from twin.dataset.taken import TakenSample
from twin.output import write_json
from twin.pipeline import measure
from twin.pipeline.captures import options_of
from twin.pipeline.colours import coat_albedo
from twin.pipeline.fringes import expose_capture, record, render_bare
from twin.pipeline.lit_frames import albedo
from twin.pipeline.memory import Memory
from twin.pipeline.press import PressedFace, press
from twin.pipeline.progress import Stopwatch
from twin.results.figures import Metrics
from twin.results.parts import taken_figures
from twin.results.score import metrics, score
from twin.study.measuring import NOMINAL_CONDITIONS, CaseMeasurer, CaseResult, Conditions

SAMPLE_FOLDER = "sample"
_CALIBRATION = CALIBRATION_JSON.removesuffix(".json")


@dataclass
class SampleMeasurer(CaseMeasurer):
    """Measurer of the samples of a data set; the attributes are those of `CaseMeasurer`.

    Attributes
    ----------
    content : quantities that each sample contains
    """

    content: SampleContent = field(default_factory=lambda: SampleContent(hold=("depth_mm",)))

    def __call__(
        self, experiment: Experiment, conditions: Conditions = NOMINAL_CONDITIONS
    ) -> CaseResult:
        """Take one sample, and return its figures and the function that writes its files.

        Raises
        ------
        InputError, MissingBackend : for the reasons of `twin.pipeline.measure`; or the experiment
            does not have a quantity of the content
        """
        self._computed_before = self.memory.requests()
        self.memory.calibrations = self.calibrations
        check_content(self.content, experiment)
        figures: list[tuple[MethodPart, Metrics]] = []
        files: dict[str, Content] = {}
        for part in parts_of(self.content, experiment):
            taken, known = take_sample(
                part.experiment,
                self.memory,
                conditions.trial,
                decode=needs_decoding(part.held),
                with_albedo=needs_albedo(part.held),
            )
            figures.append((part, known))
            files |= _files_of(taken, part)
        return CaseResult(together(figures), partial(_write, files, self.content))


@dataclass(frozen=True)
class SampleMeasuring:
    """Factory of the measurer of a worker; equal factories share one measurer.

    Attributes
    ----------
    content : quantities that each sample contains
    calibrations : folder that caches the calibrations of photometric sensors; None: no cache
    measurer : class of the measurer
    """

    content: SampleContent
    calibrations: Path | None = None
    measurer: type[SampleMeasurer] = SampleMeasurer

    def __call__(self, keep: tuple[str, ...]) -> SampleMeasurer:
        """Return a measurer with an empty cache."""
        return self.measurer(keep, calibrations=self.calibrations, content=self.content)


def take_sample(
    experiment: Experiment, memory: Memory, trial: int, *, decode: bool, with_albedo: bool = False
) -> tuple[TakenSample, Metrics]:
    """Run the stages of a measurement that a sample needs; return their results and figures.

    Parameters
    ----------
    memory : cache of stage results
    trial : number that selects the temporal noise
    decode : whether fringes are decoded and scored; an image of a photometric sensor always is
    with_albedo : whether the albedo of the surface is traced

    Raises
    ------
    InputError, MissingBackend : for the reasons of `twin.pipeline.measure`
    """
    if not experiment.method.fringes:
        return _take_image(experiment, memory, trial, with_albedo=with_albedo)
    pressed = press(experiment, memory).pressed if experiment.method.presses else None
    if pressed is None:
        radiance = render_bare(experiment, memory=memory)
        recording = expose_capture(experiment, radiance, Stopwatch(), trial)
    else:
        recording = record(experiment, pressed, trial=trial, memory=memory)
    figures: Metrics = taken_figures(experiment, pressed, recording)
    maps = None
    if decode:
        maps = reconstruct(recording.capture, options_of(experiment.decode))
        figures = {**figures, **metrics(score(experiment, maps, recording.truth))}
    reflectance = None
    if with_albedo:
        face = None if pressed is None else PressedFace.of(pressed)
        reflectance = albedo(experiment, face, memory)
    taken = TakenSample(experiment, recording.truth, pressed, recording, maps, albedo=reflectance)
    return taken, figures


def _take_image(
    experiment: Experiment, memory: Memory, trial: int, *, with_albedo: bool
) -> tuple[TakenSample, Metrics]:
    """Take one image of a photometric sensor; see `take_sample`."""
    done = measure(experiment, memory=memory, trial=trial)
    taken = TakenSample(experiment, done.truth, done.pressed, colours=done.colours)
    if with_albedo:
        taken = replace(taken, albedo=coat_albedo(experiment, taken.face, memory))
    return taken, done.metrics


Content = NDArray[Any] | Mapping[str, Any]
"""Content of a file of a sample: an array, or the tables of a JSON file."""


def _files_of(taken: TakenSample, part: MethodPart) -> dict[str, Content]:
    """Return the content of the files that one method gives, by name without ending."""
    # The arrays are computed here, where it may fail; `_write` then only accesses the disk.
    files: dict[str, Content] = {
        f"{part.prefix}{name}": SAMPLE_QUANTITIES[name].values(taken) for name in part.held
    }
    if taken.recording is not None:
        files[f"{part.prefix}{_CALIBRATION}"] = calibration_tree(taken.recording.capture)
    return files


def _write(files: Mapping[str, Content], content: SampleContent, folder: Path) -> None:
    inside = folder / SAMPLE_FOLDER
    inside.mkdir()
    for name, values in files.items():
        if not isinstance(values, np.ndarray):
            write_json(inside / f"{name}.json", values)
        elif content.frames == "png" and quantity_of(name) is SAMPLE_QUANTITIES["frames"]:
            for number, frame in enumerate(values):
                write_png(inside / f"{name}.{number:03d}.png", frame)
        else:
            write_bytes(inside / f"{name}.npy", *npy_parts(values))


def npy_parts(values: NDArray[Any]) -> tuple[bytes, memoryview]:
    """Return an array in the format of NumPy's .npy files: header, and values without a copy."""
    contiguous = np.ascontiguousarray(values)
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        header, np.lib.format.header_data_from_array_1_0(contiguous)
    )
    return header.getvalue(), contiguous.data


def calibration_tree(capture: Capture) -> Mapping[str, Any]:
    """Return the calibration of a capture as nested tables for JSON; lengths in mm.

    `T_world_from_cam` maps points from the camera's frame (x right, y down, z forward) to the world
    frame (z up towards the devices). `periods_px` is the measuring period along each axis of the
    fringes, projector px.
    """
    calibration, patterns = capture.calibration, capture.patterns
    axes = patterns.axes if patterns.steps else ()
    tree = {
        "periods_px": {axis: float(patterns.period_along(axis)) for axis in axes},
        "camera": _pinhole_tree(calibration.camera),
        "projector": _pinhole_tree(calibration.projector),
        "T_world_from_cam": calibration.T_world_from_cam.tolist(),
        "T_world_from_proj": calibration.T_world_from_proj.tolist(),
    }
    if calibration.layers is not None:
        surfaces = zip(calibration.layers.tops_mm, calibration.layers.iors, strict=True)
        tree["layers"] = [{"top_mm": float(top), "ior": float(ior)} for top, ior in surfaces]
    return dict(json.loads(json.dumps(tree)))


def _pinhole_tree(device: Pinhole) -> dict[str, Any]:
    return {
        "image_width": int(device.width_px),
        "image_height": int(device.height_px),
        "camera_matrix": [
            [float(device.fx_px), 0.0, float(device.cx_px)],
            [0.0, float(device.fy_px), float(device.cy_px)],
            [0.0, 0.0, 1.0],
        ],
        "distortion_coefficients": [float(value) for value in device.distortion],
    }
