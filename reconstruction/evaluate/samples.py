"""Read the samples of a data set from its shards: WebDataset tar files, HDF5 or Parquet files.

A sample has a key, the content of its `sample.json`, and arrays by name. Members of other names are
not read. The format of a data set is documented in docs/datasets.md.
"""

import io
import json
import tarfile
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import groupby
from pathlib import Path
from tokenize import TokenError
from typing import Any

import numpy as np
from numpy.typing import NDArray

from reconstruction.errors import InputError
from reconstruction.reading import read_json

SAMPLE_JSON, SCHEMA_JSON = "sample.json", "schema.json"
CALIBRATION_JSON = "calibration.json"
SPLITS = ("train", "validation", "test")
"""Parts of a data set; an object is in one of them only."""
_NPY = ".npy"


@dataclass(frozen=True, eq=False)
class LabelledSample:
    """One sample of a data set.

    Attributes
    ----------
    key : name of the sample
    described : content of `sample.json`: scene, split, object, drawn values, figures
    arrays : the requested arrays that the sample contains, by name
    calibration : content of `calibration.json`; empty if the sample has none
    """

    key: str
    described: Mapping[str, Any]
    arrays: Mapping[str, NDArray[Any]]
    calibration: Mapping[str, Any] = field(default_factory=dict)


def arrays_of(dataset: Path) -> list[str]:
    """Return the names of the arrays that each sample of a data set contains.

    Raises
    ------
    InputError : the folder is no data set
    """
    try:
        files = read_json(dataset / SCHEMA_JSON)["files"]
        return [name.removesuffix(_NPY) for name in files if name.endswith(_NPY)]
    except (InputError, KeyError, TypeError, AttributeError):
        raise InputError(
            f"{dataset}: is no data set: {SCHEMA_JSON} is missing or damaged; give the -o DIR of "
            "twin dataset"
        ) from None


def read_samples(dataset: Path, split: str, names: Collection[str]) -> Iterator[LabelledSample]:
    """Yield the samples of one split in the order of their keys.

    Parameters
    ----------
    split : "train", "validation" or "test"
    names : names of the arrays that are read

    Raises
    ------
    InputError : the split is not known or has no shard, or a shard cannot be read
    """
    if split not in SPLITS:
        raise InputError(f"--split: found '{split}', allowed: {', '.join(SPLITS)}")
    shards = sorted(path for ending in _READERS for path in dataset.glob(f"{split}-*{ending}"))
    if not shards:
        raise InputError(f"{dataset}: the split '{split}' has no sample; choose another --split")
    for shard in shards:
        try:
            yield from _READERS[shard.suffix](shard, names)
        except (OSError, ValueError, KeyError, tarfile.TarError) as error:
            raise InputError(f"{shard}: damaged ({error}); make the data set again") from None


def _from_tar(shard: Path, names: Collection[str]) -> Iterator[LabelledSample]:
    wanted = {f"{name}{_NPY}" for name in names} | {SAMPLE_JSON, CALIBRATION_JSON}
    with tarfile.open(shard, "r:") as tar:
        for key, members in groupby(tar, lambda member: member.name.partition(".")[0]):
            read = {}
            for member in members:
                name = member.name.partition(".")[2]
                content = tar.extractfile(member) if name in wanted else None
                if content is not None:
                    read[name] = content.read()
            described = json.loads(read.pop(SAMPLE_JSON))
            calibration = json.loads(read.pop(CALIBRATION_JSON, b"{}"))
            arrays = {name.removesuffix(_NPY): npy(content) for name, content in read.items()}
            yield LabelledSample(key, described, arrays, calibration)


def npy(content: bytes) -> NDArray[Any]:
    """Return the array of the bytes of an .npy file.

    Raises
    ------
    ValueError : the bytes are no .npy file, or damaged
    """
    try:
        return np.asarray(np.lib.format.read_array(io.BytesIO(content), allow_pickle=False))
    except (EOFError, SyntaxError, TypeError, TokenError) as error:  # by a damaged header
        raise ValueError(str(error)) from None


def _from_hdf5(shard: Path, names: Collection[str]) -> Iterator[LabelledSample]:
    import h5py

    with h5py.File(shard, "r") as file:
        for key in sorted(file):
            group = file[key]
            arrays = {name: group[name][()] for name in names if name in group}
            described = json.loads(group.attrs[SAMPLE_JSON])
            calibration = json.loads(group.attrs.get(CALIBRATION_JSON, "{}"))
            yield LabelledSample(key, described, arrays, calibration)


def _from_parquet(shard: Path, names: Collection[str]) -> Iterator[LabelledSample]:
    try:
        from pyarrow import parquet
    except ModuleNotFoundError:
        raise InputError(f"{shard}: needs pyarrow, which is not installed") from None
    file = parquet.ParquetFile(shard)
    present = set(file.schema_arrow.names)
    columns, rig = [name for name in names if name in present], {CALIBRATION_JSON} & present
    for batch in file.iter_batches(1, columns=["key", SAMPLE_JSON, *rig, *columns]):
        row = {name: batch.column(name) for name in batch.schema.names}
        arrays = {name: _nested(row[name]) for name in columns if row[name].null_count == 0}
        described = json.loads(row[SAMPLE_JSON][0].as_py())
        text = row[CALIBRATION_JSON][0].as_py() if rig else None  # None: a sample without fringes
        calibration = json.loads(text or "{}")
        yield LabelledSample(row["key"][0].as_py(), described, arrays, calibration)


def _nested(column: Any) -> NDArray[Any]:
    """Return the array of a column of nested lists with one row; all lists of a level are equal."""
    shape: list[int] = []
    while hasattr(column, "flatten") and hasattr(column, "offsets"):
        count = len(column)
        column = column.flatten()
        shape.append(len(column) // count)
    return np.asarray(column.to_numpy(zero_copy_only=False)).reshape(shape)


_Reader = Callable[[Path, Collection[str]], Iterator[LabelledSample]]
_READERS: Mapping[str, _Reader] = {
    ".tar": _from_tar,
    ".h5": _from_hdf5,
    ".parquet": _from_parquet,
}
