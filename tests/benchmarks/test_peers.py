"""The comparison with other programs: its inputs, its judgement, and rows without a result."""

import os
import sys
from pathlib import Path

import numpy as np
import pytest

from benchmarks import peers
from benchmarks.contest import environments, work
from benchmarks.contest.contestants import CONTESTANTS, Contestant
from benchmarks.contest.environments import STAMP, Environment, PeerError
from benchmarks.regression.tables import BEGIN, END
from twin.optics.backend import CHOICE_VARIABLE, LIBRARY_VARIABLE, Backend

NOWHERE = Environment("nowhere", ("fringe-twin-test-of-a-missing-package==0.0",))


@pytest.fixture
def truth_px() -> np.ndarray:
    rng = np.random.default_rng(4)
    return np.stack([rng.uniform(0, 1279, (4, 50)), rng.uniform(0, 719, (4, 50))], axis=-1)


def test_gray_code_frames_have_the_bits_of_the_coordinates(truth_px: np.ndarray) -> None:
    *bits, white, black = work.gray_frames(truth_px) > work.MEAN_DN
    assert len(bits) == 2 * (11 + 10)
    assert white.all()
    assert not black.any()
    plain, inverse = np.array(bits[::2]), np.array(bits[1::2])
    assert (plain != inverse).all()
    for axis, part in enumerate((plain[:11], plain[11:])):
        binary = np.logical_xor.accumulate(part, axis=0)
        word = np.tensordot(2 ** np.arange(len(part))[::-1], binary, axes=1)
        np.testing.assert_array_equal(word, np.rint(truth_px[..., axis]))


def test_phase_frames_have_the_phases_of_three_periods(truth_px: np.ndarray) -> None:
    frames = work.phase_frames(truth_px).reshape(2, 3, work.STEPS, 4, 50)
    phase = -np.angle(np.fft.fft(frames, axis=2)[:, :, 1]) - np.pi
    for axis in range(2):
        for number, count in enumerate(work.FRINGES):
            expected = 2 * np.pi * count * truth_px[..., axis] / 1280
            off = np.angle(np.exp(1j * (phase[axis, number] - expected)))
            np.testing.assert_allclose(off, 0.0, atol=1e-9)


def test_gross_errors_are_counted_and_not_part_of_the_rms(truth_px: np.ndarray) -> None:
    decoded_px = truth_px + 0.3
    decoded_px[0, :10] += 5.0
    decoded_px[1, :50] = np.nan
    error, remark = work.decode_error({"truth_px": truth_px}, {"px": decoded_px})
    assert error == pytest.approx(0.3)
    assert remark == "75.0% of the pixels decoded, 5.00% gross errors"


def test_a_mirror_image_and_another_colour_order_are_no_error() -> None:
    real = work.read_presses()
    inputs = {"presses": np.array([3, 20])}
    images = np.zeros((1, 3, 480, 640, 3))
    changes = [real.change[real.of_press == number] for number in inputs["presses"]]
    x_px = np.linspace(-1.0, 1.0, 320).repeat(2)[:, np.newaxis]
    for image, change in zip(images[0, 1:], changes, strict=True):
        image += change.mean(axis=0) + np.array([4.0, 0.0, -4.0]) * x_px
    error = work.tactile_error(inputs, {"images": images})[0]
    assert 0.0 < error < np.sqrt(np.mean(np.concatenate(changes) ** 2))
    turned = np.zeros((4, *images.shape[1:]))
    turned[2] = work.mirrored(images[0], 2)[..., ::-1]
    assert work.tactile_error(inputs, {"images": turned})[0] == pytest.approx(error)


def task_of(name: str) -> work.PeerTask:
    (task,) = (task for task in work.WORKS if task.name == name)
    return task


def test_the_time_is_divided_by_the_number_of_images_that_the_action_computes() -> None:
    """Expected: seven presses are seven results; the image without contact is none."""
    for mirrors in (1, 4):
        result = {"images": np.zeros((mirrors, 1 + 7, 2, 2, 3))}
        assert task_of("tactile").results_in(result) == 7 * mirrors
    assert task_of("decode").results_in({"px": np.zeros((2, 2, 2))}) == 1


