"""A second process that draws figures of a measurement's page while this one draws the others.

Matplotlib draws on one core. The process imports what it needs while the measurement still runs,
then answers requests, one line of JSON each way; it ends when its input does. It draws from the
folder what this process draws from memory: the same bytes.
"""

import json
import os
import select
import subprocess
import sys
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from reconstruction.machine import threads
from twin.report.page import Figure, figures_in

_AHEAD = 2
"""Requests under way: the next one is there when a figure is done."""


class SecondProcess:
    """The process; `asked` are the figures that it has not drawn yet."""

    def __init__(self, process: "subprocess.Popen[bytes]") -> None:
        self._process = process
        self.asked: deque[Figure] = deque()

    def ask(self, folder: Path, figure: Figure, picture: Path) -> bool:
        """Ask for a figure of the measurement in `folder`; False where the process is gone."""
        request = {"folder": str(folder), "name": figure.name, "picture": str(picture)}
        try:
            self._input.write(f"{json.dumps(request)}\n".encode())
        except OSError:
            return False
        self.asked.append(figure)
        return True

    def drawn(self, wait: bool) -> bool:
        """Tell whether the figure asked for first is drawn; False also where it never will be."""
        if not wait and not select.select([self._output], [], [], 0.0)[0]:
            return False
        done: bool = self._output.readline() == f"{self.asked[0].name}\n".encode()
        if done:
            self.asked.popleft()
        return done

    @property
    def _input(self) -> Any:
        return self._process.stdin

    @property
    def _output(self) -> Any:
        return self._process.stdout


@contextmanager
def second_process(wanted: bool = True) -> Iterator[SecondProcess | None]:
    """Yield the process, which is ended afterwards; None on one core, or where it cannot start."""
    if not wanted or threads() < 2 or os.name != "posix":
        yield None
        return
    command = [sys.executable, "-m", __name__]
    pipes: Any = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "bufsize": 0}
    same = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    try:
        process = subprocess.Popen(command, stderr=subprocess.DEVNULL, env=same, **pipes)
    except OSError:
        yield None
        return
    try:
        yield SecondProcess(process)
    finally:
        process.kill()
        with process:
            pass


def draw_figures(
    figures: Sequence[Figure],
    place: Callable[[Figure], Path],
    told: Callable[[], None],
    second: tuple[SecondProcess, Path] | None = None,
) -> None:
    """Draw figures: from the first on here, from the last on in the second process.

    Parameters
    ----------
    place : where a figure's picture goes
    told : called after each
    second : the process, and the folder of the measurement that it reads
    """
    waiting = deque(figure for figure in figures if figure.draw is not None)
    other, folder = second or (None, Path())
    while waiting or (other and other.asked):
        while other and waiting and len(other.asked) < _AHEAD:
            if not other.ask(folder, waiting[-1], place(waiting[-1])):
                break
            waiting.pop()
        if waiting:
            figure = waiting.popleft()
            assert figure.draw is not None
            figure.draw(place(figure))
            told()
        while other and other.asked:
            if other.drawn(wait=not waiting):
                told()
            elif waiting:
                break
            else:  # it has failed: what it was asked for is drawn here, and the reason told
                waiting, other = other.asked, None


def _serve() -> None:
    """Draw what is asked for, until the input ends or something fails."""
    from twin.report import contact as contact  # imported ahead: most pages need it
    from twin.report.measurement import page_of
    from twin.results.folder import read_measurement

    known: dict[str, dict[str, Figure]] = {}
    for line in sys.stdin:
        request = json.loads(line)
        folder = request["folder"]
        if folder not in known:
            page = page_of(read_measurement(Path(folder)))
            found = (figure for section in page.sections for figure in figures_in(section))
            known = {folder: {figure.name: figure for figure in found}}
        draw = known[folder][request["name"]].draw
        assert draw is not None
        draw(Path(request["picture"]))
        sys.stdout.write(f"{request['name']}\n")
        sys.stdout.flush()


if __name__ == "__main__":
    with suppress(KeyboardInterrupt):
        _serve()
