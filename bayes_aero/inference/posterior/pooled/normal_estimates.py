"""Manoeuvres fitted alone as normal distributions in units of the priors, those without full information among them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from bayes_aero.arrays import Array
from bayes_aero.inference.likelihood.mle import SINGULAR, TOLERANCE
from bayes_aero.inference.likelihood.mle_result import MleResult, MleStatus
from bayes_aero.inference.likelihood.sensitivity import data_of, evaluate, full_steps
from bayes_aero.inference.variance.robust_bounds import robust_covariance
from bayes_aero.model.model import Model
from bayes_aero.model.observations import Observations
from bayes_aero.parameter import Parameter, Prior

USABLE = (MleStatus.CONVERGED, MleStatus.AT_BOUND, MleStatus.SINGULAR)
BARELY = 1e-10  # information, in units of the priors, that stands for none
INFINITE = 1e3  # deviations of the prior: a standard error beyond is none


@dataclass(frozen=True)
class NormalEstimates:
    """m manoeuvres: estimates y (m, k) and information matrices (m, k, k) in units of the priors.

    `determined` (m, k): whether a record says more of a parameter than the prior does. `sd` (m, k): standard errors of
    the manoeuvres alone in units of the priors, infinite where there is none. `left_out`: manoeuvres without a usable
    fit, with the reason.
    """

    names: tuple[str, ...]
    y: Float[np.ndarray, "m k"]
    information: Float[np.ndarray, "m k k"]
    determined: Bool[np.ndarray, "m k"]
    sd: Float[np.ndarray, "m k"]
    left_out: dict[str, str]


def to_prior_units(prior: Prior, x: Float[Array, "*s"]) -> Float[Array, "*s"]:
    """How many of its standard deviations a value lies above the prior's centre; lognormal priors in the logarithm."""
    if prior.family == "lognormal":
        return np.log(np.asarray(x) / prior.location) / prior.scale
    mean, sd = prior.normal
    return (np.asarray(x) - mean) / sd


def from_prior_units(prior: Prior, v: Float[Array, "*s"]) -> Float[Array, "*s"]:
    """The inverse of `to_prior_units`."""
    if prior.family == "lognormal":
        return prior.location * np.exp(prior.scale * np.asarray(v))
    mean, sd = prior.normal
    return mean + sd * np.asarray(v)


def prior_unit(prior: Prior, x: Float[Array, "*s"]) -> Float[Array, "*s"]:
    """The derivative of `from_prior_units` where it gives `x`."""
    return prior.scale * np.asarray(x) if prior.family == "lognormal" else np.full(np.shape(x), prior.normal[1])


def normal_estimates(model: Model, observations: Observations, alone: Mapping[str, MleResult]) -> NormalEstimates:
    """The normal approximations of the likelihoods of `alone`, the fits by manoeuvre of `observations`."""
    used = {name: fit for name, fit in alone.items() if fit.status in USABLE}
    y, information = [], []
    for name, fit in used.items():
        full = _full(fit)
        if full is None:
            full = _of_singular(model, observations.only(observations.names.index(name)), fit)
        unit = _each(model.free, prior_unit, fit.estimate)
        y.append(_each(model.free, to_prior_units, fit.estimate))
        information.append(full * np.outer(unit, unit))
    k = len(model.free)
    shaped = np.reshape(information, (-1, k, k))
    with_prior = np.linalg.inv(shaped + np.eye(k)) if used else shaped
    barely = np.linalg.inv(shaped + BARELY * np.eye(k)) if used else shaped
    variance = np.diagonal(barely, axis1=1, axis2=2)
    return NormalEstimates(
        tuple(used),
        np.reshape(y, (-1, k)),
        shaped,
        np.diagonal(with_prior, axis1=1, axis2=2) < 0.5,
        np.sqrt(np.where(variance < INFINITE**2, np.maximum(variance, 0.0), np.inf)),
        {name: fit.status.value for name, fit in alone.items() if name not in used},
    )


def _each(
    parameters: Sequence[Parameter], function: Callable[[Prior, Any], Any], x: Float[np.ndarray, " k"]
) -> Float[np.ndarray, " k"]:
    return np.array([float(function(p.prior, value)) for p, value in zip(parameters, x, strict=True)])


def _full(fit: MleResult) -> Float[np.ndarray, "k k"] | None:
    """Information from the covariance corrected for coloured residuals; of parameters at a bound there is none."""
    inside = np.array([name not in fit.at_bound for name in fit.names])
    kept = np.ix_(inside, inside)
    if fit.status is MleStatus.SINGULAR or not np.all(np.isfinite(fit.corrected[kept])):
        return None
    scale = np.sqrt(np.diag(fit.corrected[kept]))
    found = np.zeros_like(fit.corrected)
    found[kept] = np.linalg.inv(fit.corrected[kept] / np.outer(scale, scale)) / np.outer(scale, scale)
    return (found + found.T) / 2.0


def _of_singular(model: Model, own: Observations, fit: MleResult) -> Float[np.ndarray, "k k"]:
    """The same of the combinations of parameters that a record with a singular information matrix determines."""
    data = data_of(model, own)
    point = full_steps(data, fit.estimate, fit.estimate, fit.estimate, TOLERANCE, 0)
    residual, S, _ = map(np.asarray, evaluate(data, jnp.asarray(fit.estimate)))
    A = point.information
    own_size = np.diag(A)
    scale = np.sqrt(np.where(own_size > 0.0, own_size, own_size.max()))
    size, vectors = np.linalg.eigh(A / np.outer(scale, scale))
    kept = size > np.sqrt(SINGULAR)
    inverse = (vectors[:, kept] / size[kept]) @ vectors[:, kept].T / np.outer(scale, scale)
    covariance, _ = robust_covariance(inverse, S, point.R, residual, own.manoeuvre, np.asarray(own.start), own.dt)
    combined = vectors[:, kept] * scale[:, None]  # what the record determines is combined' times the parameters
    found = combined @ np.linalg.inv(combined.T @ covariance @ combined) @ combined.T
    return (found + found.T) / 2.0
