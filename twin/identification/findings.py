"""Conclusions from a posterior: intervals, predicted rows, ridges, prior sensitivity, worth."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.special import ndtr

from reconstruction.arrays import FloatArray
from twin.identification.posterior import Likelihood, Posterior

# A field is not determined if its posterior variance is more than this share of the prior's.
_UNDETERMINED = 0.5
# A field takes part in a ridge if its component of the unit vector is larger.
_NEGLIGIBLE = 0.25
# Largest variance across a ridge over that of each of its fields.
_NARROW = 0.1
_HALF = float(np.sqrt(0.5))


@dataclass(frozen=True)
class Marginal:
    """Mean, standard deviation and central 68.3 and 95 % intervals."""

    mean: float
    sd: float
    low_68: float
    high_68: float
    low_95: float
    high_95: float


def interval_of(samples: FloatArray) -> Marginal:
    """Return the interval of samples (n,)."""
    quantiles = np.quantile(samples, (0.1585, 0.8415, 0.025, 0.975))
    low_68, high_68, low_95, high_95 = map(float, quantiles)
    return Marginal(float(samples.mean()), float(samples.std()), low_68, high_68, low_95, high_95)


@dataclass(frozen=True)
class Prediction:
    """A measured row and the twin's prediction of it, given the rows that were fitted.

    Attributes
    ----------
    scatter : standard deviation of one measurement, where `sd` is that of a mean
    twin : of the figure given the fitted rows, with the remaining uncertainty of fields, emulator,
        nuisance, discrepancy and coat
    any_coat : the same for another sensor with these fields; its coat, scale and emulator error are
        independent of the fitted rows
    deviation : (measured - any_coat) over the standard deviation of their difference: whether the
        fields explain the row without an effect of its own coat
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
        """Measured minus the twin's mean, in standard deviations of one measurement."""
        return (self.measured - self.twin.mean) / self.scatter


def predict_rows(posterior: Posterior, rows: Likelihood, seed: int) -> list[Prediction]:
    """Predict rows, fitted and held out, from the posterior.

    Parameters
    ----------
    posterior : Posterior
    rows : Likelihood
        The rows to predict, of the same free fields.
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
    """A limit and the twin's prediction of its figure.

    Attributes
    ----------
    limit : its name
    twin : of the figure given the fitted rows and limits, with the remaining uncertainty
    before, probability : that the limit is met, over the prior and given rows and limits
    """

    limit: str
    twin: Marginal
    before: float
    probability: float


def limits_met(posterior: Posterior, seed: int) -> list[LimitMet]:
    """Return the probability of each limit, over the posterior and as many draws of the prior."""
    rng, likelihood = np.random.default_rng(seed), posterior.likelihood
    prior = rng.standard_normal(posterior.z.shape)
    limits = []
    for name in likelihood.limits:
        figure, open_sd = likelihood.emulators[name].predict(posterior.places)
        drawn = figure + open_sd * rng.standard_normal(figure.size)
        before, after = (np.exp(likelihood.within(name, z)).mean() for z in (prior, posterior.z))
        limits.append(LimitMet(name, interval_of(drawn), float(before), float(after)))
    return limits


def draw_rows(posterior: Posterior, rows: Likelihood, seed: int) -> FloatArray:
    """Return figures (sample, row) given the fitted rows, without the rows' own noise.

    The fitted rows constrain the fields and the errors that rows share: nuisances, emulators'
    errors, the draw of a coat. At each sample of the fields these are normal: joint draws of all
    rows, and of the noise of the fitted rows, are corrected by the regression on the measured
    values (Matheron's rule; Rasmussen and Williams 2006, eq. 2.19).
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
    """Return figures (sample, row) of another sensor with these fields: independent errors."""
    return _drawn(posterior, rows, seed)[0]


def _drawn(posterior: Posterior, rows: Likelihood, seed: int) -> tuple[FloatArray, FloatArray]:
    """Return figures (sample, row) with drawn shared errors, and the loadings of these."""
    figures, loadings = rows.predicted(posterior.z)
    latent = np.random.default_rng(seed).standard_normal((len(figures), loadings.shape[2], 1))
    return figures + (loadings @ latent)[..., 0], loadings


@dataclass(frozen=True)
class Ridge:
    """A combination of fields that the rows determine better than each of these fields.

    Along the ridge the fields trade off: only their combination is known.

    Attributes
    ----------
    share : component by field of the unit vector across the ridge, in standard deviations of the
        prior
    variance_ratio : posterior over prior variance across it
    open_ratio : posterior over prior variance of the best determined of its single fields
    """

    share: Mapping[str, float]
    variance_ratio: float
    open_ratio: float


def ridges(posterior: Posterior) -> list[Ridge]:
    """Return the combinations of two or more fields that the rows cannot separate.

    Principal directions of the posterior with less than 10 % of the variance of each field that
    takes part, the narrowest first. Then pairs of fields on a curve: after a parabola in one field
    is subtracted, the other has less than 10 % of its variance.
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
    """Return the fields that the rows hardly narrow: more than 50 % of the prior's variance."""
    variances = posterior.z.var(axis=0)
    names = posterior.likelihood.free
    return [name for name, v in zip(names, variances, strict=True) if v > _UNDETERMINED]


@dataclass(frozen=True)
class Worth:
    """Expected reduction of the fields' variances by one more measurement.

    Attributes
    ----------
    expected_sd : of the figure before it is measured
    shrink : by field, its expected variance after the measurement over the present one
    """

    row: str
    expected_sd: float
    shrink: Mapping[str, float]

    @property
    def gain(self) -> float:
        """Expected information (nats), summed over the single fields."""
        return float(-0.5 * np.sum(np.log(list(self.shrink.values()))))


def worth_of(posterior: Posterior, candidates: Likelihood, seed: int) -> list[Worth]:
    """Return the worth of measuring each candidate row, the largest information first.

    Linear Bayes estimate from the posterior's samples: 1 - corr^2 of the field with the figure
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
    """Effect of a tilted prior: its density is doubled at one end and zero at the other.

    Attributes
    ----------
    field, towards : field with the tilted prior, and the end with doubled density, "low" or "high"
    mean_before, mean : of the field, in its own unit
    row, row_steps : row with the largest change of its prediction, and that change in standard
        deviations of the prediction
    probability : of the most probable choices
    effective_share : of the samples, (sum w)^2 / (n sum w^2): few count where it is small
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
    """Return the effect of each field's prior on mean, prediction and probability.

    Samples are weighted by 2 u or 2 (1 - u), u the prior's own quantile of the field; the evidence
    of a model changes by the mean of the weights (importance sampling).

    Parameters
    ----------
    posteriors, chances : of the models with their probabilities, the most probable first
    rows : Likelihood
        All rows to predict, of the first model.
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
    """Return weights (sample,) of the tilted prior over the prior, 1 in the mean over the prior."""
    return np.asarray(2.0 * ndtr(z if towards == "high" else -z))
