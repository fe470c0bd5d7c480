"""Accuracy and speed of the press.

Accuracy against Hertz, the Fredholm ball on a layer, finite elements and large strain; speed of
the layer's set-up and of whole solutions on 512 x 512 cells, of every listed specimen, of a study
of 25 cases, and against ContactMechanics (`pip install ContactMechanics`, null if it is not
installed). Seconds are processor seconds, which a busy machine does not change. The last line of
the output is one JSON object. `--quick` omits the finite elements and takes the large-strain
surface from the file of the tests.
"""

import json
import statistics
import time
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from scipy import fft

from benchmarks._harness import print_figures, quick_parser
from twin.config.models import Elastomer, Press
from twin.mechanics import press
from twin.mechanics.contact import solve_contact, solve_on_layer
from twin.mechanics.control import DepthControl
from twin.mechanics.layer import BondedLayer, FreeSlab
from twin.specimens import height_above_lowest
from twin.specimens.kinds.ball import Ball
from twin.specimens.kinds.two_balls import TwoBalls

CELLS, DEPTH_MM, THICKNESS_MM, NU = 512, 0.6, 4.0, 0.49
BONDED_MM, FREE_MM = 28.0, 20.0
STORED = Path(__file__).parents[1] / "tests/mechanics/reference/neo_hookean.json"


def elastomer(layout: str = "opposite_face", **changes: float) -> Elastomer:
    """Return a 20 x 20 x 4 mm slab of 1 MPa."""
    sides = {"length_x_mm": FREE_MM, "length_y_mm": FREE_MM, "thickness_mm": THICKNESS_MM}
    values = sides | {"young_modulus_kpa": 1000.0, "poisson_ratio": NU, "layout": layout}
    return Elastomer.model_validate(values | changes)


def to_depth(depth_mm: float, pitch_mm: float = 0.08) -> Press:
    return Press(control="depth", depth_mm=depth_mm, solver_pitch_mm=pitch_mm)


def cpu_s(action: Callable[[], object], repeats: int = 3) -> float:
    """Return the median processor time of `repeats` calls, seconds."""
    times = []
    for _ in range(repeats):
        start = time.process_time()
        action()
        times.append(time.process_time() - start)
    return statistics.median(times)


# ---- accuracy ------------------------------------------------------------------------------------


def hertz_force_rel(cells: int = 128) -> float:
    """Return the relative error of the force of a paraboloid on a half-space (Love's kernel)."""
    width, radius, depth = 3.0, 10.0, 0.1
    pitch = width / cells
    x = (np.arange(cells) + 0.5) * pitch - width / 2
    lag = pitch * fft.fftfreq(2 * cells, 1 / (2 * cells))
    lag_x, lag_y = np.meshgrid(lag, lag)
    half = pitch / 2

    def corner(p: np.ndarray, q: np.ndarray) -> np.ndarray:
        return p * np.arcsinh(q / np.abs(p)) + q * np.arcsinh(p / np.abs(q))

    kernel = (
        corner(lag_x + half, lag_y + half)
        - corner(lag_x + half, lag_y - half)
        - corner(lag_x - half, lag_y + half)
        + corner(lag_x - half, lag_y - half)
    ) / np.pi
    spectrum = fft.rfft2(kernel)

    def deflect(pressure: np.ndarray) -> np.ndarray:
        wide = fft.rfft2(pressure, s=kernel.shape) * spectrum
        return fft.irfft2(wide, s=kernel.shape)[:cells, :cells]

    paraboloid = (x**2 + x[:, None] ** 2) / (2 * radius)
    solution = solve_contact(deflect, paraboloid, DepthControl(depth), 1e-6)
    force = 4 / 3 * np.sqrt(radius) * depth**1.5
    return abs(float(solution.pressure.sum()) * pitch**2 / force - 1)


