"""Pictures of cases at reduced size: camera image, measured heights and error of the heights.

A store has the figures of a case, but not its arrays. The few designs that a report shows are
measured again by the same pipeline, which gives the same bytes. Their pictures are stored as
DIR/pictures/DIGEST.npz, which reports read.
"""

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import cv2
import numpy as np

from reconstruction.arrays import BoolImage, FloatArray, FloatImage, Levels
from reconstruction.errors import InputError
from reconstruction.reading import read_arrays
from reconstruction.writing import write_npz
from twin.config import Experiment
from twin.config.study import Objective
from twin.files import naming_unwritable
from twin.pipeline import Memory, measure
from twin.pipeline.progress import ProgressCallback, no_progress
from twin.results.record import Measurement
from twin.results.score import wanted_pixels
from twin.study.cases import Case
from twin.study.store import Store
from twin.study.table import designs_of, goals_of, ranked_rows, read_table, usable_rows

_FOLDER = "pictures"
_MOST_PX = 360


@dataclass(frozen=True, eq=False)
class CasePicture:
    """Maps of a case on a reduced grid of camera pixels, without NaN; row 0 is the top.

    Attributes
    ----------
    seen : (row, col) or (row, col, rgb) uint8
        First phase-shift frame, or the colour image of photometric stereo; 255 is saturation.
    z_mm, measured : (row, col) float32 and bool
        Measured world z, mm, and mask of the pixels with a measurement.
    error_um, scored : (row, col) float32 and bool
        Measured minus true z, um, and mask of the pixels that have both.
    true_z_mm : (2,) float64
        Lowest and highest true world z in the image, mm.
    width_mm : () float64
        Width of the image on the flat coated face, mm.
    """

    seen: Levels
    z_mm: FloatImage
    measured: BoolImage
    error_um: FloatImage
    scored: BoolImage
    true_z_mm: FloatArray
    width_mm: FloatArray


def picture_best(
    folder: Path, objectives: Sequence[Objective] = (), watch: ProgressCallback = no_progress
) -> dict[str, str]:
    """Make and store the missing pictures of the best designs of a study.

    Returns
    -------
    dict
        By digest of each design without a picture, the reason.

    Raises
    ------
    InputError : the folder is not a store, or it cannot be written
    """
    table = read_table(folder)
    goals = goals_of(table, objectives)
    if not usable_rows(table.done(), goals):
        return {}
    rows = designs_of(ranked_rows(table.done(), goals), table.axes)
    by_digest = {case.digest: case for case in table.cases}
    return pictures_of(Store(folder), [by_digest[row["case"]] for row in rows], watch)[1]


def pictures_of(
    store: Store, cases: Iterable[Case], watch: ProgressCallback = no_progress
) -> tuple[dict[str, CasePicture], dict[str, str]]:
    """Return the pictures of cases, and the reasons for missing pictures, both by digest.

    Pictures in the store are read; other cases are measured in the given order, and stored.

    Raises
    ------
    InputError : the store cannot be written
    """
    pictures: dict[str, CasePicture] = {}
    failed: dict[str, str] = {}
    wanted, memory = list(cases), Memory()
    for number, case in enumerate(wanted, start=1):
        try:
            pictures[case.digest] = _picture(store, case, memory)
        except InputError as error:
            failed[case.digest] = str(error)
        except RuntimeError as error:
            if type(error).__name__ != "MissingBackend":
                raise
            failed[case.digest] = str(error)
        watch("pictures", number / len(wanted))
    return pictures, failed


def stored_picture(folder: Path, digest: str) -> CasePicture | None:
    """Return the stored picture of a case; None if it is missing or damaged."""
    return read_picture(_file(folder, digest))


def _file(folder: Path, digest: str) -> Path:
    return folder / _FOLDER / f"{digest}.npz"


def _picture(store: Store, case: Case, memory: Memory) -> CasePicture:
    path = _file(store.folder, case.digest)
    stored = read_picture(path)
    if stored is not None:
        return stored
    store.check_versions()  # other versions could give other values than the table
    picture = take_picture(case.experiment, memory)
    write_picture(path, picture)
    return picture


def take_picture(experiment: Experiment, memory: Memory) -> CasePicture:
    """Measure an experiment and return its reduced maps.

    Raises
    ------
    InputError, MissingBackend : as `twin.pipeline.measure`
    """
    return picture_of(measure(experiment, memory=memory))


def picture_of(done: Measurement) -> CasePicture:
    """Return the reduced maps of a measurement.

    The camera image is averaged. Of the heights every n-th is taken, as an average over an edge is
    not a height of the object.
    """
    points, truth = done.points, done.truth
    z_mm, true_z_mm = points.world_mm[..., 2], truth.points_world_mm[..., 2]
    scored = points.valid & wanted_pixels(done.experiment, truth)
    step = -(-max(z_mm.shape) // _MOST_PX)
    error_um = np.where(scored, 1e3 * (z_mm.astype(np.float64) - true_z_mm), 0.0)
    size = -(-z_mm.shape[1] // step), -(-z_mm.shape[0] // step)
    there = truth.depth_mm > 0
    ends = (true_z_mm[there].min(), true_z_mm[there].max()) if there.any() else (0.0, 1.0)
    return CasePicture(
        seen=np.asarray(cv2.resize(done.picture, size, interpolation=cv2.INTER_AREA), np.uint8),
        z_mm=np.where(points.valid, z_mm, 0.0)[::step, ::step].astype(np.float32),
        measured=points.valid[::step, ::step],
        error_um=error_um[::step, ::step].astype(np.float32),
        scored=scored[::step, ::step],
        true_z_mm=np.array(ends, np.float64),
        width_mm=np.array(done.pixel_mm * z_mm.shape[1], np.float64),
    )


def write_picture(path: Path, picture: CasePicture) -> None:
    """Write a picture as an NPZ file in one atomic step.

    Raises
    ------
    InputError : the file cannot be written
    """
    with naming_unwritable(path):
        path.parent.mkdir(exist_ok=True)
        write_npz(path, asdict(picture))


def read_picture(path: Path) -> CasePicture | None:
    """Read a picture from an NPZ file; return None if the file is missing or damaged."""
    try:
        arrays = read_arrays(path)
        return CasePicture(**{name: arrays[name] for name in CasePicture.__annotations__})
    except (InputError, KeyError):
        return None
