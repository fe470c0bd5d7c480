"""Draw docs/thin_sheets.png: four specimens through sheets of 0.1 to 3 mm, under one press.

Nut, balls and bars are pressed. The fingerprint is its own relief times the share of it that
`twin press --transfer` gives: its ridges are too fine for the thin-sheet press.

.venv/bin/python docs/draw_thin_sheets.py out/thin_sheets

Presses that lie in the folder are not made again: some minutes the first time, seconds then.
"""

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from reconstruction.errors import InputError
from reconstruction.evaluate.fit import fit_sphere
from twin.config import Experiment, load_experiment
from twin.mechanics import PressedElastomer, read_press, ridge_height_mm, write_press
from twin.mechanics.contact_transfer import Ridges
from twin.pipeline.press import press_specimen
from twin.specimens import shape_of

PICTURE = Path(__file__).with_name("thin_sheets.png")
THICKNESSES_MM = (0.1, 0.2, 0.3, 0.5, 1.0, 3.0)
# No equilibrium is found at the others' 3 kPa.
LESS_AIR_KPA = {("wrapped_nut", 0.1): 1.5}
LIGHT = np.array([-0.5, 0.5, 0.6]) / np.linalg.norm([-0.5, 0.5, 0.6])


def main(folder: Path) -> None:
    """Press what is not there yet, then draw."""
    folder.mkdir(parents=True, exist_ok=True)
    figure = Figure(figsize=(13.2, 8.4), facecolor="white", layout="constrained")
    panels = figure.subplots(len(ROWS) + 1, len(THICKNESSES_MM))
    for column, thickness_mm in enumerate(THICKNESSES_MM):
        panels[0, column].set_title(f"{thickness_mm:g} mm", fontsize=12)
        for row, (name, half_mm, figure_of) in enumerate(ROWS):
            experiment = through(name, thickness_mm)
            pressed = kept(folder / f"{name}_{thickness_mm:g}.nc", experiment)
            if pressed is None:
                panels[row, column].set_xlabel("no equilibrium found", fontsize=10)
                continue
            relief(panels[row, column], pressed, half_mm)
            less = ", 1.5 kPa" if (name, thickness_mm) in LESS_AIR_KPA else ""
            panels[row, column].set_xlabel(figure_of(experiment, pressed) + less, fontsize=10)
        ridges(panels[-1, column], through("wrapped_fingerprint", thickness_mm))
    for axes in panels.ravel():
        axes.set(xticks=[], yticks=[])
    for axes, name in zip(panels[:, 0], ("nut", "balls", "bars", "fingerprint"), strict=True):
        axes.set_ylabel(name, fontsize=12)
    figure.savefig(PICTURE, dpi=80, metadata={"Software": None})
    sys.stdout.write(f"wrote {PICTURE}\n")


def through(name: str, thickness_mm: float) -> Experiment:
    """Return a scene with another sheet; the thinnest wrinkles on cells that are too wide."""
    cell_mm = 0.1 if thickness_mm < 0.2 else 0.2  # finer ones would not show in such pictures
    requested = {"press.cell_mm": cell_mm, "press.relief_pitch_mm": 0.04}
    if (name, thickness_mm) in LESS_AIR_KPA:
        requested["press.back_pressure_kpa"] = LESS_AIR_KPA[name, thickness_mm]
    return load_experiment(f"examples/{name}", requested | {"elastomer.thickness_mm": thickness_mm})


def kept(path: Path, experiment: Experiment) -> PressedElastomer | None:
    """Read a press, or make and write it; None where there is no equilibrium."""
    if not path.is_file():
        try:
            write_press(path, press_specimen(experiment))
        except InputError as error:
            sys.stderr.write(f"{path.stem}: {error}\n")
            return None
        sys.stdout.write(f"{path}\n")
    return read_press(path)


