"""The thin sheet that wraps: accuracy, figures of the paper's objects, speed, robustness.

- upper face, force and stuck force against the stored solid neo-Hookean elements: a ball of R 4
  under a round clamped sheet of 20 mm, travel 0.5, 1 and 2 mm, the product's default cells;
- through 0.2 mm (300 kPa, 20 x 20 mm, 1 and 3 kPa, travel 1 mm): width of an M6 nut over its flats
  less the nut's own width and the local thickness of both sides, depth of its hole, radii of the
  two balls for regions of 1.0 to 2.5 mm; bars fully wrapped by 10 kPa, both faces;
- the same pair on cells of half the size: change of the coat, and of its radius;
- seconds of two balls, nut (3 kPa) and fingerprint on this machine, which should be idle, median of
  three after a first press that compiles, and processor seconds, waiting threads included;
- `..._over_limit`: processor time of a press with one thread, divided by that of one analysis,
  factorisation and solution on its finest cells;
- random presses (`random_presses`).

`--press SEED` repeats a random press, `--presses N --workers 2 --kept FILE` runs many, two at the
same time, and continues after an interruption. Last line: {"solid_max_um_h02", ...}.
"""

import json
import multiprocessing
import statistics
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from benchmarks._harness import print_figures, quick_parser, resident_bytes
from benchmarks.random_presses import PRESSES, QUICK_PRESSES, outcome, press_all, summary
from reconstruction.evaluate.fit import fit_sphere
from reconstruction.machine import VARIABLE, environment_variable
from twin.config.models import Elastomer, Mechanics, Press, Specimen
from twin.mechanics import PressedElastomer
from twin.mechanics.errors import PressError, SolverError
from twin.mechanics.sheet.energy import System
from twin.mechanics.sheet.linear_solver import has_pardiso
from twin.mechanics.sheet.press import forget_paths, press_sheet, settled_sheet
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
    sides = {"length_x_mm": 20.0, "length_y_mm": 20.0, "thickness_mm": THIN_MM}
    values = sides | {"young_modulus_kpa": YOUNG_KPA, "poisson_ratio": 0.49}
    return Elastomer.model_validate(values | changes)


def pressed(specimen: Specimen, sheet: Elastomer, depth_mm: float, **load: Any) -> PressedElastomer:
    """Press to a depth with the sheet model."""
    values = {"control": "depth", "depth_mm": depth_mm} | load
    return press_sheet(specimen, sheet, Press.model_validate(values), Mechanics(model="sheet"))


# ---- accuracy --------------------------------------------------------------------------------


def against_solid(name: str) -> tuple[float, float]:
    """Return the largest error of the upper face, um, and relative error of the force."""
    case = json.loads(SOLIDS.read_text(encoding="utf-8"))[name]
    friction = "stick" if case["kind"] == "stick" else "none"
    sheet = elastomer(thickness_mm=case["thickness_mm"], outline="round", friction=friction)
    faces, forces = [], []
    for solid in case["travels"]:
        pressed_sheet = pressed(Ball(), sheet, solid["travel_mm"], relief_pitch_mm=0.05)
        x, y = np.meshgrid(pressed_sheet.face_x_mm, pressed_sheet.face_y_mm)
        r, tabled = np.hypot(x, y), 0.1 * np.arange(len(solid["upper_z_mm"]))
        error = pressed_sheet.face_z_mm - CubicSpline(tabled, solid["upper_z_mm"])(r)
        faces.append(1e3 * float(np.abs(error)[r < tabled[-1]].max()))
        forces.append(pressed_sheet.force_n / (1e-3 * YOUNG_KPA) / solid["force"] - 1)
        values = f"face {faces[-1]:.2f} um, force {forces[-1]:+.2%}"
        print(f"{name}, travel {solid['travel_mm']:g}: {values}", flush=True)
    return max(faces), float(np.abs(forces).max())


