"""What a case looks like, small: the camera's image, measured heights and their error.

Cases keep figures, not arrays. The few designs that a report shows are measured once more, by the
same path and so with the same bytes, and what it draws is kept as DIR/pictures/DIGEST.npz: drawn
again it needs no renderer.
"""

import os
import zipfile
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from reconstruction.disk import unwritable
from reconstruction.errors import InputError
from twin.config import Experiment
from twin.optics.rig import camera_pinhole
from twin.pipeline import Memory, measure
from twin.pipeline.colours import PhotometricMeasurement
from twin.pipeline.fringes import Measurement
from twin.pipeline.photometric_score import wanted_of
from twin.pipeline.progress import Watcher, nobody
from twin.pipeline.score import wanted_pixels
from twin.study.cases import Case
from twin.study.store import Store

_FOLDER = "pictures"
_MOST_PX = 360


@dataclass(frozen=True, eq=False)
class CasePicture:
    """One case in camera pixels, thinned out; row 0 is the top, and nothing is NaN.

    Attributes
    ----------
    seen : (row, col) or (row, col, rgb) uint8
        First phase frame, 255 at saturation, or the colour image of photometric stereo.
    z_mm, measured : (row, col) float32 and bool
        Measured world z, and where there is a measurement.
    error_um, scored : (row, col) float32 and bool
        Measured minus true z, and where both are.
    true_z_mm : (2,) float64
        Lowest and highest true z in the image.
    width_mm : () float64
        Width of the image on the flat coated face.
    """

    seen: NDArray[np.uint8]
    z_mm: NDArray[np.float32]
    measured: NDArray[np.bool_]
    error_um: NDArray[np.float32]
    scored: NDArray[np.bool_]
    true_z_mm: NDArray[np.float64]
    width_mm: NDArray[np.float64]


def pictures_of(
    store: Store, cases: Iterable[Case], watch: Watcher = nobody
) -> tuple[dict[str, CasePicture], dict[str, str]]:
    """Return the pictures of cases by digest, and for those that have none the reason.

    What the store keeps is read; the others are measured, in the order given, and kept.

    Raises
    ------
    InputError
        The store cannot be written.
    """
    found: dict[str, CasePicture] = {}
    failed: dict[str, str] = {}
    wanted, memory = list(cases), Memory()
    for number, case in enumerate(wanted, start=1):
        try:
            found[case.digest] = _picture(store, case, memory)
        except InputError as error:
            failed[case.digest] = str(error)
        except RuntimeError as error:
            if type(error).__name__ != "MissingBackend":
                raise
            failed[case.digest] = str(error)
        watch("pictures", number / len(wanted))
    return found, failed


def _picture(store: Store, case: Case, memory: Memory) -> CasePicture:
    path = store.folder / _FOLDER / f"{case.digest}.npz"
    kept = read_picture(path)
    if kept is not None:
        return kept
    store.check_versions()  # other versions would measure something else than the table tells
    picture = take_picture(case.experiment, memory)
    write_picture(path, picture)
    return picture


def take_picture(experiment: Experiment, memory: Memory) -> CasePicture:
    """Measure a case as its study did, and thin it out.

    Raises
    ------
    InputError
        Something in the experiment cannot be pressed, rendered or fitted.
    MissingBackend
        No usable Dr.Jit backend.
    """
    done = measure(experiment, memory=memory)
    if isinstance(done, Measurement):
        return _of_fringes(experiment, done)
    return _of_colours(experiment, done)


def _of_fringes(experiment: Experiment, done: Measurement) -> CasePicture:
    capture, truth = done.recording.capture, done.recording.truth
    points = done.reconstruction.point_map
    first = capture.patterns.index("phase", "column").start
    share = capture.stack[first] / np.float32(capture.sensor.saturation_dn)
    z_mm, true_z_mm = points.points_world_mm[..., 2], truth.points_world_mm[..., 2]
    pixel_mm = experiment.camera.pose.standoff_mm / camera_pinhole(experiment.camera).fx_px
    return _thinned(
        seen=np.rint(255 * np.clip(share, 0.0, 1.0)).astype(np.uint8),
        z_mm=z_mm,
        measured=points.valid,
        true_z_mm=true_z_mm,
        there=truth.depth_mm > 0,
        scored=points.valid & wanted_pixels(experiment, truth),
        width_mm=pixel_mm * z_mm.shape[1],
    )


def _of_colours(experiment: Experiment, done: PhotometricMeasurement) -> CasePicture:
    heights, truth = done.heights, done.truth
    return _thinned(
        seen=done.image,
        z_mm=heights.height_mm,
        measured=heights.valid,
        true_z_mm=truth.points_world_mm[..., 2],
        there=truth.measured,
        scored=heights.valid & wanted_of(experiment, truth),
        width_mm=heights.pitch_mm * heights.height_mm.shape[1],
    )


def _thinned(
    *,
    seen: NDArray[np.uint8],
    z_mm: NDArray[np.floating],
    measured: NDArray[np.bool_],
    true_z_mm: NDArray[np.floating],
    there: NDArray[np.bool_],
    scored: NDArray[np.bool_],
    width_mm: float,
) -> CasePicture:
    """Average the image; take every n-th height, which must not be averaged across edges."""
    step = -(-max(z_mm.shape) // _MOST_PX)
    error_um = np.where(scored, 1e3 * (z_mm.astype(np.float64) - true_z_mm), 0.0)
    size = -(-seen.shape[1] // step), -(-seen.shape[0] // step)
    ends = (true_z_mm[there].min(), true_z_mm[there].max()) if there.any() else (0.0, 1.0)
    return CasePicture(
        seen=np.asarray(cv2.resize(seen, size, interpolation=cv2.INTER_AREA), np.uint8),
        z_mm=np.where(measured, z_mm, 0.0)[::step, ::step].astype(np.float32),
        measured=measured[::step, ::step],
        error_um=error_um[::step, ::step].astype(np.float32),
        scored=scored[::step, ::step],
        true_z_mm=np.array(ends, np.float64),
        width_mm=np.array(width_mm, np.float64),
    )


def write_picture(path: Path, picture: CasePicture) -> None:
    """Write a picture, whole or not at all.

    Raises
    ------
    InputError
        It cannot be written.
    """
    part = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        path.parent.mkdir(exist_ok=True)
        with part.open("wb") as file:
            np.savez_compressed(file, **asdict(picture))
        part.replace(path)
    except OSError as error:
        with suppress(OSError):
            part.unlink()
        raise unwritable(path, error) from None


def read_picture(path: Path) -> CasePicture | None:
    """Read a picture; None when it is missing or damaged."""
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as kept:
            return CasePicture(**{name: kept[name] for name in CasePicture.__annotations__})
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        return None
