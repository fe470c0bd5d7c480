"""Film of a moving scene: the recorded frames, and a section of the relief at their times.

The film is an animated PNG, slower than the sequence. The section of a bare specimen is its true
surface at time 0, moved rigidly. The section of a pressed coat is quadratic in time between the
presses at the start of the sequence, at time 0 and at its end.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure as Canvas

from reconstruction.arrays import FloatArray, FloatImage, IntArray
from reconstruction.capture.folder import Capture
from twin.config.motion import Motion
from twin.mechanics import PressedElastomer
from twin.optics.frame_times import frame_times_s, sequence_ends_s
from twin.optics.stack import Truth
from twin.report.camera_images import block_mean
from twin.report.canvas import (
    FAINT,
    MEASURED,
    axes_at,
    draw_film,
    no_ticks,
    plain_spines,
    symmetric_limit,
)
from twin.report.page import Figure, Section
from twin.report.section import face_profile, trace_through_apexes
from twin.results.record import Measurement

MOST_FRAMES = 30
"""Frames of a film; of a longer sequence every n-th is shown, so that a film has less than 2 MB."""
_SHOWN_PX, _FRAME_MS = 200, 250
_IMAGE_IN, _PLOT_IN, _TOP_IN = 3.0, 2.8, 0.35
# The steep sides of a specimen that slides change by much more than its top.
_SHOWN_PERCENT = 95.0
_SECTION_POINTS = 401

SectionAt = Callable[[float], tuple[FloatArray, FloatArray]]
"""Function of a time, s: positions along the section and world z, both (point,), mm."""


@dataclass(frozen=True, eq=False)
class MotionFilm:
    """Content of a film.

    Attributes
    ----------
    images : (frame, row, col) digital numbers, averaged over blocks of pixels
    times_s : (frame,) middle of each exposure after time 0
    labels : kind of each frame
    section_at : section of the relief by time
    """

    images: FloatImage
    times_s: FloatArray
    labels: tuple[str, ...]
    section_at: SectionAt


def film_sections(measured: Measurement) -> list[Section]:
    """Return the section with the film of a measurement.

    It is empty for a scene at rest, and without the presses at the ends of a moving press: the
    figures of `measure_whole` include them.
    """
    is_open = measured.pressed is not None and not measured.pressed_at_ends
    if is_open or not measured.experiment.motion.moves:
        return []
    film = film_of(measured)
    how = "rigidly moved" if measured.pressed is None else "interpolated between three presses"
    caption = (
        f"Left: {len(film.times_s)} of {len(measured.fringes.capture.stack)} recorded frames, "
        "from 0 (black) to the largest value (white). Right: section of the true relief at the "
        f"time of the frame (blue, {how}) and at time 0, to which the truth belongs (gray); below, "
        "the change since time 0. "
        f"Shown {_slowed(film.times_s):.0f} times slower than recorded."
    )
    figure = Figure(
        "motion", "", caption, "film of the frames and of a section", partial(_draw, film)
    )
    return [Section("film", "Motion during the sequence", (figure,))]


def film_of(measured: Measurement) -> MotionFilm:
    """Return the film of a measured moving scene."""
    capture: Capture = measured.fringes.capture
    times = frame_times_s(measured.experiment)
    shown = shown_frames(len(times.start_s))
    block = -(-max(capture.stack[0].shape) // _SHOWN_PX)
    return MotionFilm(
        images=np.array([block_mean(capture.stack[frame], block) for frame in shown]),
        times_s=(times.start_s + times.duration_s / 2.0)[shown],
        labels=tuple(capture.patterns.frames[frame].kind for frame in shown),
        section_at=_section_of(measured),
    )


def shown_frames(count: int) -> IntArray:
    """Return the numbers of the frames that a film of a sequence of `count` frames shows."""
    return np.arange(0, count, -(-count // MOST_FRAMES))


def _slowed(times_s: FloatArray) -> float:
    return 1e-3 * _FRAME_MS * (len(times_s) - 1) / float(times_s[-1] - times_s[0])


def _section_of(measured: Measurement) -> SectionAt:
    if measured.pressed is None:
        motion = Motion(**measured.experiment.motion.model_dump())
        points = _middle_row(measured.truth, measured.experiment.specimen.y_mm)
        return partial(_moved, points, motion)
    return _pressed_section(measured, measured.pressed)


def _middle_row(truth: Truth, y_mm: float) -> FloatArray:
    """Return the true points (point, xyz), mm, of the image row nearest to a world y."""
    points, hit = truth.points_world_mm.astype(np.float64), truth.depth_mm > 0.0
    counts = np.maximum(hit.sum(axis=1), 1)
    y_of_rows = np.where(hit, points[..., 1], 0.0).sum(axis=1) / counts
    distance = np.where(hit.any(axis=1), np.abs(y_of_rows - y_mm), np.inf)
    row = int(np.argmin(distance))
    return np.asarray(points[row][hit[row]])


def _moved(points_mm: FloatArray, motion: Motion, time_s: float) -> tuple[FloatArray, FloatArray]:
    pose = motion.pose_at(time_s)
    moved = points_mm @ pose[:3, :3].T + pose[:3, 3]
    return moved[:, 0], moved[:, 2]


def _pressed_section(measured: Measurement, middle: PressedElastomer) -> SectionAt:
    experiment, trace = measured.experiment, trace_through_apexes(measured.experiment)
    reach_mm = min(float(np.ptp(middle.face_x_mm)), float(np.ptp(middle.face_y_mm))) / 2.0
    s_mm = np.linspace(-reach_mm, reach_mm, _SECTION_POINTS)
    ends_s = sequence_ends_s(experiment)
    first, last = measured.pressed_at_ends
    profiles_mm = [face_profile(pressed, trace, s_mm) for pressed in (first, middle, last)]
    nodes_s = np.array([ends_s[0], 0.0, ends_s[1]])
    return partial(_interpolated, s_mm, np.array(profiles_mm), nodes_s)


def _interpolated(
    s_mm: FloatArray, profiles_mm: FloatArray, nodes_s: FloatArray, time_s: float
) -> tuple[FloatArray, FloatArray]:
    """Return the parabola in time through the profiles (node, point) at three times."""
    weights = [
        np.prod([(time_s - other) / (node - other) for other in nodes_s if other != node])
        for node in nodes_s
    ]
    return s_mm, np.asarray(np.array(weights) @ profiles_mm)


def _draw(film: MotionFilm, path: Path) -> None:
    rows, cols = film.images.shape[1:]
    size_in = _IMAGE_IN + _PLOT_IN + 1.1, _TOP_IN + _IMAGE_IN * rows / cols + 0.5
    reliefs = Reliefs.of(film)

    def draw(canvas: Canvas, frame: int) -> None:
        image = axes_at(canvas, 0.1, _TOP_IN, _IMAGE_IN, _IMAGE_IN * rows / cols)
        image.imshow(film.images[frame], cmap="gray", vmin=0, vmax=float(film.images.max()))
        no_ticks(image)
        image.set_title(f"{film.labels[frame]}, {1e3 * film.times_s[frame]:+.1f} ms", fontsize=8.5)
        reliefs.draw(canvas, frame, _IMAGE_IN + 0.85, _IMAGE_IN * rows / cols)

    draw_film(path, size_in, draw, len(film.times_s), _FRAME_MS)


@dataclass(frozen=True, eq=False)
class Reliefs:
    """Sections of all frames, and their changes since time 0 at equal positions.

    Attributes
    ----------
    s_mm, z_mm : (point,) section at time 0, in the order of s
    change_um : (frame, point) change of z since time 0 at the positions `s_mm`
    """

    s_mm: FloatArray
    z_mm: FloatArray
    change_um: FloatArray

    @classmethod
    def of(cls, film: MotionFilm) -> "Reliefs":
        """Return the sections of a film."""
        s_mm, z_mm = _in_order(film.section_at(0.0))
        later = [_in_order(film.section_at(float(time_s))) for time_s in film.times_s]
        moved_mm = [np.interp(s_mm, *section) - z_mm for section in later]
        return cls(s_mm, z_mm, 1e3 * np.array(moved_mm))

    def draw(self, canvas: Canvas, frame: int, left_in: float, height_in: float) -> None:
        """Draw the section of one frame, and below it the change since time 0."""
        each_in = (height_in - 0.25) / 2.0
        section = axes_at(canvas, left_in, _TOP_IN, _PLOT_IN, each_in)
        section.plot(self.s_mm, self.z_mm, color=FAINT, linewidth=1.0)
        all_mm = self.z_mm + 1e-3 * self.change_um
        section.plot(self.s_mm, all_mm[frame], color=MEASURED, linewidth=1.4)
        margin_mm = 0.05 * float(np.ptp(all_mm)) or 0.05
        section.set_ylim(float(all_mm.min()) - margin_mm, float(all_mm.max()) + margin_mm)
        section.set(ylabel="z (mm)")
        section.set_xticklabels([])
        change = axes_at(canvas, left_in, _TOP_IN + each_in + 0.25, _PLOT_IN, each_in)
        change.plot(self.s_mm, self.change_um[frame], color=MEASURED, linewidth=1.4)
        limit_um = 1.05 * symmetric_limit(self.change_um, _SHOWN_PERCENT) or 1.0
        change.set(xlabel="along the section (mm)", ylabel="change (µm)")
        change.set_ylim(-limit_um, limit_um)
        for axes in (section, change):
            plain_spines(axes)


def _in_order(section: tuple[FloatArray, FloatArray]) -> tuple[FloatArray, FloatArray]:
    """Return a section in the order of its positions."""
    s_mm, z_mm = section
    order = np.argsort(s_mm, kind="stable")
    return s_mm[order], z_mm[order]
