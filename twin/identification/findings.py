"""Conclusions from the posterior of an identification.

They are intervals of the fields, predictions of rows, probabilities of limits, ridges
(combinations of fields that cannot be separated), the effect of the prior, and the worth of
further measurements. A row is one measured figure with its standard deviation.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.special import ndtr

from reconstruction.arrays import FloatArray
from twin.identification.posterior import Likelihood, Posterior

# A field is not determined if its posterior variance is more than this share of the prior's.
_UNDETERMINED = 0.5
# A field takes part in a ridge if its component of the unit vector across the ridge is larger.
_NEGLIGIBLE = 0.25
# Largest ratio of the variance across a ridge to the variance of each field in the ridge.
_NARROW = 0.1
_HALF = float(np.sqrt(0.5))


@dataclass(frozen=True)
class Marginal:
    """Mean, standard deviation, central 68.3 % and 95 % intervals of a quantity, in its unit."""

    mean: float
    sd: float
    low_68: float
    high_68: float
    low_95: float
    high_95: float


def interval_of(samples: FloatArray) -> Marginal:
    """Return mean, standard deviation and central intervals of samples (n,)."""
    quantiles = np.quantile(samples, (0.1585, 0.8415, 0.025, 0.975))
    low_68, high_68, low_95, high_95 = map(float, quantiles)
    return Marginal(float(samples.mean()), float(samples.std()), low_68, high_68, low_95, high_95)


@dataclass(frozen=True)
class Prediction:
    """A measured row and the twin's prediction of its figure, given the rows that were fitted.

    Attributes
    ----------
    row : name of the row
    measured, sd : measured value and its standard deviation
    scatter : standard deviation of one measurement; `sd` may be that of a mean of several
    fitted : True if the row was fitted, False if it was held out
    twin : figure of the twin given the fitted rows, with the remaining uncertainty of fields,
        emulator, nuisance, discrepancy and coat
    any_coat : figure of another sensor with the same fields. Its coat, scale and emulator error are
        independent of those of the fitted rows
    deviation : (measured - any_coat) over the standard deviation of this difference. It shows
        whether the fields explain the row without an effect of the row's own coat
    """

    row: str
    measured: float
    sd: float
    scatter: float
    fitted: bool
    twin: Marginal
    any_coat: Marginal
    deviation: float

    @property
    def steps(self) -> float:
        """Measured value minus the twin's mean, in standard deviations of one measurement."""
        return (self.measured - self.twin.mean) / self.scatter


def predict_rows(posterior: Posterior, rows: Likelihood, seed: int) -> list[Prediction]:
    """Predict the figures of rows, fitted or held out, from the posterior of the fields.

    Parameters
    ----------
    posterior : Posterior
    rows : Likelihood
        The rows to predict, with the free fields of the posterior.
    seed : int
    """
    given, unconditioned = draw_rows(posterior, rows, seed), _unconditioned(posterior, rows, seed)
    predictions = []
    for number, (name, row) in enumerate(rows.rows.items()):
        twin, any_coat = interval_of(given[:, number]), interval_of(unconditioned[:, number])
        deviation = (row.value - any_coat.mean) / float(np.hypot(any_coat.sd, row.sd))
        fitted = name in posterior.likelihood.rows
        predictions.append(
            Prediction(name, row.value, row.sd, row.scatter, fitted, twin, any_coat, deviation)
        )
    return predictions


@dataclass(frozen=True)
class LimitMet:
    """Probability that a limit (a known bound of a figure) is met, and the predicted figure.

    Attributes
    ----------
    limit : name of the limit
    twin : figure of the twin given the fitted rows and limits, with the remaining uncertainty
    before, probability : probability that the limit is met: over the prior, and given the fitted
        rows and limits
    """

    limit: str
    twin: Marginal
    before: float
    probability: float


def limits_met(posterior: Posterior, seed: int) -> list[LimitMet]:
    """Return the probability that each limit is met, over the prior and over the posterior.

    The number of draws from the prior is the number of samples of the posterior.
    """
    rng, likelihood = np.random.default_rng(seed), posterior.likelihood
    prior = rng.standard_normal(posterior.z.shape)
    limits = []
    for name in likelihood.limits:
        figure, open_sd = likelihood.emulators[name].predict(posterior.places)
        drawn = figure + open_sd * rng.standard_normal(figure.size)
        before, after = (np.exp(likelihood.within(name, z)).mean() for z in (prior, posterior.z))
        limits.append(LimitMet(name, interval_of(drawn), float(before), float(after)))
    return limits


@dataclass(frozen=True)
class BoundCompared:
    """Posterior with one value of a limit's bound, or without the limit.

    Attributes
    ----------
    limit : name of the limit
    bound : value of the bound; None: without the limit
    fields : mean, standard deviation and intervals of each field by name
    log_evidence : natural logarithm of the evidence of rows and limits
    """

    limit: str
    bound: float | None
    fields: Mapping[str, Marginal]
    log_evidence: float


