"""Read a finished measurement back from its folder; the files are the contract of `storage`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from reconstruction.capture.folder import Capture, read_capture
from reconstruction.errors import InputError
from reconstruction.outputs import read_reconstruction
from reconstruction.pipeline import Reconstruction
from twin.config import Experiment, load_experiment
from twin.mechanics import PressedElastomer, read_press
from twin.optics.stack import Truth
from twin.optics.storage import read_truth
from twin.output import EXPERIMENT_FILE, RESULT_FILE, read_json
from twin.pipeline.score import Score, score
from twin.pipeline.storage import CAPTURE_FOLDER, TIMINGS_FILE

_MEASURING_COMMANDS = ("measure", "demo")

_NEEDED_FIGURES = (
    "completeness",
    "error_over_sigma",
    "exposure_ms",
    "filter_bias_share",
    "filter_bias_um",
    "good_share",
    "saturated_share",
    "sigma_z_median_um",
    "warnings",
    "wrong_order_pixels",
    "z_bias_um",
    "z_p95_um",
    "z_rmse_um",
)
_NEEDED_OF_A_PRESS = (
    "depth_mm",
    "force_n",
    "height_error_estimate_mm",
    "relief_peak_mm",
    "young_modulus_kpa",
)


@dataclass(frozen=True, eq=False)
class Result:
    """What every measurement is, whatever the method.

    Attributes
    ----------
    figures : dict
        The metrics of result.json, units in their names.
    """

    experiment: Experiment
    digest: str
    figures: dict[str, Any]
    versions: dict[str, str]


@dataclass(frozen=True, eq=False)
class Scored(Result):
    """What was measured with fringes and how good it is.

    Attributes
    ----------
    score : Score
        The scores of result.json anew from the stored maps, with residuals per pixel.
    """

    reconstruction: Reconstruction
    truth: Truth
    score: Score


@dataclass(frozen=True, eq=False)
class Measured(Scored):
    """A whole result folder; nothing is pressed where the bare specimen is seen."""

    pressed: PressedElastomer | None
    capture: Capture
    seconds: dict[str, float]


def read_scored(folder: Path) -> Scored:
    """Read what the result table needs.

    Raises
    ------
    InputError
        The folder is no finished measurement, or a file is missing or damaged.
    """
    return Scored(**_scored_parts(folder))


def read_measured(folder: Path) -> Measured:
    """Read a whole result folder.

    Raises
    ------
    InputError
        The folder is no finished measurement, or a file is missing or damaged.
    """
    parts = _scored_parts(folder)
    direct = not parts["experiment"].method.presses
    return Measured(
        **parts,
        pressed=None if direct else read_press(folder / "press.nc"),
        capture=read_capture(folder / CAPTURE_FOLDER),
        seconds=read_seconds(folder),
    )


def is_photometric(folder: Path) -> bool:
    """Return whether a result folder holds a measurement by photometric stereo.

    Raises
    ------
    InputError
        The folder is no finished measurement.
    """
    read_result(folder, ())
    return not _read_experiment(folder / EXPERIMENT_FILE).method.fringes


def result_parts(folder: Path, needed: tuple[str, ...]) -> dict[str, Any]:
    """Read the parts of `Result` and check that all needed figures are there.

    Raises
    ------
    InputError
        The folder is no finished measurement, or a figure is missing.
    """
    result = read_result(folder, needed)
    experiment = _read_experiment(folder / EXPERIMENT_FILE)
    if experiment.method.presses:
        _require(folder, result["metrics"], _NEEDED_OF_A_PRESS)
    return {
        "experiment": experiment,
        "digest": str(result.get("digest", "")),
        "figures": result["metrics"],
        "versions": result.get("versions", {}),
    }


def _scored_parts(folder: Path) -> dict[str, Any]:
    parts = result_parts(folder, _NEEDED_FIGURES)
    reconstruction = read_reconstruction(folder / "reconstruction.nc")
    truth = read_truth(folder / "truth.nc")
    found, true = reconstruction.point_map.mask_reason.shape, truth.lit.shape
    if found != true:
        raise InputError(
            f"{folder}: reconstruction.nc is {found}, truth.nc {true} (row, col); measure again"
        )
    return parts | {
        "reconstruction": reconstruction,
        "truth": truth,
        "score": score(parts["experiment"], reconstruction, truth),
    }


def read_result(folder: Path, needed: tuple[str, ...]) -> dict[str, Any]:
    """Read result.json of a measurement.

    Raises
    ------
    InputError
        The folder is no finished measurement, or a figure is missing.
    """
    if not (folder / RESULT_FILE).is_file():
        raise InputError(f"{folder}: no finished result (no {RESULT_FILE}); run twin measure first")
    result = read_json(folder / RESULT_FILE)
    command, figures = result.get("command"), result.get("metrics")
    if command not in _MEASURING_COMMANDS or not isinstance(figures, dict):
        raise InputError(
            f"{folder}: result of command {command!r}; "
            f"a report needs one of {', '.join(_MEASURING_COMMANDS)}"
        )
    _require(folder, figures, needed)
    return result


def _require(folder: Path, figures: dict[str, Any], names: tuple[str, ...]) -> None:
    missing = [name for name in names if name not in figures]
    if missing:
        raise InputError(f"{folder / RESULT_FILE}: no {', '.join(missing)}; measure again")


def _read_experiment(path: Path) -> Experiment:
    # load_experiment would take the missing file for the name of a shipped experiment.
    if not path.is_file():
        raise InputError(f"{path}: no such file; measure again")
    return load_experiment(path)


def read_seconds(folder: Path) -> dict[str, float]:
    """Read stage times; a result may have lost them without losing anything measured."""
    path = folder / TIMINGS_FILE
    return read_json(path) if path.is_file() else {}
