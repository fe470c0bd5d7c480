"""Data of real presses of balls, and the twins of these presses.

`real_presses.csv` has 67 presses of 6.31 and 9.5 mm balls on one unit of a GelSight Mini: place and
depth, and the levels on 17 spots of each contact, before the press and during it. It was measured
in the images published with GelSLAM (rpl-cmu/gelslam, example_calibration), which have no clear
licence and are not in this repository: `python -m benchmarks.real_presses FOLDER` repeats it.

A twin of a press has the same ball at the same place, at the depth that follows from the radius of
the contact after Hertz, and its own noise and drift of the lamps.
"""

import argparse
import csv
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.photometric_balls import PITCH_MM, presses_of
from reconstruction.arrays import FloatArray
from reconstruction.photometric import BallPress
from reconstruction.photometric.calibration_ball import ContactCircle, find_contact_circle
from reconstruction.photometric.images import mean_background, smoothed
from reconstruction.photometric.press_files import read_rgb
from twin.config import Experiment
from twin.config.lamps import CHANNELS
from twin.optics.backed_coat import seen_face
from twin.pipeline import press_specimen
from twin.pipeline.colours import ColourSensor
from twin.pipeline.reference_presses import with_ball
from twin.specimens.kinds.ball import Ball

FILE = Path(__file__).with_name("real_presses.csv")
WIDTH_PX, HEIGHT_PX = 320, 240
# Spots: the contact's middle, and eight directions at two radii, in radii of the contact.
RADII, DIRECTIONS = (0.5, 0.88), 8
REACH = 0.1
# A spot counts if it has so many pixels in the image.
LEAST_PX = 8
# Balls at the border of the field need a wider gel.
WIDE_PAD = {
    f"elastomer.length_{axis}_mm": {"value": mm, "range": [20.0, 40.0], "source": "benchmark"}
    for axis, mm in (("x", 32.0), ("y", 28.0))
}
FIRST_TWIN = 7000
# Apparent distance of the camera's pupil inside the gel: 25.2 mm in air, focal length in pixels
# times pitch, times the gel's index of 1.41.
VIEW_MM = 35.5
_STEPS = 4


@dataclass(frozen=True)
class RealPress:
    """One press.

    Attributes
    ----------
    x_mm, y_mm : apparent place of the contact's middle on the undeformed coat, world
    contact_mm : radius of the contact
    """

    ball_mm: float
    x_mm: float
    y_mm: float
    contact_mm: float

    @property
    def depth_mm(self) -> float:
        """Depth after Hertz: square of the contact's radius over the ball's.

        A bonded gel needs 20 % less depth for this contact, but the largest change of colour, which
        was measured, is 2 to 3 px inside the contact: twins at this depth show the same circles.
        """
        return 2.0 * self.contact_mm**2 / self.ball_mm

    @property
    def place_mm(self) -> tuple[float, float]:
        """World x and y of the ball; the edge of its contact is half the depth above the coat."""
        nearer = 1.0 - self.depth_mm / 2.0 / VIEW_MM
        return self.x_mm * nearer, self.y_mm * nearer


@dataclass(frozen=True, eq=False)
class RealPresses:
    """All presses and their spots.

    Attributes
    ----------
    of_press : (spot,) int, index of the press of a spot
    across : (spot, xy) float, place in the contact, world axes, in radii of the contact
    before, during : (spot, channel) float, 8-bit levels, red first
    """

    presses: tuple[RealPress, ...]
    of_press: NDArray[np.intp]
    across: FloatArray
    before: FloatArray
    during: FloatArray

    @property
    def change(self) -> FloatArray:
        """Change of levels by the press, (spot, channel)."""
        return self.during - self.before

    @cached_property
    def normals(self) -> FloatArray:
        """Normals of the balls at the spots, (spot, xyz)."""
        radius_mm = self._each("ball_mm") / 2.0
        xy = (self.points_mm[:, :2] - self._each("place_mm")) / radius_mm[:, None]
        return np.column_stack([xy, np.sqrt(1.0 - np.sum(xy**2, axis=1))])

    @cached_property
    def points_mm(self) -> FloatArray:
        """Intersections of the camera's rays through the spots with the balls, (spot, xyz).

        A ray that meets the undeformed coat at x is at x (1 - z / VIEW_MM) at a height z above it.
        """
        seen = self.untouched_mm[:, :2]
        radius_mm, depth_mm = self._each("ball_mm") / 2.0, self._each("depth_mm")
        z_mm = depth_mm
        for _ in range(_STEPS):
            xy = seen * (1.0 - z_mm / VIEW_MM)[:, None]
            off_mm2 = np.sum((xy - self._each("place_mm")) ** 2, axis=1)
            z_mm = depth_mm - radius_mm + np.sqrt(radius_mm**2 - off_mm2)
        return np.column_stack([xy, z_mm])

    @cached_property
    def untouched_mm(self) -> FloatArray:
        """Places of the spots on the undeformed coat, (spot, xyz)."""
        places = np.column_stack([self._each("x_mm"), self._each("y_mm")])
        xy = places + self.across * self._each("contact_mm")[:, None]
        return np.column_stack([xy, np.zeros(len(xy))])

    def _each(self, key: str) -> FloatArray:
        return np.array([getattr(press, key) for press in self.presses])[self.of_press]


