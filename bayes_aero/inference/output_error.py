"""Output error: parameters and initial states such that the simulated trajectory follows the measured one.

Gauss-Newton with Levenberg and Marquardt's damping on exact forward sensitivities; diagonal R re-estimated each step
(cost det R). Initial states belong to one segment each and are eliminated there. Source: Jategaonkar, *Flight Vehicle
System Identification*, 2nd ed. 2015, ch. 4.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from enum import Enum
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from bayes_aero.inference.mle import solve
from bayes_aero.model.segments import Flown, simulate
from bayes_aero.parameter import Parameter

MAX_ITERATIONS, EARLY = 60, 12  # of the last stage of a cascade, and of those before
DECREMENT = 2e-5  # expected gain in log-likelihood of one more step, at which it stops
SLACK = 1e-3  # the same per sample's weight, where residuals are coloured: 0.05 of a deviation that knows the colour
THINNED = 5  # samples, for the colour of the residuals
HELD = 0.9  # posterior over prior deviation from which a parameter is said to be held by its prior
DEPARTURE = {"airspeed": 1.0, "alpha": 0.01, "theta": 0.01, "q": 0.01, "altitude": 3.0, "X": 0.1}
"""Standard deviation of the measured initial state, SI: what the sensors of a flight test allow; our choice."""
OTHER_DEPARTURE = 0.05
TINY, HUGE = 1e-300, 1e100  # a sensitivity beyond HUGE is that of a motion that is not unique
OUTSIDE = 1e6  # cost of a trajectory that is all outside the envelope: worse than any inside
BEGIN_DAMPING, LEAST_DAMPING = 1e-2, 1e-4  # relative to the information's diagonal: far steps end in other basins
WORTH = 0.05  # least share of the expected gain that a step must bring


class OutputErrorStatus(Enum):
    """How the fit ended; the value is what to tell the user."""

    CONVERGED = "converged"
    AT_BOUND = "converged with a parameter at its bound: its deviation means little; widen the bound or fix it"
    NOT_CONVERGED = "stopped before the optimum: start nearer, or begin with shorter windows; do not use the numbers"
    LEFT_ENVELOPE = (
        "the simulation leaves the flight envelope at every parameter value tried: the model cannot fly this record; "
        "check signs and units, or begin with shorter windows"
    )


class Normal(NamedTuple):
    """Inner products of residual and sensitivities: (w, c, 1 + k + s, 1 + k + s), samples (w,), and what was inside.

    `thinned` are residual and sensitivities themselves, (1 + k + s, w, m, c), means over `THINNED` samples.
    """

    gram: Float[np.ndarray, "w c j j"]
    count: Float[np.ndarray, " w"]
    inside: float
    thinned: Float[np.ndarray, "j w m c"]


@eqx.filter_jit
def _normal(flown: Flown, theta: Float[Array, " k"], departure: Float[Array, "w s"]):
    """Grams and the share of samples inside the envelope; sensitivities forward, in all directions at once."""
    k, s = theta.shape[0], departure.shape[1]

    def residual(theta, shared):
        found = simulate(flown, theta, departure + shared)
        return found.residual, found.trajectory.inside

    point = (theta, jnp.zeros(s))
    towards = (jnp.concatenate([jnp.eye(k), jnp.zeros((s, k))]), jnp.concatenate([jnp.zeros((k, s)), jnp.eye(s)]))
    r, slope, inside = jax.vmap(lambda t: jax.jvp(residual, point, t, has_aux=True), out_axes=(None, 0, None))(towards)
    columns = jnp.concatenate([r[None], -slope])  # j w n c
    gram = jnp.einsum("iwnc,jwnc->wcij", columns, columns)
    whole = columns.shape[2] // THINNED * THINNED
    blocks = columns[:, :, :whole].reshape(*columns.shape[:2], -1, THINNED, columns.shape[3]).mean(axis=3)
    return gram, jnp.sum(inside & flown.inside, axis=1), blocks


def _in_parts(flown: Flown, theta: Array, departure: Float[np.ndarray, "w s"], together: bool) -> list[np.ndarray]:
    """`_normal`, its segments shared out among the cores: XLA leaves a scan to one of them.

    Not `together` the first time, lest every thread compile for itself.
    """
    w = len(flown.index)
    parts = min(w, os.cpu_count() or 1)
    size = -(-w // parts)
    rows = [np.minimum(np.arange(a, a + size), w - 1) for a in range(0, w, size)]  # one shape; the last may repeat

    def one(own: np.ndarray):
        fewer = flown.index[own], flown.inside[own], flown.dt[own]
        part = eqx.tree_at(lambda f: (f.index, f.inside, f.dt), flown, fewer)
        return [np.asarray(x) for x in _normal(part, theta, jnp.asarray(departure[own]))]

    with ThreadPoolExecutor(parts if together else 1) as pool:
        found = list(pool.map(one, rows))
    gram, inside, thinned = zip(*found, strict=True)
    return [np.concatenate(gram)[:w], np.concatenate(inside)[:w], np.concatenate(thinned, axis=1)[:, :w]]


@eqx.filter_jit
def trajectories(flown: Flown, theta: Float[Array, " k"], departure: Float[Array, "w s"]):
    """`segments.simulate`, compiled."""
    return simulate(flown, theta, departure)


@dataclass(frozen=True)
class Priors:
    """Normal priors of the step: mean and precision of theta (k,) and of the states' departures (s,)."""

    mean: Float[np.ndarray, " k"]
    precision: Float[np.ndarray, " k"]
    states: Float[np.ndarray, " s"]

    @classmethod
    def of(cls, flown: Flown, weight: float) -> Priors:
        """All priors as normals, counted `weight` times: what coloured residuals cost the likelihood."""
        pairs = np.array([p.prior.normal for p in flown.dynamics.free]).reshape(-1, 2)
        deviations = np.array([DEPARTURE.get(name, OTHER_DEPARTURE) for name in flown.dynamics.states])
        return cls(pairs[:, 0], weight * pairs[:, 1] ** -2.0, weight * deviations**-2.0)


