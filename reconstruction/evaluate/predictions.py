"""Score predicted depths, normals and phases against the truth of a data set.

A prediction is an array of the shape of the truth, in the same unit and frame; NaN states that a
pixel has no prediction. Target pixels are those of the measured surface that are lit. Sums over
pixels are exact: a sample counts with its number of target pixels, also if it has no prediction.

In a data set of several methods, the predictions of each method are scored by themselves
(`evaluate.methods`).
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from reconstruction.arrays import BoolImage, FloatArray
from reconstruction.errors import InputError, few
from reconstruction.evaluate.samples import LabelledSample, npy, read_samples, read_schema
from reconstruction.reading import read_bytes

Array = NDArray[Any]
MASKS = ("label", "lit")
_MEASURED = 2  # label of the measured surface
_DEPTH, _NORMAL = "depth_mm", "normal_world"
PHASES = {f"phase_{axis}_rad": axis for axis in ("column", "row")}
SCORED = (_DEPTH, _NORMAL, *PHASES)
"""Quantities that can be scored, by their names in the data set."""

COUNTS = ("samples", "objects", "samples_without_prediction", "unused_predictions")
"""Names of the figures that are no errors."""

_UNITS = {_DEPTH: "millimetres"} | dict.fromkeys(PHASES, "radians")
_OTHER_UNITS = {
    _DEPTH: {"metres": 1e-3, "centimetres": 1e-1, "micrometres": 1e3},
    **{name: {"turns": 1 / (2 * np.pi), "degrees": 180 / np.pi} for name in PHASES},
}
"""Values of one rad or one mm in the units that predictions have by mistake."""
_LIKE, _FAR = 0.02, 30.0
"""A prediction has another unit if its ratio to the truth is that of the unit to within 2 %, or
beyond 30 in either direction. Assumed: a useful depth or phase is never so wrong."""


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
        stem, unit = LABELS[name]
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


LABELS = {_DEPTH: ("depth", "um"), _NORMAL: ("normal", "deg")} | {
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
    split_of : split of each object
    rms : root mean square error of each sample by its key, for each quantity; None: no pixel
    """

    names: tuple[str, ...]
    sums: dict[str, dict[str, ErrorSums]] = field(default_factory=dict)
    samples: dict[str, int] = field(default_factory=dict)
    without_prediction: list[str] = field(default_factory=list)
    unused: int = 0
    split_of: dict[str, str] = field(default_factory=dict)
    rms: dict[str, dict[str, float | None]] = field(default_factory=dict)

    def figures(self) -> dict[str, float | None]:
        """Return the figures over all samples."""
        counts = (
            sum(self.samples.values()),
            len(self.samples),
            len(self.without_prediction),
            self.unused,
        )
        return dict(zip(COUNTS, counts, strict=True)) | self._errors_of(self.sums)

    def _errors_of(self, objects: Iterable[str]) -> dict[str, float | None]:
        """Return the figures of some objects together."""
        chosen = [self.sums[name] for name in objects]
        known: dict[str, float | None] = {}
        for quantity in self.names:
            known |= _together(sums[quantity] for sums in chosen).figures(quantity)
        return known

    def by_split(self) -> list[dict[str, Any]]:
        """Return a row for each split: its name, number of samples and objects, and figures."""
        rows: list[dict[str, Any]] = []
        for split in dict.fromkeys(self.split_of.values()):
            inside = [name for name, own in self.split_of.items() if own == split]
            samples = sum(self.samples[name] for name in inside)
            row = {"split": split, "samples": samples, "objects": len(inside)}
            rows.append(row | self._errors_of(inside))
        return rows

    def by_object(self) -> list[dict[str, Any]]:
        """Return a row for each object: its digest, number of samples, and figures."""
        rows: list[dict[str, Any]] = []
        for name in sorted(self.sums):
            row: dict[str, Any] = {"object": name, "samples": self.samples[name]}
            rows.append(row | self._errors_of([name]))
        return rows

    def add(self, sample: LabelledSample, predicted: Mapping[str, Array]) -> None:
        """Add the errors of the predictions of one sample, by the name of the quantity.

        A quantity that the sample lacks, as with several scenes and methods, has no target pixel.

        Raises
        ------
        InputError : a prediction has another shape than the truth
        """
        name = str(sample.described.get("object", ""))
        sums = self.sums.setdefault(name, {quantity: ErrorSums() for quantity in self.names})
        self.samples[name] = self.samples.get(name, 0) + 1
        self.split_of[name] = sample.split
        self.rms[sample.key] = {}
        present = [quantity for quantity in self.names if quantity in sample.arrays]
        if not set(present) <= set(predicted):
            self.without_prediction.append(sample.key)
        targets = int(target_pixels(sample).sum())
        for quantity in present:
            shape = sample.arrays[quantity].shape
            given = predicted.get(quantity, np.full(shape, np.nan, np.float32))
            errors = error_map(sample, quantity, given)
            errors = errors[np.isfinite(errors)]
            sums[quantity].add(errors, targets)
            rms = float(np.sqrt(np.mean(errors**2))) if errors.size else None
            self.rms[sample.key][quantity] = rms


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