def solids(quick: bool) -> Figures:
    """Compare with the stored solids."""
    names = ["free_h0.2", "free_h0.5", "free_h1", "stick_h0.5"]
    if not quick:
        names += ["free_h0.1", "free_h0.3", "stick_h0.2", "stick_h1"]
    figures = {name: against_solid(name) for name in names}
    return {
        "solid_max_um_h02": figures["free_h0.2"][0],
        "solid_max_um_h05": figures["free_h0.5"][0],
        "solid_max_um_h10": figures["free_h1"][0],
        "force_rel_h02": figures["free_h0.2"][1],
        "stick_force_rel_h05": figures["stick_h0.5"][1],
    }


# ---- the paper's objects ---------------------------------------------------------------------


def width_mm(x_mm: np.ndarray, z_mm: np.ndarray, level_mm: float) -> tuple[float, np.ndarray]:
    """Return the width of a section at a height, and the outermost places of that height."""
    high = np.flatnonzero(z_mm > level_mm)
    first, last = int(high[0]), int(high[-1])
    left = np.interp(level_mm, z_mm[[first - 1, first]], x_mm[[first - 1, first]])
    right = np.interp(-level_mm, -z_mm[[last, last + 1]], x_mm[[last, last + 1]])
    return float(right - left), np.array([left, right])


def flank_width_mm(
    x_mm: np.ndarray, z_mm: np.ndarray, thickness_mm: np.ndarray, edge_z_mm: float
) -> tuple[float, float]:
    """Return (width of the clear face, of the coat at its steepest) between two flanks.

    At an edge the sheet spans free between contact and rim: its flank, moved in by the local
    thickness and extended straight, meets the level of the edge at the edge of the object.
    """
    slope, ends, steepest = np.gradient(z_mm, x_mm), [], []
    for sign in (1, -1):
        at = int(np.argmax(sign * slope))
        across, up = np.array([-slope[at], 1.0]) / np.hypot(1, slope[at])
        x, z = x_mm[at] - across * thickness_mm[at], z_mm[at] - up * thickness_mm[at]
        ends.append(float(x + (edge_z_mm - z) / slope[at]))
        steepest.append(float(x_mm[at]))
    return ends[1] - ends[0], steepest[1] - steepest[0]


def hole_depth_mm(face: PressedElastomer) -> float:
    """Return the height of the coat on the nut's ring over that in the middle of its hole."""
    x, y = np.meshgrid(face.face_x_mm, face.face_y_mm)
    ring, centre = np.abs(np.hypot(x, y) - 4.0) < 0.1, np.hypot(x, y) < 0.1
    return float(face.face_z_mm[ring].mean() - face.face_z_mm[centre].mean())


def edge_of_flats_mm(x_mm: float) -> float:
    """Return the height of a flat's edge, x from its middle, below the nut's face: 30 degrees."""
    outside = np.hypot(Nut().across_flats_mm / 2, x_mm) - Nut().face_radius_mm
    return -float(max(outside, 0.0) * np.tan(np.pi / 6))


def nut(quick: bool) -> Figures:
    """Measure the M6 nut: width over the flats, which face +-y, and depth of the hole."""
    flats, depth = [], []
    for pressure in (1.0, 3.0):
        face = pressed(Nut(), elastomer(), 1.0, back_pressure_kpa=pressure)
        assert face.sheet is not None
        for col in np.flatnonzero(np.abs(face.face_x_mm) <= 1.0)[::10]:
            thick = face.sheet.thickness_mm[:, col]
            edge_z = face.depth_mm - THIN_MM + edge_of_flats_mm(face.face_x_mm[col])
            section = face.face_y_mm, face.face_z_mm[:, col]
            width, steepest = flank_width_mm(*section, thick, edge_z)
            flats.append(width - Nut().across_flats_mm)
        depth.append(hole_depth_mm(face))
        values = f"error of the flats {flats[-1]:+.3f} mm, hole {depth[-1]:.3f} mm deep"
        print(f"nut, {pressure:g} kPa: {values}, coat at its steepest {steepest:.3f} mm wide")
    figures: Figures = {
        "nut_flats_error_mm": float(np.abs(flats).max()),
        "nut_hole_depth_mm": depth[1],
        "nut_hole_depth_1kpa_mm": depth[0],
    }
    if not quick:
        plain = pressed(Nut(countersink_mm=0.0), elastomer(), 1.0, back_pressure_kpa=3.0)
        figures["nut_plain_hole_depth_mm"] = hole_depth_mm(plain)
    return figures


