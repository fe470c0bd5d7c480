"""Posterior of the free fields: samples by MCMC, evidence, and the profile of the likelihood.

Each free field has a coordinate z that is standard normal under the prior. The place of z, a share
of the field's axis, is the quantile of the prior at the probability Phi(z).

The measured values of rows are normally distributed. Their variance is the sum of four variances:
the row's own uncertainty, the discrepancy of the model, the scatter over realisations (coats) and
the emulator's error. Nuisances are linear with normal priors and are integrated out. The covariance
is C = diag(s^2) + L L^T, with s the rows' own standard deviations. L contains the change of each
row by one standard deviation of each source of error.

Rows of one figure share the error of its emulator, and rows of one coat share the random effect of
the coat's texture. A limit is a bound of a figure from one side. The figure is normally
distributed; its variance is the sum of the variances of limit and emulator. The likelihood of the
limit is the probability that the figure is on the allowed side.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any, TypeVar

import emcee
import numpy as np
from scipy.optimize import minimize
from scipy.special import log_ndtr, logsumexp, ndtr
from scipy.stats import multivariate_t, norm, qmc

from reconstruction.arrays import FloatArray
from twin.config.problem import LONGEST_CHAIN, Free, SensorProblem
from twin.config.rows import Limit, Row
from twin.identification.emulator import Emulator

_Prediction = TypeVar("_Prediction")
_START_EXPONENT = 13
_WALKERS_PER_FIELD, _LEAST_WALKERS = 6, 40
_STEPS = 1000
_CORRELATION_TIMES, _EFFECTIVE = 20, 1000
_FARTHEST = 6.0
_PROPOSALS_EXPONENT = 13
_FREEDOM = 5.0
_PROFILE = 25
_SURE = 3.0


@dataclass(frozen=True, eq=False)
class Likelihood:
    """Likelihood of the measured values of some rows and limits, as a function of the free fields.

    Attributes
    ----------
    free : the free fields by name, in the order of the columns of the result of `places`
    rows, limits : rows and limits by name; limits contribute to the likelihood but are not
        predicted
    emulators : emulator of the figure, by name of the row or limit
    nuisance_sd : standard deviation of each nuisance, by its name
    scatters : emulator of the standard deviation over the repeats, by name of each row with
        `realisations`
    """

    free: Mapping[str, Free]
    rows: Mapping[str, Row]
    emulators: Mapping[str, Emulator]
    nuisance_sd: Mapping[str, float]
    scatters: Mapping[str, Emulator] = field(default_factory=dict)
    limits: Mapping[str, Limit] = field(default_factory=dict)

    def places(self, z: FloatArray) -> FloatArray:
        """Return places, shares of the axes, of coordinates z; both (n, free field)."""
        probability = ndtr(np.clip(z, -_FARTHEST, _FARTHEST))
        columns = [free.place(p) for free, p in zip(self.free.values(), probability.T, strict=True)]
        return np.stack(columns, axis=1)

    def predicted(self, z: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return figures (n, row) at coordinates z, and error loadings (n, row, latent).

        The expected value of a row differs from its figure by its loadings times independent
        standard normal latent variables: the error of each emulator, the effect of each coat, each
        nuisance, and the discrepancy of each row.
        """
        at = self.places(z)
        figures, emulated = self._figures(at)
        rows, every = list(self.rows.values()), np.ones((len(at), 1))
        loadings = [
            _loaded(emulated, [id(self.emulators[name]) for name in self.rows]),
            _loaded(self._scatter(at), self._coats()),
            _loaded(every * [row.discrepancy for row in rows], list(self.rows)),
        ]
        for name, sd in self.nuisance_sd.items():
            changes = sd * every * [row.nuisance.get(name, 0.0) for row in rows]
            loadings.append(changes[:, :, None])
        return figures, np.concatenate(loadings, axis=2)

    def _figures(self, at: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return figures and emulators' standard deviations (n, row), scaled to the statistic."""
        emulators = [self.emulators[name] for name in self.rows]
        predicted = _each_once(emulators, lambda emulator: emulator.predict(at))
        rows = self.rows.values()
        factor = [1.0 if row.statistic == "mean" else row.scatter_share for row in rows]
        means, sds = (np.stack(parts, axis=1) for parts in zip(*predicted, strict=True))
        return means * factor, sds * factor

    def _scatter(self, at: FloatArray) -> FloatArray:
        """Return the common standard deviation (n, row) of a row's realisations; 0 if none."""
        scatter = np.zeros((len(at), len(self.rows)))
        numbers = [i for i, row in enumerate(self.rows.values()) if row.realisations is not None]
        names, rows = list(self.rows), list(self.rows.values())
        emulators = [self.scatters[names[i]] for i in numbers]
        means = _each_once(emulators, lambda emulator: emulator.mean(at))
        for i, mean in zip(numbers, means, strict=True):
            scatter[:, i] = mean * rows[i].scatter_share
        return scatter

    def _coats(self) -> list[object]:
        """Return a key of each row's coat: rows of one figure on one coat have the same key."""
        return [
            name if row.coat is None else (row.coat, id(self.scatters[name]))
            for name, row in self.rows.items()
        ]

    def among(self, others: "Likelihood") -> "Likelihood":
        """Return this likelihood, extended by the rows that only `others` has.

        Rows that both likelihoods have are included once. The limits are those of this likelihood.
        """
        return replace(
            self,
            rows={**self.rows, **{n: r for n, r in others.rows.items() if n not in self.rows}},
            emulators={**others.emulators, **self.emulators},
            scatters={**others.scatters, **self.scatters},
        )

    def log(self, z: FloatArray) -> FloatArray:
        """Return the natural logarithm of the likelihood (n,) at coordinates z (n, free field)."""
        figures, loadings = self.predicted(z)
        factor = np.linalg.cholesky(self.covariance(loadings))
        residual = np.array([row.value for row in self.rows.values()]) - figures
        white = np.linalg.solve(factor, residual[..., None])[..., 0]
        spread = np.log(np.diagonal(factor, axis1=1, axis2=2)).sum(axis=1)
        constant = 0.5 * len(self.rows) * np.log(2 * np.pi)
        rows = -0.5 * np.sum(white**2, axis=1) - spread - constant
        return np.asarray(rows + sum(self.within(name, z) for name in self.limits))

    def within(self, limit: str, z: FloatArray) -> FloatArray:
        """Return the logarithm of the probability (n,) that a limit is met at coordinates z."""
        stated = self.limits[limit]
        figure, emulated = self.emulators[limit].predict(self.places(z))
        steps = stated.side * (figure - stated.value) / np.hypot(stated.sd, emulated)
        return np.asarray(log_ndtr(steps))

    def log_posterior(self, z: FloatArray) -> FloatArray:
        """Return log likelihood plus log prior density (n,), with normalising constants."""
        log_density = self.log(z) + _log_prior(z)
        return np.where(np.abs(z).max(axis=1) < _FARTHEST, log_density, -np.inf)

    def covariance(self, loadings: FloatArray) -> FloatArray:
        """Return the covariance (n, row, row) of measured rows about the twin's figures."""
        own = np.diag([row.sd**2 for row in self.rows.values()])
        return np.asarray(loadings @ loadings.transpose(0, 2, 1) + own)


def _each_once(
    emulators: Sequence[Emulator], predict: Callable[[Emulator], _Prediction]
) -> list[_Prediction]:
    """Return the prediction by each emulator in the list; compute equal emulators only once."""
    distinct = {id(emulator): emulator for emulator in emulators}
    predicted = {key: predict(emulator) for key, emulator in distinct.items()}
    return [predicted[id(emulator)] for emulator in emulators]


def _loaded(sd: FloatArray, latent: Sequence[object]) -> FloatArray:
    """Return loadings (n, row, latent) from standard deviations (n, row).

    `latent` has a key of the latent variable of each row; rows with equal keys share the variable.
    """
    columns = {key: number for number, key in enumerate(dict.fromkeys(latent))}
    membership = np.zeros((len(latent), len(columns)))
    membership[range(len(latent)), [columns[key] for key in latent]] = 1.0
    return np.asarray(sd[:, :, None] * membership)


def _log_prior(z: FloatArray) -> FloatArray:
    """Return the logarithm of the prior density (n,) at coordinates z (n, free field)."""
    return np.asarray(-0.5 * np.sum(z**2, axis=1) - 0.5 * z.shape[1] * np.log(2 * np.pi))


def likelihood_of(
    problem: SensorProblem,
    rows: Mapping[str, Row],
    emulators: Mapping[str, Emulator],
    scatters: Mapping[str, Emulator] = MappingProxyType({}),
) -> Likelihood:
    """Return the likelihood of the given rows of a problem and of all limits of the problem."""
    sds = {name: nuisance.sd for name, nuisance in problem.nuisance.items()}
    ours = {name: nuisance for name, nuisance in scatters.items() if name in rows}
    return Likelihood(problem.free, rows, emulators, sds, ours, problem.limits)


@dataclass(frozen=True, eq=False)
class Posterior:
    """Samples of the free fields given the fitted rows and limits.

    Attributes
    ----------
    likelihood : likelihood of the fitted rows and limits
    z : (sample, free field) coordinates, standard normal under the prior
    log_evidence : natural logarithm of the evidence: the probability density of the measured rows,
        integrated over the prior
    log_evidence_sd : standard uncertainty of `log_evidence`
    steps, correlation_time : number of steps of the chains, and their autocorrelation time in steps
    independent : effective number of independent samples of the chains
    """

    likelihood: Likelihood
    z: FloatArray
    log_evidence: float
    log_evidence_sd: float
    steps: int
    correlation_time: float
    independent: float

    @property
    def is_converged(self) -> bool:
        """Whether the chains are long enough and have enough independent samples."""
        return (
            self.independent >= 0.75 * _EFFECTIVE
            and self.steps >= _CORRELATION_TIMES * self.correlation_time
        )

    @property
    def places(self) -> FloatArray:
        """Places of the samples (sample, free field): shares, 0 to 1, of the axes."""
        return self.likelihood.places(self.z)

    @property
    def values(self) -> FloatArray:
        """Values of the samples (sample, free field), each field in its own unit."""
        free = self.likelihood.free.values()
        return np.stack([f.value(x) for f, x in zip(free, self.places.T, strict=True)], axis=1)

    @property
    def best_z(self) -> FloatArray:
        """Coordinates (free field,) of the sample with the largest posterior density."""
        best: FloatArray = self.z[int(np.argmax(self.likelihood.log_posterior(self.z)))]
        return best


def sample(likelihood: Likelihood, seed: int, longest: int = LONGEST_CHAIN) -> Posterior:
    """Sample the posterior by an affine-invariant ensemble of chains (Goodman and Weare 2010).

    The start positions of the chains are drawn from the prior with weights by their likelihood, so
    that every maximum of the likelihood has chains. The chains run until they are 20
    autocorrelation times long and have 1000 independent samples, or for `longest` steps.
    """
    rng = np.random.default_rng(seed)
    fields = len(likelihood.free)
    walkers = max(_LEAST_WALKERS, _WALKERS_PER_FIELD * fields)
    walkers += walkers % 2
    # emcee's snooker move is not used: it weighs proposals by the root of the ratio that detailed
    # balance requires (ter Braak and Vrugt 2008, eq. 4). With 10 % of such moves, 68 % intervals
    # contained only 60 %.
    moves = [(emcee.moves.StretchMove(), 0.5), (emcee.moves.DEMove(), 0.5)]
    sampler = emcee.EnsembleSampler(
        walkers, fields, likelihood.log_posterior, moves=moves, vectorize=True
    )
    random_state = np.random.RandomState(seed).get_state()
    state: Any = emcee.State(_starts(likelihood, walkers, rng), random_state=random_state)
    steps, time = 0, np.inf
    while steps < longest and steps < max(_CORRELATION_TIMES, _EFFECTIVE / walkers) * time:
        further = min(_STEPS, longest - steps)
        state = sampler.run_mcmc(state, further, skip_initial_state_check=True)
        steps += further
        time = float(np.max(sampler.get_autocorr_time(tol=0)))
        time = time if np.isfinite(time) else steps
    z = sampler.get_chain(discard=steps // 4, thin=max(1, int(time / 2)), flat=True)
    evidence, sd = _evidence(likelihood, z, rng)
    independent = walkers * (steps - steps // 4) / max(time, 1.0)
    return Posterior(likelihood, z, evidence, sd, steps, time, independent)


def _starts(likelihood: Likelihood, walkers: int, rng: np.random.Generator) -> FloatArray:
    unit = qmc.Sobol(len(likelihood.free), rng=rng).random_base2(_START_EXPONENT)
    z = norm.ppf(np.clip(unit, 1e-6, 1 - 1e-6))
    log_likelihood = likelihood.log(z)
    # Tempered until some hundred places have a notable weight: with starts at the best place only,
    # chains would miss other maxima.
    for temper in 2.0 ** np.arange(0, 40):
        weight = np.exp((log_likelihood - log_likelihood.max()) / temper)
        weight /= weight.sum()
        if 1.0 / np.sum(weight**2) > 2 * walkers:
            break
    chosen = z[rng.choice(len(z), walkers, replace=False, p=weight)]
    return np.asarray(chosen + 1e-3 * rng.standard_normal(chosen.shape))


def _evidence(
    likelihood: Likelihood, z: FloatArray, rng: np.random.Generator
) -> tuple[float, float]:
    """Return the log evidence and its standard uncertainty, by importance sampling.

    50 % of the proposals are from the prior and 50 % from t densities round the samples. The
    proposals from the prior keep the weights bounded where there are no samples (defensive mixture,
    Hesterberg 1995).
    """
    count, fields = 2**_PROPOSALS_EXPONENT, z.shape[1]
    shape = np.atleast_2d(np.cov(z.T)) * 0.5 + 1e-8 * np.eye(fields)
    centres = z[rng.choice(len(z), min(200, len(z)), replace=False)]
    kernel = multivariate_t(np.zeros(fields), shape, df=_FREEDOM, seed=rng)
    steps = np.reshape(kernel.rvs(count // 2), (-1, fields))
    near = centres[rng.integers(len(centres), size=count // 2)] + steps
    drawn = np.concatenate((near, rng.standard_normal((count // 2, fields))))
    prior = _log_prior(drawn)
    local = logsumexp([kernel.logpdf(drawn - centre) for centre in centres], axis=0)
    proposal = np.logaddexp(local - np.log(len(centres)), prior) - np.log(2.0)
    weight = likelihood.log_posterior(drawn) - proposal
    log_mean = float(logsumexp(weight) - np.log(count))
    relative = np.exp(weight - log_mean)
    return log_mean, float(relative.std() / np.sqrt(count))


def profile(posterior: Posterior, field: int) -> tuple[FloatArray, FloatArray]:
    """Return the profile likelihood of a field: shares (n,) of its axis and log likelihood (n,).

    At each share the log likelihood is the largest over all other fields. It is relative to its
    maximum; a value of -0.5 marks the ends of a 68 % interval and -1.92 of a 95 % interval (for one
    field).
    """
    likelihood, z = posterior.likelihood, posterior.z
    grid = norm.ppf(np.linspace(0.01, 0.99, _PROFILE))
    known = likelihood.log(z)
    highest = np.array([_highest(likelihood, field, at, z, known) for at in grid])
    best = max(float(highest.max()), float(known.max()))
    full = np.zeros((grid.size, z.shape[1]))
    full[:, field] = grid
    return likelihood.places(full)[:, field], highest - best


def _highest(
    likelihood: Likelihood, field: int, at: float, z: FloatArray, known: FloatArray
) -> float:
    others = [i for i in range(z.shape[1]) if i != field]

    def lowered(points: FloatArray) -> FloatArray:
        whole = np.full((len(points), z.shape[1]), at)
        whole[:, others] = points
        return -likelihood.log(whole)

    start = z[int(np.argmax(known - 0.5 * ((z[:, field] - at) / 0.3) ** 2))][others]
    if not others:
        return -float(lowered(np.zeros((1, 0)))[0])
    optimum = minimize(
        lambda p: _with_slope(lowered, p),
        start,
        jac=True,
        method="L-BFGS-B",
        bounds=[(-3.0, 3.0)] * len(others),
        options={"maxiter": 60},
    )
    return -float(optimum.fun)


def _with_slope(function: Any, at: FloatArray, step: float = 1e-4) -> tuple[float, FloatArray]:
    """Return the value and the gradient, by central differences, in one vectorised call."""
    moves = step * np.eye(at.size)
    values = function(np.concatenate((at[None], at + moves, at - moves)))
    return float(values[0]), (values[1 : at.size + 1] - values[at.size + 1 :]) / (2 * step)


def probabilities(posteriors: Sequence[Posterior], weights: Sequence[float]) -> FloatArray:
    """Return posterior probabilities (model,) from the models' evidence and prior weights."""
    logs = np.log(weights) + np.array([posterior.log_evidence for posterior in posteriors])
    return np.asarray(np.exp(logs - logsumexp(logs)))


def highest_probabilities(posteriors: Sequence[Posterior], weights: Sequence[float]) -> FloatArray:
    """Return the probability (model,) over that of the best model, at the end of its evidence.

    The end is 3 standard uncertainties of the logarithm of the evidence above its value.
    """
    logs = np.log(weights) + np.array([posterior.log_evidence for posterior in posteriors])
    uncertain = _SURE * np.array([posterior.log_evidence_sd for posterior in posteriors])
    return np.asarray(np.exp(np.minimum(logs + uncertain - logs.max(), 0.0)))