def bound_compared(limit: str, bound: float | None, posterior: Posterior) -> BoundCompared:
    """Return the fields' intervals from a posterior that was sampled with a value of a bound."""
    columns = zip(posterior.likelihood.free, posterior.values.T, strict=True)
    fields = {name: interval_of(values) for name, values in columns}
    return BoundCompared(limit, bound, fields, posterior.log_evidence)


def draw_rows(posterior: Posterior, rows: Likelihood, seed: int) -> FloatArray:
    """Draw the figures (sample, row) of rows given the fitted rows, without the noise of `rows`.

    The fitted rows constrain the fields and the errors that rows share: nuisances, the errors of
    emulators, the effect of a coat. At each sample of the fields these errors are normally
    distributed. Therefore all rows, and the noise of the fitted rows, are drawn jointly. The draws
    are then corrected by the regression on the measured values (Matheron's rule; Rasmussen and
    Williams 2006, eq. 2.19).
    """
    every, fitted = rows.among(posterior.likelihood), posterior.likelihood.rows
    drawn, loadings = _drawn(posterior, every, seed)
    where = [list(every.rows).index(name) for name in fitted]
    value, sd = (np.array([getattr(r, n) for r in fitted.values()]) for n in ("value", "sd"))
    noise = sd * np.random.default_rng(seed + 1).standard_normal((len(drawn), len(where)))
    missed = value - drawn[:, where] - noise
    fitted_part = loadings[:, where]
    weights = np.linalg.solve(
        fitted_part @ fitted_part.transpose(0, 2, 1) + np.diag(sd**2), missed[..., None]
    )
    moved = drawn + (loadings @ (fitted_part.transpose(0, 2, 1) @ weights))[..., 0]
    return np.asarray(moved[:, : len(rows.rows)])


def _unconditioned(posterior: Posterior, rows: Likelihood, seed: int) -> FloatArray:
    """Draw figures (sample, row) of another sensor with the same fields and independent errors."""
    return _drawn(posterior, rows, seed)[0]


def _drawn(posterior: Posterior, rows: Likelihood, seed: int) -> tuple[FloatArray, FloatArray]:
    """Return figures (sample, row) with drawn shared errors, and loadings (sample, row, error)."""
    figures, loadings = rows.predicted(posterior.z)
    latent = np.random.default_rng(seed).standard_normal((len(figures), loadings.shape[2], 1))
    return figures + (loadings @ latent)[..., 0], loadings


@dataclass(frozen=True)
class Ridge:
    """A combination of fields that the rows determine better than each single field.

    Along the ridge a change of one field compensates a change of another one; only their
    combination is known.

    Attributes
    ----------
    share : by name of the field, its component of the unit vector across the ridge; the vector is
        in standard deviations of the prior
    variance_ratio : posterior over prior variance across the ridge
    open_ratio : smallest ratio of posterior to prior variance among the single fields in the ridge
    """

    share: Mapping[str, float]
    variance_ratio: float
    open_ratio: float


def ridges(posterior: Posterior) -> list[Ridge]:
    """Return the combinations of two or more fields that the rows cannot separate.

    First come straight ridges, the narrowest first: principal directions of the posterior with less
    than 10 % of the variance of each field that takes part. Then come pairs of fields on a curve:
    after a parabola in one field is subtracted, the other field has less than 10 % of its variance.
    """
    straight = _straight_ridges(posterior)
    named = [set(ridge.share) for ridge in straight]
    curved = [
        ridge
        for ridge in _curved_ridges(posterior)
        if not any(set(ridge.share) <= t for t in named)
    ]
    return straight + curved


def _straight_ridges(posterior: Posterior) -> list[Ridge]:
    names = list(posterior.likelihood.free)
    covariance = np.atleast_2d(np.cov(posterior.z.T))
    variances, axes = np.linalg.eigh(covariance)
    directions = []
    for variance, axis in zip(variances, axes.T, strict=True):
        axis = axis * np.sign(axis[np.argmax(np.abs(axis))])
        takes_part = (np.abs(axis) > _NEGLIGIBLE) & (np.diag(covariance) > variance / _NARROW)
        if takes_part.sum() > 1:
            share = {names[i]: float(axis[i]) for i in np.flatnonzero(takes_part).tolist()}
            least = float(np.diag(covariance)[takes_part].min())
            directions.append(Ridge(share, float(variance), least))
    return directions


def _curved_ridges(posterior: Posterior) -> list[Ridge]:
    names, z = list(posterior.likelihood.free), posterior.z
    pairs = []
    for i, j in combinations(range(len(names)), 2):
        variances = z[:, i].var(), z[:, j].var()
        left = min(_left_by_parabola(z[:, i], z[:, j]), _left_by_parabola(z[:, j], z[:, i]))
        if left < _NARROW:
            # With a negative correlation the direction across the ridge has components of one sign.
            sign = -float(np.sign(np.corrcoef(z[:, i], z[:, j])[0, 1]))
            share = {names[i]: _HALF, names[j]: sign * _HALF}
            pairs.append(Ridge(share, float(left * min(variances)), float(min(variances))))
    return pairs


