"""A headless Chromium under the control of a test: open a page, read it, drag on it.

Commands are sent through a pipe in the browser's debugging protocol: no driver, no port.
"""

import base64
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from select import select
from time import monotonic
from typing import Any
from urllib.parse import urlsplit

import pytest

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
WIDTHS = (1280, 390)
PAPER_PX = (718, 1047)
"""A4 less margins of 10 mm, at 96 pixels per inch."""
SECONDS = 60.0
"""Time limit against a hang, much longer than any page takes."""


@dataclass
class PageActivity:
    """Activity of a page since it was opened: errors on its console, requested addresses."""

    errors: list[str] = field(default_factory=list)
    requests: list[str] = field(default_factory=list)

    def take(self, message: dict[str, Any]) -> None:
        """Record an event."""
        parameters = message.get("params", {})
        match message.get("method"):
            case "Network.requestWillBeSent":
                self.requests.append(parameters["request"]["url"])
            case "Network.webSocketCreated":
                self.requests.append(parameters["url"])
            case "Runtime.exceptionThrown":
                self.errors.append(json.dumps(parameters["exceptionDetails"])[:500])
            case "Runtime.consoleAPICalled" if parameters["type"] == "error":
                self.errors.append(json.dumps(parameters["args"])[:500])
            case "Log.entryAdded" if parameters["entry"]["level"] == "error":
                self.errors.append(parameters["entry"]["text"])


