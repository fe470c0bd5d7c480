"""Pack samples into shards: WebDataset tar files, HDF5 or Parquet files.

An HDF5 or Parquet shard is built in memory and then written, see `reconstruction.writing`; a tar
file is written piece by piece. Equal samples give equal bytes: a tar file has no times, owners or
order of its own. Shards are named SPLIT-NNNNNN.
"""

import io
import json
import tarfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from reconstruction.errors import InputError
from reconstruction.evaluate.samples import SPLITS, npy
from reconstruction.writing import write_parts
from twin.dataset.quantities import quantity_of
from twin.extras import missing

ENDINGS = {"webdataset": "tar", "hdf5": "h5", "parquet": "parquet"}
SAMPLE_JSON, EXPERIMENT_TOML = "sample.json", "experiment.toml"
_MODE = 0o644
_PIECE_BYTES = 2**20


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

    def members(self) -> Iterator[tuple[str, Path | bytes]]:
        """Yield name and path or bytes of every file, sorted by name."""
        for name in sorted({*self.files, SAMPLE_JSON}):
            yield name, self.json_bytes if name == SAMPLE_JSON else self.files[name]

    def contents(self) -> Iterator[tuple[str, bytes]]:
        """Yield name and bytes of every file, sorted by name."""
        for name, content in self.members():
            yield name, content if isinstance(content, bytes) else content.read_bytes()


_Encoder = Callable[[Sequence[PackedSample]], Iterable[bytes | memoryview]]
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
    InputError : pyarrow, which Parquet needs, is not installed; or a file of a sample changed
    OSError : a shard cannot be written, or a file of a sample cannot be read
    """
    encoders: dict[str, _Encoder] = {"webdataset": _tar, "hdf5": _hdf5, "parquet": _parquet}
    encode = encoders[kind]
    shards = shards_of(samples, ENDINGS[kind], shard_mb)

    def write(name: str) -> int:
        write_parts(folder / name, encode(shards[name]), durable=True)
        return len(shards[name])

    # The device stores one tar file while the next one is read. Others would need twice the memory.
    with ThreadPoolExecutor(2 if kind == "webdataset" else 1) as pool:
        for count in pool.map(write, shards):
            watch(count)
    return {sample.key: name for name, some in shards.items() for sample in some}


def shards_of(
    samples: Iterable[PackedSample], ending: str, shard_mb: float
) -> dict[str, list[PackedSample]]:
    """Return the samples of each shard by its name; arguments as those of `write_shards`."""
    shards: dict[str, list[PackedSample]] = {}
    sizes, counts = dict.fromkeys(SPLITS, 0), dict.fromkeys(SPLITS, 0)
    for sample in samples:
        split, size = sample.split, sample.size_bytes
        sizes[split] += size
        if not counts[split] or sizes[split] > 1e6 * shard_mb:
            counts[split], sizes[split] = counts[split] + 1, size
        shards.setdefault(f"{split}-{counts[split] - 1:06d}.{ending}", []).append(sample)
    return shards


def _tar(samples: Sequence[PackedSample]) -> Iterator[bytes]:
    """Yield the parts of a tar file with the members KEY.NAME, those of one sample in sequence."""
    written = 2 * tarfile.BLOCKSIZE
    for sample in samples:
        for name, content in sample.members():
            member = tarfile.TarInfo(f"{sample.key}.{name}")
            member.mode = _MODE
            if isinstance(content, Path):
                member.size = content.stat().st_size
                pieces = _pieces(content, member.size)
            else:
                member.size, pieces = len(content), iter([content])
            yield member.tobuf(tarfile.USTAR_FORMAT)
            yield from pieces
            yield bytes(-member.size % tarfile.BLOCKSIZE)
            written += tarfile.BLOCKSIZE + member.size + -member.size % tarfile.BLOCKSIZE
    # Two empty blocks end the file, which is filled up to whole records.
    yield bytes(2 * tarfile.BLOCKSIZE + -written % tarfile.RECORDSIZE)


def _pieces(path: Path, size: int) -> Iterator[bytes]:
    """Yield the content of a file piece by piece; InputError if it has another size."""
    with path.open("rb", buffering=0) as file:
        while piece := file.read(_PIECE_BYTES):
            size -= len(piece)
            yield piece
    if size:
        raise InputError(f"{path}: changed while the data set was written; run again")


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
                quantity = quantity_of(stem)
                array.attrs["units"] = "" if quantity is None else quantity.unit
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
