"""Compute the phase error by a projector with a nonlinear response, and its uncertainty.

The phase error is a ripple with N periods per fringe. Symbols: N steps, phi phase, B_m amplitude of
harmonic m of a fringe. N steps cancel all harmonics except m = k N +- 1 with whole k. These change
the phase by about (B_(N-1) - B_(N+1)) / B_1 sin(N phi), which for N = 3 and 4 exceeds the noise.
Zhang and Huang, Opt. Eng. 46, 063601 (2007), correct this error by a table over the phase, as this
module does. Lens blur reduces high harmonics more than the first one. The table includes this
blur, and is computed from the 8-bit levels that were shown.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from reconstruction.arrays import FloatArray, FloatImage
from reconstruction.patterns import AXES, Axis, PatternSet
from reconstruction.pixel_shape import pixels_per_column, smear_px
from reconstruction.rig.projected_light import GAMMA_RANGE, ProjectorResponse, blurred

NODES = 512
"""Number of nodes of a table over one turn of the phase, at n / NODES turns. The value of a node is
a local mean. A curvature k of the phase error adds k h^2 / 12 to the mean at the node distance h:
0.2 mrad for N = 3 and gamma 2.2."""

TURN = 2.0 * np.pi
_PER_NODE = 2
_MOST_PERIODS = 24
# A pixel further from the end of the image than this many blurs is not affected by it.
_EDGE_BLURS = 4.0
# Step of gamma and of blur, px, for numerical derivatives: small compared with both, large compared
# with rounding errors.
_STEP = 1e-3


@dataclass(frozen=True, eq=False)
class Ripple:
    """Tables over the measured phase for a projector's response, at NODES + 1 nodes.

    The last node equals the first. A table that is not needed has the shape (2, 0, 0).

    Attributes
    ----------
    error_rad : (axis, set, node) float32, measured minus true phase
    sigma_rad : (axis, set, node) float32, standard uncertainty of error_rad
    shot_share : (axis, set, node) float32; the light that determines the shot noise of the phase,
        minus the mean light of the steps, as a share of the modulation
    threshold_share : (axis,); level halfway between white and black, minus the mean of the phase
        frames, as a share of the modulation
    """

    error_rad: FloatImage
    sigma_rad: FloatImage
    shot_share: FloatImage
    threshold_share: tuple[float, float]


_EMPTY: FloatImage = np.zeros((2, 0, 0), np.float32)


def ripple_of(patterns: PatternSet, response: ProjectorResponse | None) -> Ripple:
    """Return the tables of phase error and noise over the phase for a projector's response.

    If the sequence has no fringes, or if `response` is None (a linear response), the tables have
    the shape (2, 0, 0). Only `shot_share` is computed for a linear response, too, if the sequence
    has three phase steps.

    Parameters
    ----------
    patterns : pattern sequence
    response : response of the projector; None: a linear response
    """
    if response is None or not patterns.steps:
        shot = _of_three_steps(patterns) if _is_three_steps(patterns) else _EMPTY
        return Ripple(_EMPTY, _EMPTY, shot, (0.0, 0.0))
    shape = 2, len(patterns.periods_px), NODES + 1
    error, sigma, shot = (np.zeros(shape, np.float32) for _ in range(3))
    shares = [0.0, 0.0]
    for axis in patterns.axes:
        k = AXES.index(axis)
        for fringes in range(shape[1]):
            error[k, fringes], sigma[k, fringes] = _tables(patterns, axis, fringes, response)
            shot[k, fringes] = _shot_table(patterns, axis, fringes, response)
        shares[k] = _threshold_share(patterns, axis, response)
    return Ripple(error, sigma, shot, (shares[0], shares[1]))


def turned(ripple: Ripple, share: float) -> Ripple:
    """Return the tables as functions of a phase that is larger by a share of a turn."""
    if share == 0.0:
        return ripple

    def around(table: FloatImage) -> FloatImage:
        if not table.size:
            return table
        moved = np.roll(table[..., :-1], round(share * NODES), axis=-1)
        return np.concatenate([moved, moved[..., :1]], axis=-1)

    return replace(
        ripple,
        error_rad=around(ripple.error_rad),
        sigma_rad=around(ripple.sigma_rad),
        shot_share=around(ripple.shot_share),
    )


def _is_three_steps(patterns: PatternSet) -> bool:
    """Return True if the frames of a period are one or two sets of three equal steps."""
    return patterns.steps == 3 or (patterns.steps == 6 and patterns.stepping == "quarter_pairs")


def _of_three_steps(patterns: PatternSet) -> FloatImage:
    """Return `Ripple.shot_share` of three steps for a linear response: -cos(3 (phi + t_0)) / 2.

    This is (2 / N) sum cos(x_n) sin^2(x_n) with x_n = phi + t_n for N = 3 and the first shift t_0.
    The sum is 0 for more steps. Two sets of three steps have the mean of both.
    """
    shot: FloatImage = np.zeros((2, len(patterns.periods_px), NODES + 1), np.float32)
    turns = np.arange(NODES + 1) / NODES
    for axis in patterns.axes:
        for fringes in range(shot.shape[1]):
            share = [
                -0.5 * np.cos(3.0 * TURN * (turns + first))
                for first in patterns.shifts(axis, fringes)[: patterns.steps // 3]
            ]
            shot[AXES.index(axis), fringes] = np.mean(share, axis=0)
    return shot


def _shot_table(
    patterns: PatternSet, axis: Axis, fringes: int, response: ProjectorResponse
) -> FloatArray:
    """Return `Ripple.shot_share` (node,) of one fringe set over the measured phase.

    It is ((2 / N) sum L_n sin^2(x_n) - mean L) / modulation with the light L_n of step n. The error
    of the phase of N equal steps is -(2 / (N B)) sum e_n sin(x_n), with the noise e_n of step n and
    x_n = phi + t_n (Surrel 1997).
    """
    light, phasor, turns = _frames_at(patterns, axis, fringes, response)[1:]
    weight = 2.0 * np.sin(np.angle(phasor)[:, None] + TURN * turns) ** 2
    modulation = 2.0 / patterns.steps * np.abs(phasor)
    share = ((weight * light).mean(axis=1) - light.mean(axis=1)) / modulation
    return _over_nodes(share, np.angle(phasor))[0]


def _tables(
    patterns: PatternSet, axis: Axis, fringes: int, response: ProjectorResponse
) -> tuple[FloatArray, FloatArray]:
    mean, spread = _table(patterns, axis, fringes, response)
    variance = spread**2
    for changed, step, uncertainty in _changes(response):
        if uncertainty > 0.0:
            perturbed, _ = _table(patterns, axis, fringes, changed)
            variance = variance + ((perturbed - mean) / step * uncertainty) ** 2
    return mean, np.sqrt(variance)


def _changes(
    response: ProjectorResponse,
) -> list[tuple[ProjectorResponse, float, float]]:
    """Return changed responses for numerical derivatives of the tables.

    Each entry is a response with gamma or blur changed by a small step, the step, and the standard
    uncertainty of gamma or blur.
    """
    up = response.gamma + _STEP <= GAMMA_RANGE[1]
    step = _STEP if up else -_STEP
    steeper = replace(response, gamma=1.0 if response.curve else response.gamma + step)
    wider = replace(response, blur_px=min(response.blur_px + _STEP, 10.0))
    gamma_uncertainty = 0.0 if response.curve else response.gamma_uncertainty
    return [
        (steeper, step, gamma_uncertainty),
        (wider, max(wider.blur_px - response.blur_px, 1e-9), response.blur_uncertainty_px),
    ]


def _table(
    patterns: PatternSet, axis: Axis, fringes: int, response: ProjectorResponse
) -> tuple[FloatArray, FloatArray]:
    """Return the mean phase error (node,), rad, and its standard deviation over the periods, rad.

    The phase error varies because of the 8-bit levels, which differ from period to period unless
    the period is a whole number of pixels.
    """
    u_px, _, phasor, _ = _frames_at(patterns, axis, fringes, response)
    period_px = patterns.periods_along(axis)[fringes]
    error = np.angle(phasor * np.exp(-1j * TURN * u_px / period_px))
    return _over_nodes(error, np.angle(phasor))


def _over_nodes(values: FloatArray, phase_rad: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return mean and standard deviation (node,) of values (place,) at phases near each node."""
    place = phase_rad / TURN % 1.0 * NODES
    low = np.floor(place)
    share = place - low
    node = np.concatenate([low, low + 1.0]).astype(int) % NODES
    weight, twice = np.concatenate([1.0 - share, share]), np.tile(values, 2)
    total = np.bincount(node, weight, NODES)
    mean = _filled(np.bincount(node, weight * twice, NODES), total)
    around = (values - np.interp(place, np.arange(NODES), mean, period=NODES)) ** 2
    spread = _filled(np.bincount(node, weight * np.tile(around, 2), NODES), total)
    return np.append(mean, mean[0]), np.sqrt(np.append(spread, spread[0]))


