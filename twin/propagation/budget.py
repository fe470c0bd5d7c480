"""Ranked uncertainty budget: contributions of each input, of noise and of calibration.

The contribution of an input is computed from first and second differences of the measurand over
one standard uncertainty of the input (JCGM 100, 5.1.3 and 5.1.2, note). The combined budget is
compared with the standard deviation of the trials, in which all inputs are drawn together.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from reconstruction.arrays import FloatArray
from twin.config.inputs import Input
from twin.study.trials import HIGH, LOW, MIDDLE


@dataclass(frozen=True)
class Part:
    """Contribution of one source to the standard uncertainty of a measurand.

    Attributes
    ----------
    name, group, key : name, group and dotted key of the input; key is empty for noise and
        calibration
    u : standard uncertainty from this source, in the measurand's unit
    """

    name: str
    group: str
    key: str
    u: float


def part_of(name: str, distributed: Input, by_step: Mapping[str, float]) -> Part | None:
    """Return the contribution of one input to the standard uncertainty of a measurand.

    Parameters
    ----------
    name : name of the input
    distributed : the input with its distribution
    by_step : value of the measurand by step: nominal, low and high; if the input is a choice, by
        the chosen value

    Returns
    -------
    Part or None
        None if the measurand has no value at a step, because the press or the fit failed.
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
    """Return the standard deviation of a measurand that is a parabola of one normal input.

    Parameters
    ----------
    low, middle, high : measurand at the nominal input minus u, at the nominal input, and plus u,
        with u the standard uncertainty of the input

    Notes
    -----
    An untilted specimen is symmetric in tilt and yaw. There the slope f' is 0, and the variance is
    that of the curvature, 1/2 (f'' u^2)^2.
    """
    slope, bend = (high - low) / 2, high + low - 2 * middle
    return float(np.hypot(slope, bend / np.sqrt(2.0)))


def noise_part(repeated: FloatArray) -> Part | None:
    """Return the contribution of noise from repeats (n,) that differ in noise; None if n < 2."""
    if repeated.size < 2:
        return None
    return Part("noise and decoding", "camera", "", float(repeated.std(ddof=1)))


def noise_left(differences: FloatArray, parts: Sequence[Part]) -> Part | None:
    """Return the contribution of noise, from trials in which all inputs are drawn; None if n < 2.

    It is the variance of `differences` minus the variances of the optics.

    Parameters
    ----------
    differences : (n,) float
        By trial, the measurand evaluated with the true rig minus the measurand of the true face.
    parts : contributions of the inputs; `differences` contain those of group "optics"
    """
    if differences.size < 2:
        return None
    light = [part.u for part in parts if part.group == "optics"]
    left = float(differences.var(ddof=1)) - sum(u**2 for u in light)
    name = "noise and decoding" if light else "noise, optics and decoding"
    return Part(name, "camera", "", float(np.sqrt(max(left, 0.0))))


def calibration_part(differences: FloatArray) -> Part | None:
    """Return the contribution of calibration; None if n < 2.

    `differences` (n,) is the change of the measurand, by trial, if the same images are evaluated
    with another calibration.
    """
    if differences.size < 2:
        return None
    return Part("calibration", "rig", "", float(differences.std(ddof=1)))


def ranked(parts: Sequence[Part]) -> list[Part]:
    """Return the contributions sorted by standard uncertainty, the largest first."""
    return sorted(parts, key=lambda part: -part.u)


def together(parts: Sequence[Part]) -> float:
    """Return the combined standard uncertainty of independent contributions (JCGM 100, 5.1.2)."""
    return float(np.sqrt(sum(part.u**2 for part in parts)))


def shares(parts: Sequence[Part]) -> list[float]:
    """Return the share of each contribution in the variance, 0 to 1; all 0 if the variance is 0."""
    whole = sum(part.u**2 for part in parts)
    return [part.u**2 / whole if whole else 0.0 for part in parts]