def fredholm_max_rel() -> float:
    """Return the largest relative force error of a ball on a pad, chi 0.1 to 1, nu to 0.4999."""
    from tests.oracles.fredholm import press_ball

    worst = 0.0
    for nu in (0.45, 0.49, 0.4999):
        for chi, thickness, pitch in ((0.1, 4.0, 0.02), (0.4, 4.0, 0.04), (1.0, 1.5, 0.04)):
            depth = (chi * thickness) ** 2 / 4.0
            pad = elastomer("contact_face", thickness_mm=thickness, poisson_ratio=nu)
            force_n = press(Ball(), pad, to_depth(depth, pitch)).force_n
            truth = press_ball(4.0, depth, thickness, nu).force_over_modulus_mm2
            worst = max(worst, abs(force_n / truth - 1))
    return worst


def free_fem_face_um() -> float:
    """Return the largest difference of the coated face, free slab, to P2/P1 tetrahedra."""
    from twin.mechanics.reference.fem import press_fem

    load = to_depth(1.0)
    reference = press_fem(Ball(), elastomer(), load, timeout_s=120.0)
    solution = press(Ball(), elastomer(), load)
    return 1e3 * float(np.abs(solution.face_z_mm - reference.face_z_mm).max())


def nh_face_rms_um(quick: bool) -> float | None:
    """Return the RMS difference of the pad's face to large strain, R 4, h 4, d 1, r <= 10 mm."""
    r = np.linspace(0, 10, 401)
    surface = _stored_surface(r) if quick else _computed_surface(r)
    if surface is None:
        return None
    pad = elastomer("contact_face", length_x_mm=24.0, length_y_mm=24.0)
    solution = press(Ball(), pad, to_depth(1.0))
    middle = solution.face_z_mm[solution.face_y_mm.size // 2]
    error = np.interp(r, solution.face_x_mm, middle) - surface
    # Over the disc, so each ring has the weight of its circumference.
    return 1e3 * float(np.sqrt(np.average(error**2, weights=r)))


def _computed_surface(r_mm: np.ndarray) -> np.ndarray:
    from tests.oracles.axisymmetric import RoundSlab, press_axisymmetric

    slab = RoundSlab(THICKNESS_MM, 28.0, NU, "bonded")
    return press_axisymmetric(slab, 4.0, 1.0).touched_face_mm(r_mm)


def _stored_surface(r_mm: np.ndarray) -> np.ndarray | None:
    if not STORED.is_file():
        return None
    case = json.loads(STORED.read_text())["bonded_r4_h4_d1"]
    return np.interp(r_mm, case["r_mm"], case["touched_face_mm"])


# ---- speed ---------------------------------------------------------------------------------------


def listed_specimens(x_mm: np.ndarray) -> Iterator[tuple[str, np.ndarray]]:
    """Yield name and height above the foremost point of the paper's objects, mm."""
    x, y = np.meshgrid(x_mm, x_mm)
    r = np.hypot(x, y)
    yield "ball", height_above_lowest(Ball(), x_mm, x_mm)
    yield "two balls", height_above_lowest(TwoBalls(), x_mm, x_mm)
    for radius in (1.0, 2.4, 3.6):
        inside = (np.abs(y) < radius) & (np.abs(x) < 7.0)
        fall = radius - np.sqrt(np.maximum(radius**2 - y**2, 0.0))
        yield f"rod {2 * radius:g}", np.where(inside, fall, np.inf)
    flats = [np.abs(x * np.cos(a) + y * np.sin(a)) for a in np.deg2rad((0.0, 60.0, 120.0))]
    yield "nut", np.where((r > 2.5) & (np.maximum.reduce(flats) < 5.0), 0.0, np.inf)
    brick = np.where((np.abs(x) < 7.9) & (np.abs(y) < 3.9), 1.7, np.inf)
    for at_x in (-6.0, -2.0, 2.0, 6.0):
        for at_y in (-2.0, 2.0):
            brick = np.where(np.hypot(x - at_x, y - at_y) < 1.2, 0.0, brick)
    yield "brick", brick
    bear = r**2 / 40 - 0.5 * np.cos(2 * x) * np.cos(2 * y)
    yield "bear", np.where(r < 5.0, bear - bear.min(), np.inf)


def free() -> FreeSlab:
    return FreeSlab(CELLS, CELLS, FREE_MM, FREE_MM, THICKNESS_MM, NU)


def bonded() -> BondedLayer:
    return BondedLayer(CELLS, CELLS, BONDED_MM, BONDED_MM, THICKNESS_MM, NU)


def solve_free(height_mm: np.ndarray) -> None:
    """Set up and solve, both faces."""
    slab = free()
    solution = solve_on_layer(slab, height_mm, DepthControl(DEPTH_MM))
    slab.deflect_opposite(solution.pressure)


def bonded_force(height_mm: np.ndarray) -> float:
    """Set up and solve; return the force over the modulus, mm2."""
    layer = bonded()
    solution = solve_on_layer(layer, height_mm, DepthControl(DEPTH_MM))
    return float(solution.pressure.sum()) * layer.cell_area_mm2


def study() -> None:
    """Two balls, thickness x depth, 25 presses at 80 um with their reliefs."""
    for thickness in (2.0, 2.5, 3.0, 3.5, 4.0):
        slab = elastomer(thickness_mm=thickness, length_x_mm=24.0)
        for depth in (0.2, 0.4, 0.6, 0.8, 1.0):
            press(TwoBalls(), slab, to_depth(depth))


def contact_mechanics_s(height_mm: np.ndarray) -> float | None:
    """Return the processor time of the same bonded case by ContactMechanics; print both forces."""
    try:
        from ContactMechanics import PeriodicFFTElasticHalfSpace
        from ContactMechanics.Systems import NonSmoothContactSystem
        from SurfaceTopography import Topography
    except ImportError:
        print("ContactMechanics is not installed: over_contactmechanics is null", flush=True)
        return None
    size = (BONDED_MM, BONDED_MM)
    far = np.where(np.isfinite(height_mm), height_mm, 50.0)  # it has no absent cells
    system = NonSmoothContactSystem(
        PeriodicFFTElasticHalfSpace((CELLS, CELLS), 1.0, size, thickness=THICKNESS_MM, poisson=NU),
        Topography(-far, size, periodic=True),
    )
    peer_s = cpu_s(lambda: system.minimize_proxy(offset=DEPTH_MM, pentol=1e-5 * DEPTH_MM), 1)
    force, own = float(system.compute_normal_force()), bonded_force(height_mm)
    print(f"ContactMechanics: {peer_s:.2f} s, F / E {force:.5f}, here {own:.5f}", flush=True)
    return peer_s


def fft_pair_s() -> float:
    """Return the time of a transform of 1024 x 1024 cells and back, the unit of the ratios."""
    cells = np.random.default_rng(1).normal(size=(2 * CELLS, 2 * CELLS))

    def pairs() -> None:
        for _ in range(10):
            fft.irfft2(fft.rfft2(cells), s=cells.shape)

    pairs()
    return cpu_s(pairs, 5) / 10


def speed() -> dict[str, float | None]:
    """Return the seconds of set-up, solutions and study."""
    ball = height_above_lowest(Ball(), bonded().x_mm, bonded().x_mm)
    bonded_s, each = cpu_s(lambda: bonded_force(ball)), {}
    for name, height in listed_specimens(free().x_mm):
        each[name] = cpu_s(lambda height=height: solve_free(height), 1 if name == "brick" else 3)
        print(f"free back, {name}: {each[name]:.2f} s", flush=True)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        peer_s = contact_mechanics_s(ball)
    empty = np.zeros((CELLS, CELLS))
    return {
        "fft_pair_s": fft_pair_s(),
        "setup_s": cpu_s(lambda: free().deflect(empty)),
        "bonded_512_s": bonded_s,
        "free_ball_512_s": each["ball"],
        "slowest_specimen_s": max(each.values()),
        "study_25_s": cpu_s(study, 1),
        "over_contactmechanics": bonded_s / peer_s if peer_s else None,
    }


def main() -> None:
    quick = quick_parser(__doc__, "no finite elements").parse_args().quick
    print("accuracy", flush=True)
    result: dict[str, float | None] = {
        "hertz_force_rel": hertz_force_rel(),
        "fredholm_max_rel": fredholm_max_rel(),
        "free_fem_face_um": None if quick else free_fem_face_um(),
        "nh_face_rms_um": nh_face_rms_um(quick),
    }
    print("speed, processor seconds", flush=True)
    print_figures(result | speed())


if __name__ == "__main__":
    main()