def _left_by_parabola(of: FloatArray, by: FloatArray) -> float:
    """Return the share of a field's variance that a parabola in another field does not explain."""
    fitted = np.polynomial.Polynomial.fit(by, of, 2)
    return float(np.var(of - fitted(by)) / of.var())


def undetermined(posterior: Posterior) -> list[str]:
    """Return the names of fields with a posterior variance over 50 % of the prior's."""
    variances = posterior.z.var(axis=0)
    names = posterior.likelihood.free
    return [name for name, v in zip(names, variances, strict=True) if v > _UNDETERMINED]


@dataclass(frozen=True)
class Worth:
    """Expected reduction of the variances of the fields by one more measurement.

    Attributes
    ----------
    row : name of the candidate row
    expected_sd : standard deviation of the figure before it is measured, in the figure's unit
    shrink : by name of the field, its expected variance after the measurement over its present
        variance
    """

    row: str
    expected_sd: float
    shrink: Mapping[str, float]

    @property
    def gain(self) -> float:
        """Expected gain of information (nats), summed over the fields as if independent."""
        return float(-0.5 * np.sum(np.log(list(self.shrink.values()))))


def worth_of(posterior: Posterior, candidates: Likelihood, seed: int) -> list[Worth]:
    """Return the worth of measuring each candidate row, the largest gain of information first.

    The remaining share of a field's variance is estimated from the samples of the posterior (linear
    Bayes estimate). It is 1 - corr^2, with corr the correlation of the field with the figure
    including its measurement noise.
    """
    if not candidates.rows:
        return []
    whole = draw_rows(posterior, candidates, seed)
    rng = np.random.default_rng(seed + 1)
    worths = []
    for number, (name, row) in enumerate(candidates.rows.items()):
        read = whole[:, number] + row.sd * rng.standard_normal(len(whole))
        shrink = {
            field: 1.0 - min(0.999, float(np.corrcoef(posterior.z[:, i], read)[0, 1]) ** 2)
            for i, field in enumerate(candidates.free)
        }
        worths.append(Worth(name, float(whole[:, number].std()), shrink))
    return sorted(worths, key=lambda worth: -worth.gain)


@dataclass(frozen=True)
class PriorShift:
    """Effect of a tilted prior: the prior density is doubled at one end and zero at the other end.

    Attributes
    ----------
    field, towards : field with the tilted prior, and the end with doubled density, "low" or "high"
    mean_before, mean : posterior mean of the field before and after the tilt, in the field's unit
    row, row_steps : row with the largest change of its prediction, and that change in standard
        deviations of the prediction
    probability : probability, after the tilt, of the most probable combination of choices
    effective_share : effective share of the samples, (sum w)^2 / (n sum w^2), with weights w. If it
        is small, the result depends on few samples
    """

    field: str
    towards: str
    mean_before: float
    mean: float
    row: str
    row_steps: float
    probability: float
    effective_share: float


def prior_shifts(
    posteriors: Sequence[Posterior], chances: Sequence[float], rows: Likelihood, seed: int
) -> list[PriorShift]:
    """Return the effect of tilting each field's prior on means, predictions and probabilities.

    Samples are weighted by 2 u or 2 (1 - u), where u (0 to 1) is the field's quantile under the
    original prior. The evidence of a model is multiplied by the mean of the weights (importance
    sampling).

    Parameters
    ----------
    posteriors, chances : posterior and probability of each model, the most probable model first
    rows : Likelihood
        All rows to predict, with the emulators of the first model.
    seed : int
    """
    best = posteriors[0]
    figures = draw_rows(best, rows, seed)
    means, sds = figures.mean(axis=0), figures.std(axis=0)
    shifts = []
    for number, name in enumerate(rows.free):
        for towards in ("low", "high"):
            weights = [_tilted(posterior.z[:, number], towards) for posterior in posteriors]
            evidence = np.array([w.mean() for w in weights]) * chances
            own = weights[0] / weights[0].sum()
            steps = (own @ figures - means) / sds
            farthest = int(np.abs(steps).argmax())
            values = best.values[:, number]
            shifts.append(
                PriorShift(
                    field=name,
                    towards=towards,
                    mean_before=float(values.mean()),
                    mean=float(own @ values),
                    row=list(rows.rows)[farthest],
                    row_steps=float(steps[farthest]),
                    probability=float(evidence[0] / evidence.sum()),
                    effective_share=float(1.0 / (len(own) * (own**2).sum())),
                )
            )
    return shifts


def _tilted(z: FloatArray, towards: str) -> FloatArray:
    """Return the ratio (sample,) of the tilted to the original prior density, of prior mean 1."""
    return np.asarray(2.0 * ndtr(z if towards == "high" else -z))