@dataclass(frozen=True)
class OutputErrorResult:
    """Estimates of k parameters and of each segment's initial state, with what they rest on.

    `covariance` is Cramer and Rao's with the priors' information, `information` the data's alone. `rms` is by segment
    and output, in the recorded unit. `thinned` are means of residual and sensitivities over `THINNED` samples.
    """

    flown: Flown
    parameters: tuple[Parameter, ...]
    estimate: Float[np.ndarray, " k"]
    departure: Float[np.ndarray, "w s"]
    R: Float[np.ndarray, " c"]
    cost: float
    covariance: Float[np.ndarray, "k k"]
    information: Float[np.ndarray, "k k"]
    priors: Priors
    rms: Float[np.ndarray, "w c"]
    status: OutputErrorStatus
    iterations: int
    at_bound: tuple[str, ...]
    thinned: Float[np.ndarray, "j w m c"]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return tuple(p.name for p in self.parameters)

    @property
    def sd(self) -> Float[np.ndarray, " k"]:
        """Standard deviations, priors counted, residuals taken as white."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def crb(self) -> Float[np.ndarray, " k"]:
        """Cramer-Rao standard deviations: the data alone, residuals taken as white. Infinite where there is nothing."""
        scale = np.sqrt(np.diag(self.information))
        known = scale > 0.0
        found = np.full(len(scale), np.inf)
        part = self.information[np.ix_(known, known)] / np.outer(scale[known], scale[known])
        values, vectors = np.linalg.eigh(part)
        if len(values) and values[0] > 1e-13:
            found[known] = np.sqrt(np.diag((vectors / values) @ vectors.T)) / scale[known]
        return found

    @property
    def held(self) -> tuple[str, ...]:
        """Parameters of which the record says next to nothing: their priors hold them."""
        prior = self.priors.precision**-0.5
        return tuple(n for n, sd, own in zip(self.names, self.sd, prior, strict=True) if sd > HELD * own)


@dataclass
class _Point:
    theta: np.ndarray
    departure: np.ndarray
    normal: Normal
    R: np.ndarray
    cost: float


def fit_output_error(
    flown: Flown,
    *,
    start: Float[np.ndarray, " k"] | None = None,
    departure: Float[np.ndarray, "w s"] | None = None,
    held: Mapping[str, float] | None = None,
    prior_weight: float = 1.0,
    most: int = MAX_ITERATIONS,
) -> OutputErrorResult:
    """Fit all segments together from one start (default: the parameters' own); parameters `held` keep their value."""
    free, held = flown.dynamics.free, held or {}
    lower, upper = (np.array([p.bounds[i] for p in free], float) for i in (0, 1))
    prior = Priors.of(flown, prior_weight)
    theta = np.array([p.start for p in free]) if start is None else np.asarray(start, float)
    theta = np.array([held.get(p.name, x) for p, x in zip(free, theta, strict=True)])
    rest = np.array([p.name in held for p in free], bool)
    lower, upper = np.where(rest, theta, lower), np.where(rest, theta, upper)
    prior = replace(prior, mean=np.where(rest, theta, prior.mean))  # what is held has no say in the cost
    w, s = flown.index.shape[0], len(flown.dynamics.states)
    here = _look(
        flown, np.clip(theta, lower, upper), np.zeros((w, s)) if departure is None else departure, prior, False
    )
    damping, converged, active = BEGIN_DAMPING, False, np.zeros(len(free), bool)
    count = 0
    while count < most and math.isfinite(here.cost):
        count += 1
        A, g, local = _reduced(here, prior)
        active = rest | ((here.theta <= lower) & (g < 0.0)) | ((here.theta >= upper) & (g > 0.0))
        moving = np.flatnonzero(~active)
        newton = solve(A[np.ix_(moving, moving)], g[moving], 0.0)
        gain = 0.5 * float(newton @ g[moving]) + local.gain
        if 0.0 <= gain < max(DECREMENT, SLACK * (prior_weight - 1.0)):
            converged = True
            break
        better = None
        for _ in range(12):
            step = np.zeros(len(free))
            step[moving] = solve(A[np.ix_(moving, moving)], g[moving], damping)
            step = np.clip(here.theta + step, lower, upper) - here.theta
            new = _look(flown, here.theta + step, here.departure + local.step(step), prior)
            expected = step @ g - 0.5 * step @ A @ step + local.gain
            kept = (here.cost - new.cost) / max(expected, TINY)
            if new.cost < here.cost and kept > WORTH:
                better = new
                break
            damping = max(LEAST_DAMPING, 4.0 * damping)
        if better is None:
            converged = bool(0.0 <= gain < 1e-2 * max(1.0, prior_weight))
            break
        damping = damping / 5.0 if kept > 0.75 else damping if kept > 0.3 else max(LEAST_DAMPING, 2.0 * damping)
        here = better
    return _result(flown, here, prior, converged, count, active, rest)


class _Local(NamedTuple):
    """What was eliminated: the segments' own states, given the step of theta."""

    inverse: np.ndarray  # w s s
    cross: np.ndarray  # w s k
    gradient: np.ndarray  # w s
    gain: float

    def step(self, theta: np.ndarray) -> np.ndarray:
        """Best departure of every segment after a step of theta."""
        return np.einsum("wij,wj->wi", self.inverse, self.gradient - self.cross @ theta)


def _look(flown: Flown, theta: np.ndarray, departure: np.ndarray, prior: Priors, together: bool = True) -> _Point:
    gram, within, thinned = _in_parts(flown, jnp.asarray(theta), departure, together)
    count = flown.inside.sum(axis=1).astype(float)
    inside = float(within.sum() / count.sum())
    if not np.all(np.abs(gram) < HUGE):
        return _Point(theta, departure, Normal(gram, count, 0.0, thinned), np.ones(gram.shape[1]), math.inf)
    R = np.maximum(gram[:, :, 0, 0].sum(axis=0) / count.sum(), TINY)
    cost = 0.5 * count.sum() * float(np.sum(np.log(R)))
    cost += 0.5 * float(prior.precision @ (theta - prior.mean) ** 2) + 0.5 * float(np.sum(departure**2 @ prior.states))
    if inside < 1.0:
        cost += OUTSIDE * (1.0 - inside)
    return _Point(theta, departure, Normal(gram, count, inside, thinned), R, cost)


def _reduced(point: _Point, prior: Priors) -> tuple[np.ndarray, np.ndarray, _Local]:
    """Information and gradient of theta with every segment's state at its best."""
    k = len(point.theta)
    N = np.einsum("wcij,c->wij", point.normal.gram, 1.0 / point.R)
    A = N[:, 1 : k + 1, 1 : k + 1].sum(axis=0) + np.diag(prior.precision)
    g = N[:, 1 : k + 1, 0].sum(axis=0) - prior.precision * (point.theta - prior.mean)
    own = N[:, k + 1 :, k + 1 :] + np.diag(prior.states)
    cross, gradient = N[:, k + 1 :, 1 : k + 1], N[:, k + 1 :, 0] - prior.states * point.departure
    # By Cholesky factors: where a trial is unstable, A less cross' own^-1 cross loses all its digits otherwise.
    L = np.linalg.cholesky(own)
    Y, y = np.linalg.solve(L, cross), np.linalg.solve(L, gradient[:, :, None])[:, :, 0]
    A = A - np.einsum("wia,wib->ab", Y, Y)
    g = g - np.einsum("wia,wi->a", Y, y)
    gain = 0.5 * float(np.sum(y**2))
    inverse = np.linalg.inv(L)
    inverse = np.swapaxes(inverse, 1, 2) @ inverse
    return A, g, _Local(inverse, cross, gradient, gain)


def _result(
    flown: Flown,
    point: _Point,
    prior: Priors,
    converged: bool,
    iterations: int,
    active: np.ndarray,
    rest: np.ndarray,
) -> OutputErrorResult:
    known = math.isfinite(point.cost)
    A = _reduced(point, prior)[0] if known else np.diag(prior.precision)
    free = flown.dynamics.free
    at_bound = tuple(p.name for p, a in zip(free, active & ~rest, strict=True) if a)
    if point.normal.inside < 1.0:
        status = OutputErrorStatus.LEFT_ENVELOPE
    elif not converged:
        status = OutputErrorStatus.NOT_CONVERGED
    else:
        status = OutputErrorStatus.AT_BOUND if at_bound else OutputErrorStatus.CONVERGED
    moving = np.ix_(~rest, ~rest)
    scale = np.sqrt(np.diag(A)[~rest])
    covariance = np.zeros_like(A)
    covariance[moving] = np.linalg.pinv(A[moving] / np.outer(scale, scale), hermitian=True) / np.outer(scale, scale)
    return OutputErrorResult(
        flown=flown,
        parameters=free,
        estimate=point.theta,
        departure=point.departure,
        R=point.R,
        cost=point.cost,
        covariance=covariance,
        information=A - np.diag(prior.precision),
        priors=prior,
        rms=np.sqrt(point.normal.gram[:, :, 0, 0] / np.maximum(point.normal.count, 1.0)[:, None]),
        status=status,
        iterations=iterations,
        at_bound=at_bound,
        thinned=point.normal.thinned,
    )


def fit_cascade(
    stages: Sequence[Flown],
    starts: Sequence[Float[np.ndarray, " k"]],
    *,
    held: Mapping[str, float] | None = None,
    prior_weight: float = 1.0,
) -> OutputErrorResult:
    """Fit the first stage's short windows from every start, then each later stage from the best so far.

    Windows keep an unstable or poorly started simulation on its path, but hide slow errors of the model; so the last
    stage should be whole manoeuvres.
    """
    first = [fit_output_error(stages[0], start=s, held=held, prior_weight=prior_weight, most=EARLY) for s in starts]
    best = min(first, key=lambda found: (found.status is OutputErrorStatus.LEFT_ENVELOPE, found.cost))
    for number, stage in enumerate(stages[1:], start=2):
        most = MAX_ITERATIONS if number == len(stages) else EARLY
        best = fit_output_error(stage, start=best.estimate, held=held, prior_weight=prior_weight, most=most)
    return best
