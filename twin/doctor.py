"""Check this machine for the requirements of the twin; every finding has a remedy.

No check raises: an exception becomes a finding.

`python -m twin.doctor` compiles the Numba kernels of ordinary measurements in advance.
"""

from __future__ import annotations

import gc
import importlib.metadata
import importlib.util
import os
import platform
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

import reconstruction
from reconstruction.machine import usable_cores
from twin.assets import Collection, asset_folders, list_assets
from twin.caches import CLEAR, CodeCache, caches, numba_folders
from twin.extras import install, pip_install

DISTRIBUTION = "fringe-twin"
MINIMUM_PYTHON = (3, 11)
MINIMUM_MEMORY_GIB = 4.0  # one 16-bit stack at 1936 x 1464 px is 0.3 GiB
MINIMUM_DISK_GIB = 2.0
_GIB = 2.0**30


@dataclass(frozen=True)
class Finding:
    """Result of one check of this machine.

    Parameters
    ----------
    name : name of the checked property, for example `memory`
    ok : True if the property is sufficient for the twin
    detail : value of the property
    advice : remedy; empty if `ok`
    """

    name: str
    ok: bool
    detail: str
    advice: str = ""


def diagnose() -> list[Finding]:
    """Run all checks of this machine and return their findings.

    Returns
    -------
    Findings in the order in which they should be repaired
    """
    checks: tuple[Callable[[], list[Finding]], ...] = (
        _python,
        _packages,
        _backend,
        _cuda,
        _sheet_solver,
        _cores,
        _memory,
        _caches,
        _assets,
        _disk,
    )
    return [finding for check in checks for finding in _safely(check)]


def _safely(check: Callable[[], list[Finding]]) -> list[Finding]:
    try:
        return check()
    except Exception as error:  # any broken package must give a finding, not end the diagnosis
        name = check.__name__.strip("_").replace("_", " ")
        return [Finding(name, False, f"{type(error).__name__}: {error}", "./run setup")]


def _python() -> list[Finding]:
    ok = sys.version_info >= MINIMUM_PYTHON
    detail = f"{platform.python_version()}, {sys.executable}"
    return [Finding("python", ok, detail, "" if ok else "use Python 3.11 or newer")]


def _packages() -> list[Finding]:
    try:
        requirements = importlib.metadata.requires(DISTRIBUTION) or []
    except importlib.metadata.PackageNotFoundError:
        advice = f"./run setup, or {install()}"
        return [Finding("packages", False, f"{DISTRIBUTION} is not installed", advice)]
    return [_package(line) for line in requirements if "extra ==" not in line]


def _package(requirement: str) -> Finding:
    matched = re.match(r"[A-Za-z0-9._-]+", requirement)
    name = matched[0] if matched else requirement
    try:
        version = importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return Finding(name, False, "not installed", pip_install(requirement))
    floor = re.search(r">=\s*([\d.]+)", requirement)
    if floor and _release(version) < _release(floor[1]):
        return Finding(name, False, version, pip_install(requirement))
    return Finding(name, True, version)


def _release(version: str) -> tuple[int, ...]:
    return tuple(int(part) for part in re.findall(r"\d+", version.partition("+")[0])[:3])


def _backend() -> list[Finding]:
    from twin.optics.backend import MissingBackend, find_backend

    try:
        return [Finding("renderer backend", True, str(find_backend()))]
    except MissingBackend as error:
        problem, _, advice = str(error).rpartition(": ")
        return [Finding("renderer backend", False, problem, advice)]


def _cuda() -> list[Finding]:
    devices = sorted(path.name for path in Path("/dev").glob("nvidia[0-9]*"))
    detail = ", ".join(devices) or "no device, the CPU is used"
    return [Finding("cuda", True, detail)]


def _sheet_solver() -> list[Finding]:
    """Name the linear solver of thin sheets; PARDISO uses several cores, the other solver one."""
    from twin.mechanics.sheet.linear_solver import has_pardiso

    if has_pardiso():
        return [Finding("thin-sheet solver", True, "PARDISO (pypardiso)")]
    detail = "nested dissection (SciPy), 1.2 times the processor time of PARDISO, one core"
    if platform.machine() in {"x86_64", "AMD64"}:
        detail = f"{detail}; to get PARDISO: {install('fast')}"
    return [Finding("thin-sheet solver", True, detail)]


def _cores() -> list[Finding]:
    return [Finding("cores", True, f"{usable_cores()} usable of {os.cpu_count()}")]


def _memory() -> list[Finding]:
    try:
        page = os.sysconf("SC_PAGE_SIZE") / _GIB
        total, free = page * os.sysconf("SC_PHYS_PAGES"), page * os.sysconf("SC_AVPHYS_PAGES")
    except (AttributeError, ValueError):  # Windows has no sysconf, macOS not all of its names
        return [Finding("memory", True, "unknown: this system does not report it")]
    ok = total >= MINIMUM_MEMORY_GIB
    detail = f"{total:.1f} GiB, {free:.1f} GiB unused"
    return [Finding("memory", ok, detail, "" if ok else "render fewer pixels or frames")]


def _caches() -> list[Finding]:
    """Report size and place of the caches of compiled code.

    Without a writable folder for Numba's cache every start of the twin compiles the kernels again.
    """
    findings = [_cache(cache) for cache in caches()]
    chosen = os.environ.get("NUMBA_CACHE_DIR")
    folders = [*([] if chosen else [Path(reconstruction.__file__).parent]), *numba_folders()]
    if not any(map(_is_writable, folders)):
        tried = ", ".join(map(str, folders))
        advice = "set NUMBA_CACHE_DIR to a writable folder"
        findings[0] = Finding(findings[0].name, False, f"not writable: {tried}", advice)
    return findings


