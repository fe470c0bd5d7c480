"""Pack samples into shards: WebDataset tar files, HDF5 or Parquet files.

A shard is built in memory and then written, see `reconstruction.writing`. Equal samples give equal
bytes: a tar file has no times, owners or order of its own. Shards are named SPLIT-NNNNNN.
"""

import io
import json
import tarfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from reconstruction.evaluate.samples import SPLITS, npy
from reconstruction.writing import write_bytes
from twin.dataset.quantities import SAMPLE_QUANTITIES
from twin.extras import missing

ENDINGS = {"webdataset": "tar", "hdf5": "h5", "parquet": "parquet"}
SAMPLE_JSON, EXPERIMENT_TOML = "sample.json", "experiment.toml"
_MODE = 0o644


@dataclass(frozen=True, eq=False)
class PackedSample:
    """One sample that is ready to be packed.

    Attributes
    ----------
    key : name of the sample
    split : part of the data set to which it belongs
    files : name of every file of the sample, with its path; without `sample.json`
    described : content of `sample.json`
    """

    key: str
    split: str
    files: Mapping[str, Path]
    described: Mapping[str, Any]

    @property
    def json_bytes(self) -> bytes:
        """The bytes of `sample.json`."""
        return json.dumps(self.described, sort_keys=True, indent=1, allow_nan=False).encode()

    @property
    def size_bytes(self) -> int:
        """Size of all files."""
        return sum(path.stat().st_size for path in self.files.values()) + len(self.json_bytes)

    def contents(self) -> Iterator[tuple[str, bytes]]:
        """Yield name and bytes of every file, sorted by name."""
        named = {**dict.fromkeys(self.files), SAMPLE_JSON: None}
        for name in sorted(named):
            known = self.json_bytes if name == SAMPLE_JSON else self.files[name].read_bytes()
            yield name, known


_Encoder = Callable[[Sequence[PackedSample]], Sequence[bytes | memoryview]]
"""Returns the parts of a shard's content, in their order."""


def write_shards(
    folder: Path,
    samples: Iterable[PackedSample],
    kind: str,
    shard_mb: float,
    watch: Callable[[int], None] = lambda _: None,
) -> dict[str, str]:
    """Write samples into shards; return the name of the shard of every key.

    Parameters
    ----------
    folder : folder for the shards
    samples : samples in the order of their numbers
    kind : "webdataset", "hdf5" or "parquet"
    shard_mb : size at which the next shard begins, 10^6 bytes
    watch : called with the number of samples that a shard contains, after it was written

    Raises
    ------
    InputError : pyarrow, which Parquet needs, is not installed
    OSError : a shard cannot be written
    """
    encoders: dict[str, _Encoder] = {"webdataset": _tar, "hdf5": _hdf5, "parquet": _parquet}
    encode = encoders[kind]
    waiting: dict[str, list[PackedSample]] = {split: [] for split in SPLITS}
    sizes, counts = dict.fromkeys(SPLITS, 0), dict.fromkeys(SPLITS, 0)
    shard_of: dict[str, str] = {}

    def write(split: str) -> None:
        some = waiting[split]
        name = f"{split}-{counts[split]:06d}.{ENDINGS[kind]}"
        write_bytes(folder / name, *encode(some))
        shard_of.update((sample.key, name) for sample in some)
        counts[split] += 1
        watch(len(some))
        waiting[split], sizes[split] = [], 0

    for sample in samples:
        size = sample.size_bytes
        if waiting[sample.split] and sizes[sample.split] + size > 1e6 * shard_mb:
            write(sample.split)
        waiting[sample.split].append(sample)
        sizes[sample.split] += size
    for split in SPLITS:
        if waiting[split]:
            write(split)
    return shard_of


