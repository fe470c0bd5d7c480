"""Options with several values, as the documentation writes them."""

from pathlib import Path

import pytest

from twin import cli
from twin.cli.calibration import with_repeated_options
from twin.cli.commands import app

ALL = ("k1", "k2", "p1", "p2", "k3")


@pytest.mark.parametrize("names", [ALL[:1], ALL[:2], ALL[:4], ALL])
@pytest.mark.parametrize("device", ["camera", "projector"])
def test_distortion_coefficients_follow_one_option(device: str, names: tuple[str, ...]) -> None:
    """Before and after the source, one by one, and with an equals sign or commas."""
    option = f"--{device}-distortion"
    one_by_one = [word for name in names for word in (option, name)]
    for words in (
        ["captures", option, *names, "-o", "out"],
        [option, *names, "captures", "-o", "out"],
        ["-o", "out", *one_by_one, "captures"],
        [f"{option}={names[0]}", *names[1:], "captures", "-o", "out"],
        ["captures", option, ",".join(names), "-o", "out"],
        [f"{option}={','.join(names)}", "captures", "-o", "out"],
    ):
        command, bound, _ = app.parse_args(with_repeated_options(["calibrate", *words]))
        assert command is cli.calibration.calibrate
        assert bound.arguments[f"{device}_distortion"] == names
        assert str(bound.arguments["source"]) == "captures"


def test_other_words_stay_as_they_are() -> None:
    words = ["measure", "k1", "-o", "k2", "--set", "name=k1", "k2", "--", "--camera-distortion"]
    words += ["--camera-distortion=k9", "k1", "--camera-distortion", "k9"]
    assert with_repeated_options(words) == words


def test_the_program_takes_them(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    words = ["calibrate", "--camera-distortion", "k1", "k2", "nowhere", "-o", "out"]
    assert cli.run(words) == 2
    assert "nowhere: no such folder of captures" in capsys.readouterr().err
