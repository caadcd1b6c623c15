"""Whether a posterior predicts what was measured (PIT), and how much it leans on its priors.

Under a correct model the values are uniform. Each sample is predicted one step ahead, given those before it in its
manoeuvre; under white noise they carry no information, and the values are those of the predictive distribution.
Sources: Dawid 1984, J. R. Stat. Soc. A 147, 278; Diebold, Gunther and Tay 1998, Int. Econ. Rev. 39, 863.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from enum import Enum
from typing import Any

import arviz_base as azb
import arviz_stats as azs
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from jax.scipy.special import ndtr
from jaxtyping import Array, Bool, Float
from scipy.special import betainc
from scipy.stats import beta, binom, norm

from bayes_aero.dynamics.innovations import neighbour_correlation
from bayes_aero.dynamics.kalman import Filtered
from bayes_aero.dynamics.trim import conditions, steady_flow
from bayes_aero.inference.covariance import standard_error_of_sum
from bayes_aero.inference.results import (
    SENSITIVITY_LIMIT,
    Histogram,
    Identification,
    Interval,
    PitResult,
    Posterior,
    PosteriorStatus,
    Stall,
)
from bayes_aero.inference.scores import COLOURED_INNOVATIONS, Calibration, OneStep, Predicted, Share
from bayes_aero.model.model import Model
from bayes_aero.model.noise import Colour, Density, LogDensity, Noise
from bayes_aero.physics.aircraft import Aircraft

DRAWS = 200  # of the posterior: the probability of a sample hardly varies between them; our choice
MAX_BINS, MIN_PER_BIN = 20, 20
BAND = 0.95  # that all bars of uniform values lie inside


def pit_of(run: Identification) -> PitResult | None:
    """The transform of a run's samples by its first posterior under the chosen noise; None without a posterior."""
    engine = next((key for key in run.posteriors if key != "white"), None)
    if engine is None:
        return None
    posterior = run.posteriors[engine]
    density = Density.of(run.observations, run.model, Noise(Colour(posterior.noise)), run.mle.bias)
    values = pit(density, posterior.draws()[:, [posterior.names.index(name) for name in density.names]])
    columns, start = [values[:, c] for c in range(values.shape[1])], np.asarray(density.observations.start)
    bars, correlation = tuple(map(histogram, columns)), tuple(neighbours(column, start) for column in columns)
    return PitResult(engine, values, bars, correlation)


def pit(density: Density, x: Float[np.ndarray, "m k"]) -> Float[np.ndarray, "n c"]:
    """Posterior probability of less than what was measured, from draws `x` as rows; by sample and coefficient."""
    kept = x[np.linspace(0, len(x) - 1, min(len(x), DRAWS)).astype(int)]
    return np.asarray(_mean_probability(density, jnp.asarray(kept)))


@eqx.filter_jit
def _mean_probability(density: Density, x: Float[Array, "m k"]) -> Float[Array, "n c"]:
    # Noise is normal given the parameters, so each draw's probability is exact and their mean has no steps of 1/m.
    add = lambda total, row: (total + ndtr(density.standardised(row)), None)  # noqa: E731
    return jax.lax.scan(add, jnp.zeros_like(density.observations.measured), x)[0] / len(x)


