"""Damage to files: bits, cuts, hostile tokens, lines; or a pipe, device or folder instead of it."""

import os
import random
from collections.abc import Callable
from pathlib import Path

_TOKENS = (
    b"nan", b"inf", b"-inf", b"-1", b"0", b"1e300", b"-1e-300", b"9" * 5000, b"true", b"[]", b"{}",
    b'""', b"'", b'"""', b"\x00", b"\xff\xfe", b"[[a]]", b"[a.b.c]", b"=", b"#", b"..",
    b"/dev/zero", b"[bold]", b"$\\frac{$", b"=cmd|' /C calc'!A0", b"\xe2\x80\xae",
    b"{" * 3000, b"[" * 3000, b"a" * 300, b"a" * 100_000, b"1" + b"0" * 400, b"-0.0",
    b"1979-05-27T07:32:00Z",
)  # fmt: skip


def damaged_bytes(content: bytes, rng: random.Random) -> tuple[bytes, str]:
    """Return a file's content with one to four faults, and their names."""
    names = []
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        fault = rng.choice((_flip, _cut, _truncate, _double, _token, _zero, _number, _line))
        content = fault(content, rng)
        names.append(fault.__name__.strip("_"))
    return content, "+".join(names)


def _at(content: bytes, rng: random.Random) -> int:
    # Headers decide more than pixels do.
    reach = rng.choice((64, 512, 4096, len(content)))
    return rng.randrange(max(1, min(reach, len(content))))


def _flip(content: bytes, rng: random.Random) -> bytes:
    changed = bytearray(content)
    for _ in range(rng.choice((1, 8, 64)) if changed else 0):
        changed[_at(content, rng)] ^= 1 << rng.randrange(8)
    return bytes(changed)


def _cut(content: bytes, rng: random.Random) -> bytes:
    at = _at(content, rng)
    return content[:at] + content[at + rng.choice((1, 4, 100, 10_000)) :]


def _truncate(content: bytes, rng: random.Random) -> bytes:
    return content[: _at(content, rng)]


def _double(content: bytes, rng: random.Random) -> bytes:
    at, size = _at(content, rng), rng.choice((1, 16, 1000))
    return content[: at + size] + content[at:]


def _token(content: bytes, rng: random.Random) -> bytes:
    at = _at(content, rng)
    return content[:at] + rng.choice(_TOKENS) + content[at:]


def _zero(content: bytes, rng: random.Random) -> bytes:
    at, size = _at(content, rng), rng.choice((1, 8, 1000))
    return content[:at] + bytes(min(size, len(content) - at)) + content[at + size :]


def _number(content: bytes, rng: random.Random) -> bytes:
    """Replace a number or a word after `=`, `:` or `,` by a hostile token."""
    places = [i for i, sign in enumerate(content[:100_000]) if sign in b"=:,"]
    if not places:
        return _flip(content, rng)
    at = rng.choice(places) + 1
    end = at
    while end < len(content) and content[end] not in b"\n,]}":
        end += 1
    return content[:at] + b" " + rng.choice(_TOKENS) + content[end:]


def _line(content: bytes, rng: random.Random) -> bytes:
    """Drop, double or exchange a line."""
    lines = content.split(b"\n")
    first, second = rng.randrange(len(lines)), rng.randrange(len(lines))
    way = rng.randrange(3)
    if way == 0:
        del lines[first]
    elif way == 1:
        lines.insert(second, lines[first])
    else:
        lines[first], lines[second] = lines[second], lines[first]
    return b"\n".join(lines)


_REPLACEMENTS: dict[str, Callable[[Path], object]] = {
    "fifo": os.mkfifo,
    "folder": Path.mkdir,
    "nothing": lambda path: None,
    "device": lambda path: path.symlink_to("/dev/zero"),
    "circle": lambda path: path.symlink_to(path.name),
    "empty": Path.touch,
}


def damage_file(path: Path, rng: random.Random) -> str:
    """Damage a file, or replace it by a pipe, folder or device; return a description."""
    if rng.random() < 0.85:
        content, description = damaged_bytes(path.read_bytes(), rng)
        path.write_bytes(content)
        return f"{path.name}: {description}"
    kind = rng.choice(tuple(_REPLACEMENTS))
    path.unlink()
    _REPLACEMENTS[kind](path)
    return f"{path.name}: {kind}"
