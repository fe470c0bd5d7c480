"""Result folders of the tests: write one, list its contents, start a command on it."""

import subprocess
import sys
import time
from pathlib import Path

from twin.cli import run
from twin.output import output_folder, write_json

ROOT = Path(__file__).parents[2]
OURS = ("result.json", "twin-manifest.txt")
CAPTURE = ROOT / "docs" / "example_capture"
TWIN = "import sys; from twin.cli import main; main()"
# A reconstruction that has made its working folder and then waits to be ended.
WAITING = """
import time
from twin.cli import main
import twin.pipeline.captures as captures
captures.read_capture = lambda _: time.sleep(60)
main()
"""


def contents(folder):
    """Every entry below a folder with its bytes; None for folders."""
    return {
        str(path.relative_to(folder)): None if path.is_dir() else path.read_bytes()
        for path in sorted(folder.rglob("*"))
    }


def write(target, *, inputs=(), **files):
    with output_folder(target, inputs) as folder:
        for name, text in files.items():
            (folder / name).parent.mkdir(exist_ok=True)
            (folder / name).write_text(text)
        write_json(folder / "result.json", {})


def start(program, out):
    command = [sys.executable, "-c", program, "reconstruct", str(CAPTURE), "-o", str(out)]
    return subprocess.Popen(command, stderr=subprocess.PIPE, text=True)


def started(out):
    """A reconstruction that is under way."""
    child = start(WAITING, out)
    while not list(out.parent.rglob("*.part/new")):
        assert child.poll() is None, child.stderr.read()
        time.sleep(0.02)
    return child


def refusal(capsys, *arguments):
    assert run([str(argument) for argument in arguments]) == 2
    message = capsys.readouterr().err.strip().splitlines()
    assert len(message) == 1  # no stage was begun
    return message[0]
