"""Digests and coarse figures of a few small measurements and a study.

`python -m tests.pipeline.reference` records them again: only where bytes are meant to change.
"""

import hashlib
import json
import os
import sys
import tempfile
from pathlib import Path

import h5netcdf
import imageio.v3 as imageio
import llvmlite.binding
import numpy as np
import OpenEXR

from reconstruction.reading import read_json
from twin.config import load_experiment
from twin.config.methods import METHODS
from twin.config.study import Study
from twin.output import RESULT_FILE, versions
from twin.pipeline.comparison import PhotometricPlan, compare
from twin.pipeline.methods import measure_into
from twin.study.record import StudyRecord
from twin.study.sweep import sweep
from twin.study.workers import local_workers

REFERENCE = Path(__file__).with_name("reference.json")

CAMERA = {"camera.binning": 4, "camera.width_px": 640, "camera.height_px": 480}
COARSE = {"press.relief_pitch_mm": 0.05, "press.solver_pitch_mm": 0.16}
SMALL = CAMERA | COARSE | {"patterns.steps": 4}
PATHS = {"render.photons": 20_000, "render.bounce_paths": 1}
FREE = SMALL | PATHS | {"press.back_pressure_kpa": 0.0}
DIRECT = CAMERA | PATHS | {"modality": "direct_fpp", "patterns.steps": 3}
ALONE = {
    "gel_on_window": ("examples/gel_on_window", SMALL),
    "airbrushed": ("examples/airbrushed", SMALL),
    "nut": ("paper/nut", DIRECT),
    "brick": ("paper/brick", DIRECT),
}
FEW_PRESSES = COARSE | {
    "photometric.presses.count": 5,
    "photometric.presses.backgrounds": 2,
    "photometric.presses.smallest_diameter_mm": 5.5,
}
AXES = (
    {"path": "coating.base_albedo", "values": [0.3, 0.5]},
    {"path": "patterns.period_px", "values": [18.0, 24.0]},
    {"path": "elastomer.shore_a", "values": [8.0, 12.0]},
)


def measured(folder):
    """Measure everything; digests and figures by the name of the measurement."""
    two_balls, figures = load_experiment("examples/slab_balls", FREE), {}
    plan = PhotometricPlan(settings=FEW_PRESSES)
    compare([two_balls], METHODS, folder / "compare", plan=plan)
    for method in METHODS:
        figures[f"compared_{method}"] = contents(folder / "compare" / two_balls.name / method)
    for name, (experiment, settings) in ALONE.items():
        (folder / name).mkdir()
        measure_into(folder / name, "measure", load_experiment(experiment, settings))
        figures[name] = contents(folder / name)
    return figures | studied(folder / "study", two_balls)


def studied(folder, base):
    """Run a study of eight cases that share stages; contents by case."""
    study = Study(
        name="digests",
        base=base.name,
        axis=AXES,
        keep=("press", "capture", "points"),
    )
    record = StudyRecord(study, base)
    sweep(record, folder, local_workers(1))
    return {
        f"case_{number}": contents(folder / "cases" / case.digest)
        for number, case in enumerate(record.cases().unique())
    }


def contents(folder):
    """Metrics of a result folder, and of each array in it the digest and coarse figures."""
    arrays = {
        f"{path.relative_to(folder).as_posix()}{name}": described(values)
        for path in sorted(folder.rglob("*"))
        for name, values in arrays_in(path)
    }
    return {"metrics": read_json(folder / RESULT_FILE)["metrics"], "arrays": arrays}


def arrays_in(path):
    """Yield the arrays of a file by name; none of a file without arrays."""
    if path.suffix == ".nc":
        with h5netcdf.File(path, "r") as file:
            for name, variable in sorted(file.variables.items()):
                yield f"/{name}", np.asarray(variable[...])
    elif path.suffix == ".npz":
        with np.load(path, allow_pickle=False) as file:
            yield from ((f"/{name}", file[name]) for name in sorted(file.files))
    elif path.suffix == ".png":
        yield "", imageio.imread(path)
    elif path.suffix == ".exr":
        with OpenEXR.File(str(path)) as file:
            for name, channel in sorted(file.channels().items()):
                yield f"/{name}", channel.pixels
    elif path.suffix == ".ply":
        yield "", np.frombuffer(path.read_bytes(), "V1")


def described(values):
    """Digest of an array, and of numbers count, least, greatest, mean and RMS."""
    content = repr(values.tolist()).encode() if values.dtype.kind == "O" else values.tobytes()
    digest = hashlib.sha256(f"{values.dtype.str}{values.shape}".encode() + content)
    description = {"sha256": digest.hexdigest(), "count": values.size}
    if values.dtype.kind not in "biuf" or not values.size:
        return description
    numbers = values.astype(np.float64)
    figures = {
        "min": numbers.min(),
        "max": numbers.max(),
        "mean": numbers.mean(),
        "rms": np.sqrt(np.mean(numbers**2)),
    }
    return description | {name: float(f"{value:.9g}") for name, value in figures.items()}


def machine():
    """Name the influences on the last digit: processor, threads of the linear algebra, versions."""
    others = {name: version for name, version in versions().items() if name != "fringe-twin"}
    threads = os.environ.get("OPENBLAS_NUM_THREADS") or os.environ.get("OMP_NUM_THREADS")
    count = threads or str(len(os.sched_getaffinity(0)))
    return {"cpu": llvmlite.binding.get_host_cpu_name(), "threads": count} | others


def recorded():
    """Read the recorded digests and figures."""
    return json.loads(REFERENCE.read_text(encoding="utf-8"))


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as place:
        content = {"machine": machine(), "measured": measured(Path(place))}
    REFERENCE.write_text(json.dumps(content, sort_keys=True) + "\n", encoding="utf-8")
    sys.stdout.write(f"wrote {REFERENCE.name}\n")
