"""The thin sheet that wraps: accuracy, figures of the paper's objects, speed, robustness.

- upper face, force and stuck force against the stored solid neo-Hookean elements: a ball of R 4
  under a round clamped sheet of 20 mm, travel 0.5, 1 and 2 mm, the product's own cells;
- through 0.2 mm (300 kPa, 20 x 20 mm, 1 and 3 kPa, travel 1 mm): width of an M6 nut over its flats
  less its own and twice the local thickness, depth of its hole, radii of the two balls for regions
  of 1.0 to 2.5 mm; bars fully wrapped by 10 kPa, both faces;
- the same pair on half the cells: how far the coat moves, and its radius;
- seconds of two balls, nut (3 kPa) and fingerprint on this machine, which should be idle, median of
  three after a first one that compiles; beside them processor seconds, waiting threads included;
- random presses (`random_presses`).

`--press SEED` repeats one of these, `--presses N --workers 2 --kept FILE` runs many, two side by
side, and goes on where it was interrupted. Last line: {"solid_max_um_h02", ...}.
"""

import argparse
import json
import multiprocessing
import resource
import statistics
import time
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from benchmarks.random_presses import PRESSES, QUICK_PRESSES, outcome, press_all, summary
from reconstruction.evaluate.fit import fit_sphere
from twin.config.models import Elastomer, Mechanics, Press, Specimen
from twin.mechanics import PressedElastomer
from twin.mechanics.errors import PressError, SolverError
from twin.mechanics.sheet.linear_solver import has_pardiso
from twin.mechanics.sheet.press import forget_paths, press_sheet
from twin.specimens.kinds.ball import Ball
from twin.specimens.kinds.bar import Bar
from twin.specimens.kinds.fingerprint import Fingerprint
from twin.specimens.kinds.nut import Nut
from twin.specimens.kinds.two_balls import TwoBalls

SOLIDS = Path(__file__).parents[1] / "tests/mechanics/reference/solid_sheets.json"
YOUNG_KPA, THIN_MM = 300.0, 0.2
REGIONS_MM = (1.0, 1.2, 1.5, 2.0, 2.5)
WIDTHS_MM = (1.99, 4.81, 7.23)

Figures = dict[str, float | None]


def elastomer(**changes: Any) -> Elastomer:
    """Return a sheet of 0.2 mm and 300 kPa in a frame of 20 x 20 mm."""
    values = {
        "thickness_mm": THIN_MM,
        "length_x_mm": 20.0,
        "length_y_mm": 20.0,
        "young_modulus_kpa": YOUNG_KPA,
        "poisson_ratio": 0.49,
    }
    return Elastomer.model_validate(values | changes)


def pressed(specimen: Specimen, sheet: Elastomer, depth_mm: float, **load: Any) -> PressedElastomer:
    """Press to a depth with the sheet model."""
    values = {"control": "depth", "depth_mm": depth_mm} | load
    return press_sheet(specimen, sheet, Press.model_validate(values), Mechanics(model="sheet"))


# ---- accuracy --------------------------------------------------------------------------------


def against_solid(name: str) -> list[tuple[float, float]]:
    """Return (largest error of the upper face in um, relative error of the force) per travel."""
    case = json.loads(SOLIDS.read_text(encoding="utf-8"))[name]
    friction = "stick" if case["kind"] == "stick" else "none"
    sheet = elastomer(thickness_mm=case["thickness_mm"], outline="round", friction=friction)
    found = []
    for solid in case["travels"]:
        one = pressed(Ball(), sheet, solid["travel_mm"], relief_pitch_mm=0.05)
        x, y = np.meshgrid(one.face_x_mm, one.face_y_mm)
        r, tabled = np.hypot(x, y), 0.1 * np.arange(len(solid["upper_z_mm"]))
        error = one.face_z_mm - CubicSpline(tabled, solid["upper_z_mm"])(r)
        largest = 1e3 * float(np.abs(error)[r < tabled[-1]].max())
        force = one.force_n / (1e-3 * YOUNG_KPA) / solid["force"] - 1
        print(
            f"{name}, travel {solid['travel_mm']:g}: face {largest:.2f} um, force {force:+.2%}",
            flush=True,
        )
        found.append((largest, abs(force)))
    return found


