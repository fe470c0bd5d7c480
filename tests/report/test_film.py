"""The film of a moving scene: frames of the file, and sections against their closed forms."""

from pathlib import Path

import imageio.v3 as imageio
import numpy as np
import pytest

import twin
from twin.config import load_experiment
from twin.config.motion import Motion
from twin.pipeline.methods import measure_into
from twin.report import film
from twin.report.film import MotionFilm, Reliefs, film_of, film_sections, shown_frames
from twin.report.measurement import page_of
from twin.results.folder import read_measurement

DISC = Path(__file__).parents[1] / "optics" / "disc_on_stage.toml"
SMALL = {
    "camera.binning": 4,
    "camera.width_px": 320,
    "camera.height_px": 240,
    "camera.exposure_ms": 2.8,
    "camera.frame_rate_hz": 130.0,
    "patterns.steps": 3,
    "patterns.axes": ["column"],
}


def film_with(section_at, times_s):
    images = np.random.default_rng(1).uniform(0, 4000, (len(times_s), 12, 16)).astype(np.float32)
    return MotionFilm(images, np.array(times_s), ("phase",) * len(times_s), section_at)


def test_the_file_has_all_frames(tmp_path):
    """Three frames of a plane that rises by 1 mm/s, an animated PNG of less than 100 kB."""
    s_mm = np.linspace(-1.0, 1.0, 5)
    moving = film_with(lambda time_s: (s_mm, np.full(5, time_s)), [-0.1, 0.0, 0.1])
    film._draw(moving, tmp_path / "motion.png")
    frames = imageio.imread(tmp_path / "motion.png", plugin="pillow", index=None)
    assert frames.shape[0] == 3
    assert not np.array_equal(frames[0], frames[2])
    assert (tmp_path / "motion.png").stat().st_size < 1e5
    reliefs = Reliefs.of(moving)
    np.testing.assert_allclose(reliefs.change_um, [[-100.0] * 5, [0.0] * 5, [100.0] * 5])


def test_the_section_of_a_bare_specimen_moves_rigidly():
    """A slope of 1/2 that slides by v t changes by -v t / 2; twisted about z it keeps its z."""
    x = np.linspace(-4.0, 4.0, 33)
    points = np.column_stack([x, np.zeros_like(x), 0.5 * x])
    moved = film_with(lambda at: film._moved(points, Motion(x_mm_s=2.0), at), [-0.1, 0.1])
    change = Reliefs.of(moved).change_um[:, 2:-2]
    np.testing.assert_allclose(change, np.full_like(change, 100.0) * [[1.0], [-1.0]])
    _, z_mm = film._moved(points, Motion(twist_deg_s=90.0), 1.0)
    np.testing.assert_allclose(z_mm, 0.5 * x)


def test_a_section_between_presses_is_a_parabola_in_time():
    """z = s + 2 t - 3 t^2 at three times that are not equally spaced, and between them."""
    s_mm, nodes_s = np.linspace(0.0, 1.0, 4), np.array([-0.1, 0.0, 0.3])

    def profile(time_s):
        return s_mm + 2.0 * time_s - 3.0 * time_s**2

    profiles = np.array([profile(time_s) for time_s in nodes_s])
    for time_s in (-0.1, -0.05, 0.0, 0.2, 0.3):
        _, z_mm = film._interpolated(s_mm, profiles, nodes_s, time_s)
        np.testing.assert_allclose(z_mm, profile(time_s), atol=1e-12)


def test_the_page_of_a_moving_specimen_has_a_film(mi, tmp_path):
    """A disc rises by 5 mm/s: its section changes by 5 um per ms in every frame."""
    measured = twin.measure(load_experiment(DISC, SMALL | {"motion.z_mm_s": 5.0}))
    assert [section.name for section in page_of(measured).sections].count("film") == 1
    (section,) = film_sections(measured)
    (figure,) = section.blocks
    figure.draw(tmp_path / "motion.png")
    assert 1e4 < (tmp_path / "motion.png").stat().st_size < 2e6
    moving = film_of(measured)
    assert len(moving.times_s) == len(measured.fringes.capture.stack)
    change_um = Reliefs.of(moving).change_um
    np.testing.assert_allclose(change_um, 5e3 * moving.times_s[:, None] + 0 * change_um, atol=1e-6)


def test_the_film_of_a_press_is_drawn_from_its_folder(mi, tmp_path):
    """The apex of a coat that a ball lifts by 0.1 mm/s rises at each time; nothing is pressed."""
    settings = {
        "camera.binning": 4,
        "camera.width_px": 640,
        "camera.height_px": 480,
        "camera.exposure_ms": 11.12,
        "patterns.steps": 3,
        "patterns.axes": ["column"],
        "press.solver_pitch_mm": 0.4,
        "motion.z_mm_s": 0.1,
    }
    measure_into(tmp_path, "measure", load_experiment("examples/slab_ball", settings))
    stored = read_measurement(tmp_path)
    assert len(stored.pressed_at_ends) == 2
    (section,) = film_sections(stored)
    assert "three presses" in section.blocks[0].caption
    rises_um = Reliefs.of(film_of(stored)).change_um.max(axis=1)
    assert (np.diff(np.where(film_of(stored).times_s > 0, rises_um, -1.0)) >= 0).all()
    (tmp_path / "press_end.nc").unlink()
    assert not film_sections(read_measurement(tmp_path))


def test_a_scene_at_rest_has_no_film(mi):
    measured = twin.measure(load_experiment(DISC, SMALL))
    assert not film_sections(measured)


@pytest.mark.parametrize(("count", "shown"), [(30, 30), (31, 16), (100, 25)])
def test_a_long_sequence_is_thinned(count, shown):
    frames = shown_frames(count)
    assert len(frames) == shown
    assert frames[0] == 0
    assert set(np.diff(frames)) == {-(-count // 30)}