def balls(quick: bool) -> Figures:
    """Fit spheres to both balls of the pair; 4.23 +- 0.02 is the target for every region."""
    radii = []
    for pressure in (1.0, 3.0):
        face = pressed(TwoBalls(), elastomer(), 1.0, back_pressure_kpa=pressure)
        x, y = np.meshgrid(face.face_x_mm, face.face_y_mm)
        points = np.stack((x, y, face.face_z_mm), axis=-1)
        for region in REGIONS_MM:
            for middle in (-4.0, 4.0):
                near = np.hypot(x - middle, y) < region
                radii.append(fit_sphere(points[near]).radius_mm)
        shown = ", ".join(f"{radius:.3f}" for radius in radii[-2 * len(REGIONS_MM) :])
        print(f"two balls, {pressure:g} kPa, regions {REGIONS_MM}: {shown}", flush=True)
    return {"balls_radius_low_mm": min(radii), "balls_radius_high_mm": max(radii)}


def halved(quick: bool) -> Figures:
    """Press the pair with 3 kPa on cells of 0.15 mm and of 0.075 mm."""
    faces, radii = [], []
    if quick:
        return {}
    for cell in (0.15, 0.075):
        face = pressed(TwoBalls(), elastomer(), 1.0, back_pressure_kpa=3.0, cell_mm=cell)
        x, y = np.meshgrid(face.face_x_mm, face.face_y_mm)
        near = np.hypot(x - 4.0, y) < max(REGIONS_MM)
        faces.append(face.face_z_mm[near])
        radii.append(fit_sphere(np.stack((x[near], y[near], faces[-1]), axis=-1)).radius_mm)
    return {
        "balls_halved_um": 1e3 * float(np.abs(faces[1] - faces[0]).max()),
        "balls_halved_radius_rel": abs(radii[1] / radii[0] - 1),
    }


def bars(quick: bool) -> Figures:
    """Measure bars at 33 % of their height from the top: w + 2 h lambda, and w below.

    Near the plate the sheet separates from the wall on an arc of tension over pressure, about 1 mm.
    """
    load = {"back_pressure_kpa": 10.0, "solver_pitch_mm": 0.02, "cell_mm": 0.04}
    over, under = [], []
    for width in () if quick else WIDTHS_MM:
        bar = Bar(width_mm=width, length_mm=15.0)
        try:
            face = pressed(bar, elastomer(), 1.0, **load)
        except (PressError, SolverError) as error:
            print(f"bar {width:g}: {error}", flush=True)
            over, under = [], []
            break
        assert face.sheet is not None
        row, cell = face.face_y_mm.size // 2, face.y_mm.size // 2
        level = face.depth_mm - bar.height_mm / 3
        upper, places = width_mm(face.face_x_mm, face.face_z_mm[row], level)
        thick = np.interp(places, face.face_x_mm, face.sheet.thickness_mm[row]).sum()
        lower, _ = width_mm(face.x_mm, face.touched_face_mm[cell] + THIN_MM, level)
        over.append(abs(upper - width - thick))
        under.append(abs(lower - width))
        print(f"bar {width:g}: upper {upper:.3f} mm, lower {lower:.3f} mm", flush=True)
    return {
        "bars_error_mm": max(over, default=None),
        "bars_lower_error_mm": max(under, default=None),
    }


# ---- speed -----------------------------------------------------------------------------------