class Browser:
    """One tab; the methods return when the browser has answered."""

    def __init__(self, commands: int, events: int) -> None:
        self._commands, self._events = commands, events
        self._bytes = b""
        self._number = 0
        self._session: str | None = None
        self.activity = PageActivity()
        page = self._call("Target.createTarget", url="about:blank")["targetId"]
        attached = self._call("Target.attachToTarget", targetId=page, flatten=True)
        self._session = attached["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self._call(f"{domain}.enable")

    def open(self, address: str, width: int = 1280, height: int = 900) -> None:
        """Open an address in a window of this size, on a screen; wait until it has loaded."""
        self.resize(width, height)
        self._call("Emulation.setEmulatedMedia", media="")
        self.activity = PageActivity()
        self._call("Page.navigate", url=address)
        self._until(lambda message: message.get("method") == "Page.loadEventFired")
        self.evaluate("document.readyState")

    def resize(self, width: int, height: int = 900) -> None:
        """Give the window another size."""
        size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
        self._call("Emulation.setDeviceMetricsOverride", **size)

    def print(self) -> None:
        """Lay the page out as it is printed."""
        self._call("Emulation.setEmulatedMedia", media="print")

    def evaluate(self, expression: str) -> Any:
        """Return the value of an expression in the page; wait for a promise."""
        arguments = {"expression": expression, "returnByValue": True, "awaitPromise": True}
        answer = self._call("Runtime.evaluate", **arguments)
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    def until(self, expression: str) -> None:
        """Wait until an expression in the page holds."""
        end = monotonic() + SECONDS
        while not self.evaluate(f"new Promise(r => setTimeout(() => r({expression}), 50))"):
            assert monotonic() < end, f"never true: {expression}"

    def drag(self, start: tuple[float, float], end: tuple[float, float], steps: int = 5) -> None:
        """Press the mouse at a point of the window, move it to a second point, release it."""
        places = [
            tuple(a + (b - a) * step / steps for a, b in zip(start, end, strict=True))
            for step in range(steps + 1)
        ]
        self._mouse("mousePressed", places[0])
        for place in places:
            self._mouse("mouseMoved", place)
        self._mouse("mouseReleased", places[-1])

    def press(self, key: str) -> None:
        """Press a key, by its name in the DOM, such as ArrowRight."""
        codes = {"ArrowLeft": 37, "ArrowUp": 38, "ArrowRight": 39, "ArrowDown": 40}
        event = {"key": key, "code": key, "windowsVirtualKeyCode": codes.get(key, 0)}
        for kind in ("keyDown", "keyUp"):
            self._call("Input.dispatchKeyEvent", type=kind, **event)

    def picture(self) -> bytes:
        """Return the content of the window as PNG."""
        return base64.b64decode(self._call("Page.captureScreenshot", format="png")["data"])

    def overflow(self) -> list[str]:
        """Return the elements wider than the window, if the page can be scrolled sideways."""
        elements = self.evaluate(WIDER)
        assert isinstance(elements, list)
        return elements

    def _mouse(self, kind: str, place: tuple[float, ...]) -> None:
        held = {"button": "left", "buttons": 1, "clickCount": 1}
        self._call("Input.dispatchMouseEvent", type=kind, x=place[0], y=place[1], **held)

    def _call(self, method: str, **parameters: Any) -> dict[str, Any]:
        self._number += 1
        number = self._number
        message = {"id": number, "method": method, "params": parameters}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._commands, json.dumps(message).encode() + b"\0")
        answer = self._until(lambda message: message.get("id") == number)
        assert "error" not in answer, answer
        result = answer["result"]
        assert isinstance(result, dict)
        return result

    def _until(self, wanted: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
        end = monotonic() + SECONDS
        while True:
            message = self._next(end)
            self.activity.take(message)
            if wanted(message):
                return message

    def _next(self, end: float) -> dict[str, Any]:
        while b"\0" not in self._bytes:
            ready, _, _ = select([self._events], [], [], max(0.0, end - monotonic()))
            assert ready, "the browser does not answer"
            read = os.read(self._events, 1 << 16)
            assert read, "the browser has ended"
            self._bytes += read
        text, self._bytes = self._bytes.split(b"\0", 1)
        message = json.loads(text)
        assert isinstance(message, dict)
        return message


WIDER = """
(() => {
  const page = document.documentElement, width = page.clientWidth;
  if (page.scrollWidth <= width) return [];
  const wide = [...document.body.querySelectorAll('*')]
    .filter(one => one.getBoundingClientRect().right > width + 0.5)
    .map(one => one.tagName + '.' + one.className + ' ' + one.textContent.slice(0, 60));
  return ['page: ' + page.scrollWidth, ...wide.slice(-5)];
})()
"""


PLUMB = """
import fcntl, os, sys
read, write = (fcntl.fcntl(int(end), fcntl.F_DUPFD, 10) for end in sys.argv[1:3])
os.dup2(read, 3)
os.dup2(write, 4)
os.execv(sys.argv[3], sys.argv[3:])
"""
"""Becomes the browser, which reads on 3 and writes on 4."""


@contextmanager
def browser(profile: Path) -> Iterator[Browser]:
    """Start a browser; skip the test where there is none, or none that starts here.

    Parameters
    ----------
    profile : folder for the browser's profile
    """
    if CHROMIUM is None:
        pytest.skip("no chromium on this machine")
    line = [
        CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage",
        "--disable-background-networking", "--disable-component-update", "--no-first-run",
        "--enable-unsafe-swiftshader", "--remote-debugging-pipe", f"--user-data-dir={profile}",
    ]  # fmt: skip
    from_us, commands = os.pipe()
    events, to_us = os.pipe()
    through = [sys.executable, "-c", PLUMB, str(from_us), str(to_us), *line]
    process = subprocess.Popen(
        through,
        pass_fds=(from_us, to_us),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    os.close(from_us)
    os.close(to_us)
    try:
        try:
            tab = Browser(commands, events)
        except (AssertionError, OSError) as error:
            pytest.skip(f"chromium does not start here: {error}")
        yield tab
    finally:
        process.kill()
        process.wait()
        os.close(commands)
        os.close(events)


def assert_readable(page: Path, profile: Path) -> None:
    """Check a page as `assert_page_readable` in a browser of its own."""
    with browser(profile) as tab:
        assert_page_readable(tab, page)


def assert_page_readable(tab: Browser, page: Path) -> None:
    """Check a page at desktop and phone width, with all folded sections open.

    No error, no network request, no element wider than the window.
    """
    tab.open(page.as_uri())
    tab.evaluate("document.querySelectorAll('details').forEach(one => one.open = true)")
    for width in WIDTHS:
        tab.resize(width)
        assert tab.overflow() == [], width
    assert tab.activity.errors == []
    assert {urlsplit(address).scheme for address in tab.activity.requests} <= {"file", "data"}


def printed_px(tab: Browser, page: Path, selector: str) -> float:
    """Return where an element ends, in pixels, on the paper of a page that is printed."""
    tab.open(page.as_uri(), PAPER_PX[0])
    tab.print()
    bottom = tab.evaluate(f"document.querySelector('{selector}').getBoundingClientRect().bottom")
    return float(bottom)
