"""Scores of a data set by method of measurement, of predictions and of a classical baseline.

In a data set of several methods, PREDICTIONS has a folder for each: METHOD/KEY.QUANTITY.npy. If one
method is chosen, its files may also be in PREDICTIONS itself.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from reconstruction.errors import InputError
from reconstruction.evaluate.baselines import score_baseline
from reconstruction.evaluate.predictions import COUNTS, SCORED, PredictionScore, score_predictions
from reconstruction.evaluate.samples import ALL_SPLITS, prefix_of, read_schema

PREDICTIONS, BASELINE = "predictions", "baseline"


@dataclass(frozen=True, eq=False)
class ScoredMethod:
    """Score of one source of predictions for one method of measurement.

    Attributes
    ----------
    method : method of measurement; empty for a data set of one method
    source : "predictions", or the name of a classical baseline
    score : the errors
    """

    method: str
    source: str
    score: PredictionScore


@dataclass(frozen=True, eq=False)
class DataSetScore:
    """Scores of all methods of measurement and sources, and why others have none.

    Attributes
    ----------
    parts : scores, by method; the predictions of a method before its baseline
    split : the split that was scored, or "all"
    unable : reason why a method has no score of the baseline, by method
    """

    parts: tuple[ScoredMethod, ...]
    split: str
    unable: Mapping[str, str] = field(default_factory=dict)

    def figures(self) -> dict[str, float | None]:
        """Return the figures over all samples.

        Names begin with the method, if there are several; then with `baseline`, if a baseline is
        scored in addition to predictions.
        """
        known: dict[str, float | None] = {}
        for part in self.parts:
            start = prefix_of(part.method)
            known |= {
                f"{start}{n}": v for n, v in self._prefixed(part, part.score.figures()).items()
            }
        return known

    def by_object(self) -> list[dict[str, Any]]:
        """Return a row for each method and object, with its split if all splits are scored."""
        rows: dict[tuple[str, str], dict[str, Any]] = {}
        for part in self.parts:
            for row in part.score.by_object():
                split = {"split": part.score.split_of[row["object"]]} if self._splits else {}
                own = {"method": part.method} if part.method else {}
                at = (part.method, row["object"])
                rows[at] = own | split | rows.get(at, {}) | self._prefixed(part, row)
        return list(rows.values())

    def by_split(self) -> list[dict[str, Any]]:
        """Return a row for each method and split, if all splits are scored."""
        rows: dict[tuple[str, str], dict[str, Any]] = {}
        for part in self.parts if self._splits else ():
            for row in part.score.by_split():
                own = {"method": part.method} if part.method else {}
                at = (part.method, row["split"])
                rows[at] = own | rows.get(at, {}) | self._prefixed(part, row)
        return list(rows.values())

    @property
    def baseline(self) -> str:
        """Name of the scored classical method; empty if there is none."""
        return next((part.source for part in self.parts if part.source != PREDICTIONS), "")

    @property
    def _splits(self) -> bool:
        return self.split == ALL_SPLITS

    def _prefixed(self, part: ScoredMethod, row: Mapping[str, Any]) -> dict[str, Any]:
        """Return a row; the errors of a baseline have its prefix if there are predictions, too."""
        both = any(other.source == PREDICTIONS for other in self.parts)
        if part.source == PREDICTIONS or not both:
            return dict(row)
        kept = ("object", "split")
        return {
            name if name in kept else f"{BASELINE}_{name}": value
            for name, value in row.items()
            if name not in COUNTS
        }


def score_dataset(
    dataset: Path,
    predictions: Path | None = None,
    *,
    baseline: str = "",
    split: str = "test",
    method: str = "",
) -> DataSetScore:
    """Score predictions, a classical baseline, or both.

    Parameters
    ----------
    predictions : folder of predictions; None: only the baseline is scored
    baseline : name of a classical method; empty: that of the data set's recipe, if it states one
    split : "train", "validation", "test" or "all"
    method : method of measurement; empty: each one that has predictions or the baseline's input

    Raises
    ------
    InputError : a name is not known, or for the reasons of `score_predictions`; or no method has a
        score
    """
    schema = read_schema(dataset)
    if method:
        _require_method(method, schema.methods)
    chosen = (method,) if method else schema.methods or ("",)
    folders: dict[str, Path] = {}
    if predictions is not None:
        folders = _folders_of(predictions, chosen, schema.methods)
        chosen = tuple(folders)
    classical = baseline or schema.baseline
    parts: list[ScoredMethod] = []
    unable: dict[str, str] = {}
    for each in chosen:
        if each in folders:
            score = score_predictions(folders[each], dataset, split, each)
            parts.append(ScoredMethod(each, PREDICTIONS, score))
        if classical:
            try:
                names = parts[-1].score.names if each in folders else SCORED
                score = score_baseline(classical, dataset, split, each, names)
                parts.append(ScoredMethod(each, classical, score))
            except InputError as error:
                unable[each] = str(error)
    if not any(part.source == classical for part in parts) and (baseline or not parts):
        raise InputError(next(iter(unable.values()), _NO_BASELINE))
    return DataSetScore(tuple(parts), split, unable)


_NO_BASELINE = "twin score: found neither PREDICTIONS nor a baseline in the recipe; give --baseline"


def _require_method(method: str, known: Sequence[str]) -> None:
    if method not in known:
        allowed = ", ".join(known) or "none: the data set has one method; remove --method"
        raise InputError(f"--method: found '{method}', allowed: {allowed}")


def _folders_of(
    predictions: Path, chosen: Sequence[str], methods: Sequence[str]
) -> dict[str, Path]:
    """Return the folder of the predictions of each method that has one."""
    if not methods:
        return {"": predictions}
    inside = sorted(path.name for path in predictions.glob("*/")) if predictions.is_dir() else []
    if len(chosen) == 1 and chosen[0] not in inside:
        return {chosen[0]: predictions}
    if unknown := [name for name in inside if name not in methods]:
        raise InputError(
            f"{predictions}: found the folder '{unknown[0]}', allowed: {', '.join(methods)}"
        )
    outside = sorted(predictions.glob("*.npy"))
    if outside or not inside:
        start = (
            f"{outside[0]}: belongs to no method" if outside else f"{predictions}: found no folder"
        )
        raise InputError(
            f"{start}; give files METHOD/KEY.QUANTITY.npy with METHOD one of {', '.join(methods)}, "
            "or --method"
        )
    return {name: predictions / name for name in chosen if name in inside}