def _cache(cache: CodeCache) -> Finding:
    count, strangers = len(list(cache.files())), cache.strangers()
    if strangers:
        detail = f"{strangers[0]} belongs to another user, who could change the code in it"
        return Finding(cache.name, False, detail, "set NUMBA_CACHE_DIR or DRJIT_CACHE_DIR")
    places = _common_folder(cache.folders)
    size = f"{cache.size_bytes() / 1e6:.1f} MB in {count} files"
    return Finding(cache.name, True, f"{size}, {places}; to clear: {CLEAR}")


def _common_folder(folders: tuple[Path, ...]) -> str:
    return os.path.commonpath(folders) if folders else "no folder yet"


def _is_writable(folder: Path) -> bool:
    existing = next(parent for parent in (folder, *folder.absolute().parents) if parent.exists())
    try:
        with tempfile.TemporaryFile(dir=existing):
            return True
    except OSError:
        return False


def _assets() -> list[Finding]:
    return [_collection(name) for name in get_args(Collection)]


def _collection(name: Collection) -> Finding:
    count = len(list_assets(name))
    folders = ", ".join(map(str, asset_folders(name))) or "no folder"
    advice = "" if count else "reinstall fringe-twin, or set TWIN_ASSETS"
    return Finding(name, count > 0, f"{count} files in {folders}", advice)


def _disk() -> list[Finding]:
    free = shutil.disk_usage(Path.cwd()).free / _GIB
    ok = free >= MINIMUM_DISK_GIB
    detail = f"{free:.1f} GiB free in {Path.cwd()}"
    return [Finding("disk", ok, detail, "" if ok else "a full stack takes 300 MB, make room")]


# Groups of kernels. One process per group compiles them, in similar time. The size of the arrays
# in the calls below does not matter.
WARMED = ("renderer, decoder, meshes", "camera noise, filter, thin sheets")


def warm(report: Callable[[str], object] = lambda _: None) -> list[Finding]:
    """Compile the Numba kernels of ordinary measurements in advance, one process per group.

    Parameters
    ----------
    report : is called with name and run time of each group when the group is compiled

    Returns
    -------
    One finding per group of `WARMED`
    """
    start = time.perf_counter()

    def compile_one(name: str) -> Finding:
        command = [sys.executable, "-m", "twin.doctor", name]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        seconds = f"{time.perf_counter() - start:.0f} s"
        if done.returncode:
            reason = (done.stderr.strip().splitlines() or ["no reason given"])[-1]
            return Finding(name, False, reason, "the first measurement compiles them")
        report(f"{name}: {seconds}")
        return Finding(f"kernels: {name}", True, f"compiled or there already, {seconds}")

    with ThreadPoolExecutor() as pool:
        return list(pool.map(compile_one, WARMED))


def _warm_measurement() -> None:
    import numpy as np

    from twin.config import load_experiment
    from twin.pipeline import measure
    from twin.specimens import shape_of
    from twin.specimens.distance import distances_of

    camera = {"camera.binning": 4, "camera.width_px": 640, "camera.height_px": 480}
    coarse = {"press.relief_pitch_mm": 0.05, "press.solver_pitch_mm": 0.16}
    measure(load_experiment("examples/slab_balls", camera | coarse))
    # The press of the other process compiles the distance to a ball.
    for body in distances_of(shape_of(load_experiment("examples/wrapped_nut").specimen)):
        body.evaluate(np.zeros((64, 3)), 1.0)


def _warm_sheets() -> None:
    import numpy as np

    from reconstruction.decoding._filter import Unfiltered, smooth
    from reconstruction.decoding._glints import GlintPixels, GlintScale, add_glint_rows
    from twin.camera import expose
    from twin.config import load_experiment
    from twin.pipeline.press import press_specimen

    coarse = {"press.relief_pitch_mm": 0.05, "press.cell_mm": 0.5, "press.depth_mm": 0.1}
    sheet = {"mechanics.model": "sheet", "press.back_pressure_kpa": 0.0}
    experiment = load_experiment("examples/wrapped_balls", coarse | sheet)
    # Kernels that the other process needs last: of the camera's noise and of the decoder's filter.
    expose(experiment, [np.full((16, 16), 1e-3, np.float32)], white_frame=0)
    maps, mask = np.zeros((2, 16, 16)), np.zeros((16, 16), np.uint8)
    coordinate_px, sigma = maps.astype(np.float32), maps.astype(np.uint16)
    smooth(Unfiltered(coordinate_px, sigma, mask), 5, 1.0, 9.0, 1e-3)
    one = np.float32(1.0)
    scale = GlintScale(one, np.ones(2, np.float32), one, one)
    add_glint_rows(0, 16, GlintPixels(coordinate_px, sigma, mask, sigma[0]), scale)
    press_specimen(experiment)


def _main(names: list[str]) -> bool:
    """Compile the named groups of kernels, or all groups in parallel; return True on success."""
    by_name = dict(zip(WARMED, (_warm_measurement, _warm_sheets), strict=True))
    gc.disable()  # the search for cycles among the compiler's objects takes 8 % of the time
    for name in names:
        by_name[name]()
    if names:
        return True
    findings = warm(lambda done: sys.stderr.write(f"      {done}\n"))
    sys.stderr.writelines(
        f"      {finding.name}: {finding.detail}\n" for finding in findings if not finding.ok
    )
    return all(finding.ok for finding in findings)


if __name__ == "__main__":
    sys.exit(not _main(sys.argv[1:]))
