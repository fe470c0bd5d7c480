"""Random presses of the thin sheet: how many converge, and their run time and memory.

Specimen, thickness (0.05 to 1 mm), travel (0.1 to 2 mm), tack, pressure (0 to 5 kPa) and pose are
drawn from a seed, in a frame of 26 x 26 mm. Each press runs in a process of its own, as a user's
does, with a limit of its processor time. A press converges; or is refused, with the largest
pressure that has an equilibrium, which counts neither way; or fails.
"""

import hashlib
import json
import multiprocessing
import resource
import signal
import statistics
import time
from collections import Counter
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from types import FrameType

import numpy as np

import twin.mechanics.sheet
from twin.config.models import Elastomer, Mechanics, Press, Specimen
from twin.mechanics.sheet.path import LimitPressureError
from twin.mechanics.sheet.press import press_sheet
from twin.specimens.kinds.ball import Ball
from twin.specimens.kinds.bar import Bar
from twin.specimens.kinds.brick import Brick
from twin.specimens.kinds.flat import Flat
from twin.specimens.kinds.grating import Grating
from twin.specimens.kinds.nut import Nut
from twin.specimens.kinds.rod import Rod
from twin.specimens.kinds.step import Step
from twin.specimens.kinds.t_bolt import TBolt
from twin.specimens.kinds.two_balls import TwoBalls

PRESSES, QUICK_PRESSES, LIMIT_S = 300, 12, 900.0
SPAN_MM, YOUNG_KPA = 26.0, 300.0


@dataclass(frozen=True)
class PressOutcome:
    """How a press ended, its processor time and its memory.

    Attributes
    ----------
    end : converged, refused or failed
    message : the drawn press, and the error if it did not converge
    code : digest of the solver's sources
    """

    seed: int
    end: str
    message: str
    cpu_s: float
    memory_gib: float
    code: str


def random_press(seed: int) -> tuple[Specimen, Elastomer, float, dict[str, float]]:
    """Draw a specimen in its pose, a sheet, a travel and a load; the specimen fits the frame."""
    rng = np.random.default_rng([20261122, seed])
    pose = {
        "x_mm": rng.uniform(-1.5, 1.5),
        "y_mm": rng.uniform(-1.5, 1.5),
        "yaw_deg": rng.uniform(-180, 180),
        "tilt_deg": rng.uniform(-5, 5),
    }
    kinds: tuple[Callable[[], Specimen], ...] = (
        lambda: Ball(diameter_mm=rng.uniform(4, 10), **pose),
        lambda: TwoBalls(**pose),
        lambda: Rod(diameter_mm=rng.uniform(1.5, 8), **pose),
        lambda: Flat(diameter_mm=rng.uniform(3, 10), **pose),
        lambda: Bar(width_mm=rng.uniform(1.5, 8), length_mm=12.0, **pose),
        lambda: Step(**pose),
        lambda: Nut(**pose),
        lambda: TBolt(**pose),
        lambda: Brick(**pose),
        lambda: Grating(**pose),
    )
    kind = kinds[rng.integers(len(kinds))]
    tack = float(rng.uniform(0.02, 0.5)) if rng.random() < 0.5 else 0.0
    sheet = Elastomer(
        young_modulus_kpa=YOUNG_KPA,
        poisson_ratio=0.49,
        thickness_mm=float(np.exp(rng.uniform(np.log(0.05), 0.0))),
        length_x_mm=SPAN_MM,
        length_y_mm=SPAN_MM,
        tack_j_m2=tack,
        friction="none" if rng.random() < 0.2 else "auto",
    )
    load = {"back_pressure_kpa": float(rng.uniform(0, 5)) if rng.random() < 0.5 else 0.0}
    return kind(), sheet, float(rng.uniform(0.1, 2.0)), load


class TooLongError(Exception):
    """A press has used up its processor time."""


def outcome(seed: int) -> PressOutcome:
    """Press and return how it ended.

    A refused press names the largest pressure with an equilibrium; any other error is a failure.
    """
    specimen, sheet, travel, load = random_press(seed)
    text = (
        f"{specimen.kind}, h {sheet.thickness_mm:.3f}, travel {travel:.2f}, "  # type: ignore[attr-defined]
        f"G {sheet.tack_j_m2:.2f} ({sheet.friction}), {load['back_pressure_kpa']:.2f} kPa"
    )
    values = {"control": "depth", "depth_mm": travel, "relief_pitch_mm": 0.05} | load
    start = time.process_time()
    signal.signal(signal.SIGPROF, _end)
    signal.setitimer(signal.ITIMER_PROF, LIMIT_S)
    end = "converged"
    try:
        press_sheet(specimen, sheet, Press.model_validate(values), Mechanics(model="sheet"))
    except LimitPressureError as error:
        end, text = "refused" if error.held_kpa > 0 else "failed", f"{text}: {error}"
    except Exception as error:  # any error is counted and printed
        end, text = "failed", f"{text}: {type(error).__name__}: {error}"
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
    took = time.process_time() - start
    # Linux gives KiB.
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    return PressOutcome(seed, end, text, round(took, 1), round(memory, 3), code_digest())


def _end(_signal: int, _frame: FrameType | None) -> None:
    raise TooLongError(f"not done within {LIMIT_S:g} s of processor time")


def code_digest() -> str:
    """Return the digest of the solver's sources, which identifies stored presses."""
    files = sorted(Path(twin.mechanics.sheet.__path__[0]).glob("*.py"))
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()[:12]


def press_all(seeds: Iterable[int], workers: int, cache: Path | None) -> list[PressOutcome]:
    """Press at random in processes of their own; reuse the presses of a file, and add to it."""
    known: dict[int, PressOutcome] = {}
    if cache is not None and cache.exists():
        lines = map(json.loads, cache.read_text(encoding="utf-8").splitlines())
        known = {line["seed"]: PressOutcome(**line) for line in lines}
    outcomes = [known[seed] for seed in seeds if seed in known]
    left = [seed for seed in seeds if seed not in known]
    context = multiprocessing.get_context("spawn")
    # One press per process, so that its memory is known, and released.
    with ProcessPoolExecutor(workers, mp_context=context, max_tasks_per_child=1) as pool:
        for number, pressed in enumerate(pool.map(outcome, left), 1):
            outcomes.append(pressed)
            print(f"{number} of {len(left)}: {pressed}", flush=True)
            if cache is not None:
                with cache.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(asdict(pressed)) + "\n")
    return outcomes


def summary(outcomes: list[PressOutcome]) -> dict[str, float | None]:
    """Return the share that converged of those not refused, and median time and peak memory."""
    ends = Counter(pressed.end for pressed in outcomes)
    judged = ends["converged"] + ends["failed"]
    return {
        "presses": float(len(outcomes)),
        "presses_of_this_code": float(sum(one.code == code_digest() for one in outcomes)),
        "converged_share": ends["converged"] / judged if judged else None,
        "refused": float(ends["refused"]),
        "press_s": statistics.median(one.cpu_s for one in outcomes) if outcomes else None,
        "press_gib": max((one.memory_gib for one in outcomes), default=None),
    }
