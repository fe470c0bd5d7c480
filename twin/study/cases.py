"""Cases of a study: validated experiments at the points of the design space.

A point of the design space has one level (a value, or a set of changed fields) of every axis. The
name of a case is a digest of its experiment and conditions.
"""

import hashlib
import itertools
import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.errors import InputError
from twin.config import ConfigError, Experiment, digest, vary
from twin.config.axis import Axis, Level
from twin.config.loading import by_method
from twin.config.quantities import value_at
from twin.config.study import MOST_CASES, Constraint, Study, without_absent
from twin.results.layout import KNOWN_BEFORE, layout_figures
from twin.study.measuring import NOMINAL_CONDITIONS, Conditions
from twin.study.needed import (
    bound_needed,
    compensation_needed,
    derivatives_needed,
    layer_for,
)

Point = tuple[Level, ...]

MORRIS_LEVELS = 4


def points_of(study: Study) -> list[Point]:
    """Return the points of a study; each point is a tuple with one level per axis.

    Raises
    ------
    InputError : the study has more cases than allowed, or it chooses its points while it runs
    """
    method = study.sampling.method
    if method in ("optimise", "gradient", "trials"):
        raise InputError(f"sampling.method = '{method}': its cases are no points of axes")
    count = point_count(study)
    if (cases := count * cases_per_point(study)) > MOST_CASES:
        raise InputError(
            f"study: found {cases} cases ({count} points, {study.repeats} repeats, "
            f"{len(study.modalities) or 1} methods), allowed up to {MOST_CASES}; take fewer"
        )
    if method == "grid":
        return list(itertools.product(*(axis.levels() for axis in study.axis)))
    return [point_at(study.axis, row) for row in shares_of(study)]


def point_count(study: Study) -> int:
    """Return the number of points of a study without making the points."""
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
        case "gradient":
            return study.gradient.evaluations if study.gradient else 0
    return count


def cases_per_point(study: Study) -> int:
    """Return the number of cases (repeats x methods) at each point, before constraints."""
    return study.repeats * max(1, len(study.modalities))


def point_at(axes: tuple[Axis, ...], shares: FloatArray) -> Point:
    """Return the point at the coordinates `shares` (axis,), 0 to 1, of the unit cube."""
    return tuple(axis.level_at(float(u)) for axis, u in zip(axes, shares, strict=True))


def shares_of(study: Study) -> FloatArray:
    """Return the points of a study that samples its axes, as coordinates (point, axis), 0 to 1.

    Raises
    ------
    ValueError : the study's method of sampling is not latin_hypercube, sobol, saltelli or morris
    """
    from scipy.stats import qmc  # takes 0.5 s to import, and a grid does not need it

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


def _sobol(axes: int, count: int, rng: np.random.Generator) -> FloatArray:
    """Return scrambled Sobol' points (count, axes): the first `count` of a set of 2^k points."""
    from scipy.stats import qmc

    exponent = int(np.ceil(np.log2(max(count, 1))))
    return np.asarray(qmc.Sobol(axes, rng=rng).random_base2(exponent))[:count]


def saltelli_shares(axes: int, count: int, rng: np.random.Generator) -> FloatArray:
    """Return the points of a Saltelli design as coordinates (count x (axes + 2), axes), 0 to 1.

    First come the rows of the matrix A, then those of B, then for each i the rows of A with column
    i from B. Saltelli, A. et al.: Variance based sensitivity analysis of model output. Computer
    Physics Communications 181, 259-270 (2010), table 2.
    """
    pairs = _sobol(2 * axes, count, rng)
    a, b = pairs[:, :axes], pairs[:, axes:]
    mixed = [np.where(np.arange(axes) == i, b, a) for i in range(axes)]
    return np.concatenate([a, b, *mixed])


