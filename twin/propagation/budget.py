"""Ranked uncertainty budget: what each input alone adds to a measurand, and what noise adds.

By first and second differences over one standard uncertainty of each input (JCGM 100, 5.1.3 and
5.1.2, note), beside the standard deviation of the trials, in which all inputs are drawn together.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from reconstruction.arrays import FloatArray
from twin.config.inputs import Input
from twin.study.trials import HIGH, LOW, MIDDLE


@dataclass(frozen=True)
class Part:
    """What one source adds to the standard uncertainty of a measurand, in the measurand's unit.

    Attributes
    ----------
    name, group, key : of the input; noise and calibration have no key
    u : standard uncertainty
    """

    name: str
    group: str
    key: str
    u: float


def part_of(name: str, one: Input, found: Mapping[str, float]) -> Part | None:
    """Return what an input adds, from the measurand at its steps and at the nominal value.

    Parameters
    ----------
    found : measurand by step: nominal, low and high; of a choice by value

    Returns
    -------
    Part or None
        None where a step has no value: the press failed, or there was nothing to fit.
    """
    if one.distribution == "choice":
        weights = np.array(one.weights or [1.0] * len(one.values))
        values = [found.get(f"{value:g}") for value in one.values]
        if None in values:
            return None
        taken, shares = np.array(values, np.float64), weights / weights.sum()
        u = float(np.sqrt(shares @ (taken - shares @ taken) ** 2))
        return Part(name, one.group, one.key, u)
    if one.spread == 0.0:
        return Part(name, one.group, one.key, 0.0)
    ends = [found.get(step) for step in (LOW, MIDDLE, HIGH)]
    if None in ends:
        return None
    return Part(name, one.group, one.key, spread_of_parabola(*map(float, ends)))  # type: ignore[arg-type]


def spread_of_parabola(low: float, middle: float, high: float) -> float:
    """Return the standard deviation of the parabola through three points, of a normal input.

    They lie one standard uncertainty apart. A specimen at rest is symmetric in tilt and yaw: there
    the slope is nothing and the bend, 1/2 (f'' u^2)^2, is all.
    """
    slope, bend = (high - low) / 2, high + low - 2 * middle
    return float(np.hypot(slope, bend / np.sqrt(2.0)))


def noise_part(repeated: FloatArray) -> Part | None:
    """Return what noise adds: the standard deviation of repeats (n,) with new noise alone."""
    if repeated.size < 2:
        return None
    return Part("noise and decoding", "camera", "", float(repeated.std(ddof=1)))


def noise_left(differences: FloatArray, parts: Sequence[Part]) -> Part | None:
    """Return noise from trials: what they differ from the face by, less what the optics add.

    Parameters
    ----------
    differences : (n,) float
        Measurand with the true rig less that of the true face, by trial.
    parts : those of group "optics" are in the differences, and are taken off once
    """
    if differences.size < 2:
        return None
    light = [part.u for part in parts if part.group == "optics"]
    left = float(differences.var(ddof=1)) - sum(u**2 for u in light)
    name = "noise and decoding" if light else "noise, optics and decoding"
    return Part(name, "camera", "", float(np.sqrt(max(left, 0.0))))


def calibration_part(differences: FloatArray) -> Part | None:
    """Return what the calibration adds, from what another one changes (n,) on the same images."""
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
    """Return the share of the variance of each part, 0 to 1; all 0 where nothing adds anything."""
    whole = sum(part.u**2 for part in parts)
    return [part.u**2 / whole if whole else 0.0 for part in parts]
