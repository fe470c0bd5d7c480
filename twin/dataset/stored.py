"""Files of a sample in the store, checked before they are packed."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from reconstruction.errors import InputError, one_line
from reconstruction.evaluate.samples import CALIBRATION_JSON
from twin.config import Experiment
from twin.config.dataset import SampleContent
from twin.dataset.methods import parts_of
from twin.dataset.shards import EXPERIMENT_TOML
from twin.dataset.taking import SAMPLE_FOLDER


def stored_files(folder: Path, content: SampleContent, experiment: Experiment) -> dict[str, Path]:
    """Return the files of a computed sample by name.

    Parameters
    ----------
    folder : folder of the sample in the store
    experiment : experiment of the sample

    Raises
    ------
    InputError : a file is missing or was cut
    """
    inside = folder / SAMPLE_FOLDER
    files = {path.name: path for path in (sorted(inside.iterdir()) if inside.is_dir() else ())}
    files[EXPERIMENT_TOML] = folder / EXPERIMENT_TOML
    stems = {name.partition(".")[0] for name, path in files.items() if path.is_file()}
    needed = (EXPERIMENT_TOML.partition(".")[0], *_stems(content, experiment))
    problems = [f"{stem} is missing" for stem in needed if stem not in stems]
    problems = problems or [f"{name}: {why}" for name, why in _cut(files)]
    if problems:
        raise InputError(f"{folder}: {problems[0]}; delete this folder and run again")
    return files


def _stems(content: SampleContent, experiment: Experiment) -> Iterator[str]:
    """Yield the names, without ending, of all files that the methods of a sample give."""
    for part in parts_of(content, experiment):
        yield from (f"{part.prefix}{name}" for name in part.held)
        if part.experiment.method.fringes:
            yield f"{part.prefix}{CALIBRATION_JSON.partition('.')[0]}"


def _cut(files: dict[str, Path]) -> Iterator[tuple[str, str]]:
    """Yield the arrays whose files have another size than their header states."""
    for name, path in files.items():
        if not name.endswith(".npy"):
            continue
        with path.open("rb") as file:
            try:
                np.lib.format.read_magic(file)
                shape, _, dtype = np.lib.format.read_array_header_1_0(file)
            except ValueError as error:
                yield name, one_line(error)
                continue
            expected = file.tell() + int(np.prod(shape)) * dtype.itemsize
        if (stored := path.stat().st_size) != expected:
            yield name, f"found {stored} bytes, allowed {expected}"
