"""Parameters that scatter from manoeuvre to manoeuvre around the aircraft's: partial pooling by NUTS.

All is in units of the parameters' priors: an aircraft's value is a standard normal one. A manoeuvre is its normal
approximation, an estimate y with information F F', which may be singular. Given the scatter, the parameters of the
aircraft and of the manoeuvres are normal: they are integrated out, and NUTS samples the scatter alone.

Source: Gelman et al., *Bayesian Data Analysis*, 3rd ed. 2013, ch. 5; half-normal scatter: Gelman, Bayesian Analysis 1
(2006) 515.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import arviz_base as azb
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from bayes_aero.arrays import AnyArray
from bayes_aero.errors import InputError
from bayes_aero.inference import mle
from bayes_aero.inference.covariance import robust_covariance
from bayes_aero.inference.results import MleResult, MleStatus, NextFlight, Posterior
from bayes_aero.inference.sampling import NutsLength, diagnose, find_mode, sample_nuts
from bayes_aero.model.model import Model
from bayes_aero.model.observations import LogDensity, Observations
from bayes_aero.parameter import Parameter, Prior
from bayes_aero.progress import Progress, quiet

SCATTER = 0.5  # of a prior's deviation: 95 % sure that flights of one aircraft differ less than aircraft do; our choice


class Hierarchy(LogDensity):
    """Density of the scatter of k parameters between m manoeuvres; `x` are its standard deviations."""

    scattering: tuple[Parameter, ...] = eqx.field(static=True)
    noise_label = "normal approximation"  # pyright: ignore[reportAssignmentType]
    estimate: Float[Array, "m k"]
    factor: Float[Array, "m k k"]  # F of each information matrix F F'

    @classmethod
    def of(cls, names: Sequence[str], estimate: np.ndarray, information: Float[np.ndarray, "m k k"]) -> Hierarchy:
        """The density of estimates (m, k) with their information matrices, in units of the priors."""
        prior = Prior("halfnormal", 0.0, SCATTER)
        text = "standard deviation between manoeuvres, in units of the prior's"
        scattering = tuple(Parameter(name, "1", 0.0, SCATTER, text, prior, (0.0, np.inf)) for name in names)
        size, vectors = np.linalg.eigh(information)
        factor = vectors * np.sqrt(np.maximum(size, 0.0))[:, None, :]
        return cls(scattering, jnp.asarray(estimate), jnp.asarray(factor))

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return self.scattering

    def log_likelihood(self, x: Float[Array, " k"]) -> Float[Array, ""]:
        """Log-density of the estimates at the scatter `x`, up to a constant; all other parameters are integrated out. P
        = (inv(F F') + T)^-1 = F (I + F' T F)^-1 F', T = diag x^2, needs no inverse of F F' and does not cancel."""

        def whitened(factor: Array) -> tuple[Array, Array]:
            scaled = x[:, None] * factor
            lower = jnp.linalg.cholesky(jnp.eye(self.size) + scaled.T @ scaled)
            return jax.scipy.linalg.solve_triangular(lower, factor.T, lower=True), jnp.sum(jnp.log(jnp.diag(lower)))

        left, log_det = jax.vmap(whitened)(self.factor)
        weighed = jnp.einsum("mij,mj->mi", left, self.estimate)
        precision = jnp.eye(self.size) + jnp.einsum("mij,mik->jk", left, left)
        lower = jnp.linalg.cholesky(precision)
        mean = jax.scipy.linalg.solve_triangular(lower, jnp.einsum("mij,mi->j", left, weighed), lower=True)
        determinants = jnp.sum(log_det) + jnp.sum(jnp.log(jnp.diag(lower)))
        return 0.5 * (jnp.sum(mean**2) - jnp.sum(weighed**2)) - determinants


class PooledDraws(NamedTuple):
    """Draws in units of the priors."""

    aircraft: Float[np.ndarray, "chain draw k"]
    scatter: Float[np.ndarray, "chain draw k"]
    following: Float[np.ndarray, "chain draw k"]
    manoeuvres: Float[np.ndarray, "chain draw m k"]


def pool(
    density: Hierarchy, *, seed: int = 0, length: NutsLength = NutsLength(), progress: Progress = quiet
) -> tuple[PooledDraws, Posterior]:
    """Draws of all, and the posterior of the scatter by NUTS, given which all else is normal."""
    mode = find_mode(density, np.full(density.size, SCATTER))
    sampled = sample_nuts(density, mode, seed=seed, length=length, progress=progress, predictive=False)
    posterior = sampled.tree["posterior"].to_dataset()
    scatter = np.stack([np.asarray(posterior[name]) for name in density.names], axis=-1)
    return given_scatter(density, scatter, np.random.default_rng([seed, 5])), sampled


def given_scatter(
    density: Hierarchy, scatter: Float[np.ndarray, "chain draw k"], rng: np.random.Generator
) -> PooledDraws:
    """A draw of the aircraft, of each manoeuvre and of the next flight for each draw of the scatter."""
    identity = np.eye(density.size)
    precision, weighed = np.broadcast_to(identity, (*scatter.shape, density.size)).copy(), np.zeros(scatter.shape)
    each = list(zip(*map(np.asarray, (density.estimate, density.factor)), strict=True))
    for y, F in each:
        scaled = scatter[..., :, None] * F
        P = F @ np.linalg.solve(identity + np.swapaxes(scaled, -1, -2) @ scaled, np.broadcast_to(F.T, scaled.shape))
        precision, weighed = precision + P, weighed + P @ y

    def normal(precision: np.ndarray, weighed: np.ndarray) -> np.ndarray:
        upper = np.swapaxes(np.linalg.cholesky(precision), -1, -2)
        white = np.linalg.solve(upper, rng.standard_normal((*weighed.shape, 1)))
        return (np.linalg.solve(precision, weighed[..., None]) + white)[..., 0]

    aircraft, manoeuvres = normal(precision, weighed), []
    for y, F in each:
        scaled = scatter[..., :, None] * F
        pulled = np.einsum("...ij,...j->...i", scaled, (y - aircraft) @ F)
        offset = normal(identity + scaled @ np.swapaxes(scaled, -1, -2), pulled)
        manoeuvres.append(aircraft + scatter * offset)
    following = aircraft + scatter * rng.standard_normal(scatter.shape)
    return PooledDraws(aircraft, scatter, following, np.stack(manoeuvres, axis=-2))


# --- From fits of single manoeuvres to the parameters of a flight not yet flown.

HALF_NORMAL_SD = SCATTER * np.sqrt(1.0 - 2.0 / np.pi)
SHAPES = {key: ["parameter"] for key in ("aircraft", "scatter", "next_flight")} | {"manoeuvre": ["flown", "parameter"]}


def check_manoeuvres(count: int) -> None:
    """Refuse one manoeuvre, or more than are fitted one by one, by an `InputError` before anything is computed."""
    if not 1 < count <= mle.MAX_SEPARATE_FITS:
        raise InputError(
            f"the next flight needs 2 to {mle.MAX_SEPARATE_FITS} manoeuvres, and there {'is' if count == 1 else 'are'} "
            f"{count}; give other records, or divide a file by --split or parts like flight.csv@12.5:40"
        )


def next_flight(
    model: Model,
    observations: Observations,
    alone: Mapping[str, MleResult],
    *,
    seed: int = 0,
    progress: Progress = quiet,
) -> NextFlight:
    """Pool the fits `alone` of manoeuvres: parameters scatter around the aircraft's, by an amount that is sampled."""
    # `InputError`: fewer than two of the fits are usable.
    began = time.perf_counter()
    given = normal_estimates(model, observations, alone)
    if len(given.names) < 2:
        reasons = "; ".join(f"{name}: {reason}" for name, reason in given.left_out.items())
        raise InputError(f"fewer than two manoeuvres have a usable fit of their own ({reasons}); add manoeuvres")
    try:
        drawn, sampled = pool(Hierarchy.of(model.names, given.y, given.information), seed=seed, progress=progress)
    except np.linalg.LinAlgError as reason:
        sizes = {name: np.linalg.eigvalsh(A)[-1] for name, A in zip(given.names, given.information, strict=True)}
        raise InputError(
            f"the manoeuvres cannot be pooled for the next flight: with the information of "
            f"{max(sizes, key=lambda name: sizes[name])} a matrix is singular ({reason}); leave this record out, fix "
            "the parameters that the correlations name on the card, or do without --next-flight"
        ) from reason
    names, scatter, used = model.names, drawn.scatter, given.names
    drawn = PooledDraws(*(_each(model.free, from_prior_units, v) for v in drawn))
    drawn = drawn._replace(scatter=scatter * _each(model.free, prior_unit, drawn.aircraft))
    stats = {name: np.asarray(x) for name, x in sampled.tree["sample_stats"].to_dataset().items()}
    groups = {"posterior": dict(zip(SHAPES, drawn, strict=True)), "sample_stats": stats}
    tree = azb.from_dict(groups, dims=SHAPES, coords={"parameter": list(names), "flown": list(used)})
    tree.attrs |= {"engine": sampled.engine, "likelihood": sampled.noise}
    alone_by_name, unseen = {}, dict.fromkeys(names, ())
    for name, deviation, shown in zip(used, given.sd, given.determined, strict=True):
        sd = deviation * _each(model.free, prior_unit, alone[name].estimate)
        both = zip(names, map(float, alone[name].estimate), map(float, sd), strict=True)
        alone_by_name[name] = {n: (x, error) for n, x, error in both if np.isfinite(error)}
        unseen |= {n: (*unseen[n], name) for n, says in zip(names, shown, strict=True) if not says}
    return NextFlight(
        parameters=model.free,
        manoeuvres=used,
        alone=alone_by_name,
        pooled={name: diagnose(drawn.manoeuvres[:, :, m], names) for m, name in enumerate(used)},
        aircraft=diagnose(drawn.aircraft, names),
        scatter=diagnose(drawn.scatter, names),
        following=diagnose(drawn.following, names),
        narrowed={name: marginal.sd / HALF_NORMAL_SD for name, marginal in sampled.marginals.items()},
        undetermined={name: flights for name, flights in unseen.items() if flights},
        left_out=given.left_out,
        tree=tree,
        status=sampled.status,
        seconds=time.perf_counter() - began,
    )


# --- Manoeuvres fitted alone as normal distributions in units of the priors, those without full information among
# them.

USABLE = (MleStatus.CONVERGED, MleStatus.AT_BOUND, MleStatus.SINGULAR)
BARELY = 1e-10  # information, in units of the priors, that stands for none
INFINITE = 1e3  # deviations of the prior: a standard error beyond is none


class NormalEstimates(NamedTuple):
    """m manoeuvres as normal distributions in units of the priors."""

    names: tuple[str, ...]
    y: Float[np.ndarray, "m k"]
    information: Float[np.ndarray, "m k k"]
    determined: Bool[np.ndarray, "m k"]  # whether a record says more of a parameter than the prior does
    sd: Float[np.ndarray, "m k"]  # standard errors of the manoeuvres alone, infinite where there is none
    left_out: dict[str, str]  # manoeuvres without a usable fit, with the reason


def to_prior_units(prior: Prior, x: Float[AnyArray, "*s"]) -> Float[AnyArray, "*s"]:
    """How many of its standard deviations a value lies above the prior's centre; lognormal priors in the logarithm."""
    if prior.family == "lognormal":
        return np.log(np.asarray(x) / prior.location) / prior.scale
    mean, sd = prior.normal
    return (np.asarray(x) - mean) / sd


def from_prior_units(prior: Prior, v: Float[AnyArray, "*s"]) -> Float[AnyArray, "*s"]:
    """The inverse of `to_prior_units`."""
    if prior.family == "lognormal":
        return prior.location * np.exp(prior.scale * np.asarray(v))
    mean, sd = prior.normal
    return mean + sd * np.asarray(v)


def prior_unit(prior: Prior, x: Float[AnyArray, "*s"]) -> Float[AnyArray, "*s"]:
    """The derivative of `from_prior_units` where it gives `x`."""
    return prior.scale * np.asarray(x) if prior.family == "lognormal" else np.full(np.shape(x), prior.normal[1])


def normal_estimates(model: Model, observations: Observations, alone: Mapping[str, MleResult]) -> NormalEstimates:
    """The normal approximations of the likelihoods of `alone`, the fits by manoeuvre of `observations`."""
    left_out = {name: fit.status.value for name, fit in alone.items() if fit.status not in USABLE}
    y, shaped, k = {}, [], len(model.free)
    for name in (name for name in alone if name not in left_out):
        information = _information(model, observations, name, alone[name])
        if information is None:
            left_out[name] = (
                "the covariance of its estimates is singular: this record alone does not separate the parameters; give "
                "a longer or livelier record, or fix parameters on the card"
            )
            continue
        unit = _each(model.free, prior_unit, alone[name].estimate)
        y[name] = _each(model.free, to_prior_units, alone[name].estimate)
        shaped.append(information * np.outer(unit, unit))
    shaped = np.reshape(shaped, (-1, k, k))
    with_prior, bare = (np.linalg.inv(shaped + weight * np.eye(k)) for weight in (1.0, BARELY))
    determined, variance = np.diagonal(with_prior, axis1=1, axis2=2) < 0.5, np.diagonal(bare, axis1=1, axis2=2)
    sd = np.sqrt(np.where(variance < INFINITE**2, np.maximum(variance, 0.0), np.inf))
    return NormalEstimates(tuple(y), np.reshape(list(y.values()), (-1, k)), shaped, determined, sd, left_out)


def _each(
    parameters: Sequence[Parameter], function: Callable[[Prior, Any], Any], x: Float[np.ndarray, "*s k"]
) -> Float[np.ndarray, "*s k"]:
    return np.stack([function(p.prior, x[..., i]) for i, p in enumerate(parameters)], axis=-1)


def _information(
    model: Model, observations: Observations, name: str, fit: MleResult
) -> Float[np.ndarray, "k k"] | None:
    """Information by the covariance corrected for coloured residuals, none at a bound; None where singular."""
    # Where the information matrix is singular: of the combinations of parameters that the record determines.
    inside = np.array([name not in fit.at_bound for name in fit.names])
    kept = np.ix_(inside, inside)
    if fit.status is not MleStatus.SINGULAR and np.all(np.isfinite(fit.corrected[kept])):
        information = np.zeros_like(fit.corrected)
        information[kept] = mle.scaled_inverse(fit.corrected[kept])[0]
    else:
        alone = observations.only(observations.names.index(name))
        data = mle.data_of(model, alone)
        point = mle.full_steps(data, fit.estimate, fit.estimate, fit.estimate, mle.TOLERANCE, 0)
        residual, S, _ = map(np.asarray, mle.evaluate(data, jnp.asarray(fit.estimate)))
        own_size = np.diag(point.information)
        scale = np.sqrt(np.where(own_size > 0.0, own_size, own_size.max()))
        size, vectors = np.linalg.eigh(point.information / np.outer(scale, scale))
        seen = size > np.sqrt(mle.SINGULAR)
        inverse = (vectors[:, seen] / size[seen]) @ vectors[:, seen].T / np.outer(scale, scale)
        marks = alone.manoeuvre, np.asarray(alone.start), alone.dt
        covariance, _ = robust_covariance(inverse, S, point.R, residual, *marks)
        combined = vectors[:, seen] * scale[:, None]  # what the record determines is combined' times the parameters
        information = combined @ mle.scaled_inverse(combined.T @ covariance @ combined)[0] @ combined.T
    return (information + information.T) / 2.0 if np.all(np.isfinite(information)) else None