def _tar(samples: Sequence[PackedSample]) -> list[bytes]:
    """Return a tar file with the members KEY.NAME, those of one sample in sequence.

    The file is returned in parts, because joining them would take as long as writing them.
    """
    parts: list[bytes] = []
    for sample in samples:
        for name, content in sample.contents():
            member = tarfile.TarInfo(f"{sample.key}.{name}")
            member.size, member.mode = len(content), _MODE
            padding = bytes(-len(content) % tarfile.BLOCKSIZE)
            parts += [member.tobuf(tarfile.USTAR_FORMAT), content, padding]
    # Two empty blocks end the file, which is filled up to whole records.
    size = sum(map(len, parts)) + 2 * tarfile.BLOCKSIZE
    return [*parts, bytes(2 * tarfile.BLOCKSIZE + -size % tarfile.RECORDSIZE)]


def _hdf5(samples: Sequence[PackedSample]) -> list[memoryview]:
    """Return an HDF5 file with one group per sample; units are attributes of the arrays."""
    import h5py

    made = io.BytesIO()
    with h5py.File(made, "w") as file:
        for sample in samples:
            group = file.create_group(sample.key)
            for name, content in sample.contents():
                stem, _, ending = name.rpartition(".")
                if ending != "npy":
                    group.attrs[name] = content.decode()
                    continue
                array = group.create_dataset(stem, data=npy(content), track_times=False)
                array.attrs["units"] = SAMPLE_QUANTITIES[stem].unit
    return [made.getbuffer()]


def _parquet(samples: Sequence[PackedSample]) -> list[memoryview]:
    """Return a Parquet file with one row per sample; arrays are nested lists of numbers."""
    pyarrow, parquet = arrow("format = 'parquet'")
    rows = [dict(sample.contents()) for sample in samples]
    columns: dict[str, Any] = {"key": pyarrow.array([sample.key for sample in samples])}
    for name in dict.fromkeys(name for row in rows for name in row):
        contents = [row.get(name) for row in rows]
        if name.endswith(".npy"):
            arrays = [None if c is None else npy(c) for c in contents]
            columns[name.removesuffix(".npy")] = _nested(pyarrow, arrays)
        else:
            texts = [None if c is None else c.decode() for c in contents]
            columns[name] = pyarrow.array(texts, pyarrow.string())
    made = io.BytesIO()
    parquet.write_table(pyarrow.table(columns), made, compression="zstd")
    return [made.getbuffer()]


def _nested(pyarrow: Any, arrays: Sequence[Any]) -> Any:
    """Return arrays of equal number of axes as an Arrow column of nested lists, one per row."""
    present = [array for array in arrays if array is not None]
    # Frames of 8 and of 12 bits in one shard have the larger type.
    dtype = np.result_type(*(array.dtype for array in present))
    kind = pyarrow.from_numpy_dtype(dtype)
    for _ in range(present[0].ndim):
        kind = pyarrow.list_(kind)
    return pyarrow.chunked_array(
        [
            pyarrow.nulls(1, kind) if array is None else _one_nested(pyarrow, array.astype(dtype))
            for array in arrays
        ],
        kind,
    )


def _one_nested(pyarrow: Any, array: Any) -> Any:
    values = pyarrow.array(np.ascontiguousarray(array).ravel())
    for axis in range(array.ndim - 1, -1, -1):
        count = int(np.prod(array.shape[:axis], dtype=np.int64))
        ends = np.arange(count + 1, dtype=np.int64) * array.shape[axis]
        values = pyarrow.ListArray.from_arrays(pyarrow.array(ends, pyarrow.int32()), values)
    return values


def arrow(where: str) -> tuple[Any, Any]:
    """Return the modules `pyarrow` and `pyarrow.parquet`.

    Raises
    ------
    InputError : they are not installed; the message starts with `where`
    """
    try:
        import pyarrow
        import pyarrow.parquet
    except ModuleNotFoundError:
        raise missing(where, "pyarrow", "sweep") from None
    return pyarrow, pyarrow.parquet
