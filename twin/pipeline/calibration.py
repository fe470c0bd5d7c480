"""Calibrate a rig on captures of a board, or on rendered captures of an experiment's rig.

In a rendered calibration the true rig is known, and so the error of every parameter.
"""

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from reconstruction.arrays import Levels
from reconstruction.calibration import (
    AdjustOptions,
    BoardCapture,
    Observation,
    calibrate,
    observe,
    read_board_capture,
)
from reconstruction.calibration.observation import pose_folders
from reconstruction.capture.folder import Capture, write_capture
from reconstruction.capture.frame_set import write_frame_set
from reconstruction.errors import InputError, require_instance
from reconstruction.rig.calibration import Calibration
from twin.camera import expose
from twin.config import Experiment, digest
from twin.config.board import BoardFile, BoardPose, load_board
from twin.optics.board import render_board
from twin.optics.light import pattern_set
from twin.optics.rig import true_calibration
from twin.pipeline.board_calibration import BoardCalibration, SkippedPose
from twin.pipeline.progress import ProgressCallback, no_progress

if TYPE_CHECKING:
    pass


LEAST_POSES = 3


def record_board(
    experiment: Experiment, board: BoardFile, pose: BoardPose, number: int = 0
) -> BoardCapture:
    """Return the rendered capture of a board in one pose.

    Parameters
    ----------
    number : number of the pose, which selects the temporal noise

    Raises
    ------
    MissingBackend : there is no usable Dr.Jit backend
    """
    frames = render_board(experiment, board, pose)
    patterns = pattern_set(experiment.projector, experiment.patterns)
    exposed = expose(experiment, frames, patterns.exposure_frame, number)
    return BoardCapture(exposed.stack, patterns, exposed.sensor)


def calibrate_rendered(
    experiment: Experiment,
    board: BoardFile,
    options: AdjustOptions | None = None,
    *,
    keep: Path | None = None,
    as_images: bool = False,
    watch: ProgressCallback = no_progress,
) -> BoardCalibration:
    """Render every pose of a board file, and calibrate on the captures.

    Parameters
    ----------
    experiment : gives rig, patterns, camera noise and seed; specimen and press are not used
    keep : new folder in which the captures are stored, each with the true calibration; None: they
        are not stored
    as_images : True: the stored captures have image files, as a real camera gives them, and no
        true calibration

    Raises
    ------
    InputError : the board file has no poses, or the board is not recognised in a pose
    MissingBackend : there is no usable Dr.Jit backend
    """
    if not board.poses:
        raise InputError("the board file has no [[poses]]: add at least 3 (better 12) to render")
    observed = []
    for number, pose in enumerate(board.poses):
        name = f"pose_{number:02d}"
        watch("poses", number / len(board.poses))
        capture = record_board(experiment, board, pose, number)
        if keep is not None:
            _keep(keep / name, capture, experiment, as_images)
        observed.append(observe(capture, board.board(), name))
    watch("poses", 1.0)
    named = _digest([digest(experiment), _canonical(board), repr(options)])
    return BoardCalibration(calibrate(observed, options), tuple(observed), named, experiment)


def calibrate_captures(
    folder: Path,
    board: BoardFile,
    options: AdjustOptions | None = None,
    *,
    watch: ProgressCallback = no_progress,
) -> BoardCalibration:
    """Calibrate on a folder with one capture folder per board pose.

    Poses that are incomplete, have a different image size, or show no board are left out, with a
    warning. The first pose that is used defines the world frame.

    Raises
    ------
    InputError : too few poses can be used, or they do not determine the rig
    """
    folders = pose_folders(folder)
    observed: list[Observation] = []
    skipped: list[SkippedPose] = []
    named, size = [_canonical(board), repr(options)], ""
    for number, path in enumerate(folders):
        watch("poses", number / len(folders))
        capture: BoardCapture | None = None
        try:
            capture = read_board_capture(path)
            _require_size(path.name, capture, size, observed[0].name if observed else "")
            observed.append(observe(capture, board.board(), path.name))
        except InputError as error:
            skipped.append(SkippedPose(path.name, str(error), _picture(capture)))
            continue
        size = _size(capture)
        named.append(hashlib.blake2b(capture.stack.tobytes(), digest_size=8).hexdigest())
    watch("poses", 1.0)
    if skipped and len(observed) < LEAST_POSES:
        reasons = "; ".join(pose.reason for pose in skipped)
        raise InputError(
            f"{len(observed)} of {len(folders)} poses can be used, {LEAST_POSES} are needed: "
            f"{reasons}"
        )
    result = calibrate(observed, options)
    return BoardCalibration(result, tuple(observed), _digest(named), skipped=tuple(skipped))


def calibrate_rig(
    source: Experiment | Path | str,
    board: BoardFile | Path | str = "boards/paper_dots",
    options: AdjustOptions | None = None,
    *,
    watch: ProgressCallback = no_progress,
) -> BoardCalibration:
    """Calibrate camera and projector on real or rendered captures of a board.

    Parameters
    ----------
    source : path of a folder with one capture folder per board pose; the first pose that is used
        defines the world frame. Or an experiment: its rig is rendered with the poses of the board
        file
    board : board file, its path, or the name of a shipped board
    options : estimated parameters and corrections; None: the defaults

    Raises
    ------
    InputError : too few poses can be used, or they do not determine the rig; for an experiment: the
        board file has no poses, or the board is not recognised in a pose
    MissingBackend : `source` is an experiment, and there is no usable Dr.Jit backend
    """
    kinds, remedy = (Experiment, Path, str), "give an experiment, or a folder of captures"
    require_instance("source", source, kinds, remedy)
    shown = board if isinstance(board, BoardFile) else load_board(board)
    if isinstance(source, Experiment):
        return calibrate_rendered(source, shown, options, watch=watch)
    return calibrate_captures(Path(source), shown, options, watch=watch)


def _require_size(name: str, capture: BoardCapture, size: str, first: str) -> None:
    if size and _size(capture) != size:
        raise InputError(
            f"{name}: {_size(capture)}, but {first}: {size}; record all poses with the same camera "
            "and projector images"
        )


def _picture(capture: BoardCapture | None) -> Levels | None:
    """Return the mean of the frames, (row, col) uint8, with the brightest pixel at 255.

    None if there is no capture.
    """
    if capture is None:
        return None
    mean = capture.stack.mean(axis=0, dtype=np.float64)
    return np.asarray(np.rint(255 * mean / max(float(mean.max()), 1.0)), np.uint8)


def _size(capture: BoardCapture) -> str:
    _, rows, cols = capture.stack.shape
    shown = capture.patterns
    return f"{cols} x {rows} px seen, {shown.width_px} x {shown.height_px} px projected"


def _keep(folder: Path, capture: BoardCapture, experiment: Experiment, as_images: bool) -> None:
    folder.mkdir(parents=True)
    depth = experiment.camera.bit_depth
    if as_images:
        stack = capture.stack.astype(np.uint8) if depth == 8 else capture.stack
        write_frame_set(folder, stack, capture.patterns, capture.sensor, depth)
        return
    calibration: Calibration = true_calibration(experiment)
    write_capture(
        folder, Capture(capture.stack, capture.patterns, capture.sensor, calibration, depth)
    )


def _canonical(board: BoardFile) -> str:
    content = board.model_dump(mode="json", exclude={"description", "provenance"})
    return json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)


def _digest(parts: Sequence[str]) -> str:
    return hashlib.blake2b("\n".join(parts).encode(), digest_size=8).hexdigest()