def solids(quick: bool) -> Figures:
    """Compare with the stored solids."""
    names = ["free_h0.2", "free_h0.5", "free_h1", "stick_h0.5"]
    if not quick:
        names += ["free_h0.1", "free_h0.3", "stick_h0.2", "stick_h1"]
    found = {name: against_solid(name) for name in names}
    return {
        "solid_max_um_h02": max(face for face, _ in found["free_h0.2"]),
        "solid_max_um_h05": max(face for face, _ in found["free_h0.5"]),
        "solid_max_um_h10": max(face for face, _ in found["free_h1"]),
        "force_rel_h02": max(force for _, force in found["free_h0.2"]),
        "stick_force_rel_h05": max(force for _, force in found["stick_h0.5"]),
    }


# ---- the paper's objects ---------------------------------------------------------------------


def width_mm(x_mm: np.ndarray, z_mm: np.ndarray, level_mm: float) -> tuple[float, np.ndarray]:
    """Return how far apart a section crosses a height, and where it does, outermost first."""
    high = np.flatnonzero(z_mm > level_mm)
    first, last = int(high[0]), int(high[-1])
    left = np.interp(level_mm, z_mm[[first - 1, first]], x_mm[[first - 1, first]])
    right = np.interp(-level_mm, -z_mm[[last, last + 1]], x_mm[[last, last + 1]])
    return float(right - left), np.array([left, right])


def flank_width_mm(
    x_mm: np.ndarray, z_mm: np.ndarray, thickness_mm: np.ndarray, edge_z_mm: float
) -> tuple[float, float]:
    """Return (width of the clear face, of the coat at its steepest) between two flanks.

    A sheet leaves an edge as a tent: its flank, moved in by the local thickness and extended
    straight, meets the level of the edge where the object ends, however steep the tent is.
    """
    slope, ends, steepest = np.gradient(z_mm, x_mm), [], []
    for sign in (1, -1):
        at = int(np.argmax(sign * slope))
        across, up = np.array([-slope[at], 1.0]) / np.hypot(1, slope[at])
        x, z = x_mm[at] - across * thickness_mm[at], z_mm[at] - up * thickness_mm[at]
        ends.append(float(x + (edge_z_mm - z) / slope[at]))
        steepest.append(float(x_mm[at]))
    return ends[1] - ends[0], steepest[1] - steepest[0]


def hole_depth_mm(one: PressedElastomer) -> float:
    """Return by how much the coat sinks from the nut's ring to the middle of its hole."""
    x, y = np.meshgrid(one.face_x_mm, one.face_y_mm)
    ring, centre = np.abs(np.hypot(x, y) - 4.0) < 0.1, np.hypot(x, y) < 0.1
    return float(one.face_z_mm[ring].mean() - one.face_z_mm[centre].mean())


def edge_of_flats_mm(x_mm: float) -> float:
    """Return the height of a flat's edge, x from its middle, below the nut's face: 30 degrees."""
    nut = Nut()
    outside = np.hypot(nut.across_flats_mm / 2, x_mm) - nut.face_radius_mm
    return -float(max(outside, 0.0) * np.tan(np.pi / 6))


def nut(quick: bool) -> Figures:
    """Measure the M6 nut: width over the flats, which face +-y, and depth of the hole."""
    flats, depth = [], []
    for pressure in (1.0, 3.0):
        one = pressed(Nut(), elastomer(), 1.0, back_pressure_kpa=pressure)
        assert one.sheet is not None
        for col in np.flatnonzero(np.abs(one.face_x_mm) <= 1.0)[::10]:
            thick = one.sheet.thickness_mm[:, col]
            edge_z = one.depth_mm - THIN_MM + edge_of_flats_mm(one.face_x_mm[col])
            found, steepest = flank_width_mm(one.face_y_mm, one.face_z_mm[:, col], thick, edge_z)
            flats.append(found - Nut().across_flats_mm)
        depth.append(hole_depth_mm(one))
        print(
            f"nut, {pressure:g} kPa: flats {flats[-1]:+.3f} mm beside its own (the coat "
            f"{steepest:.3f} mm wide at the steepest), hole {depth[-1]:.3f} mm deep",
            flush=True,
        )
    found: Figures = {
        "nut_flats_error_mm": float(np.abs(flats).max()),
        "nut_hole_depth_mm": depth[1],
        "nut_hole_depth_1kpa_mm": depth[0],
    }
    if not quick:
        plain = pressed(Nut(countersink_mm=0.0), elastomer(), 1.0, back_pressure_kpa=3.0)
        found["nut_plain_hole_depth_mm"] = hole_depth_mm(plain)
    return found