def _walks(axes: int, count: int, rng: np.random.Generator) -> Iterator[FloatArray]:
    """Yield trajectories (axes + 1, axes) in which each axis changes once, in random order.

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


_MOST_PROBLEMS = 5


@dataclass(frozen=True, eq=False)
class Case:
    """One measurement of a study: an experiment, its conditions, and the name in the store.

    Attributes
    ----------
    settings : value of every axis by the axis' title, and `modality` and `seed` if they are varied
    experiment : the experiment of the measurement
    digest : name of the case in the store
    conditions : conditions of the measurement that are not part of its experiment
    """

    settings: Mapping[str, Any]
    experiment: Experiment
    digest: str
    conditions: Conditions = NOMINAL_CONDITIONS


def case_of(
    settings: Mapping[str, Any], experiment: Experiment, conditions: Conditions = NOMINAL_CONDITIONS
) -> Case:
    """Return a case with its digest.

    The digest is computed from the experiment, and from the conditions if they are not nominal.
    """
    name = digest(experiment)
    if conditions != NOMINAL_CONDITIONS:
        described = asdict(conditions)
        if conditions.bound == NOMINAL_CONDITIONS.bound:  # keeps names in older stores
            del described["bound"]
        if not conditions.derivatives:
            del described["derivatives"]
        if conditions.layer is None:
            del described["layer"]
        else:
            described["layer"] = conditions.layer.model_dump(mode="json")
        named = f"{name} {json.dumps(described, sort_keys=True)}"
        name = hashlib.blake2b(named.encode(), digest_size=8).hexdigest()
    return Case(settings, experiment, name, conditions)


@dataclass(frozen=True, eq=False)
class Cases:
    """Cases of a study in the order of the study, and the number of cases that constraints exclude.

    Attributes
    ----------
    run : the cases to be measured
    excluded : number of cases that constraints exclude
    step : 1 if `run` has all cases; n if it has the cases of every n-th point, for a preview
    """

    run: tuple[Case, ...]
    excluded: int
    step: int = 1

    def unique(self) -> list[Case]:
        """Return the cases; of several cases with equal content only one."""
        return list({case.digest: case for case in self.run}.values())


def cases_of(study: Study, base: Experiment, points: Iterable[Point] | None = None) -> Cases:
    """Return the cases of a study at its points, with validated experiments.

    Parameters
    ----------
    study : the study
    base : the experiment that is varied
    points : points of the design space; default: those of the study's sampling

    Raises
    ------
    ConfigError : some cases are not valid experiments, or constraints exclude all cases. The
        message lists the first problems, about five, each once with one case that has it
    InputError : too many points
    """
    cases, excluded = [], 0
    problems: dict[str, str] = {}
    for point in points_of(study) if points is None else points:
        try:
            made = list(_cases_at(study, base, point))
        except ConfigError as error:
            example = ", ".join(f"{t} = {v}" for t, v in _settings(study, point).items())
            for line in str(error).splitlines():
                problems.setdefault(line.removeprefix(f"{base.name}: "), example)
            if len(problems) >= _MOST_PROBLEMS:
                break
            continue
        allowed = [case for case in made if _admits(study.constraint, case.experiment)]
        excluded += len(made) - len(allowed)
        cases += allowed
    if problems:
        lines = (f"{study.name}: {line} (at {example})" for line, example in problems.items())
        raise ConfigError("\n".join(lines))
    if not cases:
        raise ConfigError(f"{study.name}: no case is left, constraints exclude all {excluded}")
    return Cases(tuple(cases), excluded)


def _cases_at(study: Study, base: Experiment, point: Point) -> Iterable[Case]:
    changes: dict[str, Any] = {}
    for level in point:
        changes |= without_absent(dict(level.changes))
    settings = _settings(study, point)
    bound = bound_needed(study)
    compensates = compensation_needed(study)
    for modality in study.modalities or (base.modality,):
        for repeat in range(study.repeats):
            named: dict[str, Any] = {"modality": modality} if len(study.modalities) > 1 else {}
            if study.repeats > 1:
                named["seed"] = base.seed + repeat
            method = by_method(modality) if study.modalities else {}
            experiment = vary(base, changes | method | named)
            layer = layer_for(experiment) if compensates else None
            derivatives = derivatives_needed(study, experiment)
            conditions = Conditions(bound=bound, derivatives=derivatives, layer=layer)
            yield case_of(settings | named, experiment, conditions)


def _settings(study: Study, point: Point) -> dict[str, Any]:
    return {axis.title: level.label for axis, level in zip(study.axis, point, strict=True)}


def quantity(experiment: Experiment, figures: Mapping[str, Any], bound: Constraint) -> float | None:
    """Return the number that a constraint limits: a field, a figure, or the ratio of two.

    None if a field or figure is missing, or if the denominator is 0.
    """
    parts = _parts(experiment, figures, bound)
    if parts is None or 0.0 in parts[1:]:
        return None
    return parts[0] if len(parts) == 1 else parts[0] / parts[1]


def meets(experiment: Experiment, figures: Mapping[str, Any], bound: Constraint) -> bool:
    """Return True if a case satisfies a constraint; False if the limited number does not exist."""
    number = quantity(experiment, figures, bound)
    return number is not None and bound.holds_for(number)


def _parts(
    experiment: Experiment, figures: Mapping[str, Any], bound: Constraint
) -> list[float] | None:
    """Return the limited number, or numerator and denominator; None if one of them is missing."""
    names = [bound.value] if bound.per is None else [bound.value, bound.per]
    values = [figures.get(name, value_at(experiment, name)) for name in names]
    if not all(isinstance(value, (int, float)) for value in values):
        return None
    return [float(value) for value in values]


def _admits(constraints: tuple[Constraint, ...], experiment: Experiment) -> bool:
    """Return True if all constraints on fields, and on figures of the layout, are satisfied.

    Constraints on other figures are checked after the measurement.
    """
    named = {name for bound in constraints for name in (bound.value, bound.per)}
    known = layout_figures(experiment) if named & KNOWN_BEFORE else {}
    return all(_may_meet(bound, experiment, known) for bound in constraints)


def _may_meet(bound: Constraint, experiment: Experiment, known: Mapping[str, float]) -> bool:
    """Return False if the known figures, or a lower limit of the duration, miss a constraint."""
    if _parts(experiment, known, bound) is not None:
        return meets(experiment, known, bound)
    if bound.value != "sequence_ms" or bound.per is not None or bound.at_most is None:
        return True
    return known.get("least_sequence_ms", 0.0) <= bound.at_most
