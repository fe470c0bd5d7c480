"""Points of the design space: which level of every axis each point takes."""

import itertools
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from reconstruction.errors import InputError
from twin.config.study import MOST_CASES, Axis, Level, Study

Point = tuple[Level, ...]
Shares = NDArray[np.float64]

MORRIS_LEVELS = 4


def points_of(study: Study) -> list[Point]:
    """Return the points of a study, one level per axis each.

    Raises
    ------
    InputError
        More points than a study may have, or a study that finds its points as it goes.
    """
    method = study.sampling.method
    if method in ("optimise", "trials"):
        raise InputError(f"sampling.method = '{method}': its cases are no points of axes")
    count = point_count(study)
    if count > MOST_CASES:
        raise InputError(f"study: found {count} points, allowed up to {MOST_CASES}; take fewer")
    if method == "grid":
        return list(itertools.product(*(axis.levels() for axis in study.axis)))
    return [point_at(study.axis, row) for row in shares_of(study)]


def point_count(study: Study) -> int:
    """Return how many points a study has, without making them."""
    count, axes = study.sampling.count or 0, len(study.axis)
    match study.sampling.method:
        case "grid":
            return int(np.prod([len(axis.levels()) for axis in study.axis], dtype=object))
        case "saltelli":
            return count * (axes + 2)
        case "morris":
            return count * (axes + 1)
        case "optimise":
            return study.optimise.trials if study.optimise else 0
    return count


def point_at(axes: tuple[Axis, ...], shares: Shares) -> Point:
    """Return the point at a place (axis,) of the unit cube."""
    return tuple(axis.level_at(float(u)) for axis, u in zip(axes, shares, strict=True))


def shares_of(study: Study) -> Shares:
    """Return places (point, axis) in the unit cube for a study that samples."""
    count, axes = study.sampling.count or 1, len(study.axis)
    rng = np.random.default_rng(study.sampling.seed)
    match study.sampling.method:
        case "latin_hypercube":
            return np.asarray(qmc.LatinHypercube(axes, rng=rng).random(count))
        case "sobol":
            return _sobol(axes, count, rng)
        case "saltelli":
            return saltelli_shares(axes, count, rng)
        case "morris":
            return np.concatenate(list(_walks(axes, count, rng)))
    raise ValueError(f"{study.sampling.method} does not draw from the unit cube")


def _sobol(axes: int, count: int, rng: np.random.Generator) -> Shares:
    """Scrambled Sobol' points; the first `count` of the next power of two, drawn whole."""
    exponent = int(np.ceil(np.log2(max(count, 1))))
    return np.asarray(qmc.Sobol(axes, rng=rng).random_base2(exponent))[:count]


def saltelli_shares(axes: int, count: int, rng: np.random.Generator) -> Shares:
    """Rows A, B and A with column i from B, for Saltelli et al. (2010), blocks one after another.

    Saltelli, A. et al.: Variance based sensitivity analysis of model output. Computer Physics
    Communications 181, 259-270 (2010), table 2.
    """
    pairs = _sobol(2 * axes, count, rng)
    a, b = pairs[:, :axes], pairs[:, axes:]
    mixed = [np.where(np.arange(axes) == i, b, a) for i in range(axes)]
    return np.concatenate([a, b, *mixed])


def _walks(axes: int, count: int, rng: np.random.Generator) -> Iterator[Shares]:
    """Yield walks (axes + 1, axes) in which every axis takes one step, in random order.

    Morris, M. D.: Factorial sampling plans for preliminary computational experiments.
    Technometrics 33, 161-174 (1991): p = 4 levels, step p / (2 (p - 1)) = 2/3.
    """
    step = MORRIS_LEVELS / (2 * (MORRIS_LEVELS - 1))
    low = np.arange(MORRIS_LEVELS // 2) / (MORRIS_LEVELS - 1)
    for _ in range(count):
        start = rng.choice(low, axes)
        up = rng.random(axes) < 0.5
        place = np.where(up, start, start + step)
        rows = [place.copy()]
        for axis in rng.permutation(axes):
            place[axis] += step if up[axis] else -step
            rows.append(place.copy())
        yield np.clip(np.array(rows), 0.0, 1.0)
