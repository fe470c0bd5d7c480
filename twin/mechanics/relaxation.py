"""Press a relaxing elastomer: its force and relief at a time after the press.

All moduli relax in proportion: E(t) = E(0) r(t), with the Prony series r(t) = 1 - sum g_i (1 -
exp(-t / tau_i)), and Poisson's ratio is constant. For a contact that does not shrink, the elastic
solutions then also solve the press of the relaxing elastomer (Lee and Radok, J. Appl. Mech. 27, 438
(1960)):

- travel control: the shape is the elastic one at each time; the force is the hereditary integral of
  r(t - s) dF(s), with F(s) the elastic force at the travel that is reached at the time s;
- force control: the shape is the elastic one for the modulus E(0) F(t) / (integral of c(t - s)
  dF(s)), with the creep function c, for which r * dc = 1.

Both are described by one modulus of an elastic press that has the same shape and force. After a
step of travel it is E(0) r(t), after a step of force E(0) / c(t).

With v_i = sqrt(g_i / tau_i) and D = diag(1 / tau_i), the Laplace transform of r times s is
1 - v (D + s)^-1 v. Its inverse is 1 + v (D - v v^T + s)^-1 v (Sherman and Morrison). The
eigenvalues x_j and eigenvectors z_j of the symmetric matrix D - v v^T therefore give

    c(t) = 1 + sum_j (v z_j)^2 / x_j (1 - exp(-x_j t)).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal, Protocol

import numpy as np
from scipy.optimize import brentq

from reconstruction.arrays import FloatArray
from twin.config.models import Elastomer, Press
from twin.config.relaxation import Relaxation
from twin.mechanics.errors import PressError
from twin.mechanics.hardness import young_modulus
from twin.mechanics.models import ElastomerModel, PressInput, Progress
from twin.mechanics.press import PressedElastomer, scaled_stress

# Travels of a ramp at which the elastic force is computed; between them it is linear in time. For a
# ball the force then deviates from the hereditary integral by 0.1 % of it or less (tests).
_RAMP_STEPS = 8


@dataclass(frozen=True, eq=False)
class ExponentialSeries:
    """Function of time 1 + sum of amplitude (1 - exp(-rate t)), t in s."""

    #: (term,)
    amplitudes: FloatArray
    rates_per_s: FloatArray

    def __call__(self, t_s: float) -> float:
        """Return the value at a time after a step, t >= 0."""
        return 1.0 - float(self.amplitudes @ np.expm1(-self.rates_per_s * t_s))

    def mean(self, first_s: float, last_s: float) -> float:
        """Return the mean over the times from `first_s` to `last_s`, closed form."""
        if last_s <= first_s:
            return self(first_s)
        span = self.rates_per_s * (last_s - first_s)
        # (1 - exp(-span)) / span is 1 for short spans; expm1 has no cancellation there.
        decayed = np.exp(-self.rates_per_s * first_s) * -np.expm1(-span) / span
        return 1.0 + float(self.amplitudes @ (1.0 - decayed))

    @property
    def final(self) -> float:
        """Value after a long time."""
        return 1.0 + float(self.amplitudes.sum())


def relaxation_function(relaxation: Relaxation) -> ExponentialSeries:
    """Return r: modulus over initial modulus as a function of the time after a step of strain."""
    return ExponentialSeries(-np.array(relaxation.shares), 1 / np.array(relaxation.times_s))


def creep_function(relaxation: Relaxation) -> ExponentialSeries:
    """Return c: compliance over initial compliance, by the time after a step of stress."""
    rates = 1 / np.array(relaxation.times_s)
    v = np.sqrt(np.array(relaxation.shares) * rates)
    own, vectors = np.linalg.eigh(np.diag(rates) - np.outer(v, v))
    return ExponentialSeries((v @ vectors) ** 2 / own, own)


def relaxes(elastomer: Elastomer, load: Press) -> bool:
    """Whether the elastomer relaxes between the start of the press and the measurement."""
    return elastomer.relaxation is not None and (load.hold_s > 0 or load.ramp_s > 0)


class HeldLoad(Protocol):
    """Load of a press with its times: `Press`, or the measured load of a layer."""

    @property
    def control(self) -> Literal["depth", "force"]:
        """Whether travel or force was prescribed."""

    @property
    def ramp_s(self) -> float:
        """Duration of the press."""

    @property
    def hold_s(self) -> float:
        """Time from the end of the press to the measurement."""


def relaxed_share(
    relaxation: Relaxation, load: HeldLoad, elastic_forces: FloatArray | None = None
) -> float:
    """Return the modulus of the equivalent elastic press over the initial modulus, 0 to 1.

    Parameters
    ----------
    load : control, duration of the press and time of the measurement
    elastic_forces : (n,) force of an elastic elastomer at n equal steps of the travel, from the
        first step to the whole travel, in any unit. None: proportional to the time of the ramp

    Returns
    -------
    With a given travel the relaxed force over the elastic one, with a given force the inverse of
    the creep function
    """
    end = load.hold_s + load.ramp_s
    if load.control == "force":
        return 1 / creep_function(relaxation).mean(load.hold_s, end)
    share = relaxation_function(relaxation)
    if elastic_forces is None:
        return share.mean(load.hold_s, end)
    ages = end - np.linspace(0.0, load.ramp_s, elastic_forces.size + 1)
    means = [share.mean(last, first) for first, last in pairwise(ages)]
    steps = np.diff(elastic_forces, prepend=0.0)
    return float(np.dot(means, steps) / elastic_forces[-1])


def check_relaxation(model: ElastomerModel, case: PressInput) -> None:
    """Raise an error if a model cannot press a relaxing elastomer, without solving it.

    Raises
    ------
    PressError : the message states key, value and remedy
    """
    if not relaxes(case.elastomer, case.load):
        return
    key = "hold_s" if case.load.hold_s > 0 else "ramp_s"
    refused = f"press.{key}: found {getattr(case.load, key):g} s with elastomer.relaxation"
    if not model.relaxes:
        raise PressError(
            f"{refused}, which the {model.name} model lacks; use mechanics.model = 'spectral' (a "
            "slab), or remove it"
        )
    if case.elastomer.film is not None:
        raise PressError(f"{refused} and a film, whose relaxation is not known; remove one")
    if case.load.back_pressure_kpa or case.load.gravity_deg is not None:
        raise PressError(
            f"{refused} and air pressure or weight, which act for another time than the press; "
            "remove press.back_pressure_kpa and press.gravity_deg, or the relaxation"
        )
    if case.load.slides and (case.load.control == "force" or case.load.ramp_s > 0):
        raise PressError(
            f"{refused} and a slide, allowed with control = 'depth' and ramp_s = 0 only: else the "
            "contact grows while it sticks; change press.control or remove one"
        )


def press_relaxing(
    model: ElastomerModel, case: PressInput, progress: Progress | None = None
) -> PressedElastomer:
    """Press a relaxing elastomer, and return it at the time `press.hold_s` after the press.

    Raises
    ------
    PressError : an error of the model, or under force control the contact shrinks while the
        elastomer creeps
    SolverError : as the model
    """
    if case.load.control == "depth":
        return relaxed_press(model.press(case, progress), case, _ramp_forces(model, case))
    first, later = (
        model.press(_elastic(case, load), progress)
        for load in (case.load.model_copy(update={"hold_s": 0.0}), case.load)
    )
    if (first.contact & ~later.contact).any():
        raise PressError(
            "press.hold_s: the contact shrinks in some cells while the elastomer creeps, for which "
            "the elastic solutions do not apply; use press.control = 'depth' or hold_s = 0"
        )
    change_mm = float(np.abs(later.face_z_mm - first.face_z_mm).max())
    return replace(later, initial_force_n=first.force_n, relief_change_um=1e3 * change_mm)


def relaxed_press(
    elastic: PressedElastomer, case: PressInput, elastic_forces: FloatArray | None = None
) -> PressedElastomer:
    """Relax a press to a given travel: pressure and force decrease, the shape does not change.

    After a ramp the force is the hereditary integral. The pressure is the elastic one in proportion
    to it, which neglects that the outer part of the contact is younger.

    Parameters
    ----------
    elastic : the press with the initial modulus
    elastic_forces : see `relaxed_share`
    """
    relaxation = case.elastomer.relaxation
    assert relaxation is not None  # `relaxes`
    at_once = case.load.model_copy(update={"hold_s": 0.0})
    share, first = (
        relaxed_share(relaxation, load, elastic_forces) for load in (case.load, at_once)
    )
    return replace(
        scaled_stress(elastic, share),
        initial_force_n=elastic.force_n * first,
        relief_change_um=0.0,
    )


def waiting_time_s(model: ElastomerModel, case: PressInput, change_um: float) -> float:
    """Return the time after the press from which the relief changes by less than `change_um`.

    Parameters
    ----------
    model, case : the press; its `hold_s` has no effect
    change_um : largest change of the coated face's heights between the measurement and any later
        time

    Returns
    -------
    Time, s: 0 with a given travel, and if the relief changes by less from the end of the press
    """
    relaxation = case.elastomer.relaxation
    if relaxation is None or case.load.control == "depth":
        return 0.0
    check_relaxation(model, replace(case, load=case.load.model_copy(update={"hold_s": 1.0})))
    creep = creep_function(relaxation)
    flowed = _with_share(case.elastomer, 1 / creep.final)
    final = model.press(replace(case, elastomer=flowed)).face_z_mm

    def excess_um(log_hold: float) -> float:
        held = case.load.model_copy(update={"hold_s": float(np.expm1(log_hold))})
        face = model.press(_elastic(case, held)).face_z_mm
        return 1e3 * float(np.abs(final - face).max()) - change_um

    return _settled_s(excess_um, creep)


def force_waiting_time_s(model: ElastomerModel, case: PressInput, change_percent: float) -> float:
    """Return the time after the press from which the force changes by less than a share of it.

    Parameters
    ----------
    model, case : the press; its `hold_s` has no effect
    change_percent : largest change of the force between the measurement and any later time, in
        percent of the force after a long time

    Returns
    -------
    Time, s: 0 with a given force, and if the force changes by less from the end of the press
    """
    relaxation = case.elastomer.relaxation
    if relaxation is None or case.load.control == "force":
        return 0.0
    check_relaxation(model, replace(case, load=case.load.model_copy(update={"hold_s": 1.0})))
    share, forces = relaxation_function(relaxation), _ramp_forces(model, case)

    def excess(log_hold: float) -> float:
        held = case.load.model_copy(update={"hold_s": float(np.expm1(log_hold))})
        return relaxed_share(relaxation, held, forces) / share.final - 1 - change_percent / 100

    return _settled_s(excess, share)


def _settled_s(excess: Callable[[float], float], series: ExponentialSeries) -> float:
    """Return the time, s, at which an excess becomes 0, as a function of log(1 + time / s).

    0 if it is not positive at once. Times are within 0.1 %.
    """
    if excess(0.0) <= 0:
        return 0.0
    # After 40 of the longest times of the series the rest of it is below rounding errors.
    longest = np.log1p(40 / float(series.rates_per_s.min()))
    return float(np.expm1(brentq(excess, 0.0, longest, rtol=1e-4)))


def _ramp_forces(model: ElastomerModel, case: PressInput) -> FloatArray | None:
    """Return the elastic forces (step,), N, at equal steps of the travel; None without a ramp."""
    depth_mm = case.load.depth_mm
    if case.load.ramp_s == 0 or depth_mm is None:
        return None
    travels = depth_mm * np.arange(1, _RAMP_STEPS + 1) / _RAMP_STEPS
    loads = (case.load.model_copy(update={"depth_mm": float(travel)}) for travel in travels)
    return np.array([model.press(replace(case, load=load)).force_n for load in loads])


def elastic_equivalent(elastomer: Elastomer, load: HeldLoad) -> Elastomer:
    """Return the elastic elastomer whose press has the shape and force at the time of `load`.

    A ramp of the travel counts as one whose force is proportional to time.
    """
    relaxation = elastomer.relaxation
    return (
        elastomer if relaxation is None else _with_share(elastomer, relaxed_share(relaxation, load))
    )


def _with_share(elastomer: Elastomer, share: float) -> Elastomer:
    modulus_kpa = share * young_modulus(elastomer).best_kpa
    return elastomer.model_copy(update={"young_modulus_kpa": modulus_kpa, "relaxation": None})


def _elastic(case: PressInput, load: Press) -> PressInput:
    """Return the elastic press that is equivalent to `case` under another load by force."""
    return replace(case, load=load, elastomer=elastic_equivalent(case.elastomer, load))
