"""Score predicted depths, normals and phases against the truth of a data set.

A prediction is an array of the shape of the truth, in the same unit and frame; NaN states that a
pixel has no prediction. Target pixels are those of the measured surface that are lit. Sums over
pixels are exact: a sample counts with its number of target pixels, also if it has no prediction.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from reconstruction.arrays import BoolImage, FloatArray
from reconstruction.errors import InputError, few
from reconstruction.evaluate.samples import LabelledSample, arrays_of, npy, read_samples
from reconstruction.reading import read_bytes

Array = NDArray[Any]
MASKS = ("label", "lit")
_MEASURED = 2  # label of the measured surface
_DEPTH, _NORMAL = "depth_mm", "normal_world"
PHASES = {f"phase_{axis}_rad": axis for axis in ("column", "row")}
SCORED = (_DEPTH, _NORMAL, *PHASES)
"""Quantities that can be scored, by their names in the data set."""


@dataclass
class ErrorSums:
    """Sums over the target pixels of any number of samples, for one quantity.

    Attributes
    ----------
    targets : number of target pixels
    predicted : number of target pixels with a prediction
    wrong_orders : number of predicted pixels with an error of the phase of half a turn or more
    error, absolute, squared : sums of error, its absolute value and its square, over the predicted
        pixels; um, degrees or rad
    """

    targets: int = 0
    predicted: int = 0
    wrong_orders: int = 0
    error: float = 0.0
    absolute: float = 0.0
    squared: float = 0.0

    def add(self, errors: FloatArray, targets: int) -> None:
        """Add the errors (n,) of the predicted pixels, of so many target pixels."""
        self.targets += targets
        self.predicted += errors.size
        self.wrong_orders += int(np.count_nonzero(np.abs(errors) >= np.pi))
        self.error += float(errors.sum())
        self.absolute += float(np.abs(errors).sum())
        self.squared += float((errors**2).sum())

    def figures(self, name: str) -> dict[str, float | None]:
        """Return the figures of a quantity by name; None if there is no pixel for a figure."""
        stem, unit = _LABELS[name]
        count = self.predicted
        known: dict[str, float | None] = {
            f"{stem}_completeness": count / self.targets if self.targets else None,
            f"{stem}_rms_{unit}": (self.squared / count) ** 0.5 if count else None,
            f"{stem}_mean_absolute_{unit}": self.absolute / count if count else None,
        }
        if name == _NORMAL:
            return known
        known[f"{stem}_bias_{unit}"] = self.error / count if count else None
        if name in PHASES:
            known[f"{stem}_wrong_order_share"] = self.wrong_orders / count if count else None
        return known


_LABELS = {_DEPTH: ("depth", "um"), _NORMAL: ("normal", "deg")} | {
    name: (f"phase_{axis}", "rad") for name, axis in PHASES.items()
}


@dataclass
class PredictionScore:
    """Score of predictions against one split of a data set.

    Attributes
    ----------
    names : quantities that are scored
    sums : error sums by object and quantity
    samples : number of samples by object
    without_prediction : keys of samples for which a quantity has no prediction
    unused : number of prediction files that belong to no sample of the split
    """

    names: tuple[str, ...]
    sums: dict[str, dict[str, ErrorSums]] = field(default_factory=dict)
    samples: dict[str, int] = field(default_factory=dict)
    without_prediction: list[str] = field(default_factory=list)
    unused: int = 0

    def figures(self) -> dict[str, float | None]:
        """Return the figures over all samples."""
        known: dict[str, float | None] = {
            "samples": sum(self.samples.values()),
            "objects": len(self.samples),
            "samples_without_prediction": len(self.without_prediction),
            "unused_predictions": self.unused,
        }
        for name in self.names:
            known |= _together(sums[name] for sums in self.sums.values()).figures(name)
        return known

    def by_object(self) -> list[dict[str, Any]]:
        """Return a row for each object: its digest, number of samples, and figures."""
        rows: list[dict[str, Any]] = []
        for name, sums in sorted(self.sums.items()):
            row: dict[str, Any] = {"object": name, "samples": self.samples[name]}
            for quantity in self.names:
                row |= sums[quantity].figures(quantity)
            rows.append(row)
        return rows

    def add(self, sample: LabelledSample, predicted: Mapping[str, Array]) -> None:
        """Add the errors of the predictions of one sample, by the name of the quantity.

        Raises
        ------
        InputError : a prediction has another shape than the truth
        """
        name = str(sample.described.get("object", ""))
        sums = self.sums.setdefault(name, {quantity: ErrorSums() for quantity in self.names})
        self.samples[name] = self.samples.get(name, 0) + 1
        if not set(self.names) <= set(predicted):
            self.without_prediction.append(sample.key)
        target = target_pixels(sample)
        for quantity in self.names:
            truth = sample.arrays[quantity]
            given = predicted.get(quantity, np.full(truth.shape, np.nan, np.float32))
            if given.shape != truth.shape:
                raise InputError(
                    f"{sample.key}: prediction of {quantity}: found the shape {given.shape}, "
                    f"allowed {truth.shape}"
                )
            errors = _ERRORS[quantity](given.astype(np.float64), truth.astype(np.float64), target)
            sums[quantity].add(errors, int(target.sum()))


def _together(parts: Iterable[ErrorSums]) -> ErrorSums:
    total = ErrorSums()
    for part in parts:
        for name, value in vars(part).items():
            setattr(total, name, getattr(total, name) + value)
    return total


def target_pixels(sample: LabelledSample) -> BoolImage:
    """Return the mask (row, col) of the pixels that are scored.

    They show the measured surface and are lit. Without `label` all pixels with a true depth count.
    """
    arrays = sample.arrays
    if "label" in arrays:
        target = arrays["label"] == _MEASURED
    else:
        target = arrays[_DEPTH] > 0 if _DEPTH in arrays else np.ones(_pixels(sample), np.bool_)
    return np.asarray(target & (arrays["lit"] > 0) if "lit" in arrays else target)


def _pixels(sample: LabelledSample) -> tuple[int, ...]:
    return next(array.shape[:2] for array in sample.arrays.values())


def _difference(
    given: FloatArray, truth: FloatArray, target: BoolImage, scale: float = 1.0
) -> FloatArray:
    return np.asarray(scale * (given - truth)[target & np.isfinite(given)])


def _angles_deg(given: FloatArray, truth: FloatArray, target: BoolImage) -> FloatArray:
    """Return the angles (n,) between predicted and true normals; predictions are normalised."""
    length = np.linalg.norm(given, axis=-1)
    usable = target & np.isfinite(length) & (length > 0)
    one, two = given[usable] / length[usable][:, None], truth[usable]
    # atan2 is exact for small angles, where the arc cosine is not.
    sine = np.linalg.norm(np.cross(one, two), axis=-1)
    return np.asarray(np.rad2deg(np.arctan2(sine, np.sum(one * two, axis=-1))))


_ERRORS: Mapping[str, Callable[[FloatArray, FloatArray, BoolImage], FloatArray]] = {
    _DEPTH: partial(_difference, scale=1e3),
    _NORMAL: _angles_deg,
    **dict.fromkeys(PHASES, _difference),
}


def score_predictions(predictions: Path, dataset: Path, split: str = "test") -> PredictionScore:
    """Score the files of a folder, KEY.QUANTITY.npy, against a data set.

    QUANTITY is one of `SCORED`; KEY.npy is a depth.

    Raises
    ------
    InputError : the folder has no prediction, the data set lacks the truth of a predicted
        quantity, or a prediction has a wrong shape
    """
    files = _prediction_files(predictions)
    names = tuple(name for name in SCORED if any(name in known for known in files.values()))
    _require_truth(dataset, names, str(predictions))
    result, used = PredictionScore(names), 0
    for sample in read_samples(dataset, split, (*names, *MASKS)):
        known = files.get(sample.key, {})
        used += len(known)
        result.add(sample, {name: _read_prediction(path) for name, path in known.items()})
    if not used:
        raise InputError(
            f"{predictions}: no file belongs to a sample of the split '{split}'; name files "
            "KEY.QUANTITY.npy with the keys of index.parquet"
        )
    result.unused = sum(map(len, files.values())) - used
    return result


def _prediction_files(folder: Path) -> dict[str, dict[str, Path]]:
    """Return the prediction files by key and quantity."""
    files: dict[str, dict[str, Path]] = {}
    for path in sorted(folder.glob("*.npy")) if folder.is_dir() else ():
        key, _, name = path.name.removesuffix(".npy").partition(".")
        quantity = name or _DEPTH
        if quantity not in SCORED:
            raise InputError(f"{path}: found '{quantity}', allowed {', '.join(SCORED)}")
        if quantity in files.setdefault(key, {}):
            raise InputError(f"{path}: the depth of this sample is given twice; remove one file")
        files[key][quantity] = path
    if not files:
        raise InputError(f"{folder}: found no predictions; give files KEY.QUANTITY.npy")
    return files


def _read_prediction(path: Path) -> Array:
    try:
        values = npy(read_bytes(path))
    except ValueError as error:
        raise InputError(f"{path}: is no .npy file of numbers ({error})") from None
    if values.dtype.kind not in "fiub":
        raise InputError(f"{path}: is no .npy file of numbers (it has the type {values.dtype})")
    return values


def _require_truth(dataset: Path, names: Iterable[str], where: str) -> None:
    missing = sorted({*names} - {*arrays_of(dataset)})
    if missing:
        raise InputError(
            f"{where}: {few(missing)}: the data set does not contain the truth; add it to "
            "sample.hold"
        )