def error_map(sample: LabelledSample, quantity: str, given: Array) -> FloatArray:
    """Return the error (row, col) of a prediction of one sample; NaN at pixels without an error.

    These are pixels that are no target or have no prediction. Depth in um, phase in rad; for
    normals the angle to the true one, degrees.

    Raises
    ------
    InputError : the prediction has another shape than the truth
    """
    truth = sample.arrays[quantity]
    if given.shape != truth.shape:
        raise InputError(
            f"{sample.key}: prediction of {quantity}: found the shape {given.shape}, "
            f"allowed {truth.shape}"
        )
    errors = _ERRORS[quantity](given.astype(np.float64), truth.astype(np.float64))
    return np.where(target_pixels(sample) & np.isfinite(errors), errors, np.nan)


def _angles_deg(given: FloatArray, truth: FloatArray) -> FloatArray:
    """Return the angles (row, col) between predicted and true normals, of any length."""
    # atan2 is exact for small angles, where the arc cosine is not.
    sine = np.linalg.norm(np.cross(given, truth), axis=-1)
    angles = np.rad2deg(np.arctan2(sine, np.sum(given * truth, axis=-1)))
    length = np.linalg.norm(given, axis=-1)
    return np.asarray(np.where(np.isfinite(length) & (length > 0), angles, np.nan))


_ERRORS: Mapping[str, Callable[[FloatArray, FloatArray], FloatArray]] = {
    _DEPTH: lambda given, truth: 1e3 * (given - truth),
    _NORMAL: _angles_deg,
    **dict.fromkeys(PHASES, np.subtract),
}


@dataclass
class UnitCheck:
    """Compares the size of predicted and true values, which shows a prediction in another unit.

    Attributes
    ----------
    ratios : median of prediction over truth of each sample, by quantity
    """

    ratios: dict[str, list[float]] = field(default_factory=dict)

    def add(self, sample: LabelledSample, predicted: Mapping[str, Array]) -> None:
        """Add the predictions of one sample; normals have no unit."""
        target = target_pixels(sample)
        for quantity in _UNITS.keys() & predicted.keys() & sample.arrays.keys():
            given, truth = predicted[quantity], sample.arrays[quantity]
            usable = target & np.isfinite(given) & (truth != 0)
            if usable.any():
                ratio = np.median(given[usable].astype(np.float64) / truth[usable])
                self.ratios.setdefault(quantity, []).append(float(ratio))

    def require(self, where: str) -> None:
        """Check that the median over all samples is that of the unit of the truth.

        Raises
        ------
        InputError : it is that of another unit
        """
        for quantity, ratios in sorted(self.ratios.items()):
            ratio = abs(float(np.median(ratios)))
            others = _OTHER_UNITS[quantity].items()
            like = [unit for unit, one in others if abs(ratio / one - 1) < _LIKE]
            if like or ratio * _FAR < 1 or ratio > _FAR:
                other = f", as in {like[0]}" if like else ""
                raise InputError(
                    f"{where}: prediction of {quantity}: found values {_times(ratio)} than the "
                    f"truth{other}; give {_UNITS[quantity]}, and NaN at pixels without prediction"
                )


def _times(ratio: float) -> str:
    if ratio == 0:
        return "of 0, smaller"
    return f"{1 / ratio:.3g} times smaller" if ratio < 1 else f"{ratio:.3g} times larger"


def score_predictions(
    predictions: Path, dataset: Path, split: str = "test", method: str = ""
) -> PredictionScore:
    """Score the files of a folder, KEY.QUANTITY.npy, against a data set.

    QUANTITY is one of `SCORED`; KEY.npy is a depth.

    Parameters
    ----------
    split : "train", "validation", "test" or "all"
    method : method of the predictions; empty for a data set of one method

    Raises
    ------
    InputError : the folder has no prediction, the data set lacks the truth of a predicted
        quantity, or a prediction has a wrong shape or unit
    """
    files = _prediction_files(predictions)
    names = tuple(name for name in SCORED if any(name in known for known in files.values()))
    _require_truth(dataset, names, str(predictions), method)
    result, used, units = PredictionScore(names), 0, UnitCheck()
    for sample in read_samples(dataset, split, (*names, *MASKS), method):
        known = files.get(sample.key, {})
        used += len(known)
        predicted = {name: _read_prediction(path) for name, path in known.items()}
        result.add(sample, predicted)
        units.add(sample, predicted)
    if not used:
        raise InputError(
            f"{predictions}: no file belongs to a sample of the split '{split}'; name files "
            "KEY.QUANTITY.npy with the keys of index.parquet"
        )
    units.require(str(predictions))
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


def _require_truth(dataset: Path, names: Iterable[str], where: str, method: str) -> None:
    missing = sorted({*names} - {*read_schema(dataset).arrays_of(method)})
    if missing:
        raise InputError(
            f"{where}: {few(missing)}: the data set does not contain the truth; add it to "
            "sample.hold"
        )
