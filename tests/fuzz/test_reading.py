"""Untrusted files: each fault is reported in one line, and no reader waits."""

import os
import re
from pathlib import Path

import pytest

from reconstruction.errors import InputError
from reconstruction.reading import (
    is_regular,
    parse_toml,
    read_bytes,
    read_json,
    read_text,
    read_toml,
    regular_file,
)


def _fifo(path):
    os.mkfifo(path)


def _device(path):
    path.symlink_to("/dev/zero")


def _folder(path):
    path.mkdir()


def _circle(path):
    path.symlink_to(path.name)


@pytest.mark.parametrize("read", [regular_file, read_bytes, read_text, read_toml, read_json])
@pytest.mark.parametrize(
    ("make", "message"),
    [
        (_fifo, "found a pipe, allowed a file"),
        (_device, "found a device, allowed a file"),
        (_folder, "found a folder, allowed a file"),
        (_circle, "symbolic links"),
        (lambda path: None, "No such file"),
    ],
)
def test_what_is_no_file_is_not_opened(tmp_path, read, make, message):
    path = tmp_path / "x.toml"
    make(path)
    with pytest.raises(InputError, match=message) as caught:
        read(path)
    assert str(caught.value).startswith(f"{path}: cannot be read: ")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["x" * 300, "a\x00b", "x/" * 3000])
def test_a_name_that_no_file_can_have_is_told_in_one_short_line(name):
    assert not is_regular(Path(name))
    with pytest.raises(InputError, match="cannot be read") as caught:
        read_text(name)
    assert len(str(caught.value)) < 400
    assert "\x00" not in str(caught.value)


def test_a_file_that_is_too_large_is_refused_with_both_sizes(tmp_path):
    path = tmp_path / "x"
    path.write_bytes(b"12345")
    assert read_bytes(path, 5) == b"12345"
    with pytest.raises(InputError, match="found 5 bytes, allowed up to 4"):
        read_bytes(path, 4)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a = 1\nb = ?", "x: not valid TOML: .*line 2"),
        ("a = " + "9" * 5000, "a number has more than 4300 digits"),
        ("a = " + "[" * 100_000, "brackets nest deeper than 64 levels"),
        ("a = " + "[" * 70 + "]" * 70, "found tables nested deeper than 64 levels"),
        ("[" + ".".join("a" * 1 for _ in range(80)) + "]", "nested deeper than 64"),
        ("b = 1\n" + "a." * 100 + "a = 1", "line 2: found a key of more than 64 parts"),
        ("'a' . \"b\" ." * 100 + "a = 1", "line 1: found a key of more than 64 parts"),
        # The parser needs minutes for a key of 50,000 parts.
        ("a." * 400_000 + "a = 1", "line 1: found a key of more than 64 parts"),
    ],
)
def test_toml_that_cannot_be_is_one_line(text, message):
    with pytest.raises(InputError, match=message) as caught:
        parse_toml(text, "x")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "text",
    [
        "a." * 63 + "a = 1",
        "a = [" + "1.5, " * 200 + "]",
        "a = 'one. two. three.'",
        "\n".join(f"a{n}.b.c = {n}.5" for n in range(200)),
        "a" * 500_000 + " = 1",
        "a = '" + "." * 500_000 + "'",
    ],
)
def test_toml_of_any_form_is_read(text):
    assert parse_toml(text, "x")


def test_toml_that_no_hand_wrote_is_refused(tmp_path):
    path = tmp_path / "x.toml"
    path.write_text("a = 1\n" * 200_000)
    with pytest.raises(InputError, match="found 1200000 bytes, allowed up to 1048576"):
        read_toml(path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "cannot be read"),
        ("[1]", "found list, allowed a JSON object"),
        ('{"a": ' + "[" * 100_000, "brackets nest deeper than 64 levels"),
        ('{"a": ' + "9" * 5000 + "}", "a number has more than 4300 digits"),
    ],
)
def test_json_that_cannot_be_is_one_line(tmp_path, text, message):
    path = tmp_path / "x.json"
    path.write_text(text)
    with pytest.raises(InputError, match=message) as caught:
        read_json(path)
    assert re.match(r"[^\n]{1,300}$", str(caught.value))


def test_bytes_that_are_no_text_are_told_with_their_line(tmp_path):
    path = tmp_path / "x.toml"
    path.write_bytes(b"a = 1\nb = '\xff'\n")
    with pytest.raises(InputError, match="line 2 is no text in UTF-8"):
        read_toml(path)
