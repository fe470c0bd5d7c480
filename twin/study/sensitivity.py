"""Effect of each axis on a figure: shares of variance, or elementary effects.

The method depends on the sampling of the points. The values of the figure are means over repeats.

- grid: correlation ratio, the share of the figure's variance over all cases that one axis explains.
  It is exact for the grid and has no interval. Interactions explain the remainder to 1.
- saltelli: first-order and total Sobol' indices with 95 % bootstrap intervals, by
  `scipy.stats.sobol_indices` (Saltelli et al., Computer Physics Communications 181, 259-270, 2010).
- morris: mean mu* of the absolute elementary effects over the whole axis, and their standard
  deviation sigma. Morris, M. D., Technometrics 33, 161-174 (1991); Campolongo et al. (2007) for
  mu*.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from reconstruction.arrays import FloatArray, IntArray
from twin.config.study import Study
from twin.results.rows import is_number
from twin.study.cases import shares_of
from twin.study.table import Row, StudyTable

_DRAWS = 1000
_MOST_LEVELS, _PARTS = 9, 6


@dataclass(frozen=True)
class Effect:
    """Effect of an axis on a figure.

    Attributes
    ----------
    axis : title of the axis
    value : first-order share of the variance, 0 to 1, or mu* in the figure's unit
    low, high : ends of the 95 % interval of `value`; equal to `value` for grids
    total : total share of the variance including interactions, or sigma; None for grids
    """

    axis: str
    value: float
    low: float
    high: float
    total: float | None = None


def effects_of(table: StudyTable, metric: str) -> list[Effect]:
    """Return the effect of every axis on a figure; empty if the points do not determine it.

    Points may lack the figure because the case failed, is missing, or has no measured point (see
    `without`). Grids leave out these points; the other designs leave out their whole trajectory or
    row.
    """
    return effects_on(table, [row.get(metric) for row in table.rows])


def effects_on(table: StudyTable, cells: Sequence[Any]) -> list[Effect]:
    """Return the effect of every axis on a value of the rows of a table, see `effects_of`."""
    study = table.record.study
    axes = [axis.title for axis in study.axis]
    if study.sampling.method == "grid":
        known = [row for row, cell in zip(table.rows, cells, strict=True) if is_number(cell)]
        numbers = [float(cell) for cell in cells if is_number(cell)]
        return variance_shares(numbers, {a: [str(row[a]) for row in known] for a in axes})
    if study.sampling.method not in ("saltelli", "morris"):
        return []
    values = _by_point(cells, study)
    if values is None:
        return []
    if study.sampling.method == "saltelli":
        return saltelli_effects(values.reshape(len(axes) + 2, -1), axes)
    walks = shares_of(study).reshape(-1, len(axes) + 1, len(axes))
    return morris_effects(values.reshape(-1, len(axes) + 1), walks, axes)


def without(table: StudyTable, metric: str) -> int:
    """Return the number of cases that lack a figure and are left out of its effects."""
    return sum(not is_number(row.get(metric)) for row in table.rows)


def _by_point(cells: Sequence[Any], study: Study) -> FloatArray | None:
    """Return the values (point,), mean over repeats; None if constraints exclude points.

    A point without a value has NaN.
    """
    repeats = study.repeats * max(1, len(study.modalities))
    values = np.array([float(cell) if is_number(cell) else np.nan for cell in cells])
    if len(values) != len(shares_of(study)) * repeats:
        return None
    return np.asarray(values.reshape(-1, repeats).mean(axis=1))


def variance_shares(values: Sequence[float], labels: Mapping[str, Sequence[str]]) -> list[Effect]:
    """Return for each axis the share of the variance of values (row,) that its labels explain.

    The list is empty if there are fewer than two values, or if all are equal.

    Parameters
    ----------
    labels : by axis, the label (row,) of its level at each value
    """
    numbers = np.asarray(values, np.float64)
    if len(numbers) < 2 or np.ptp(numbers) == 0.0:
        return []
    shares = {axis: correlation_ratio(numbers, of_axis) for axis, of_axis in labels.items()}
    return [Effect(axis, share, share, share) for axis, share in shares.items()]


def adjusted_shares(values: Sequence[float], labels: Mapping[str, Sequence[str]]) -> list[Effect]:
    """Return the shares of `variance_shares` without the part that chance explains.

    Use this for points that are no grid, because even random labels in k groups explain a share of
    (k - 1) / (n - 1) of the variance of n values on average. The adjusted share is
    1 - (1 - share) (n - 1) / (n - k), at least 0: Ezekiel's correction, as of adjusted R2. The
    list is empty if an axis has fewer than two values per group.
    """
    count, groups = len(values), {axis: len(set(of_axis)) for axis, of_axis in labels.items()}
    if count < 2 * max(groups.values(), default=0):
        return []
    plain = {effect.axis: effect.value for effect in variance_shares(values, labels)}
    shares = {
        axis: max(0.0, 1.0 - (1.0 - share) * (count - 1) / (count - groups[axis]))
        for axis, share in plain.items()
    }
    return [Effect(axis, share, share, share) for axis, share in shares.items()]


def group_labels(rows: Sequence[Row], axis: str) -> list[str]:
    """Return for each row the label of its group, see `groups_of`."""
    labels = {id(row): str(level) for level, group in groups_of(rows, axis) for row in group}
    return [labels[id(row)] for row in rows]


def groups_of(rows: Sequence[Row], axis: str) -> list[tuple[Any, list[Row]]]:
    """Group rows by the levels of an axis; return the levels, numbers in order, and their rows.

    An axis with more than nine numbers is divided into six equal parts of its range, each with the
    number in its middle.
    """
    by_label = {str(row[axis]): row[axis] for row in rows}  # a level may be a list
    if not all(is_number(level) for level in by_label.values()):
        return [(level, [row for row in rows if row[axis] == level]) for level in by_label.values()]
    levels = set(by_label.values())
    if len(levels) <= _MOST_LEVELS:
        return [(level, [row for row in rows if row[axis] == level]) for level in sorted(levels)]
    edges = np.linspace(min(levels), max(levels), _PARTS + 1)
    numbers = np.array([row[axis] for row in rows], np.float64)
    parts = np.clip(np.digitize(numbers, edges) - 1, 0, _PARTS - 1)
    filled = [part for part in range(_PARTS) if (parts == part).any()]
    return [
        (
            float(edges[part] + edges[part + 1]) / 2,
            [row for row, at in zip(rows, parts, strict=True) if at == part],
        )
        for part in filled
    ]


def correlation_ratio(values: FloatArray, labels: Sequence[str]) -> float:
    """Return the share, 0 to 1, of the variance of values (n,) that their labels (n,) explain."""
    names = np.asarray(labels)
    between = sum(
        (names == name).sum() * (values[names == name].mean() - values.mean()) ** 2
        for name in np.unique(names)
    )
    return float(between / ((values - values.mean()) ** 2).sum())


def saltelli_effects(blocks: FloatArray, axes: Sequence[str]) -> list[Effect]:
    """Return the Sobol' indices of each axis from the values (block, row) of a Saltelli design.

    The blocks are A, B and, for each axis i, A with column i from B. Rows without a value are left
    out. Further rows are left out until the number of rows is a power of two, as
    `scipy.stats.sobol_indices` requires. The result is empty if fewer than two rows have values.
    """
    from scipy import stats  # takes 0.5 s to import, and most studies have no Saltelli design

    blocks = blocks[:, np.isfinite(blocks).all(axis=0)]
    if blocks.shape[1] < 2:
        return []
    whole = 1 << (blocks.shape[1].bit_length() - 1)

    def indices(rows: IntArray) -> FloatArray:
        a, b, mixed = blocks[0, rows], blocks[1, rows], blocks[2:, rows]
        taken = {"f_A": a[None], "f_B": b[None], "f_AB": mixed[:, None]}
        sobol = stats.sobol_indices(func=taken, n=whole)
        return np.stack([np.atleast_1d(sobol.first_order), np.atleast_1d(sobol.total_order)])

    first, total = indices(np.arange(whole))
    low, high = _interval(lambda rows: indices(rows)[0], whole)
    return [
        Effect(axis, float(first[i]), float(low[i]), float(high[i]), float(total[i]))
        for i, axis in enumerate(axes)
    ]


def morris_effects(values: FloatArray, walks: FloatArray, axes: Sequence[str]) -> list[Effect]:
    """Return mu* and sigma of each axis from the values at the points of Morris trajectories.

    `values` is (trajectory, point); `walks` is (trajectory, point, axis), the coordinates of the
    points in the unit cube.
    """
    whole = np.isfinite(values).all(axis=1)
    values, walks = values[whole], walks[whole]
    if len(values) < 2:
        return []
    steps = np.diff(walks, axis=1)
    moved = np.abs(steps).argmax(axis=2)
    slopes = np.diff(values, axis=1) / np.take_along_axis(steps, moved[..., None], 2)[..., 0]
    effects = np.zeros((len(values), len(axes)))
    np.put_along_axis(effects, moved, slopes, axis=1)
    low, high = _interval(lambda rows: np.abs(effects[rows]).mean(axis=0), len(effects))
    return [
        Effect(
            axis,
            float(np.abs(effects[:, i]).mean()),
            float(low[i]),
            float(high[i]),
            float(effects[:, i].std(ddof=1)),
        )
        for i, axis in enumerate(axes)
    ]


def _interval(
    estimate: Callable[[IntArray], FloatArray], count: int
) -> tuple[FloatArray, FloatArray]:
    """Return the 95 % bootstrap interval of an estimate over `count` rows, by percentiles."""
    rng = np.random.default_rng(0)
    drawn = np.array([estimate(rng.integers(0, count, count)) for _ in range(_DRAWS)])
    low, high = np.percentile(drawn, [2.5, 97.5], axis=0)
    return np.asarray(low), np.asarray(high)
