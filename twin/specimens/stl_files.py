"""Triangles of STL files, also of files that bend the format as other readers accept.

- Binary files may have a header that starts with "solid", a count of 0 or another wrong count, and
  further bytes at the end.
- Text files may have any case, line ends and indentation, no `endsolid`, several solids, decimal
  commas, exponents such as 1.0D+00, UTF-16 characters, and zero bytes at the end.

An STL file repeats the corners of its triangles; `twin.specimens.mesh_files` merges them.
"""

import codecs
import re
import struct
from collections.abc import Iterator

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.errors import InputError

_HEADER_BYTES, _COUNT_BYTES = 80, 4
_RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_NUMBER = rb"([-+]?(?:[\d.,]+(?:[ed][-+]?\d+)?|nan|inf(?:inity)?))"
_VERTEX = re.compile(rb"\bvertex[\s;]+" + rb"[\s;]+".join([_NUMBER] * 3))
_WORD = re.compile(rb"\bvertex[\s;]+[-+.\d]")
_LOOP = re.compile(rb"\bouter\s+loop\b")
_NAME = re.compile(rb"solid\b(?:(?!\bfacet\b)[^\r\n])*")


def stl_candidates(where: str, content: bytes) -> Iterator[FloatArray]:
    """Yield the possible triangles of an STL file, the most probable first.

    A binary file has more than one possible number of triangles if its count and its size differ
    by whole triangles. The caller takes the first one that is a closed surface.

    Parameters
    ----------
    where : key and file, for messages
    content : bytes of the file

    Yields
    ------
    (n, 3, xyz) float, in the file's units; corners

    Raises
    ------
    InputError : the file ends within a triangle, a vertex has no three numbers, or a facet no three
        vertices
    """
    if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        content = content.decode("utf-16", "replace").encode()
    head = content[: 2**16].lower()
    if _VERTEX.search(head) or (b"vertex" in head and b"\0" not in content):
        yield _text(where, _NAME.sub(b"", content.lower()))
    else:
        yield from _binary(where, content)


def _binary(where: str, content: bytes) -> Iterator[FloatArray]:
    start = _HEADER_BYTES + _COUNT_BYTES
    if len(content) < start + _RECORD.itemsize:
        raise InputError(f"{where}: found no triangles; give a closed surface")
    stated = struct.unpack_from("<I", content, _HEADER_BYTES)[0]
    complete, rest = divmod(len(content) - start, _RECORD.itemsize)
    if stated > complete and rest:
        raise InputError(
            f"{where}: ends within triangle {complete + 1} of {stated}; copy or export it again"
        )
    counts = [stated] if 0 < stated <= complete else []
    if complete not in counts and (not rest or not counts):
        counts.append(complete)
    for count in counts:
        records = np.frombuffer(content, _RECORD, count, start)
        yield records["corners"].astype(np.float64)


def _text(where: str, content: bytes) -> FloatArray:
    vertices = _VERTEX.findall(content)
    if len(vertices) != len(_WORD.findall(content)):
        raise InputError(f"{where}: found a vertex without three numbers; export it again")
    loops = len(_LOOP.findall(content))
    if loops and len(vertices) != 3 * loops:
        raise InputError(
            f"{where}: found {len(vertices)} vertices in {loops} facets, allowed: 3 for each; copy"
            " or export it again, as triangles"
        )
    if not vertices or len(vertices) % 3:
        raise InputError(
            f"{where}: found {len(vertices)} vertices, no whole number of triangles; copy or export"
            " it again"
        )
    try:
        numbers = [[_float(word) for word in vertex] for vertex in vertices]
    except ValueError as error:
        raise InputError(f"{where}: a vertex has no number ({error}); export it again") from error
    return np.array(numbers).reshape(-1, 3, 3)


def _float(word: bytes) -> float:
    """Return a number that may have a decimal comma, a comma behind it, or a Fortran exponent."""
    return float(word.rstrip(b",").replace(b",", b".").replace(b"d", b"e"))
