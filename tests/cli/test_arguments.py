"""Options with several values, as the documentation writes them."""

import pytest

from twin import cli
from twin.cli.app import app

ALL = ("k1", "k2", "p1", "p2", "k3")


@pytest.mark.parametrize("names", [(), ALL[:1], ALL[:2], ALL[:4], ALL])
@pytest.mark.parametrize("device", ["camera", "projector"])
def test_distortion_coefficients_follow_one_option(device: str, names: tuple[str, ...]) -> None:
    option = f"--{device}-distortion"
    given = [option, *names] if names else [f"--empty-{device}-distortion"]
    command, bound, _ = app.parse_args(["calibrate", "captures", *given, "-o", "out"])
    assert command is cli.captures.calibrate
    assert bound.arguments[f"{device}_distortion"] == names
    repeated = [word for name in names for word in (option, name)]
    if names:
        _, again, _ = app.parse_args(["calibrate", *repeated, "-o", "out", "captures"])
        assert again.arguments == bound.arguments
