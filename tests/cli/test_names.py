"""Names that few users have: bytes that are no UTF-8, line breaks, other digits, leading dashes."""

import os
import subprocess
import sys
from pathlib import Path

import imageio.v3 as imageio
import pytest

from reconstruction.errors import InputError
from reconstruction.writing import write_text
from twin.cli import run

CAPTURE = Path(__file__).parents[2] / "docs" / "example_capture"
NO_UTF8 = os.fsdecode(b"bad\xff")
NAMES = [NO_UTF8, "a\nb", "image²", "٣", "-dash", "a\u2028b", "\x1b[31m"]


@pytest.mark.parametrize("name", NAMES)
def test_a_missing_file_of_any_name_is_one_line(tmp_path, monkeypatch, capsys, name):
    monkeypatch.chdir(tmp_path)
    assert run(["layout", name]) == 2
    message = capsys.readouterr().err
    assert len(message.splitlines()) == 1, message
    assert "\x1b" not in message


@pytest.mark.parametrize("name", NAMES)
def test_a_file_of_any_name_is_written(tmp_path, name):
    """The standard output has the strict error handler of most UTF-8 locales."""
    line = [sys.executable, "-c", "from twin.cli import main; main()", "init", f"./{name}"]
    environment = os.environ | {"PYTHONIOENCODING": "utf-8:strict"}
    environment["PYTHONPATH"] = str(Path(__file__).parents[2])
    done = subprocess.run(line, cwd=tmp_path, env=environment, capture_output=True, check=False)
    assert done.returncode == 0, done.stderr
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_a_text_with_a_name_that_is_no_utf8_is_rejected(tmp_path):
    file = tmp_path / "frames.toml"
    with pytest.raises(InputError, match=r"the name 'bad\\udcff\.png'.*rename"):
        write_text(file, f'x = 1\nfiles = ["good.png", "{NO_UTF8}.png"]\n')
    assert not file.exists()


def test_images_with_names_that_are_no_utf8_are_described_in_one_line(tmp_path, capsys):
    folder = tmp_path / "images"
    folder.mkdir()
    for path in CAPTURE.glob("*.png"):
        small = imageio.imwrite("<bytes>", imageio.imread(path)[::4, ::4], extension=".png")
        (folder / f"{NO_UTF8}{path.name}").write_bytes(small)
    assert run(["describe", str(folder), "--projector", "912", "1140"]) == 2
    message = capsys.readouterr().err.splitlines()[-1]
    assert message.startswith("twin: ")
    assert "bad\\udcff" in message
    assert "rename" in message
    assert not list(folder.glob("*.toml"))
