"""`twin view` in a browser: moving the thickness slider changes the camera's picture."""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.browser import Browser, browser

pytest.importorskip("viser", reason="the extra `view` is not installed")

ROOT = Path(__file__).parents[2]
COMMAND = "from twin.cli import main; main()"
PICTURES = "[...document.querySelectorAll('img')].map(one => one.src).filter(one => one)"
LABEL = "thickness (mm)"


@pytest.fixture(scope="module")
def address(mi) -> Iterator[str]:
    line = [sys.executable, "-c", COMMAND, "view", "examples/slab_balls", "--port", "18080"]
    child = subprocess.Popen(line, cwd=ROOT, stdout=subprocess.PIPE, text=True)
    try:
        assert child.stdout
        line = child.stdout.readline()
        assert line.startswith("open http://127.0.0.1:"), line
        yield line.split()[1]
    finally:
        child.send_signal(signal.SIGINT)
        child.communicate(timeout=60)
        assert child.returncode == 128 + signal.SIGINT


@pytest.fixture(scope="module")
def tab(tmp_path_factory) -> Iterator[Browser]:
    with browser(tmp_path_factory.mktemp("profile")) as started:
        yield started


@pytest.mark.skipif(
    "TWIN_BROWSER_3D" not in os.environ, reason="WebGL by software takes minutes on two cores"
)
def test_the_thickness_slider_changes_the_picture(address, tab):
    """Arrow keys on the slider, as a person without a mouse would."""
    tab.open(address)
    tab.until("document.body.innerText.includes('force ')")
    before = tab.evaluate(f"JSON.stringify({PICTURES})")
    assert len(json.loads(before)) >= 2
    focused = tab.evaluate(
        f"""(() => {{
          const label = [...document.querySelectorAll('label')].find(
            one => one.textContent.includes({json.dumps(LABEL)}));
          let around = label;
          while (around && !around.querySelector('[role=slider]')) around = around.parentElement;
          const slider = around && around.querySelector('[role=slider]');
          if (slider) slider.focus();
          return !!slider;
        }})()"""
    )
    assert focused
    for _ in range(20):
        tab.press("ArrowRight")
    tab.until(f"JSON.stringify({PICTURES}) !== {json.dumps(before)}")
    assert "not possible" not in tab.evaluate("document.body.innerText")
    assert tab.activity.errors == []
    hosts = [one for one in tab.activity.requests if "127.0.0.1" not in one]
    assert [one for one in hosts if not one.startswith(("data:", "blob:"))] == []