def read_presses(file: Path = FILE) -> RealPresses:
    """Read the file that `main` writes."""
    with file.open(encoding="utf-8", newline="") as text:
        rows = [{key: float(value) for key, value in row.items()} for row in csv.DictReader(text)]
    number = np.array([int(row["press"]) for row in rows])
    first = [rows[int(np.argmax(number == k))] for k in range(number.max() + 1)]
    keys = ("ball_mm", "x_mm", "y_mm", "contact_mm")

    def columns(*names: str) -> FloatArray:
        return np.array([[row[name] for name in names] for row in rows])

    return RealPresses(
        tuple(RealPress(*(row[key] for key in keys)) for row in first),
        number,
        columns("across_x", "across_y"),
        columns(*(f"{channel}_before" for channel in CHANNELS)),
        columns(*(f"{channel}_during" for channel in CHANNELS)),
    )


def twins(sensor: ColourSensor, presses: tuple[RealPress, ...]) -> list[BallPress]:
    """Photograph the same presses with a rendered sensor."""
    rendered = []
    for number, press in enumerate(presses):
        case = case_of(sensor.experiment, press)
        face = seen_face(case, press_specimen(case))
        rendered.append(BallPress(sensor.image(face, FIRST_TWIN + number), press.ball_mm))
    return rendered


def case_of(experiment: Experiment, press: RealPress) -> Experiment:
    """Return the experiment with one of the presses."""
    x_mm, y_mm = press.place_mm
    ball = Ball(diameter_mm=press.ball_mm, x_mm=x_mm, y_mm=y_mm)
    return with_ball(experiment, ball, press.depth_mm)


def circle_of(press: RealPress) -> ContactCircle:
    """Return the circle of the contact in the image."""
    return ContactCircle(
        (HEIGHT_PX - 1) / 2 - press.y_mm / PITCH_MM,
        (WIDTH_PX - 1) / 2 + press.x_mm / PITCH_MM,
        press.contact_mm / PITCH_MM,
    )


def spots_of(image: Any, circle: ContactCircle) -> tuple[FloatArray, FloatArray]:
    """Return places in the contact (spot, xy), and mean levels there, (spot, channel).

    Parameters
    ----------
    image : (row, col, channel)
    """
    row, col = np.indices(image.shape[:2])
    x, y = (col - circle.col_px) / circle.radius_px, -(row - circle.row_px) / circle.radius_px
    angles = 2.0 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    ring = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    places = np.concatenate([np.zeros((1, 2)), *(radius * ring for radius in RADII)])
    near = [np.hypot(x - place[0], y - place[1]) < REACH for place in places]
    seen = [k for k, spot in enumerate(near) if spot.sum() >= LEAST_PX]
    levels = [image[near[k]].mean(axis=0, dtype=np.float64) for k in seen]
    return places[seen], np.array(levels).reshape(-1, 3)


def _rows(presses: list[BallPress], background: Any) -> list[dict[str, Any]]:
    rows, flat = [], smoothed(mean_background([background]), 3)
    for number, press in enumerate(presses):
        circle = find_contact_circle(smoothed(press.image, 3), flat)
        place = {
            "ball_mm": press.ball_diameter_mm,
            "x_mm": round((circle.col_px - (WIDTH_PX - 1) / 2) * PITCH_MM, 3),
            "y_mm": round(((HEIGHT_PX - 1) / 2 - circle.row_px) * PITCH_MM, 3),
            "contact_mm": round(circle.radius_px * PITCH_MM, 3),
        }
        # As rounded in the file, so that a twin has the same spots.
        circle = circle_of(RealPress(**place))
        across, during = spots_of(press.image, circle)
        before = spots_of(background, circle)[1]
        names = [f"{c}_{when}" for when in ("before", "during") for c in CHANNELS]
        for at, *levels in zip(across.round(4), before.round(1), during.round(1), strict=True):
            spot = {"press": number} | place | {"across_x": at[0], "across_y": at[1]}
            rows.append(spot | dict(zip(names, np.concatenate(levels), strict=True)))
    return rows


def main() -> None:
    """Read the images and write the file."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("folder", type=Path, help="as for benchmarks/photometric_balls.py")
    folder = parser.parse_args().folder
    rows = _rows(presses_of(folder), read_rgb(folder / "background.png"))
    with FILE.open("w", encoding="utf-8", newline="") as text:
        writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    print(f"wrote {FILE} ({len(rows)} spots)")


if __name__ == "__main__":
    main()
