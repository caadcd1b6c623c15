"""The posterior mode and its curvature: where samplers start and the scale on which they work."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy import optimize

from bayes_aero.inference.likelihood.mle_result import MleResult
from bayes_aero.model.noise import LogDensity

PRIOR_DRAWS, MIN_DRAWS = 8, 2  # of the prior, from which other modes are sought
MAX_SAMPLES_TIMES_DRAWS = 48_000  # fewer draws are used for longer records
MIN_OTHER_SHARE = 0.01  # of the probability, from which other modes are reported
SAME_LOG_DENSITY = 0.05  # difference of log-densities below which two modes are one; searches stop no nearer
MIN_RELATIVE_CURVATURE = 1e-8  # curvatures below this share of the largest count as this


class ModeStatus(Enum):
    """How the search for the mode ended; the value is the text for the user."""

    CONVERGED = "converged"
    NOT_CONVERGED = "the posterior mode was not reached; the samplers start from the best point found"
    FLAT = "the posterior is flat or saddle-shaped at its mode; some combination of parameters is not identified"


@dataclass(frozen=True)
class PosteriorMode:
    """`u` is the mode on the unbounded scale, `factor` the lower Cholesky factor of the inverse curvature there."""

    u: Float[np.ndarray, " k"]
    factor: Float[np.ndarray, "k k"]
    log_density: float
    status: ModeStatus
    other_share: float = 0.0  # of the probability, in other modes that `search_modes` found

    @property
    def log_mass(self) -> float:
        """Log of the probability around the mode by its Laplace approximation, without a constant."""
        return self.log_density + float(np.sum(np.log(np.diag(self.factor))))

    def unwhiten(self, v: Float[np.ndarray, "*m k"]) -> Float[np.ndarray, "*m k"]:
        """u of whitened coordinates v, in which the posterior is close to a standard normal."""
        return self.u + v @ self.factor.T


@eqx.filter_jit
def _value_and_gradient(density: LogDensity, u: Float[Array, " k"]):
    return jax.value_and_grad(type(density).__call__, argnums=1)(density, u)


@dataclass
class _Point:
    """A point of a density, with the log-density and its gradient there."""

    density: LogDensity
    u: np.ndarray

    def __post_init__(self) -> None:
        value, slope = _value_and_gradient(self.density, jnp.asarray(self.u))
        self.value, self.slope = float(value), np.asarray(slope)

    @property
    def usable(self) -> bool:
        """Whether the density is finite here, and its gradient."""
        return bool(np.isfinite(self.value) and np.isfinite(self.slope).all())

    def factor(self, step: np.ndarray) -> tuple[np.ndarray, bool]:
        """Lower Cholesky factor of |H|^-1 with the negative Hessian H; true if H is positive definite."""
        # Away from the mode H may have negative eigenvalues. Their size is still the right scale of a step (saddle-free
        # Newton), so absolute values are taken; a lower limit keeps flat directions finite.
        rows = []  # central differences of the exact gradient
        for move, size in zip(np.diag(step), step, strict=True):
            forward, backward = (_Point(self.density, self.u + sign * move).slope for sign in (1.0, -1.0))
            rows.append((backward - forward) / (2.0 * size))
        H = (np.array(rows) + np.array(rows).T) / 2.0
        known = np.isfinite(H).all(axis=1)
        if not known.all():  # no density nearby in that direction: the largest curvature is taken
            largest = np.abs(np.diag(H)[known]).max(initial=1.0)
            H = np.where(np.outer(known, known), H, np.diag(np.where(known, 0.0, largest)))
        own = np.abs(np.diag(H))
        scale = np.sqrt(np.maximum(own, MIN_RELATIVE_CURVATURE**2 * own.max()))
        eigenvalues, vectors = np.linalg.eigh(H / np.outer(scale, scale))
        floor = MIN_RELATIVE_CURVATURE * np.abs(eigenvalues).max()
        covariance = (vectors / np.maximum(np.abs(eigenvalues), floor)) @ vectors.T / np.outer(scale, scale)
        return np.linalg.cholesky((covariance + covariance.T) / 2.0), bool(known.all() and eigenvalues[0] > floor)

    def climb(self, factor: np.ndarray) -> _Point:
        """Where L-BFGS leads on coordinates scaled by `factor`."""

        def negative(v: np.ndarray) -> tuple[float, np.ndarray]:
            at = _Point(self.density, self.u + factor @ v)
            return (-at.value, -factor.T @ at.slope) if at.usable else (1e300, np.zeros(len(v)))

        begin = np.zeros(len(self.u))
        found = optimize.minimize(negative, begin, jac=True, method="L-BFGS-B", options={"maxiter": 200})
        return _Point(self.density, self.u + factor @ found.x)


def density_start(density: LogDensity, mle: MleResult) -> np.ndarray:
    """Start of the search for the posterior mode: the maximum-likelihood estimate and the noise of its residuals."""
    # Estimate and prior are weighted by their precisions, because estimates with little information may be anywhere.
    deviation = dict(zip(mle.fit, np.sqrt(mle.R), strict=True))
    estimate, bound = (dict(zip(mle.names, x, strict=True)) for x in (mle.estimate, mle.crb))
    start = []
    for p in density.parameters:
        kind, _, coefficient = p.name.partition("_")
        value = p.start
        if p.name in estimate:  # the prior mean where the standard error is infinite
            mean, wide = p.prior.normal
            share = 1.0 / (1.0 + (bound[p.name] / wide) ** 2) if np.isfinite(bound[p.name]) else 0.0
            value = mean + share * (estimate[p.name] - mean)
        if kind == "sigma" and coefficient in deviation:
            value = deviation[coefficient]
        elif kind == "rho" and coefficient in mle.lag1:
            value = np.clip(mle.lag1[coefficient], -0.9, 0.9)
        start.append(inside(value, p.bounds))
    return np.array(start)


def inside(value: float, bounds: tuple[float, float]) -> float:
    """The value moved strictly inside the bounds, where the unbounded scale is finite."""
    lower, upper = bounds
    margin = 1e-3 * min(upper - lower, 1.0 + abs(value))
    return float(np.clip(value, lower + margin, upper - margin))


def find_mode(density: LogDensity, start: Float[np.ndarray, " k"], *, rounds: int = 12) -> PosteriorMode:
    """Maximise the log-density from `start` (x, bounded scale, strictly inside its bounds)."""
    # Each round computes the curvature and takes a Newton step if that increases the density, else steps of L-BFGS.
    at = _Point(density, np.asarray(density.unconstrain(jnp.asarray(start, float))))
    step = np.full(len(at.u), 1e-4)
    for _ in range(rounds):
        factor, positive_definite = at.factor(step)
        step = np.minimum(1e-3 * np.sqrt(np.sum(factor**2, axis=1)), 1e-2)
        move = factor @ (factor.T @ at.slope)
        gain = 0.5 * float(at.slope @ move)
        if positive_definite and gain < 1e-7:
            return PosteriorMode(at.u, factor, at.value, ModeStatus.CONVERGED)
        trial = _Point(density, at.u + move)
        if not (trial.usable and trial.value > at.value + 0.5 * gain):
            trial = at.climb(factor)
        if not (trial.usable and trial.value > at.value):
            break
        at = trial
    factor, positive_definite = at.factor(step)
    near = 0.5 * float(at.slope @ factor @ (factor.T @ at.slope)) < 1e-3
    status = ModeStatus.FLAT if not positive_definite else ModeStatus.CONVERGED if near else ModeStatus.NOT_CONVERGED
    return PosteriorMode(at.u, factor, at.value, status)


def search_modes(
    density: LogDensity, start: Float[np.ndarray, " k"], samples: int, *, seed: int = 0, draws: int = PRIOR_DRAWS
) -> PosteriorMode:
    """The mode with most of the probability, of the modes reached from `start` and from prior draws."""
    # A sampler that starts in one mode does not find the others and still reports convergence. They are therefore
    # sought before. Fewer draws are used where there are many `samples`.
    count = max(MIN_DRAWS, min(draws, MAX_SAMPLES_TIMES_DRAWS // max(samples, 1)))
    others = density.sample_prior(np.random.default_rng([seed, 9]), count)
    found = [find_mode(density, x) for x in (start, *others)]
    positive_definite = [mode for mode in found if mode.status is ModeStatus.CONVERGED]
    if not positive_definite:
        return max(found, key=lambda mode: mode.log_density)
    distinct: list[PosteriorMode] = []
    for mode in sorted(positive_definite, key=lambda mode: -mode.log_mass):
        if all(abs(mode.log_density - known.log_density) > SAME_LOG_DENSITY for known in distinct):
            distinct.append(mode)
    mass = np.exp([mode.log_mass - distinct[0].log_mass for mode in distinct])
    difference = abs(found[0].log_density - distinct[0].log_density)
    same = found[0].status is ModeStatus.CONVERGED and difference <= SAME_LOG_DENSITY
    return replace(found[0] if same else distinct[0], other_share=float(1.0 - 1.0 / mass.sum()))


def other_modes(mode: PosteriorMode, where: str) -> tuple[str, ...]:
    """A sentence where other modes have more than `MIN_OTHER_SHARE` of the probability."""
    if mode.other_share < MIN_OTHER_SHARE:
        return ()
    return (
        f"{where}: the posterior has more than one mode; about {mode.other_share:.0%} of the probability lies outside "
        "the sampled one (by the modes' curvature), so the intervals may exclude other values of the parameters.",
    )