def test_a_child_process_gives_a_row_and_a_missing_library_gives_its_reason(tmp_path: Path) -> None:
    decode, press = (task_of(name) for name in ("decode", "press"))
    inputs = press.inputs(tmp_path, True) | {"cells": np.array(64)}
    np.savez(tmp_path / "inputs.npz", **inputs)
    row = peers.row_of(press, CONTESTANTS[0], inputs, tmp_path, 1)
    assert row.seconds is not None
    assert 0.0 < row.seconds < 60.0
    assert row.figures()["press_twin_error"] < 2.0  # 0.03 with 256 cells
    absent = Contestant("absent", "absent", Environment("twin"), {"decode": "no sigma"})
    row = peers.row_of(decode, absent, inputs, tmp_path, 1)
    assert "No module named" in row.cells()[-1]
    assert row.figures() == dict.fromkeys(
        ("decode_absent_s", "decode_absent_mib", "decode_absent_error")
    )


def test_pip_states_the_reason_in_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    monkeypatch.delenv("PIP_FIND_LINKS", raising=False)
    monkeypatch.setattr(environments.venv, "create", lambda *_, **__: None)
    monkeypatch.setattr(environments, "_interpreter", lambda _: Path(sys.executable))
    with pytest.raises(PeerError, match=r"^pip cannot install fringe-twin-test.*==0\.0[^\n]*$"):
        NOWHERE.python(tmp_path)


def test_a_folder_that_is_no_environment_is_not_emptied(tmp_path: Path) -> None:
    mine = tmp_path / "nowhere" / "mine.txt"
    mine.parent.mkdir()
    mine.write_text("own data", encoding="utf-8")
    with pytest.raises(PeerError, match="is not empty and no virtual environment"):
        NOWHERE.python(tmp_path)
    assert mine.read_text(encoding="utf-8") == "own data"


def test_an_environment_that_cannot_be_made_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "nowhere").write_text("a file", encoding="utf-8")
    with pytest.raises(PeerError, match=r"^no virtual environment in [^\n]*nowhere[^\n]*$"):
        NOWHERE.python(tmp_path)


def test_an_environment_is_made_once_per_set_of_packages(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = []

    def make(self: Environment, folder: Path) -> None:
        folder.mkdir(exist_ok=True)
        made.append(self.packages)

    monkeypatch.setattr(Environment, "_make", make)
    for packages in (("one==1",), ("one==1",), ("one==2",)):
        Environment("peer", packages).python(tmp_path)
    assert made == [("one==1",), ("one==2",)]
    assert (tmp_path / "peer" / STAMP).read_text(encoding="utf-8").endswith("one==2")


@pytest.mark.parametrize("part", [["--only", "fringes"], ["--work", "press"], ["--quick"]])
def test_a_part_of_the_comparison_does_not_replace_the_table(
    part: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        peers.parsed(["--update", *part])
    assert "--update writes the whole table" in capsys.readouterr().err
    assert peers.parsed(["--update"]).update
    assert not peers.parsed(part).update


def test_all_programs_render_with_the_same_library(monkeypatch: pytest.MonkeyPatch) -> None:
    """Expected: LLVM is selected before the search, so that a GPU is not used."""
    monkeypatch.setenv(CHOICE_VARIABLE, "cuda")
    monkeypatch.setenv(LIBRARY_VARIABLE, "")
    searched = []

    def search() -> Backend:
        searched.append(os.environ[CHOICE_VARIABLE])
        return Backend("llvm_ad_mono", "libLLVM.so.19", "19")

    monkeypatch.setattr(peers, "find_backend", search)
    peers.use_llvm()
    assert searched == [os.environ[CHOICE_VARIABLE]] == ["llvm"]
    assert os.environ[LIBRARY_VARIABLE] == "libLLVM.so.19"


def test_the_page_has_a_row_for_every_program_and_work() -> None:
    page = peers.PAGE.read_text(encoding="utf-8")
    table = page[page.index(BEGIN) : page.index(END)]
    for contestant in CONTESTANTS:
        assert contestant.environment is peers.HERE or "==" in contestant.environment.packages[0]
        for name in contestant.scope:
            assert f"|{name}|{contestant.label}" in table
