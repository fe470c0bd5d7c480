"""Calibrations of other programs: share that `import-calibration` reads right.

Inputs are public files where the folder ../shared/cases/07_calibrations exists, and files of random
rigs in every layout of `tests/corpus/calibrations.py`. A file is read right if image sizes, camera
matrices, distortions and pose equal the rig in the file. For public files these are read by OpenCV
or the JSON parser under the names that their program's source states.

The last line is one JSON object with `imports_right`, 0 to 1.
"""

import json
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks._harness import print_figures, quick_parser
from reconstruction.errors import InputError
from reconstruction.rig.importing import import_calibration
from reconstruction.rig.pinhole import Pinhole
from tests.corpus.calibrations import LAYOUTS
from tests.corpus.rigs import Content, Rig, misread, random_rig

CASES = Path(__file__).parents[1] / "../shared/cases/07_calibrations"
# Assumed for a public file without the projector's size.
PROJECTOR_SIZE = (1920, 1080)
# The program's sample capture has Gray code rows up to 767. In steps of two pixels, with this size,
# the median distance of its points from the epipolar lines is 2.6 px.
KAMINO_PROJECTOR_SIZE = (2048, 1536)
RIGS, QUICK_RIGS = 10, 1


def public_rigs(folder: Path) -> Iterator[tuple[list[Path], Rig, Content]]:
    """Yield files, their rig read by the names in the program's source, and their content."""
    needs_size = Content(frozenset({"projector"}), tolerance=1e-6)
    complete = Content(tolerance=1e-6)
    for name, keys, sizes, content in (
        ("slstudio.xml", ("Kc", "kc", "Kp", "kp", "Rp", "Tp"), (1688, 1352, 1824, 1140), complete),
        ("slmaster_mono.yml", ("M1", "D1", "M4", "D4", "Rlp", "Tlp"), (1280, 1024), needs_size),
        (
            "kamino.xml",
            ("cam_int", "cam_dist", "proj_int", "proj_dist", "roration", "translation"),
            (1280, 1024, *KAMINO_PROJECTOR_SIZE),
            needs_size,
        ),
    ):
        if (folder / name).is_file():
            storage = cv2.FileStorage(str(folder / name), cv2.FILE_STORAGE_READ)
            parts = [storage.getNode(key).mat().astype(float) for key in keys]
            yield [folder / name], _rig(parts, (*sizes, *PROJECTOR_SIZE)[:4]), content
    files = [folder / f"scannersim_{name}_geometry.json" for name in ("camera", "projector")]
    if all(file.is_file() for file in files):
        yield files, _of_scanner_sim(files), complete


def _of_scanner_sim(files: list[Path]) -> Rig:
    lenses = [json.loads(file.read_text("utf-8")) for file in files]
    matrices = [np.array(lens["mtx"]) for lens in lenses]
    matrices[1][:2, 2] -= 0.5  # projector pixels are counted from the corner of the first
    sizes = [lens[f"image_{side}, pixels"] for lens in lenses for side in ("width", "height")]
    R, origin = np.array(lenses[1]["basis"]), np.array(lenses[1]["origin"])
    distortions = [np.array(lens["dist"]) for lens in lenses]
    parts = [matrices[0], distortions[0], matrices[1], distortions[1], R, -R @ origin]
    return _rig(parts, tuple(sizes))


def _rig(parts: list[np.ndarray], sizes: tuple[int, ...]) -> Rig:
    """Return the rig of both matrices and distortions, R and T."""
    devices = [
        Pinhole(*size, K[0, 0], K[1, 1], K[0, 2], K[1, 2], tuple(bent.ravel()))
        for size, K, bent in zip((sizes[:2], sizes[2:]), parts[0:4:2], parts[1:4:2], strict=True)
    ]
    return Rig(devices[0], devices[1], parts[4], parts[5].ravel())


def is_right(name: str, files: list[Path], rig: Rig, content: Content) -> bool:
    """Return True if files are read as the rig; else print what differs."""
    try:
        wrong: Any = misread(import_calibration(files, content.options(rig)), content, rig)
    except InputError as error:
        wrong = error
    if wrong:
        print(f"{name}: {wrong}")
    return not wrong


def reality_calibrations(quick: bool) -> dict[str, float]:
    """Return the share of calibrations that are read right, see the module docstring."""
    right = [
        is_right(files[0].name, files, rig, content) for files, rig, content in public_rigs(CASES)
    ]
    rng = np.random.default_rng(52)
    for number in range(QUICK_RIGS if quick else RIGS):
        rig = random_rig(rng)
        for name, layout in LAYOUTS.items():
            with tempfile.TemporaryDirectory() as folder:
                files = layout.write(Path(folder), rig)
                label = f"{name}, rig {number}"
                right.append(is_right(label, files, rig, layout.content))
    return {"imports_right": float(np.mean(right))}


def main() -> None:
    parser = quick_parser(__doc__, f"{QUICK_RIGS} rig per layout instead of {RIGS}")
    print_figures(reality_calibrations(parser.parse_args().quick))


if __name__ == "__main__":
    main()
