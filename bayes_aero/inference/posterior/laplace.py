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
from bayes_aero.model.log_density import LogDensity
from bayes_aero.parameter import Prior

DRAWS, FEWEST = 8, 2  # of the prior, from which other modes are looked for
DEAR = 48_000  # samples times draws
TELLING = 0.01  # share of the probability
SAME = 0.05  # of two modes' log-densities: from rounding, no search stops nearer
FLOOR = 1e-8  # smallest curvature, relative to the largest, that is taken at face value


class ModeStatus(Enum):
    """How the search for the mode ended; the value is what to tell the user."""

    CONVERGED = "converged"
    NOT_CONVERGED = "the posterior mode was not reached; the samplers start from the best point found"
    FLAT = "the posterior is flat or saddle-shaped at its mode; some combination of parameters is not identified"


@dataclass(frozen=True)
class Mode:
    """`u` is the mode on the unbounded scale, `factor` the lower Cholesky factor of the inverse curvature there.

    `elsewhere` is the share of the probability that other modes hold which a search has found (`search_modes`).
    """

    u: Float[np.ndarray, " k"]
    factor: Float[np.ndarray, "k k"]
    log_density: float
    status: ModeStatus
    elsewhere: float = 0.0

    @property
    def log_mass(self) -> float:
        """Log of the probability around the mode, but for a constant: its density over a normal of its curvature."""
        return self.log_density + float(np.sum(np.log(np.diag(self.factor))))

    def unwhiten(self, v: Float[np.ndarray, "*m k"]) -> Float[np.ndarray, "*m k"]:
        """u of whitened coordinates v, in which the posterior is close to a standard normal."""
        return self.u + v @ self.factor.T


@eqx.filter_jit
def _value_and_gradient(density: LogDensity, u: Float[Array, " k"]):
    return jax.value_and_grad(type(density).__call__, argnums=1)(density, u)


def value_and_gradient(density: LogDensity, u: Float[np.ndarray, " k"]) -> tuple[float, Float[np.ndarray, " k"]]:
    """Log-density and its gradient at `u`."""
    value, slope = _value_and_gradient(density, jnp.asarray(u))
    return float(value), np.asarray(slope)


def _usable(value: float, slope: np.ndarray) -> bool:
    return bool(np.isfinite(value) and np.isfinite(slope).all())


def _curvature(density: LogDensity, u: np.ndarray, step: np.ndarray) -> np.ndarray:
    """Negative Hessian by central differences of the exact gradient; symmetric by construction."""
    rows = []
    for i in range(len(u)):
        move = np.zeros_like(u)
        move[i] = step[i]
        forward, backward = (value_and_gradient(density, u + sign * move)[1] for sign in (1.0, -1.0))
        rows.append((backward - forward) / (2.0 * step[i]))
    H = np.array(rows)
    return (H + H.T) / 2.0


def _factor(H: np.ndarray) -> tuple[np.ndarray, bool]:
    """Lower Cholesky factor of |H|^-1; true if H is positive definite.

    Away from the mode H may have negative eigenvalues; their size is still the right scale to move by (saddle-free
    Newton), so absolute values are taken, and a floor keeps a flat direction finite.
    """
    known = np.isfinite(H).all(axis=1)
    if not known.all():  # no density nearby in that direction: taken to be as steep as the steepest
        H = np.where(
            np.outer(known, known), H, np.diag(np.where(known, 0.0, np.abs(np.diag(H)[known]).max(initial=1.0)))
        )
    own = np.abs(np.diag(H))
    scale = np.sqrt(np.maximum(own, FLOOR**2 * own.max()))
    eigenvalues, vectors = np.linalg.eigh(H / np.outer(scale, scale))
    floor = FLOOR * np.abs(eigenvalues).max()
    covariance = (vectors / np.maximum(np.abs(eigenvalues), floor)) @ vectors.T / np.outer(scale, scale)
    return np.linalg.cholesky((covariance + covariance.T) / 2.0), bool(known.all() and eigenvalues[0] > floor)


def _climb(density: LogDensity, u: np.ndarray, factor: np.ndarray) -> np.ndarray:
    """L-BFGS on coordinates scaled by `factor`."""

    def negative(v: np.ndarray) -> tuple[float, np.ndarray]:
        value, slope = value_and_gradient(density, u + factor @ v)
        if not _usable(value, slope):
            return 1e300, np.zeros(len(u))
        return -value, -factor.T @ slope

    found = optimize.minimize(negative, np.zeros(len(u)), jac=True, method="L-BFGS-B", options={"maxiter": 200})
    return u + factor @ found.x


