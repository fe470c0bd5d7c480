"""Phase error of a sequence by motion, and the phase rate of each pixel from its own frames.

Frame n has the level A + B cos(phi + t_n + e m_n), with the shift t_n, the phase rate e in rad per
frame and the time m_n in frames from the middle of the set. A phasor z = sum a_n I_n exp(-i t_n)
with weights a_n is then

    z = (B / 2) [P exp(i phi) + Q exp(-i phi)]
    P = sum a_n exp(i e m_n),   Q = sum a_n exp(-i e m_n - 2 i t_n)

and the phase error is arg(P + Q exp(-2 i phi)). Its mean over phi is arg P, its amplitude is
arcsin |Q / P|: a ripple with two periods per fringe. If the levels change from frame to frame, A by
a B and B by b B, P and Q contain the factors (1 + b m_n), and exp(-i phi) 2 a sum a_n m_n
exp(-i t_n) is added: a ripple with one period per fringe. For N equal steps

    |Q / P| = sin(e / 2) / sin(2 pi / N + e / 2)

as in Weise, Leibe, Van Gool, Proc. CVPR 2007, for N = 3 and small e. In addition the phase in the
middle of the set differs from that of its first frame by e (N - 1) / 2.

The residuals of the N-step fit are caused by the same motion. With N >= 4 they determine e for each
pixel by least squares.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from reconstruction.arrays import FloatArray, Stack
from reconstruction.decoding import Decoded
from reconstruction.errors import InputError
from reconstruction.motion.least_squares import fit_fringes
from reconstruction.patterns import Axis, PatternSet
from reconstruction.reduction.binomial import CYCLIC_WEIGHTS
from reconstruction.rig.sensor import SensorNoise

TURN = 2.0 * np.pi
_ITERATIONS, LARGEST_CHANGE, _RIDGE = 4, 0.3, 1e-10
# Largest standard deviation of a rate, rad per frame, for a noise of 1 DN.
_LARGEST_SHARE = 1.0


class PhaseSteps(NamedTuple):
    """Shifts of the frames of a fringe set, and their weights in the phasor; both (step,)."""

    shifts_rad: FloatArray
    weights: FloatArray

    @property
    def times(self) -> FloatArray:
        """Time of each frame, in frames, from the middle of the set."""
        count = self.shifts_rad.size
        return np.arange(count, dtype=np.float64) - 0.5 * (count - 1)


def steps_of(patterns: PatternSet, axis: Axis = "column", fringes: int = 0) -> PhaseSteps:
    """Return shifts and weights of the frames of one period of a sequence.

    Parameters
    ----------
    fringes : number of the period; 0: the measuring period

    Raises
    ------
    InputError : the sequence has no phase steps along the axis
    """
    if not patterns.step_sets(axis) or patterns.stepping == "single":
        raise InputError(f"patterns have no phase steps along axis {axis!r}")
    shifts_rad = TURN * np.array(patterns.shifts(axis, fringes))
    weights = CYCLIC_WEIGHTS.get(patterns.stepping, np.ones)(shifts_rad.size)
    return PhaseSteps(shifts_rad, weights)


@dataclass(frozen=True, eq=False)
class MotionError:
    """Phase error of a sequence by motion, relative to the phase in the middle of the set.

    Parameters
    ----------
    bias_rad : mean error over all phases; 0 for a constant rate
    ripple_rad : amplitude of the error that changes with twice the phase
    """

    bias_rad: FloatArray
    ripple_rad: FloatArray


def predicted_motion_error(
    rate_rad: Any, steps: PhaseSteps, acceleration_rad: Any = 0.0
) -> MotionError:
    """Return bias and ripple of the phase for phase rates of any shape.

    Parameters
    ----------
    rate_rad : phase rate in the middle of the set, rad per frame; a number or an array
    steps : shifts and weights of the frames, see `steps_of`
    acceleration_rad : change of the rate from frame to frame, rad, of the same shape
    """
    direct, mirrored = _responses(rate_rad, steps, acceleration_rad)
    share = np.minimum(np.abs(mirrored) / np.maximum(np.abs(direct), 1e-300), 1.0)
    return MotionError(np.angle(direct), np.arcsin(share))


def phase_error(
    phase_rad: Any,
    rate_rad: Any,
    steps: PhaseSteps,
    acceleration_rad: Any = 0.0,
    *,
    mean_change: Any = 0.0,
    modulation_change: Any = 0.0,
) -> FloatArray:
    """Return the error, rad, of the phase of the N-step fit, measured minus true phase.

    Parameters
    ----------
    phase_rad : true phase in the middle of the set; a number or an array
    rate_rad, steps, acceleration_rad : as in `predicted_motion_error`
    mean_change, modulation_change : change of A and of B from frame to frame, divided by B: another
        part of a shaded surface comes into the pixel
    """
    direct, mirrored = _responses(rate_rad, steps, acceleration_rad, modulation_change)
    constant = 2.0 * np.asarray(mean_change, np.float64) * _response_to_mean(steps)
    turned = np.exp(-1j * np.asarray(phase_rad, np.float64))
    phasor = direct + mirrored * turned**2 + constant * turned
    return np.asarray(np.angle(phasor), np.float64)


def _responses(
    rate_rad: Any, steps: PhaseSteps, acceleration_rad: Any, modulation_change: Any = 0.0
) -> tuple[Any, Any]:
    """Return P and Q of the module's docstring, complex, with the shape of the rates."""
    rate, acceleration = (np.asarray(value, np.float64) for value in (rate_rad, acceleration_rad))
    direct, mirrored = 0.0j, 0.0j
    for time, shift, weight in zip(steps.times, *steps, strict=True):
        moved = rate * time + 0.5 * acceleration * time**2
        level = weight * (1.0 + time * np.asarray(modulation_change, np.float64))
        direct = direct + level * np.exp(1j * moved)
        mirrored = mirrored + level * np.exp(-1j * moved - 2j * shift)
    return direct, mirrored


