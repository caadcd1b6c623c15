"""Filter error with a constant gain: parameters and process noise such that one-step predictions follow the measured.

Gauss-Newton on the innovations; the diagonal covariance R of the innovations is re-estimated before every step (cost
det R), and with it the process noise so that the gain stays about where it was. Source: Jategaonkar, *Flight Vehicle
System Identification*, 2nd ed. 2015, ch. 5; Maine and Iliff 1981, SIAM J. Appl. Math. 41, 558 (R and F by turns).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from bayes_aero.dynamics.filtering.innovations import Innovations, measurement_matrix, steady_innovations
from bayes_aero.dynamics.segments import SegmentTrajectories
from bayes_aero.inference.likelihood.mle import solve
from bayes_aero.inference.likelihood.scoring import covariance_of

MAX_ITERATIONS, HALVINGS = 60, 12
SETTLED = 1e-9  # relative change of det R; the published programs stop at 1e-4, short of the optimum
LEAST_F = 1e-12
EARLY, ROUGH = 8, 1e-2  # of output error, from which the filter starts
UP = 0.05  # of log det R that a step may cost: R and F take turns, and a limit may have to be regained
MOST_TAKEN = 1.0  # diag(K C): no more of a state's error can be corrected than all of it (Maine and Iliff 1981)


class FilterErrorStatus(Enum):
    """How a fit ended."""

    CONVERGED = "converged"
    NOT_CONVERGED = "not converged"
    DIVERGED = "the filter diverged"
    GAIN_AT_LIMIT = "a state is corrected by all of its error: diag(K C) is at 1"


@dataclass(frozen=True)
class FilterErrorResult:
    """Estimates and Cramér-Rao bounds of parameters (k,) and process noise F (s,); innovations' variances R (c,).

    Standard errors do not count the limit on the gain, where it is reached, nor autocorrelation of the innovations.
    """

    names: tuple[str, ...]
    states: tuple[str, ...]
    outputs: tuple[str, ...]
    estimate: Float[np.ndarray, " k"]
    sd: Float[np.ndarray, " k"]
    F: Float[np.ndarray, " s"]
    F_sd: Float[np.ndarray, " s"]
    R: Float[np.ndarray, " c"]
    found: Innovations
    status: FilterErrorStatus
    iterations: int

    @property
    def det_R(self) -> float:
        """Determinant of the diagonal covariance of the innovations."""
        return float(np.prod(self.R))


_measurement_matrix = eqx.filter_jit(measurement_matrix)


@eqx.filter_jit
def _innovations(flown, theta, F, R):
    return steady_innovations(flown, theta, jnp.zeros((len(flown.index), len(flown.dynamics.states))), F, R)


@eqx.filter_jit
def _slopes(flown, theta, F, R):
    """Innovations (w n c) and diag(K C) (w s), and their derivatives by theta and log F, the last axis."""
    nothing, k = jnp.zeros((len(flown.index), len(flown.dynamics.states))), len(theta)

    def at(point):
        found = steady_innovations(flown, point[:k], nothing, jnp.exp(point[k:]), R)
        return found.innovation, found.taken

    point = jnp.concatenate([theta, jnp.log(F)])
    return jax.vmap(lambda t: jax.jvp(at, (point,), (t,)), out_axes=(None, -1))(jnp.eye(len(point)))


def fit_filter_error(
    flown: SegmentTrajectories,
    F: Float[np.ndarray, " s"],
    *,
    start: Float[np.ndarray, " k"] | None = None,
    held: Mapping[str, float] | None = None,
    F_held: bool = False,
) -> FilterErrorResult:
    """Fit all segments, each from its fixed or measured initial state, from one start (default: the parameters' own).

    Args:
        flown: segments of flights; no priors and no free initial states.
        F: process noise by state to start from, (s,), unit of the state per square root of a second.
        start: parameters, (k,). Those `held` keep their value.
        F_held: the process noise keeps its value, and R alone is re-estimated.
    """
    flown, held = flown.nameless, held or {}
    free = flown.dynamics.free
    k, s = len(free), len(flown.dynamics.states)
    theta = np.array([p.start for p in free]) if start is None else np.asarray(start, float)
    theta = np.array([held.get(p.name, x) for p, x in zip(free, theta, strict=True)])
    moving = np.array([*(p.name not in held for p in free), *([not F_held] * s)])
    count = int(flown.inside.sum())
    F = np.maximum(np.asarray(F, float), LEAST_F)
    first = F if F_held else np.full(s, LEAST_F)
    point = _Point.of(flown, theta, first, np.ones(len(flown.outputs)), count)
    point = _descend(flown, point, count, np.append(moving[:k], np.zeros(s, bool)), most=EARLY, settled=ROUGH)[0]
    point = _started(flown, point, F, count, F_held)
    point, information, iterations, status = _descend(flown, point, count, moving, MAX_ITERATIONS, SETTLED)
    if not np.all(np.isfinite(point.R)):
        status = FilterErrorStatus.DIVERGED
    elif status is FilterErrorStatus.CONVERGED and np.any(np.asarray(point.found.taken) > MOST_TAKEN - 1e-3):
        status = FilterErrorStatus.GAIN_AT_LIMIT
    covariance = covariance_of(information, moving)
    sd = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    names = tuple(p.name for p in free)
    return FilterErrorResult(
        names,
        flown.dynamics.states,
        flown.outputs,
        point.theta,
        sd[:k],
        point.F,
        point.F * sd[k:],
        point.R,
        point.found,
        status,
        iterations,
    )


class _Point(NamedTuple):
    """Parameters, process noise, and the innovations with their variances under the gain that belongs to these."""

    theta: Float[np.ndarray, " k"]
    F: Float[np.ndarray, " s"]
    R: Float[np.ndarray, " c"]
    found: Innovations

    @classmethod
    def of(cls, flown: SegmentTrajectories, theta, F, R, count: int) -> _Point:
        """R is that of the innovations, the gain that of the R given."""
        found = _innovations(flown, *(jnp.asarray(x) for x in (theta, F, R)))
        return cls(theta, F, np.asarray(jnp.sum(found.innovation**2, axis=(0, 1))) / count, found)

    @property
    def cost(self) -> float:
        """log det R; nan where the filter diverged."""
        return float(np.sum(np.log(self.R)))


def _started(flown: SegmentTrajectories, point: _Point, F: np.ndarray, count: int, F_held: bool) -> _Point:
    """The filter from output error's estimates; F is lowered until predictions are better than without it."""
    for _ in range(60):
        new = _Point.of(flown, point.theta, F, point.R, count)
        if F_held or (new.cost < point.cost and np.max(np.asarray(new.found.taken)) < MOST_TAKEN):
            break
        F = 0.5 * F
    return new


def _descend(
    flown: SegmentTrajectories, point: _Point, count: int, moving: Bool[np.ndarray, " j"], most: int, settled: float
) -> tuple[_Point, Float[np.ndarray, "j j"], int, FilterErrorStatus]:
    """Gauss-Newton from `point` on what is `moving`: the last point, its information, steps, status."""
    k, s = len(point.theta), len(point.F)
    information, status, steps = np.eye(k + s), FilterErrorStatus.NOT_CONVERGED, 0
    while steps < most and math.isfinite(point.cost):
        steps += 1
        seen = _slopes(flown, *(jnp.asarray(x) for x in (point.theta, point.F, point.R)))
        (e, taken), (slopes, taken_slopes) = jax.tree.map(np.asarray, seen)
        weighted = np.nan_to_num(slopes) / np.sqrt(point.R)[:, None]
        information = np.einsum("wnci,wncj->ij", weighted, weighted)
        gradient = -np.einsum("wnci,wnc->i", weighted, e / np.sqrt(point.R))
        step = np.zeros(k + s)
        limits = (taken_slopes.reshape(-1, k + s)[:, moving], MOST_TAKEN - taken.reshape(-1))
        step[moving] = limited_step(information[np.ix_(moving, moving)], gradient[moving], *limits)
        better = None
        for halving in range(HALVINGS):
            part = 0.5**halving * step
            theta, F = point.theta + part[:k], point.F * np.exp(np.clip(part[k:], -2.0, 2.0))
            new = _Point.of(flown, theta, F, point.R, count)
            if math.isfinite(new.cost) and moving[k:].any():
                new = _Point.of(flown, theta, _rescaled(flown, F, point.R, new.R, theta), new.R, count)
            within = float(np.max(np.asarray(new.found.taken))) < max(MOST_TAKEN, float(np.max(taken)))
            if math.isfinite(new.cost) and (new.cost < point.cost + UP or (np.max(taken) > MOST_TAKEN and within)):
                better = new
                break
        if better is None:
            break
        change, point = point.cost - better.cost, better
        if abs(change) < settled:
            status = FilterErrorStatus.CONVERGED
            break
    return point, information, steps, status


def limited_step(
    A: Float[np.ndarray, "k k"],
    g: Float[np.ndarray, " k"],
    slopes: Float[np.ndarray, "m k"],
    room: Float[np.ndarray, " m"],
) -> Float[np.ndarray, " k"]:
    """The step of least 1/2 d A d - g d with slopes d <= room: Newton's, on the limits that it would cross."""
    active: list[int] = []
    newton = solve(A, g, 0.0)
    step = newton
    for _ in range(2 * len(room)):
        if active:
            B = slopes[active]
            back = np.stack([solve(A, b, 0.0) for b in B], axis=1)
            force = np.linalg.lstsq(B @ back, B @ newton - room[active], rcond=None)[0]
            if np.any(force < 0.0):  # it may leave this limit
                active.pop(int(np.argmin(force)))
                step = newton
                continue
            step = newton - back @ force
        over = slopes @ step - room
        worst = int(np.argmax(over))
        if over[worst] <= 1e-10 or worst in active:
            break
        active.append(worst)
    return step


def _rescaled(
    flown: SegmentTrajectories,
    F: Float[np.ndarray, " s"],
    old: Float[np.ndarray, " c"],
    new: Float[np.ndarray, " c"],
    theta: Float[np.ndarray, " k"],
) -> Float[np.ndarray, " s"]:
    """F such that the gain stays about where it was while R goes from `old` to `new`."""
    C = np.asarray(_measurement_matrix(flown, jnp.asarray(theta)))
    weight = C**2 / old[:, None]
    return F * np.einsum("cs,c->s", weight, np.sqrt(new / old)) / np.maximum(weight.sum(axis=0), 1e-300)
