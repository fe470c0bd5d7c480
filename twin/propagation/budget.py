"""Ranked uncertainty budget: contributions of each input, of noise and of calibration.

By first and second differences over one standard uncertainty of each input (JCGM 100, 5.1.3 and
5.1.2, note), for comparison with the standard deviation of the trials, in which all inputs are
drawn together.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from reconstruction.arrays import FloatArray
from twin.config.inputs import Input
from twin.study.trials import HIGH, LOW, MIDDLE


@dataclass(frozen=True)
class Part:
    """Contribution of one source to the standard uncertainty of a measurand, in its unit.

    Attributes
    ----------
    name, group, key : of the input; noise and calibration have no key
    u : standard uncertainty
    """

    name: str
    group: str
    key: str
    u: float


def part_of(name: str, distributed: Input, by_step: Mapping[str, float]) -> Part | None:
    """Return the contribution of an input, from the measurand at its steps and the nominal value.

    Parameters
    ----------
    name : of the input
    distributed : the input
    by_step : measurand by step: nominal, low and high; of a choice by value

    Returns
    -------
    Part or None
        None if a step has no value: the press or the fit failed.
    """
    if distributed.distribution == "choice":
        weights = np.array(distributed.weights or [1.0] * len(distributed.values))
        values = [by_step.get(f"{value:g}") for value in distributed.values]
        if None in values:
            return None
        taken, shares = np.array(values, np.float64), weights / weights.sum()
        u = float(np.sqrt(shares @ (taken - shares @ taken) ** 2))
        return Part(name, distributed.group, distributed.key, u)
    if distributed.spread == 0.0:
        return Part(name, distributed.group, distributed.key, 0.0)
    ends = [by_step.get(step) for step in (LOW, MIDDLE, HIGH)]
    if None in ends:
        return None
    return Part(name, distributed.group, distributed.key, spread_of_parabola(*map(float, ends)))  # type: ignore[arg-type]


def spread_of_parabola(low: float, middle: float, high: float) -> float:
    """Return the standard deviation of the parabola through three points, of a normal input.

    The points are spaced by one standard uncertainty. An untilted specimen is symmetric in tilt and
    yaw: there the slope is 0 and the variance is that of the bend, 1/2 (f'' u^2)^2.
    """
    slope, bend = (high - low) / 2, high + low - 2 * middle
    return float(np.hypot(slope, bend / np.sqrt(2.0)))


def noise_part(repeated: FloatArray) -> Part | None:
    """Return the contribution of noise: standard deviation of repeats (n,) that differ in noise."""
    if repeated.size < 2:
        return None
    return Part("noise and decoding", "camera", "", float(repeated.std(ddof=1)))


def noise_left(differences: FloatArray, parts: Sequence[Part]) -> Part | None:
    """Return noise from trials: variance of measurement minus true face, less that of the optics.

    Parameters
    ----------
    differences : (n,) float
        Measurand with the true rig minus that of the true face, by trial.
    parts : the variances of group "optics" are in the differences, and are subtracted once
    """
    if differences.size < 2:
        return None
    light = [part.u for part in parts if part.group == "optics"]
    left = float(differences.var(ddof=1)) - sum(u**2 for u in light)
    name = "noise and decoding" if light else "noise, optics and decoding"
    return Part(name, "camera", "", float(np.sqrt(max(left, 0.0))))


def calibration_part(differences: FloatArray) -> Part | None:
    """Return the calibration's contribution, from changes (n,) by recalibration on equal images."""
    if differences.size < 2:
        return None
    return Part("calibration", "rig", "", float(differences.std(ddof=1)))


def ranked(parts: Sequence[Part]) -> list[Part]:
    """Return the parts, the largest first."""
    return sorted(parts, key=lambda part: -part.u)


def together(parts: Sequence[Part]) -> float:
    """Return the combined standard uncertainty of independent parts (JCGM 100, 5.1.2)."""
    return float(np.sqrt(sum(part.u**2 for part in parts)))


def shares(parts: Sequence[Part]) -> list[float]:
    """Return the share of the variance of each part, 0 to 1; all 0 if all parts are 0."""
    whole = sum(part.u**2 for part in parts)
    return [part.u**2 / whole if whole else 0.0 for part in parts]
