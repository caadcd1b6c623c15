"""Filter error with a constant gain: parameters and process noise such that one-step predictions follow the measured.

Gauss-Newton on the innovations; the diagonal covariance R of the innovations is re-estimated before every step (cost
det R), and the process noise with it so that the gain stays about constant. Source: Jategaonkar, *Flight Vehicle
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
from bayes_aero.inference.likelihood.fisher_scoring import covariance_of
from bayes_aero.inference.likelihood.mle import solve

MAX_ITERATIONS, MAX_HALVINGS = 60, 12
TOLERANCE = 1e-9  # relative change of det R; the published programs stop at 1e-4, short of the optimum
MIN_F = 1e-12
EARLY_ITERATIONS, EARLY_TOLERANCE = 8, 1e-2  # of the fit without process noise from which the filter starts
MAX_COST_RISE = 0.05  # of log det R in a step: R and F are estimated in turns, and a step may return to the limit
MAX_SHARE = 1.0  # diag(K C): the filter cannot correct more than the whole error of a state (Maine and Iliff 1981)


class FilterErrorStatus(Enum):
    """How a fit ended."""

    CONVERGED = "converged"
    NOT_CONVERGED = "not converged"
    DIVERGED = "the filter diverged"
    GAIN_AT_LIMIT = "the filter corrects the whole error of a state: diag(K C) is at its limit of 1"


@dataclass(frozen=True)
class FilterErrorResult:
    """Estimates and Cramér-Rao bounds of parameters (k,) and process noise F (s,); variances R (c,) of the innovations.

    The standard errors account neither for the limit of the gain nor for autocorrelation of the innovations.
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
    """Innovations (w n c) and diag(K C) (w s), and their derivatives by theta and log F (the last axis)."""
    nothing, k = jnp.zeros((len(flown.index), len(flown.dynamics.states))), len(theta)

    def at(point):
        found = steady_innovations(flown, point[:k], nothing, jnp.exp(point[k:]), R)
        return found.innovation, found.correction_share

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
    """Fit all segments together, each from its fixed or measured initial state.

    Args:
        flown: segments of flights; without priors and without free initial states.
        F: process noise by state to start from, (s,), unit of the state per square root of a second.
        start: parameters, (k,); default: the starting values of the model.
        held: parameters that are not estimated, and their values.
        F_held: whether the process noise is held; R alone is then re-estimated.
    """
    flown, held = flown.nameless, held or {}
    free = flown.dynamics.free
    k, s = len(free), len(flown.dynamics.states)
    theta = np.array([p.start for p in free]) if start is None else np.asarray(start, float)
    theta = np.array([held.get(p.name, x) for p, x in zip(free, theta, strict=True)])
    moving = np.array([*(p.name not in held for p in free), *([not F_held] * s)])
    count = int(flown.inside.sum())
    F = np.maximum(np.asarray(F, float), MIN_F)
    first = F if F_held else np.full(s, MIN_F)
    point = _Point.at(flown, theta, first, np.ones(len(flown.outputs)), count)
    early = np.append(moving[:k], np.zeros(s, bool))
    point = _descend(flown, point, count, early, EARLY_ITERATIONS, EARLY_TOLERANCE)[0]
    point = _start_filter(flown, point, F, count, F_held)
    point, information, iterations, status = _descend(flown, point, count, moving, MAX_ITERATIONS, TOLERANCE)
    if not np.all(np.isfinite(point.R)):
        status = FilterErrorStatus.DIVERGED
    elif status is FilterErrorStatus.CONVERGED and point.share > MAX_SHARE - 1e-3:
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
    """Parameters, process noise, and the innovations with their variances R."""

    theta: Float[np.ndarray, " k"]
    F: Float[np.ndarray, " s"]
    R: Float[np.ndarray, " c"]
    found: Innovations

    @classmethod
    def at(cls, flown: SegmentTrajectories, theta, F, R, count: int) -> _Point:
        """Evaluate the innovations with the gain of the given R; the point has their own R."""
        found = _innovations(flown, *(jnp.asarray(x) for x in (theta, F, R)))
        return cls(theta, F, np.asarray(jnp.sum(found.innovation**2, axis=(0, 1))) / count, found)

    @property
    def cost(self) -> float:
        """log det R; nan where the filter diverged."""
        return float(np.sum(np.log(self.R)))

    @property
    def share(self) -> float:
        """Largest share of a state's error that the filter corrects at a sample, max diag(K C)."""
        return float(np.max(np.asarray(self.found.correction_share)))