def relief(axes: Axes, pressed: PressedElastomer, half_mm: float) -> None:
    """Draw the middle of the coated face."""
    near_x, near_y = (np.abs(at) <= half_mm for at in (pressed.face_x_mm, pressed.face_y_mm))
    pitch_mm = float(pressed.face_x_mm[1] - pressed.face_x_mm[0])
    shade(axes, pressed.face_z_mm[np.ix_(near_y, near_x)], pitch_mm, enlarged=1.2)


def ridges(axes: Axes, experiment: Experiment) -> None:
    """Draw what shows of the ridges of a flat print, heights enlarged ten times."""
    height_mm = ridge_height_mm(experiment.specimen)
    under = Ridges(experiment.elastomer, experiment.press.back_pressure_kpa, height_mm)
    shown = under.shown(experiment.specimen.pitch_mm)
    at_mm = np.arange(-3.0, 3.0, 0.02)
    flat = experiment.specimen.model_copy(update={"dome_radius_mm": 0.0})
    shade(axes, -shown * shape_of(flat).height_above_lowest(at_mm, at_mm), 0.02, enlarged=10.0)
    shown_um = 1e3 * height_mm * shown
    axes.set_xlabel(f"{shown_um:.2g} of 70 um" if shown_um > 0.05 else "none of 70 um", fontsize=10)


def shade(axes: Axes, z_mm: NDArray[np.float64], pitch_mm: float, enlarged: float) -> None:
    """Draw heights as hills lit from the upper left."""
    slope_y, slope_x = np.gradient(enlarged * z_mm, pitch_mm)
    normal = np.stack((-slope_x, -slope_y, np.ones_like(z_mm)), axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    axes.imshow(np.clip(normal @ LIGHT, 0, 1), cmap="gray", vmin=0.0, vmax=1.0, origin="lower")


def hole(_: Experiment, pressed: PressedElastomer) -> str:
    """Return by how much the coat sinks into the nut's hole."""
    z, x, y = pressed.face_z_mm, pressed.face_x_mm, pressed.face_y_mm
    ring = np.abs(np.hypot(x, y[:, None]) - 3.9) < 0.1
    return f"hole {z[ring].mean() - z[np.abs(y).argmin(), np.abs(x).argmin()]:.2f} mm"


def radius(experiment: Experiment, pressed: PressedElastomer) -> str:
    """Return the radius of a ball as the coat shows it, fitted over 2.5 mm round its apex."""
    x, y = np.meshgrid(pressed.face_x_mm, pressed.face_y_mm)
    cap = np.hypot(x - experiment.specimen.separation_mm / 2, y) < 2.5
    points = np.stack((x[cap], y[cap], pressed.face_z_mm[cap]), axis=-1)
    return f"R {fit_sphere(points).radius_mm:.2f} mm, ball 4.00"


def width(experiment: Experiment, pressed: PressedElastomer) -> str:
    """Return the widest bar's width between its steepest slopes."""
    row = np.abs(pressed.face_y_mm).argmin()
    slope = np.gradient(pressed.face_z_mm[row], pressed.face_x_mm)
    middle_mm = experiment.specimen.middles_mm[-1]
    beside = np.abs(pressed.face_x_mm - middle_mm) < 5.5
    left = np.where(beside & (pressed.face_x_mm < middle_mm), slope, -np.inf)
    right = np.where(beside & (pressed.face_x_mm > middle_mm), slope, np.inf)
    width_mm = pressed.face_x_mm[right.argmin()] - pressed.face_x_mm[left.argmax()]
    return f"width {width_mm:.2f} mm, bar 7.23"


Row = tuple[str, float, Callable[[Experiment, PressedElastomer], str]]
ROWS: tuple[Row, ...] = (
    ("wrapped_nut", 9.0, hole),
    ("wrapped_balls", 9.0, radius),
    ("wrapped_bars", 10.5, width),
)

if __name__ == "__main__":
    main(Path(sys.argv[1]))