def _response_to_mean(steps: PhaseSteps) -> complex:
    """Return the phasor of a mean level that increases by 1 per frame."""
    return complex(np.sum(steps.weights * steps.times * np.exp(-1j * steps.shifts_rad)))


@dataclass(frozen=True, eq=False)
class PixelMotion:
    """Motion of each pixel by the residuals of its frames; every field is (row, col) float.

    Parameters
    ----------
    rate_rad : phase rate, rad per frame; 0 where `sigma_rad` is infinite
    sigma_rad : standard deviation of the rate by the noise of the camera
    error_px : predicted error of the projector coordinate of the single pixel by this rate
    """

    rate_rad: FloatArray
    sigma_rad: FloatArray
    error_px: FloatArray


def motion_of(
    stack: Stack, patterns: PatternSet, decoded: Decoded, sensor: SensorNoise, axis: Axis = "column"
) -> PixelMotion:
    """Return the motion of every pixel along one projector axis, from the residuals of its frames.

    With four frames the sigma depends on the phase, up to infinity. Harmonics of the fringes and
    changes of the light also cause residuals: correct these first, or choose more steps.

    Parameters
    ----------
    stack, patterns, sensor : as in `decode`
    decoded : result of decoding `stack`

    Raises
    ------
    InputError : fewer than four phase steps along the axis
    """
    steps = steps_of(patterns, axis)
    if steps.weights.size < 4:
        raise InputError("patterns steps is 3: motion leaves no residual; needed are 4 or more")
    maps = decoded.row if axis == "row" else decoded.column
    lit = maps.modulation_dn > 0.0
    frames = stack[patterns.step_sets(axis)[0]][:, lit].astype(np.float64)
    fitted = fit_moving(frames, steps)
    noise_dn = np.sqrt(sensor.variance_dn2(maps.mean_dn[lit].astype(np.float64)))
    is_known = fitted.sigma_share < _LARGEST_SHARE
    rate_rad = np.where(is_known, fitted.rate_rad, 0.0)
    per_rad = patterns.period_along(axis) / TURN
    error_px = per_rad * phase_error(fitted.phase_rad, rate_rad, steps)
    sigma_rad = np.where(is_known, noise_dn * fitted.sigma_share, np.inf)
    images = [np.zeros(lit.shape), np.full(lit.shape, np.inf), np.zeros(lit.shape)]
    for image, values in zip(images, (rate_rad, sigma_rad, error_px), strict=True):
        image[lit] = values
    return PixelMotion(*images)


class MovingFit(NamedTuple):
    """Fit of fringes with a constant phase rate; every field is (pixel,) float.

    `phase_rad` is that in the middle of the set; `sigma_share` is the standard deviation of the
    rate, rad, for a noise of 1 DN.
    """

    phase_rad: FloatArray
    rate_rad: FloatArray
    sigma_share: FloatArray


def fit_moving(frames: FloatArray, steps: PhaseSteps) -> MovingFit:
    """Fit A, B, phi and the phase rate e to every pixel by Gauss-Newton least squares.

    Parameters
    ----------
    frames : (step, pixel) DN
    """
    rate_rad = np.zeros(frames.shape[1])
    for _ in range(_ITERATIONS):
        step = fit_at_rate(frames, steps, rate_rad)
        rate_rad = rate_rad + np.clip(step.change_rad, -LARGEST_CHANGE, LARGEST_CHANGE)
    return MovingFit(step.phase_rad, rate_rad, step.sigma_share)


class RateStep(NamedTuple):
    """One Gauss-Newton step of the phase rate; every field is (pixel,) float.

    phase_rad : phase in the middle of the set, fitted at the rate before the step
    change_rad : change of the rate, rad per frame
    sigma_share : standard deviation of the rate, rad, for a noise of 1 DN
    """

    phase_rad: FloatArray
    change_rad: FloatArray
    sigma_share: FloatArray


def fit_at_rate(frames: FloatArray, steps: PhaseSteps, rate_rad: FloatArray) -> RateStep:
    """Fit A, B and phi at given rates (pixel,), and return the step to better rates.

    Parameters
    ----------
    frames : (step, pixel) DN
    """
    angles = steps.shifts_rad[:, None] + rate_rad * steps.times[:, None]
    fitted = fit_fringes(frames, angles)
    x = fitted.phase_rad + angles
    slopes = -fitted.modulation_dn * steps.times[:, None] * np.sin(x)
    columns = np.stack([np.ones(x.shape), np.cos(angles), -np.sin(angles), slopes], axis=-1)
    normal = np.einsum("spi,spj->pij", columns, columns)
    side = np.einsum("spi,sp->pi", columns, frames - fitted.levels_dn(angles))
    # Scaled to a diagonal of 1; the ridge keeps pixels without information solvable.
    size = np.sqrt(np.maximum(np.einsum("pii->pi", normal), 1e-300))
    scaled = normal / (size[:, :, None] * size[:, None, :]) + _RIDGE * np.eye(4)
    inverse = np.linalg.inv(scaled)
    change_rad = np.einsum("pi,pi->p", inverse[:, 3], side / size) / size[:, 3]
    return RateStep(fitted.phase_rad, change_rad, np.sqrt(inverse[:, 3, 3]) / size[:, 3])
