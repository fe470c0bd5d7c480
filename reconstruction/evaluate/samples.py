"""Read the samples of a data set from its shards: WebDataset tar files, HDF5 or Parquet files.

A sample has a key, the content of its `sample.json`, and arrays by name. Members of other names are
not read. In a data set of several methods the names begin with the method; a reader of one method
gets its arrays under the names without it. The format is documented in docs/datasets.md.
"""

import io
import json
import tarfile
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field, replace
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
ALL_SPLITS = "all"
"""Name that selects all parts."""
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
    split : part of the data set that contains the sample
    """

    key: str
    described: Mapping[str, Any]
    arrays: Mapping[str, NDArray[Any]]
    calibration: Mapping[str, Any] = field(default_factory=dict)
    split: str = ""


@dataclass(frozen=True)
class DataSetSchema:
    """What `schema.json` states of a data set.

    Attributes
    ----------
    arrays : names of the arrays of a sample, as in the files
    methods : methods that measure each object; empty for a data set of one method
    baseline : name of the classical method that the recipe states for comparison; may be empty
    """

    arrays: tuple[str, ...]
    methods: tuple[str, ...] = ()
    baseline: str = ""

    def arrays_of(self, method: str) -> tuple[str, ...]:
        """Return the names of the arrays of one method, without its name; "" if there is one."""
        start = prefix_of(method)
        return tuple(name.removeprefix(start) for name in self.arrays if name.startswith(start))


def prefix_of(method: str) -> str:
    """Return the beginning of the names of a method's files; empty without a method."""
    return f"{method}_" if method else ""


def read_schema(dataset: Path) -> DataSetSchema:
    """Read the names of the arrays, the methods and the baseline of a data set.

    Raises
    ------
    InputError : the folder is no data set
    """
    try:
        schema = read_json(dataset / SCHEMA_JSON)
        names = [name.removesuffix(_NPY) for name in schema["files"] if name.endswith(_NPY)]
        methods = tuple(map(str, schema.get("methods", ())))
        return DataSetSchema(tuple(names), methods, str(schema.get("baseline", "")))
    except (InputError, KeyError, TypeError, AttributeError):
        raise InputError(
            f"{dataset}: is no data set: {SCHEMA_JSON} is missing or damaged; give the -o DIR of "
            "twin dataset"
        ) from None


def read_samples(
    dataset: Path, split: str, names: Collection[str], method: str = ""
) -> Iterator[LabelledSample]:
    """Yield the samples of one split, or of all, in the order of their keys within a split.

    Parameters
    ----------
    split : "train", "validation", "test" or "all"
    names : names of the arrays that are read, without method
    method : method whose arrays are read; empty for a data set of one method

    Raises
    ------
    InputError : the split is not known or has no shard, or a shard cannot be read
    """
    if split not in (*SPLITS, ALL_SPLITS):
        allowed = ", ".join((*SPLITS, ALL_SPLITS))
        raise InputError(f"--split: found '{split}', allowed: {allowed}")
    parts = SPLITS if split == ALL_SPLITS else (split,)
    shards = [(part, shard) for part in parts for shard in _shards(dataset, part)]
    if not shards:
        raise InputError(f"{dataset}: the split '{split}' has no sample; choose another --split")
    start = prefix_of(method)
    wanted = [f"{start}{name}" for name in names]
    for part, shard in shards:
        try:
            for sample in _READERS[shard.suffix](shard, wanted, f"{start}{CALIBRATION_JSON}"):
                arrays = {name.removeprefix(start): a for name, a in sample.arrays.items()}
                yield replace(sample, arrays=arrays, split=part)
        except InputError:
            raise
        except (OSError, ValueError, KeyError, tarfile.TarError) as error:
            raise InputError(f"{shard}: damaged ({error}); make the data set again") from None


def _shards(dataset: Path, split: str) -> list[Path]:
    return sorted(path for ending in _READERS for path in dataset.glob(f"{split}-*{ending}"))


def _from_tar(shard: Path, names: Collection[str], rig: str) -> Iterator[LabelledSample]:
    wanted = {f"{name}{_NPY}" for name in names} | {SAMPLE_JSON, rig}
    with tarfile.open(shard, "r:") as tar:
        for key, members in groupby(tar, lambda member: member.name.partition(".")[0]):
            read = {}
            for member in members:
                name = member.name.partition(".")[2]
                content = tar.extractfile(member) if name in wanted else None
                if content is not None:
                    read[name] = content.read()
            described = json.loads(read.pop(SAMPLE_JSON))
            calibration = json.loads(read.pop(rig, b"{}"))
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


def _from_hdf5(shard: Path, names: Collection[str], rig: str) -> Iterator[LabelledSample]:
    import h5py

    with h5py.File(shard, "r") as file:
        for key in sorted(file):
            group = file[key]
            arrays = {name: group[name][()] for name in names if name in group}
            described = json.loads(group.attrs[SAMPLE_JSON])
            calibration = json.loads(group.attrs.get(rig, "{}"))
            yield LabelledSample(key, described, arrays, calibration)


def _from_parquet(shard: Path, names: Collection[str], rig: str) -> Iterator[LabelledSample]:
    try:
        from pyarrow import parquet
    except ModuleNotFoundError:
        raise InputError(f"{shard}: needs pyarrow, which is not installed") from None
    file = parquet.ParquetFile(shard)
    present = set(file.schema_arrow.names)
    columns, rigs = [name for name in names if name in present], {rig} & present
    for batch in file.iter_batches(1, columns=["key", SAMPLE_JSON, *rigs, *columns]):
        row = {name: batch.column(name) for name in batch.schema.names}
        arrays = {name: _nested(row[name]) for name in columns if row[name].null_count == 0}
        described = json.loads(row[SAMPLE_JSON][0].as_py())
        text = row[rig][0].as_py() if rigs else None  # None: a sample without fringes
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


_Reader = Callable[[Path, Collection[str], str], Iterator[LabelledSample]]
"""Function (shard, names of arrays, name of the calibration) that yields the samples."""
_READERS: Mapping[str, _Reader] = {
    ".tar": _from_tar,
    ".h5": _from_hdf5,
    ".parquet": _from_parquet,
}