def balls(quick: bool) -> Figures:
    """Fit spheres to both balls of the pair; 4.23 +- 0.02 is wanted for every region."""
    radii = []
    for pressure in (1.0, 3.0):
        one = pressed(TwoBalls(), elastomer(), 1.0, back_pressure_kpa=pressure)
        x, y = np.meshgrid(one.face_x_mm, one.face_y_mm)
        points = np.stack((x, y, one.face_z_mm), axis=-1)
        for region in REGIONS_MM:
            for middle in (-4.0, 4.0):
                near = np.hypot(x - middle, y) < region
                radii.append(fit_sphere(points[near]).radius_mm)
        shown = ", ".join(f"{radius:.3f}" for radius in radii[-2 * len(REGIONS_MM) :])
        print(f"two balls, {pressure:g} kPa, regions {REGIONS_MM}: {shown}", flush=True)
    return {"balls_radius_low_mm": min(radii), "balls_radius_high_mm": max(radii)}


def halved(quick: bool) -> Figures:
    """Press the pair with 3 kPa on cells of 0.15 mm and of half of that."""
    faces, radii = [], []
    if quick:
        return {}
    for cell in (0.15, 0.075):
        one = pressed(TwoBalls(), elastomer(), 1.0, back_pressure_kpa=3.0, cell_mm=cell)
        x, y = np.meshgrid(one.face_x_mm, one.face_y_mm)
        near = np.hypot(x - 4.0, y) < max(REGIONS_MM)
        faces.append(one.face_z_mm[near])
        radii.append(fit_sphere(np.stack((x[near], y[near], faces[-1]), axis=-1)).radius_mm)
    return {
        "balls_halved_um": 1e3 * float(np.abs(faces[1] - faces[0]).max()),
        "balls_halved_radius_rel": abs(radii[1] / radii[0] - 1),
    }


def bars(quick: bool) -> Figures:
    """Measure bars where they are wrapped, a third down: w + 2 h lambda, and w below.

    Towards the plate the sheet leaves the wall on an arc of tension over pressure, about 1 mm.
    """
    over, under = [], []
    if quick:
        return {"bars_error_mm": None, "bars_lower_error_mm": None}
    for width in WIDTHS_MM:
        bar = Bar(width_mm=width, length_mm=15.0)
        try:
            one = pressed(
                bar, elastomer(), 1.0, back_pressure_kpa=10.0, solver_pitch_mm=0.02, cell_mm=0.04
            )
        except (PressError, SolverError) as error:
            print(f"bar {width:g}: {error}", flush=True)
            return {"bars_error_mm": None, "bars_lower_error_mm": None}
        assert one.sheet is not None
        row, cell = one.face_y_mm.size // 2, one.y_mm.size // 2
        level = one.depth_mm - bar.height_mm / 3
        upper, places = width_mm(one.face_x_mm, one.face_z_mm[row], level)
        thick = np.interp(places, one.face_x_mm, one.sheet.thickness_mm[row]).sum()
        lower, _ = width_mm(one.x_mm, one.touched_face_mm[cell] + THIN_MM, level)
        over.append(upper - width - thick)
        under.append(lower - width)
        print(
            f"bar {width:g}: upper {upper:.3f} (w + 2 h lambda {over[-1]:+.3f}), lower {lower:.3f}",
            flush=True,
        )
    return {
        "bars_error_mm": float(np.abs(over).max()),
        "bars_lower_error_mm": float(np.abs(under).max()),
    }


# ---- speed -----------------------------------------------------------------------------------