def density_start(density: LogDensity, mle: MleResult) -> np.ndarray:
    """Where the search for the posterior mode begins: the maximum-likelihood estimate with its residuals' noise.

    What the flight hardly tells begins where the prior has it: an estimate of it may be anywhere.
    """
    deviation = dict(zip(mle.fit, np.sqrt(mle.R), strict=True))
    estimate, bound = (dict(zip(mle.names, x, strict=True)) for x in (mle.estimate, mle.crb))
    start = []
    for p in density.parameters:
        kind, _, coefficient = p.name.partition("_")
        value = p.start
        if p.name in estimate:
            value = _weighed(estimate[p.name], bound[p.name], p.prior)
        if kind == "sigma" and coefficient in deviation:
            value = deviation[coefficient]
        elif kind == "rho" and coefficient in mle.lag1:
            value = np.clip(mle.lag1[coefficient], -0.9, 0.9)
        start.append(inside(value, p.bounds))
    return np.array(start)


def _weighed(estimate: float, deviation: float, prior: Prior) -> float:
    """Mean of an estimate and its prior, each by its precision; the prior's alone where there is no deviation."""
    mean, wide = prior.normal
    share = 1.0 / (1.0 + (deviation / wide) ** 2) if np.isfinite(deviation) else 0.0
    return mean + share * (estimate - mean)


def inside(value: float, bounds: tuple[float, float]) -> float:
    """Strictly inside the bounds, where the unbounded scale is finite."""
    lower, upper = bounds
    margin = 1e-3 * min(upper - lower, 1.0 + abs(value))
    return float(np.clip(value, lower + margin, upper - margin))


def find_mode(density: LogDensity, start: Float[np.ndarray, " k"], *, rounds: int = 12) -> Mode:
    """Maximise the log-density from `start` (x, bounded scale, strictly inside its bounds).

    Each round measures the curvature, takes a Newton step if that gains, else climbs by L-BFGS on the new scale.
    """
    u = np.asarray(density.unconstrain(jnp.asarray(start, float)))
    value, slope = value_and_gradient(density, u)
    step = np.full(len(u), 1e-4)
    for _ in range(rounds):
        factor, sound = _factor(_curvature(density, u, step))
        step = np.minimum(1e-3 * np.sqrt(np.sum(factor**2, axis=1)), 1e-2)
        move = factor @ (factor.T @ slope)
        gain = 0.5 * float(slope @ move)
        if sound and gain < 1e-7:
            return Mode(u, factor, float(value), ModeStatus.CONVERGED)
        trial = u + move
        new, new_slope = value_and_gradient(density, trial)
        if not (_usable(new, new_slope) and new > value + 0.5 * gain):
            trial = _climb(density, u, factor)
            new, new_slope = value_and_gradient(density, trial)
        if not (_usable(new, new_slope) and new > value):
            break
        u, value, slope = trial, new, new_slope
    factor, sound = _factor(_curvature(density, u, step))
    near = 0.5 * float(slope @ factor @ (factor.T @ slope)) < 1e-3
    status = ModeStatus.FLAT if not sound else ModeStatus.CONVERGED if near else ModeStatus.NOT_CONVERGED
    return Mode(u, factor, float(value), status)


def search_modes(
    density: LogDensity, start: Float[np.ndarray, " k"], samples: int, *, seed: int = 0, draws: int = DRAWS
) -> Mode:
    """The mode around which most of the probability lies, of those climbed to from `start` and from prior draws.

    A sampler that begins in one mode does not find the others and says that it has converged, so they are looked for
    before. Fewer draws are tried where `samples` make each of them dear.
    """
    count = max(FEWEST, min(draws, DEAR // max(samples, 1)))
    others = density.sample_prior(np.random.default_rng([seed, 9]), count)
    found = [find_mode(density, x) for x in (start, *others)]
    sound = [mode for mode in found if mode.status is ModeStatus.CONVERGED]
    if not sound:
        return max(found, key=lambda mode: mode.log_density)
    apart: list[Mode] = []
    for mode in sorted(sound, key=lambda mode: -mode.log_mass):
        if all(abs(mode.log_density - known.log_density) > SAME for known in apart):
            apart.append(mode)
    mass = np.exp([mode.log_mass - apart[0].log_mass for mode in apart])
    near = found[0].status is ModeStatus.CONVERGED and abs(found[0].log_density - apart[0].log_density) <= SAME
    return replace(found[0] if near else apart[0], elsewhere=float(1.0 - 1.0 / mass.sum()))


def other_modes(mode: Mode, where: str) -> tuple[str, ...]:
    """A sentence where other modes hold more of the probability than a table of estimates may leave out."""
    if mode.elsewhere < TELLING:
        return ()
    return (
        f"{where}: the posterior has more than one mode; about {mode.elsewhere:.0%} of the probability lies outside "
        "that which was sampled (by the modes' curvature), so intervals may leave out other values of the parameters.",
    )
