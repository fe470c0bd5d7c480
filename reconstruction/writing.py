"""Write a file completely or not at all: encode it in memory, then copy the bytes to the disk.

A native library that writes by itself may crash on a full disk (HDF5), hide the failure (OpenCV),
or report it only as text (OpenEXR, Pillow). Therefore no library gets a path or an open file. The
library encodes into memory, and `write_bytes` copies the bytes to the disk. A failed copy raises an
ordinary OSError.

A file is first written under a temporary name in the same folder, then renamed. On a failure the
temporary file is removed. Until the renaming an existing file of the final name is unchanged.
"""

import errno
import io
import os
import re
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from reconstruction.errors import InputError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

Content = bytes | bytearray | memoryview

_PIECE_BYTES = 2**24
# Where a name in a text begins and ends, and the number of characters searched for it.
_PARTS, _NEAR = re.compile("[\"'\\n]"), 300


def write_bytes(path: Path | str, *parts: Content, durable: bool = False) -> None:
    """Write the concatenated parts to a file and replace an existing file.

    Parameters
    ----------
    parts : parts of the content, in their order; each a contiguous buffer
    durable : wait until the device has stored the bytes, before the file is renamed

    Raises
    ------
    OSError : the file cannot be written; the error names it, and an existing file is unchanged
    """
    write_parts(path, parts, durable=durable)


def write_parts(path: Path | str, parts: Iterable[Content], *, durable: bool = False) -> None:
    """Write parts as `write_bytes`; each part is requested after the previous one was written.

    Raises
    ------
    OSError : as `write_bytes`, also for an OSError that `parts` raises
    """
    place = Path(os.path.realpath(path))  # a symbolic link remains a link
    try:
        if place.exists() and not os.access(place, os.W_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
        if place.exists() and not place.is_file():  # a device or a pipe is not replaced
            _write(place, parts, durable=False)
        else:
            _replace(place, parts, durable)
    except OSError as error:
        raise OSError(error.errno, error.strerror, os.fspath(path)) from None


def _replace(place: Path, parts: Iterable[Content], durable: bool) -> None:
    # With the process number: another process may write the same file.
    temporary = place.with_name(f".{place.name}.{os.getpid()}.part")
    try:
        _write(temporary, parts, durable)
        temporary.replace(place)
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def _write(place: Path, parts: Iterable[Content], durable: bool) -> None:
    with place.open("wb", buffering=0) as file:
        for part in parts:
            remaining = memoryview(part)
            remaining = remaining.cast("B") if remaining.nbytes else remaining[:0]
            while remaining:
                remaining = remaining[_written(file, remaining[:_PIECE_BYTES]) :]
        if durable:
            os.fsync(file.fileno())


def _written(file: io.FileIO, piece: memoryview) -> int:
    count = file.write(piece)
    if not count:
        raise OSError(errno.EIO, "the system wrote nothing")
    return count


def make_durable(folder: Path) -> None:
    """Wait until the storage device has stored a folder and all files and folders in it.

    Raises
    ------
    OSError : the device cannot store them; some file systems report it only now
    """
    for path in folder.rglob("*"):
        if path.is_dir():
            make_names_durable(path)
        elif path.is_file():
            # Windows synchronises only files that are open for writing.
            with path.open("r+b" if os.name == "nt" else "rb") as file:
                os.fsync(file.fileno())
    make_names_durable(folder)


def make_names_durable(folder: Path) -> None:
    """Wait until the storage device has stored which files a folder has, and their names.

    Raises
    ------
    OSError : the device cannot store them
    """
    if not hasattr(os, "O_DIRECTORY"):  # Windows cannot open folders
        return
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(handle)
    except OSError as error:
        if error.errno != errno.EINVAL:  # a file system without synchronisation of folders
            raise
    finally:
        os.close(handle)


def write_text(path: Path | str, text: str, *, durable: bool = False) -> None:
    """Write text to a file by `write_bytes`, in UTF-8, with unchanged line ends.

    Raises
    ------
    OSError : as `write_bytes`
    InputError : the text contains a file name whose bytes are no UTF-8
    """
    try:
        content = text.encode("utf-8")
    except UnicodeEncodeError as error:
        near = text[max(0, error.start - _NEAR) : error.start + _NEAR]
        name = next(part for part in _PARTS.split(near) if _is_bytes(part))
        raise InputError(
            f"{path}: would contain the name {name!r}, allowed: UTF-8; rename that file or folder"
        ) from None
    write_bytes(path, content, durable=durable)


def _is_bytes(name: str) -> bool:
    """Return True if a name contains bytes that are no UTF-8, which are surrogates in Python."""
    return any("\ud800" <= sign <= "\udfff" for sign in name)


def write_png(path: Path | str, pixels: "NDArray[Any]") -> None:
    """Write an image (row, col) or (row, col, rgb), uint8 or uint16, as a PNG file.

    Raises
    ------
    OSError : as `write_bytes`
    """
    import imageio.v3 as imageio  # 0.1 s that are not needed for text

    write_bytes(path, imageio.imwrite("<bytes>", pixels, plugin="pillow", extension=".png"))


def write_film(path: Path | str, frames: "NDArray[Any]", frame_ms: float) -> None:
    """Write images (frame, row, col, rgb), uint8, as an animated PNG file that repeats.

    Viewers without animation show the first frame.

    Raises
    ------
    OSError : as `write_bytes`
    """
    import imageio.v3 as imageio

    film = imageio.imwrite(
        "<bytes>", frames, plugin="pillow", extension=".png", is_batch=True, duration=frame_ms,
        loop=0,
    )  # fmt: skip
    write_bytes(path, film)


def write_npz(path: Path | str, arrays: Mapping[str, "NDArray[Any]"]) -> None:
    """Write arrays as a compressed .npz file; equal arrays give equal bytes.

    No suffix is added to a file name that does not end with .npz.

    Raises
    ------
    OSError : as `write_bytes`
    ValueError : an array contains Python objects
    """
    import numpy as np

    memory = io.BytesIO()
    np.savez_compressed(memory, allow_pickle=False, **arrays)
    write_bytes(path, memory.getbuffer())


def write_exr_channels(path: Path | str, channels: Mapping[str, "NDArray[np.float32]"]) -> None:
    """Write (row, col) float32 images as the channels of one EXR file.

    Raises
    ------
    OSError : as `write_bytes`
    """
    import numpy as np
    import OpenEXR

    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    pixels = {name: np.ascontiguousarray(image, np.float32) for name, image in channels.items()}
    memory = io.BytesIO()
    with OpenEXR.File(header, pixels) as file:
        file.write(memory)
    write_bytes(path, memory.getbuffer())
