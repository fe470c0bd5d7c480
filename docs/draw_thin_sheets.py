"""Draw docs/thin_sheets.png: four specimens through sheets of 0.1 to 3 mm, under one press.

.venv/bin/python docs/draw_thin_sheets.py out/thin_sheets

Presses that lie in the folder are not made again: some minutes the first time, seconds then.
"""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LightSource
from matplotlib.figure import Figure

from reconstruction.errors import InputError
from reconstruction.fit import fit_sphere
from twin.config import Experiment, load_experiment
from twin.mechanics import PressedElastomer, read_press, ridge_height_mm, write_press
from twin.mechanics.ridge_transfer import Ridges
from twin.modalities.contact_fpp import press_specimen

PICTURE = Path(__file__).with_name("thin_sheets.png")
THICKNESSES_MM = (0.1, 0.2, 0.3, 0.5, 1.0, 3.0)
# Finer cells would not show in pictures of this size.
COARSE: dict[str, Any] = {"press.cell_mm": 0.2, "press.relief_pitch_mm": 0.04}
# A print of this size shows its ridges in a small picture.
SMALL_PRINT: dict[str, Any] = {
    "press.cell_mm": 0.1,
    "press.relief_pitch_mm": 0.03,
    "specimen.length_x_mm": {"value": 9.0, "source": "a part of a fingertip"},
    "specimen.length_y_mm": {"value": 9.0, "source": "a part of a fingertip"},
}
LIGHT = LightSource(azdeg=315, altdeg=40)


def main(folder: Path) -> None:
    """Press what is not there yet, then draw."""
    folder.mkdir(parents=True, exist_ok=True)
    figure = Figure(figsize=(13.2, 8.4), facecolor="white", layout="constrained")
    panels = figure.subplots(len(ROWS), len(THICKNESSES_MM))
    for row, (name, changes, half_mm, figure_of) in enumerate(ROWS):
        for column, thickness_mm in enumerate(THICKNESSES_MM):
            axes = panels[row, column]
            axes.set(xticks=[], yticks=[])
            if row == 0:
                axes.set_title(f"{thickness_mm:g} mm", fontsize=12)
            if column == 0:
                axes.set_ylabel(name.replace("wrapped_", ""), fontsize=12)
            experiment = through(name, changes, thickness_mm)
            pressed = kept(folder / f"{name}_{thickness_mm:g}.nc", experiment)
            if pressed is None:
                axes.set_xlabel("no equilibrium found", fontsize=10)
                continue
            shade(axes, pressed, half_mm)
            axes.set_xlabel(figure_of(experiment, pressed), fontsize=10)
    figure.savefig(PICTURE, dpi=80, metadata={"Software": None})
    sys.stdout.write(f"wrote {PICTURE}\n")


def through(name: str, changes: dict[str, Any], thickness_mm: float) -> Experiment:
    """Return a scene with another sheet; the thinnest wrinkles on cells that are too wide."""
    thin: dict[str, Any] = {"press.cell_mm": 0.1} if thickness_mm < 0.2 else {}
    asked = changes | thin | {"elastomer.thickness_mm": thickness_mm}
    return load_experiment(f"examples/{name}", asked)


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


def shade(axes: Axes, pressed: PressedElastomer, half_mm: float) -> None:
    """Draw the coated face as hills lit from the upper left, heights in colour."""
    near_x, near_y = (np.abs(at) <= half_mm for at in (pressed.face_x_mm, pressed.face_y_mm))
    z = pressed.face_z_mm[np.ix_(near_y, near_x)]
    pitch = float(pressed.face_x_mm[1] - pressed.face_x_mm[0])
    light = LIGHT.hillshade(z, vert_exag=2.0, dx=pitch, dy=-pitch)
    axes.imshow(light, cmap="gray", vmin=0.0, vmax=1.0, origin="lower")


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
    found = pressed.face_x_mm[right.argmin()] - pressed.face_x_mm[left.argmax()]
    return f"width {found:.2f} mm, bar 7.23"


def ridge(experiment: Experiment, _: PressedElastomer) -> str:
    """Return how much of the ridges' height shows, by `twin press --transfer`'s exact layer."""
    height_mm = ridge_height_mm(experiment.specimen)
    ridges = Ridges(experiment.elastomer, experiment.press.back_pressure_kpa, height_mm)
    shown_um = 1e3 * height_mm * ridges.shown(experiment.specimen.pitch_mm)
    return f"{shown_um:.2g} of 70 um" if shown_um > 0.05 else "none of 70 um"


Row = tuple[str, dict[str, Any], float, Callable[[Experiment, PressedElastomer], str]]
ROWS: tuple[Row, ...] = (
    ("wrapped_nut", COARSE, 9.0, hole),
    ("wrapped_balls", COARSE, 9.0, radius),
    ("wrapped_bars", COARSE, 10.0, width),
    ("wrapped_fingerprint", SMALL_PRINT, 4.5, ridge),
)

if __name__ == "__main__":
    main(Path(sys.argv[1]))
