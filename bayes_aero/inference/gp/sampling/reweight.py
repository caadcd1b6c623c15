"""From draws of the stand-in to draws of the exact posterior, with the stand-in's error measured and removed.

Some draws of the NUTS run, thinned until nearly independent, are evaluated exactly at all n points; their
log-ratios, exact minus stand-in, are Pareto-smoothed (PSIS, Vehtari et al. 2024, JMLR 25(72)) by ArviZ. The
Pareto k says whether that works: above 0.7 the stand-in is refused.
"""

import enum
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from arviz_stats.base import array_stats
from jaxtyping import Float
from scipy.special import logsumexp

from bayes_aero.inference.gp.priors import Priors
from bayes_aero.inference.gp.reduced import ReducedData, ReducedStats
from bayes_aero.inference.gp.sampling.density import LogDensity, log_density
from bayes_aero.inference.gp.sampling.sample import Chains

__all__ = ["SampleStatus", "Weighted", "pareto_smooth", "reweight", "thin"]


K_LIMIT = 0.7
ESS_SHARE = 0.3  # k judges the tail of the weights only; a stand-in beside the posterior shows in their ESS


class SampleStatus(enum.Enum):
    """Result of the sampling of hyperparameters; the value is the text for the user."""

    accepted = "The re-weighted draws represent the exact posterior of the hyperparameters."
    not_sampled = "Only the most probable hyperparameters were asked for; set sample=True for their posterior."
    pareto_k = (
        "Refused: Pareto k is too large, so the stand-in density misses part of the exact posterior. "
        "Use the MAP, allow more rounds or design points, or give stronger hyperparameter priors."
    )
    few_effective = (
        "Refused: a few draws carry most of the weight, so the stand-in density sits beside the exact posterior. "
        "Use the MAP, allow more rounds or design points, or give stronger hyperparameter priors."
    )
    not_mixed = (
        "Refused: the NUTS chains disagree (R-hat above 1.01, or too few effective draws). "
        "Use the MAP, lengthen the chains, or give stronger hyperparameter priors."
    )
    not_positive_definite = (
        "Refused: the exact covariance could not be factorised at some draws. "
        "Use the MAP, or give the noise a prior with a larger median."
    )
    dependent = (
        "Refused: an input, or the output, is a linear combination of the inputs, and the stand-in density needs them "
        "independent. Use the MAP, or leave one of the inputs out."
    )
    no_optimum = "Refused: the search for the most probable hyperparameters failed; see the MAP's status."


class Weighted(NamedTuple):
    """Exactly evaluated draws: theta (chains, draws, p), exact and stand-in log densities, PSIS log weights.

    The log weights are normalised over all draws; `k_hat` and `ess` (of the weights) judge them.
    """

    theta: Float[np.ndarray, "chains draws p"]
    exact: Float[np.ndarray, "chains draws"]
    stand_in: Float[np.ndarray, "chains draws"]
    log_weight: Float[np.ndarray, "chains draws"]
    k_hat: float
    ess: float
    failures: int
    stats: tuple[ReducedStats, ...] = ()  # of every draw, flat: they can train the next stand-in

    @property
    def k_limit(self) -> float:
        """Largest Pareto k that is accepted; k has a standard error of about 0.2 on this few draws."""
        return K_LIMIT

    @property
    def status(self) -> SampleStatus:
        """Verdict on the stand-in."""
        if self.failures:
            return SampleStatus.not_positive_definite
        if self.k_hat > self.k_limit:
            return SampleStatus.pareto_k
        return SampleStatus.accepted if self.ess >= ESS_SHARE * self.exact.size else SampleStatus.few_effective


def thin(chains: Chains, draws: int) -> tuple[np.ndarray, np.ndarray]:
    """About `draws` of all draws, the same evenly spaced ones of each chain, and their stand-in log densities."""
    each = max(draws // chains.theta.shape[0], 2)
    at = np.linspace(0, chains.theta.shape[1] - 1, each).round().astype(int)
    return chains.theta[:, at], chains.log_density[:, at]


def _log_sum(x: Float[np.ndarray, "*shape"]) -> float:
    return float(np.asarray(logsumexp(x)))


def pareto_smooth(log_ratio: Float[np.ndarray, "*shape"]) -> tuple[Float[np.ndarray, "*shape"], float]:
    """Normalised smoothed log weights and Pareto k. (ArviZ's psislw takes *minus* the log-ratio, as in LOO.)"""
    if np.ptp(log_ratio) < 1e-12:
        return np.full(log_ratio.shape, -np.log(log_ratio.size)), -np.inf  # no error, hence no tail to fit
    smoothed, k_hat = array_stats.psislw(-log_ratio.ravel())
    smoothed = np.asarray(smoothed)
    return (smoothed - _log_sum(smoothed)).reshape(log_ratio.shape), float(k_hat)


def reweight(
    theta: Float[np.ndarray, "chains draws p"],
    stand_in: Float[np.ndarray, "chains draws"],
    data: ReducedData,
    priors: Priors,
    tell: Callable[[str], None],
) -> Weighted:
    """Evaluate every theta exactly (one factorisation each) and weigh it."""
    flat = theta.reshape(-1, theta.shape[-1])
    exact: list[LogDensity] = []
    for i, t in enumerate(flat):
        exact.append(log_density(t, data, priors, gradient=False))
        tell(f"exact evaluation {i + 1} of {len(flat)}")
    value = np.array([e.value for e in exact]).reshape(stand_in.shape)
    failures = sum(not e.ok for e in exact)
    if failures:
        nothing = np.full(value.shape, np.nan)
        return Weighted(theta, value, stand_in, nothing, np.inf, 0.0, failures)
    log_weight, k_hat = pareto_smooth(value - stand_in)
    ess = float(np.exp(-_log_sum(2.0 * log_weight)))
    return Weighted(theta, value, stand_in, log_weight, k_hat, ess, 0, tuple(e.stats for e in exact))