def _frames_at(
    patterns: PatternSet, axis: Axis, fringes: int, response: ProjectorResponse
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return positions and the light there that the decoder would measure, for one fringe set.

    Returns
    -------
    Four arrays: positions on the projector (place,), px; light of all steps (place, step); the
    phasor that the decoder measures (place,), complex; the phase shifts (step,), turns
    """
    first = patterns.index("phase", axis).start + fringes * patterns.steps
    frames = patterns.frames[first : first + patterns.steps]
    levels = np.stack([patterns.profile(frame) for frame in frames], axis=1)
    period_px, length = patterns.periods_along(axis)[fringes], patterns.length_px(axis)
    per_px = max(2, int(np.ceil(_PER_NODE * NODES / period_px)))
    blur_px = response.blur_px * pixels_per_column(patterns.pixel_ratio, axis)
    edge = min(1.0 + _EDGE_BLURS * blur_px, length / 4.0)
    last = min(length - 0.5 - edge, edge + _MOST_PERIODS * period_px)
    u_px = np.arange(edge - 0.5, last, 1.0 / per_px)
    smear = smear_px(patterns.pixel_ratio, axis)
    light = blurred(response.light(levels), u_px, blur_px, smear)
    turns = np.array(patterns.shifts(axis, fringes))
    return u_px, light, np.asarray(light @ np.exp(-1j * TURN * turns)), turns


def _filled(total: NDArray[Any], weight: NDArray[Any]) -> FloatArray:
    """Return the weighted mean at each node; nodes without samples are interpolated."""
    weighted = np.flatnonzero(weight > 0.0)
    nodes = np.arange(NODES)
    return np.asarray(np.interp(nodes, weighted, total[weighted] / weight[weighted], period=NODES))


def _threshold_share(patterns: PatternSet, axis: Axis, response: ProjectorResponse) -> float:
    """Return `Ripple.threshold_share` of one axis, from the light of the measuring period.

    It is the mean light of low and high level minus the mean light of the fringes, over the
    modulation.
    """
    low, high = response.light(
        np.array([patterns.low_level, patterns.high_level], dtype=np.uint8)
    ).tolist()
    _, light, phasor, _ = _frames_at(patterns, axis, 0, response)
    modulation = float(np.mean(np.abs(phasor))) * 2.0 / patterns.steps
    return float((0.5 * (low + high) - float(light.mean())) / modulation)