def histogram(values: Float[np.ndarray, " n"]) -> Histogram:
    """Bars of `values`, with a band by Bonferroni: exact for one bar, a little wide for all together."""
    n = len(values)
    bins = int(np.clip(n // MIN_PER_BIN, 2, MAX_BINS))
    count, edges = np.histogram(values, bins=bins, range=(0.0, 1.0))
    tail = 0.5 * (1.0 - BAND) / bins
    lower, upper = binom.ppf([tail, 1.0 - tail], n, 1.0 / bins)
    return Histogram(edges, count * bins / n, float(lower * bins / n), float(upper * bins / n))


def neighbours(values: Float[np.ndarray, " n"], start: Bool[np.ndarray, " n"]) -> float:
    """Correlation of neighbouring values within manoeuvres, on the normal scale; 0 if they are independent."""
    z = norm.ppf(np.clip(values, 1e-12, 1.0 - 1e-12))
    inside = ~np.asarray(start, bool)[1:]
    return float(np.corrcoef(z[1:][inside], z[:-1][inside])[0, 1])


# --- Sensitivity of a posterior to its priors: power-scaling of prior and likelihood.
# Source: Kallioinen, Paananen, Burkner and Vehtari 2024, Stat. Comput. 34, 57; `psense` of ArviZ, by Pareto-smoothed
# importance weights, without sampling again.

PRIOR_SENSITIVITY_DRAWS = 4000


class Dependence(Enum):
    """Whether the data or the prior decide a parameter, by its two sensitivities; the value is the text for the
    user."""

    DATA = "the data decide"
    BOTH = "prior and data conflict, or the prior is informative compared with the data"
    PRIOR = "the prior decides; the record contains little information on this parameter"
    NEITHER = "neither changes it: check its chains"


def prior_sensitivity(density: LogDensity, posterior: Posterior) -> pd.DataFrame:
    """A row per parameter: sensitivity to the prior, to the likelihood, and the conclusion (`Dependence`)."""
    # All priors are scaled together. `posterior` is one of `density`. The Monte Carlo error of the sensitivities is
    # about 0.01 for some thousand draws.
    tree = posterior.tree["posterior"].to_dataset()
    step = max(1, tree.sizes["chain"] * tree.sizes["draw"] // PRIOR_SENSITIVITY_DRAWS)
    x = np.stack([np.asarray(tree[name])[:, ::step] for name in density.names], axis=-1)
    prior, likelihood = (np.asarray(values) for values in _prior_and_likelihood(density, jnp.asarray(x)))
    groups = {
        "posterior": {name: x[..., i] for i, name in enumerate(density.names)},
        "log_prior": {"all": prior},
        "log_likelihood": {"all": likelihood},
    }
    both = azb.from_dict(groups)
    sensitivity = {part: azs.psense(both, group=part) for part in ("prior", "likelihood")}
    rows = {name: {part: float(sensitivity[part][name]) for part in sensitivity} for name in density.names}
    table = pd.DataFrame.from_dict(rows, orient="index")
    by = {(False, True): Dependence.DATA, (True, True): Dependence.BOTH, (True, False): Dependence.PRIOR}
    decided = (tuple(row >= SENSITIVITY_LIMIT) for row in table.to_numpy())
    table["says"] = [by.get(row, Dependence.NEITHER).value for row in decided]
    return table


@eqx.filter_jit
def _prior_and_likelihood(density: LogDensity, x: Float[Array, "chain draw k"]) -> tuple[Array, Array]:
    terms = lambda row: (density.log_prior(row), density.log_likelihood(row))  # noqa: E731
    return jax.lax.map(lambda chain: jax.lax.map(terms, chain), x)


# --- Whether a filter's one-step predictions are calibrated: shares of innovations inside predictive intervals.
# Each innovation is predicted from the samples before it and from the outputs before it in its own sample. Where model
# and noise are right, innovations over their predicted standard deviations are independent and standard normal, and
# their probability integral transforms are uniform. Where process noise and measurement noise were fitted to the same
# record, the mean square of the scaled innovations is near 1, and the shares test the shape of the distribution.
# Sources: Dawid 1984, J. R. Stat. Soc. A 147, 278; Diebold, Gunther and Tay 1998, Int. Econ. Rev. 39, 863.

LEVELS = (0.5, 0.9, 0.95, 0.99)  # of central predictive intervals
SIGNIFICANCE = 0.05  # rate of false alarms for calibrated predictions, all outputs and levels together
MIN_INDEPENDENT = 30  # independent innovations below which calibration is undecided; our choice
NORMAL_SCORES = np.arange(-3.0, 3.01, 0.25)  # at which quantiles are compared
MIN_BEYOND = 2.0  # least number of innovations beyond a quantile
TINY = 1e-12


def probability_transform(found: Filtered) -> Float[np.ndarray, "w n c"]:
    """Probability integral transform Phi(e / sqrt(S)) of every innovation, NaN where nothing was measured."""
    return norm.cdf(_standardised(found))


def one_step(found: Filtered, errors: Float[np.ndarray, "w n c"], outputs: Sequence[str]) -> OneStep:
    """One-step predictions of w filtered segments, from errors (w, n, c); outputs with less than two innovations are
    left out."""
    z, u, correlation = _standardised(found), probability_transform(found), neighbour_correlation(found)
    columns = [c for c in range(len(outputs)) if np.isfinite(z[..., c]).sum() > 1]
    tests = len(LEVELS) * (len(columns) + (len(columns) > 1))
    by_output = {}
    for c in columns:
        rms = float(np.sqrt(np.nanmean(np.square(np.asarray(errors)[..., c]))))
        by_output[outputs[c]] = _assess(
            z[..., [c]], u[..., [c]], rms, bool(abs(correlation[c]) > COLOURED_INNOVATIONS), tests
        )
    return OneStep(by_output, _assess(z[..., columns], u[..., columns], None, False, tests))


def _standardised(found: Filtered) -> Float[np.ndarray, "w n c"]:
    z = np.asarray(found.innovation) / np.sqrt(np.asarray(found.variance))
    return np.where(np.asarray(found.used), z, np.nan)


def _assess(
    z: Float[np.ndarray, "w n c"], u: Float[np.ndarray, "w n c"], rms: float | None, coloured: bool, tests: int
) -> Predicted:
    used = np.isfinite(z)
    n, squares = int(used.sum()), np.where(used, np.square(z), 0.0)
    mean = squares.sum() / n
    centred = np.where(used, squares - mean, 0.0)
    inflation = _inflation(centred, used) or 1.0
    ratio = float(np.sqrt(mean))
    ratio_sd = float(np.sqrt(inflation * np.sum(centred**2)) / n) / max(2.0 * ratio, TINY)
    shares, independent = [], n / inflation
    for level in LEVELS:
        inside = used & (np.abs(u - 0.5) <= 0.5 * level)
        share = float(inside.sum() / n)
        inflation = _inflation(np.where(used, inside - share, 0.0), used) or inflation
        spread = max(share * (1.0 - share), level * (1.0 - level))
        # Two-sided binomial p-value of independent innovations; by the beta distribution, for they are no whole number.
        alone = n / inflation
        missed, chance = (1.0 - share) * alone, 1.0 - level
        at_most = float(betainc(max(alone - missed, TINY), missed + 1.0, level))
        at_least = float(betainc(max(missed, TINY), alone - missed + 1.0, chance))
        p = min(1.0, 2.0 * min(at_most, at_least))
        shares.append(Share(level, share, float(np.sqrt(inflation * spread / n)), p))
        independent = min(independent, alone)
    differences = [s.share - s.level for s in shares if s.p < SIGNIFICANCE / tests]
    if coloured and not differences:
        calibration = Calibration.COLOURED
    elif independent < MIN_INDEPENDENT:
        calibration = Calibration.UNDECIDED
    elif not differences:
        calibration = Calibration.CALIBRATED
    elif max(differences) < 0.0:
        calibration = Calibration.TOO_NARROW
    else:
        calibration = Calibration.TOO_WIDE if min(differences) > 0.0 else Calibration.NOT_NORMAL
    # Quantiles: order statistics of as many uniform values as there are independent innovations (Bonferroni).
    scores, rows = NORMAL_SCORES[n * norm.sf(np.abs(NORMAL_SCORES)) >= MIN_BEYOND], []
    tail, probabilities = 0.5 * SIGNIFICANCE / max(len(scores), 1), norm.cdf(scores)
    for score, value, q in zip(scores, np.quantile(z[used], probabilities), probabilities, strict=True):
        below = used & (z <= value)
        alone = n / (_inflation(np.where(used, below - below.sum() / n, 0.0), used) or 1.0)
        band = beta.ppf([tail, 1.0 - tail], q * (alone + 1.0), (1.0 - q) * (alone + 1.0))
        rows.append([score, value, *norm.ppf(band)])
    return Predicted(n, rms, (ratio, ratio_sd), tuple(shares), calibration, np.array(rows).reshape(-1, 4))


def _inflation(centred: Float[np.ndarray, "w n c"], used: Bool[np.ndarray, "w n c"]) -> float | None:
    """Variance inflation of the sum of `centred`, zero where not measured, by all correlation, >= 1; None if it is
    zero.
    """
    white = float(np.sum(centred**2))
    if white <= TINY:
        return None
    lengths = [int(np.max(np.flatnonzero(some), initial=-1)) + 1 for some in np.any(used, axis=2)]
    series = np.concatenate([one[:length].sum(axis=1) for one, length in zip(centred, lengths, strict=True)])
    return max(1.0, standard_error_of_sum(series, [length for length in lengths if length]) ** 2 / white)


# --- The stall in two numbers with intervals: the highest steady lift coefficient, and the angle of it.
# Quasi-steady: CL(alpha) at alpha-dot = 0 and zero rates, all other signals at their median near the stall. The maximum
# is sought over the recorded angles; where it is at their edge, the record does not contain the stall.

POINTS = 241  # angles: less than 0.1 deg apart over 20 deg, and the maximum is found between them
CURVE_DRAWS = 400
QUANTILES = (0.025, 0.5, 0.975)
RATE_SHARES = (0.05, 0.95)  # quantiles of the recorded alpha-dot at which separation is shown beside the steady one


def stall_of(model: Model, draws: Float[np.ndarray, "m k"], signals: Mapping[str, Any], aircraft: Aircraft) -> Stall:
    """The stall over draws of the free parameters (columns as `model.names`), within the angles that `signals` hold."""
    thin = draws[np.unique(np.linspace(0, len(draws) - 1, min(CURVE_DRAWS, len(draws))).astype(int))]
    flown = np.asarray(signals["alpha"])
    alpha = np.linspace(float(flown.min()), float(flown.max()), POINTS)
    low, high = np.quantile(np.asarray(signals["alpha_dot"]), RATE_SHARES)
    rates = np.array([min(low, 0.0), 0.0, max(high, 0.0)])
    reference = conditions(signals)
    held = {name: jnp.asarray(value) for name, value in reference.items()}
    flows = _flows(model, jnp.asarray(thin), jnp.asarray(alpha), jnp.asarray(rates), held, aircraft)
    X, CL, CD = (np.asarray(flows[name]) for name in ("X", "CL", "CD"))  # (m, rates, angles)
    steady, drag = CL[:, 1], CD[:, 1]
    peak, place, edge = maxima(alpha, steady)
    return Stall(
        alpha=alpha,
        CL=np.quantile(steady, QUANTILES, axis=0),
        CD=np.quantile(drag, QUANTILES, axis=0),
        rates=rates,
        X=np.moveaxis(np.quantile(X, QUANTILES, axis=0), 0, 1),
        CL_max=Interval.of(peak),
        alpha_max=Interval.of(place),
        at_edge=float(np.mean(edge)),
        reference=reference,
    )


def stall_of_posterior(model: Model, posterior: Posterior, signals: Mapping[str, Any], aircraft: Aircraft) -> Stall:
    """`stall_of` the draws of a posterior, without its noise parameters."""
    return stall_of(model, posterior.draws()[:, [posterior.names.index(n) for n in model.names]], signals, aircraft)


def stall_of_run(run: Identification) -> Stall | None:
    """CLmax and its angle from the first posterior that converged; without one there is none."""
    for key, posterior in run.posteriors.items():
        if key != "white" and posterior.status is PosteriorStatus.CONVERGED:
            o = run.observations
            return stall_of_posterior(run.model, posterior, o.signals, o.aircraft)
    return None


def maxima(x: Float[np.ndarray, " g"], y: Float[np.ndarray, "m g"]):
    """Maximum of every row, its position (by a parabola through three even points), and whether it is at an edge."""
    i = np.argmax(y, axis=1)
    edge = (i == 0) | (i == len(x) - 1)
    j = np.clip(i, 1, len(x) - 2)
    rows = np.arange(len(y))
    before, here, after = y[rows, j - 1], y[rows, j], y[rows, j + 1]
    bend = np.where(edge, -1.0, before - 2.0 * here + after)
    shift = np.where(edge | (bend >= 0.0), 0.0, 0.5 * (before - after) / np.where(bend < 0.0, bend, -1.0))
    step = x[1] - x[0]
    peak = np.where(edge, y[rows, i], here - 0.25 * (before - after) * shift)
    return peak, np.where(edge, x[i], x[j] + shift * step), edge


@eqx.filter_jit
def _flows(model, thetas: Float[Array, "m k"], alpha: Float[Array, " g"], rates: Float[Array, " r"], held, aircraft):
    flows = jax.vmap(lambda theta, rate: steady_flow(model, theta, alpha, rate, held, aircraft), in_axes=(None, 0))
    return jax.lax.map(lambda theta: flows(theta, rates), thetas)