def timed(press: Callable[[], PressedElastomer], repeats: int) -> tuple[float, float]:
    """Return the median run time and processor time of a press, s, after a first that compiles.

    Each press starts at the mounted sheet; sampled distances to a mesh are reused.
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
    return _seconds("balls_s", quick, TwoBalls(yaw_deg=20.0), elastomer())


def nut_s(quick: bool) -> Figures:
    return _seconds("nut_s", quick, Nut(yaw_deg=15.0), elastomer())


def fingerprint_s(quick: bool) -> Figures:
    """Press a field of 20 x 20 mm inside a frame of 24 x 24 mm; silicone sticks to a skin."""
    sheet = elastomer(length_x_mm=24.0, length_y_mm=24.0, friction="stick")
    return _seconds("fingerprint_s", quick, Fingerprint(), sheet)


def _seconds(name: str, quick: bool, specimen: Specimen, sheet: Elastomer) -> Figures:
    def press() -> PressedElastomer:
        return pressed(specimen, sheet, 1.0, back_pressure_kpa=3.0)

    try:
        wall_s, processor_s = timed(press, 1 if quick else 3)
    except (PressError, SolverError) as error:
        print(f"{name}: {error}", flush=True)
        return {name: None}
    print(f"{name}: {wall_s:.1f} s, {processor_s:.1f} s of processors", flush=True)
    with environment_variable(VARIABLE, "1"):
        one_thread_s = timed(press, 1)[1]
        limit_s = statistics.median(solution_s(specimen, sheet) for _ in range(3))
    of = name.removesuffix("_s")
    print(f"{of}, one thread: {one_thread_s:.2f} s, limit {limit_s:.2f} s", flush=True)
    return {
        name: wall_s,
        f"{of}_processor_s": processor_s,
        f"{of}_over_limit": one_thread_s / limit_s,
    }


def solution_s(specimen: Specimen, sheet: Elastomer) -> float:
    """Return the processor time of analysis, factorisation and solution on the finest cells.

    The solver is that of the press. No press can take less time.
    """
    values = {"control": "depth", "depth_mm": 1.0, "back_pressure_kpa": 3.0}
    load, mechanics = Press.model_validate(values), Mechanics(model="sheet")
    end = settled_sheet(specimen, sheet, load, mechanics)
    end.sheet.evaluate(end.state.control_mm, end.state, tangent=True)
    start = time.process_time()
    end.sheet.system = System.of(end.sheet.grid.free)
    end.sheet.factorise(0.0)
    end.sheet.newton_step_mm()
    return time.process_time() - start


# ---- all -------------------------------------------------------------------------------------


def with_memory(part: Callable[[bool], Figures], quick: bool) -> tuple[Figures, float]:
    """Return the figures of a part, and the peak memory of this process, GiB."""
    return part(quick), resident_bytes("VmHWM") / 2**30


def in_child(part: Callable[[bool], Figures], quick: bool) -> tuple[Figures, float]:
    """Run a part in a process of its own; return its figures, and its peak memory, GiB."""
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        return pool.submit(with_memory, part, quick).result()


def measured(quick: bool) -> Figures:
    """Measure all but the random presses; finer cells have a memory figure of their own."""
    result: Figures = {}
    memory_gib: dict[str, float] = {}
    for part in (solids, nut, balls, balls_s, nut_s, fingerprint_s, bars, halved):
        figures, peak_gib = in_child(part, quick)
        name = "finer_cells_memory_gib" if part in {bars, halved} else "peak_memory_gib"
        memory_gib[name] = max(peak_gib, memory_gib.get(name, 0.0))
        result |= figures
    return result | memory_gib


def main() -> None:
    parser = quick_parser(__doc__, "12 random presses, no bars, fewer solids and repeats")
    parser.add_argument("--press", type=int, metavar="SEED", help="this random press only")
    parser.add_argument("--presses", type=int, metavar="N", help="N random presses only; 0: none")
    parser.add_argument("--workers", type=int, default=1, help="random presses at the same time")
    parser.add_argument("--kept", type=Path, metavar="FILE", help="JSON lines of finished presses")
    chosen = parser.parse_args()
    print(f"solver: {'PARDISO' if has_pardiso() else 'nested dissection'}", flush=True)
    if chosen.press is not None:
        print(outcome(chosen.press))
        return
    count = QUICK_PRESSES if chosen.quick else PRESSES
    if chosen.presses is not None:
        count = chosen.presses
    result: dict[str, Any] = {} if chosen.presses else dict(measured(chosen.quick))
    result |= summary(press_all(range(count), chosen.workers, chosen.kept))
    result["peak_memory_gib"] = max(result.get("peak_memory_gib", 0.0), result["press_gib"] or 0.0)
    print_figures(result | {"solver": "pardiso" if has_pardiso() else "nested_dissection"})


if __name__ == "__main__":
    main()
