"""Search for the fringe period of a calibrated capture of which no pixel gives a point.

The projector coordinate is proportional to the period. With a wrong period, or with exchanged axes,
the projector's ray through the decoded column and row does not meet the camera's ray. Other periods
and exchanged axes are tried on a sample of the pixels, without decoding the frames again.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from reconstruction.capture.folder import Capture
from reconstruction.capture.frame_order import MUCH_MORE, Sample, sample_of
from reconstruction.decoding import AxisDecode, Decoded, DecodeOptions
from reconstruction.decoding.decode import decode
from reconstruction.patterns import AXES, Axis
from reconstruction.triangulation import triangulate

# Tried periods: from the stated one divided by this number to that one times it, px apart.
_FACTOR, _STEP_PX = 2.5, 0.5


@dataclass(frozen=True)
class PeriodTrial:
    """A changed description of the frames, and the share of the lit pixels that it gives a point.

    Attributes
    ----------
    change : the keys of capture.toml with their tried values, as text
    share : 0 to 1
    """

    change: str
    share: float


def period_trials(capture: Capture) -> list[PeriodTrial]:
    """Return all trials, the best first; empty for patterns along one axis, which have no check.

    Trials with equal shares are in this order: exchanged axes, both axes with one period, one axis.
    """
    if capture.patterns.axes != AXES:
        return []
    sample = sample_of(capture.stack, capture.patterns, capture.sensor, capture.calibration)
    options = DecodeOptions(filter_taps=0, frame_gains=False)
    decoded = decode(sample.stack, sample.patterns, sample.sensor, options)
    trials = [
        PeriodTrial(text, _share(sample, changed)) for text, changed in _changes(decoded, sample)
    ]
    return sorted(trials, key=lambda trial: -trial.share)


def best_period(capture: Capture) -> str:
    """Return a text on the trials: the change that explains the images, or that none does."""
    trials = period_trials(capture)
    if not trials:
        return ""
    best = trials[0]
    if best.share >= MUCH_MORE:
        return f"with {best.change} {best.share:.0%} of the lit pixels give points"
    return (
        f"tried without result: exchanged axes, and period_px up to {_FACTOR:g} times larger or "
        "smaller; so the calibration is probably that of another rig"
    )


def _periods(stated_px: float) -> list[float]:
    low, high = np.ceil(stated_px / _FACTOR / _STEP_PX), np.floor(stated_px * _FACTOR / _STEP_PX)
    return [_STEP_PX * k for k in range(int(low), int(high) + 1)]


def _changes(decoded: Decoded, sample: Sample) -> Iterator[tuple[str, Decoded]]:
    """Yield each change as text, with the coordinates that it would give."""
    yield (
        "exchanged axes (column and row)",
        replace(decoded, column=decoded.row, row=decoded.column),
    )
    stated = {axis: sample.patterns.period_along(axis) for axis in AXES}
    choices: list[tuple[Axis, ...]] = [AXES] if stated["column"] == stated["row"] else []
    for axes in (*choices, ("column",), ("row",)):
        for period_px in _periods(stated[axes[0]]):
            ratio = period_px / stated[axes[0]]
            text = f"period_px = {period_px:g} along {' and '.join(axes)}"
            yield f"{text} (stated {stated[axes[0]]:g})", _scaled(decoded, axes, ratio)


def _scaled(decoded: Decoded, axes: tuple[Axis, ...], ratio: float) -> Decoded:
    def scaled(axis: Axis, values: AxisDecode) -> AxisDecode:
        times = np.float32(ratio if axis in axes else 1.0)
        return replace(
            values,
            coordinate_px=values.coordinate_px * times,
            sigma_px=values.sigma_px * times,
        )

    return replace(decoded, column=scaled("column", decoded.column), row=scaled("row", decoded.row))


def _share(sample: Sample, decoded: Decoded) -> float:
    assert sample.calibration is not None
    valid = triangulate(decoded, sample.calibration, "both").valid
    return float(np.mean(valid[sample.is_lit]))