def timed(press: Callable[[], PressedElastomer], repeats: int) -> tuple[float, float]:
    """Return the median time of a press and its median processor time, s, after one that compiles.

    Each begins at the mounted sheet; distances to a mesh stay sampled.
    """
    times = []
    for _ in range(repeats + 1):
        forget_paths()
        wall_s, processor_s = time.perf_counter(), time.process_time()
        press()
        times.append((time.perf_counter() - wall_s, time.process_time() - processor_s))
    wall, processor = zip(*times[1:], strict=True)
    return statistics.median(wall), statistics.median(processor)


def balls_s(quick: bool) -> Figures:
    return _seconds("balls_s", quick, TwoBalls(yaw_deg=20.0), 3.0, elastomer())


def nut_s(quick: bool) -> Figures:
    return _seconds("nut_s", quick, Nut(yaw_deg=15.0), 3.0, elastomer())


def fingerprint_s(quick: bool) -> Figures:
    """Press a field of 20 x 20 mm inside a frame of 24 x 24 mm; silicone sticks to a skin."""
    sheet = elastomer(length_x_mm=24.0, length_y_mm=24.0, friction="stick")
    return _seconds("fingerprint_s", quick, Fingerprint(), 3.0, sheet)


def _seconds(
    name: str, quick: bool, specimen: Specimen, pressure_kpa: float, sheet: Elastomer
) -> Figures:
    try:
        wall_s, processor_s = timed(
            lambda: pressed(specimen, sheet, 1.0, back_pressure_kpa=pressure_kpa), 1 if quick else 3
        )
    except (PressError, SolverError) as error:
        print(f"{name}: {error}", flush=True)
        return {name: None}
    print(f"{name}: {wall_s:.1f} s, {processor_s:.1f} s of processors", flush=True)
    return {name: wall_s, name.replace("_s", "_processor_s"): processor_s}


# ---- all -------------------------------------------------------------------------------------


def answer(part: Callable[[bool], Figures], quick: bool, connection: Connection) -> None:
    found = part(quick)
    # Linux gives KiB.
    connection.send((found, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20))


def in_child(part: Callable[[bool], Figures], quick: bool) -> tuple[Figures, float]:
    """Run a part in a process of its own; return what it found, and its peak memory, GiB."""
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=answer, args=(part, quick, theirs))
    process.start()
    found: tuple[Figures, float] = ours.recv()
    process.join()
    return found


def parse() -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--quick", action="store_true", help="12 random presses, no bars, fewer solids and repeats"
    )
    parser.add_argument("--press", type=int, metavar="SEED", help="only this random press")
    parser.add_argument(
        "--presses", type=int, metavar="N", help="only the first N random presses; 0: all else"
    )
    parser.add_argument("--workers", type=int, default=1, help="that press at random side by side")
    parser.add_argument(
        "--kept", type=Path, metavar="FILE", help="JSON lines: random presses done, to go on from"
    )
    return parser.parse_args()


def measured(quick: bool) -> Figures:
    """Measure all but the random presses; memory apart for what asks for finer cells itself."""
    result: Figures = {}
    memory_gib: dict[str, float] = {}
    for part in (solids, nut, balls, balls_s, nut_s, fingerprint_s, bars, halved):
        found, peak_gib = in_child(part, quick)
        name = "finer_cells_memory_gib" if part in {bars, halved} else "peak_memory_gib"
        memory_gib[name] = max(peak_gib, memory_gib.get(name, 0.0))
        result |= found
    return result | memory_gib


def main() -> None:
    chosen = parse()
    print(f"solver: {'PARDISO' if has_pardiso() else 'SuperLU'}", flush=True)
    if chosen.press is not None:
        print(outcome(chosen.press))
        return
    count = QUICK_PRESSES if chosen.quick else PRESSES
    if chosen.presses is not None:
        count = chosen.presses
    result: dict[str, Any] = {} if chosen.presses else dict(measured(chosen.quick))
    result |= summary(press_all(range(count), chosen.workers, chosen.kept))
    result["peak_memory_gib"] = max(result.get("peak_memory_gib", 0.0), result["press_gib"] or 0.0)
    result = {key: v if v is None else float(f"{v:.4g}") for key, v in result.items()}
    print(json.dumps(result | {"solver": "pardiso" if has_pardiso() else "superlu"}))


if __name__ == "__main__":
    main()