def _start_filter(flown: SegmentTrajectories, point: _Point, F: np.ndarray, count: int, F_held: bool) -> _Point:
    """The filter at the estimates of output error; F is halved until predictions are better than without it."""
    for _ in range(60):
        new = _Point.at(flown, point.theta, F, point.R, count)
        if F_held or (new.cost < point.cost and new.share < MAX_SHARE):
            break
        F = 0.5 * F
    return new


def _descend(
    flown: SegmentTrajectories,
    point: _Point,
    count: int,
    moving: Bool[np.ndarray, " j"],
    max_iterations: int,
    tolerance: float,
) -> tuple[_Point, Float[np.ndarray, "j j"], int, FilterErrorStatus]:
    """Gauss-Newton from `point` in the `moving` variables: the last point, its information, steps, status."""
    k, s = len(point.theta), len(point.F)
    information, status, steps = np.eye(k + s), FilterErrorStatus.NOT_CONVERGED, 0
    while steps < max_iterations and math.isfinite(point.cost):
        steps += 1
        evaluated = _slopes(flown, *(jnp.asarray(x) for x in (point.theta, point.F, point.R)))
        (e, shares), (slopes, share_slopes) = jax.tree.map(np.asarray, evaluated)
        weighted = np.nan_to_num(slopes) / np.sqrt(point.R)[:, None]
        information = np.einsum("wnci,wncj->ij", weighted, weighted)
        gradient = -np.einsum("wnci,wnc->i", weighted, e / np.sqrt(point.R))
        step = np.zeros(k + s)
        limits = (share_slopes.reshape(-1, k + s)[:, moving], MAX_SHARE - shares.reshape(-1))
        step[moving] = constrained_step(information[np.ix_(moving, moving)], gradient[moving], *limits)
        better = None
        for halving in range(MAX_HALVINGS):
            part = 0.5**halving * step
            theta, F = point.theta + part[:k], point.F * np.exp(np.clip(part[k:], -2.0, 2.0))
            new = _Point.at(flown, theta, F, point.R, count)
            if math.isfinite(new.cost) and moving[k:].any():
                new = _Point.at(flown, theta, _rescale_process_noise(flown, F, point.R, new.R, theta), new.R, count)
            within = new.share < max(MAX_SHARE, float(np.max(shares)))
            returning = np.max(shares) > MAX_SHARE and within
            if math.isfinite(new.cost) and (new.cost < point.cost + MAX_COST_RISE or returning):
                better = new
                break
        if better is None:
            break
        change, point = point.cost - better.cost, better
        if abs(change) < tolerance:
            status = FilterErrorStatus.CONVERGED
            break
    return point, information, steps, status


def constrained_step(
    A: Float[np.ndarray, "k k"],
    g: Float[np.ndarray, " k"],
    slopes: Float[np.ndarray, "m k"],
    margin: Float[np.ndarray, " m"],
) -> Float[np.ndarray, " k"]:
    """The step d that minimises 1/2 d A d - g d with slopes d <= margin, by active constraints."""
    active: list[int] = []
    newton = solve(A, g, 0.0)
    step = newton
    for _ in range(2 * len(margin)):
        if active:
            B = slopes[active]
            back = np.stack([solve(A, b, 0.0) for b in B], axis=1)
            force = np.linalg.lstsq(B @ back, B @ newton - margin[active], rcond=None)[0]
            if np.any(force < 0.0):  # this constraint does not hold the step
                active.pop(int(np.argmin(force)))
                step = newton
                continue
            step = newton - back @ force
        over = slopes @ step - margin
        worst = int(np.argmax(over))
        if over[worst] <= 1e-10 or worst in active:
            break
        active.append(worst)
    return step


def _rescale_process_noise(
    flown: SegmentTrajectories,
    F: Float[np.ndarray, " s"],
    old: Float[np.ndarray, " c"],
    new: Float[np.ndarray, " c"],
    theta: Float[np.ndarray, " k"],
) -> Float[np.ndarray, " s"]:
    """F that keeps the gain about constant while R changes from `old` to `new`."""
    C = np.asarray(_measurement_matrix(flown, jnp.asarray(theta)))
    weight = C**2 / old[:, None]
    return F * np.einsum("cs,c->s", weight, np.sqrt(new / old)) / np.maximum(weight.sum(axis=0), 1e-300)
