"""Normal equations of an output-error step: residuals, sensitivities, their products, and the priors.

Initial states belong to one segment each and are eliminated there.
"""

from __future__ import annotations

import math
import os
from collections.abc import Collection
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from bayes_aero.dynamics.aircraft.effect_system import POINTS
from bayes_aero.dynamics.flight import Dynamics
from bayes_aero.dynamics.segments import SegmentTrajectories, simulate
from bayes_aero.inference.threads import cores

DEPARTURE = {"airspeed": 1.0, "alpha": 0.01, "theta": 0.01, "q": 0.01, "altitude": 3.0} | dict.fromkeys(POINTS, 0.1)
"""Standard deviation of the measured initial state, SI: what the sensors of a flight test allow; our choice."""
OTHER_DEPARTURE = {"m/s": 1.0, "m": 3.0}  # by the unit of a state of another name
REST_DEPARTURE = 0.05
TINY, HUGE = 1e-300, 1e100  # a sensitivity beyond HUGE is that of a motion that is not unique
TRACE = 1e-12  # of a diagonal: beyond rounding, within nothing that a record tells
OUTSIDE = 1e6  # cost of a trajectory that is all outside the envelope: worse than any inside


def departures(dynamics: Dynamics) -> Float[np.ndarray, " s"]:
    """Standard deviations of the measured initial state, SI."""
    own = {name: OTHER_DEPARTURE.get(unit, REST_DEPARTURE) for name, unit in dynamics.units.items()}
    return np.array([DEPARTURE.get(name, own.get(name, REST_DEPARTURE)) for name in dynamics.start])


@dataclass(frozen=True)
class Priors:
    """Normal priors of the step: mean and precision of theta (k,) and of the states' departures (s,).

    Precisions have been multiplied by `weight`: what coloured residuals cost the likelihood; 0: there are no priors.
    `fixed`: the initial states do not depart from where they begin.
    """

    mean: Float[np.ndarray, " k"]
    precision: Float[np.ndarray, " k"]
    states: Float[np.ndarray, " s"]
    weight: float = 1.0
    fixed: bool = False

    @classmethod
    def of(cls, flown: SegmentTrajectories, weight: float, without: Collection[str] = ()) -> Priors:
        """All priors as normals, counted `weight` times; parameters `without` one have none."""
        pairs = np.array([p.prior.normal for p in flown.dynamics.free]).reshape(-1, 2)
        deviations = departures(flown.dynamics)
        believed = np.array([p.name not in without for p in flown.dynamics.free], float)
        precisions = weight * believed * pairs[:, 1] ** -2.0, weight * deviations**-2.0
        return cls(pairs[:, 0], *precisions, weight, flown.fixed is not None)


class Normal(NamedTuple):
    """Inner products of residual and sensitivities: (w, c, 1 + k + s, 1 + k + s), samples (w,), and what was inside.

    `columns` are residual and sensitivities themselves, (w, n, c, 1 + k + s) in parts that follow each other along w,
    both in deviations of attached flow where the noise swells.
    """

    gram: Float[np.ndarray, "w c j j"]
    count: Float[np.ndarray, " w"]
    inside: float
    columns: tuple[np.ndarray, ...]


@eqx.filter_jit
def _normal(flown: SegmentTrajectories, theta: Float[Array, " k"], departure: Float[Array, "w s"]):
    """Grams, samples inside the envelope, columns; sensitivities forward, in all directions at once."""
    k, s = theta.shape[0], departure.shape[1]

    def residual(theta, shared):
        found = simulate(flown, theta, departure + shared)
        return found.residual, found.trajectory.inside

    point = (theta, jnp.zeros(s))
    towards = (jnp.concatenate([jnp.eye(k), jnp.zeros((s, k))]), jnp.concatenate([jnp.zeros((k, s)), jnp.eye(s)]))
    r, slope, inside = jax.vmap(lambda t: jax.jvp(residual, point, t, has_aux=True), out_axes=(None, -1, None))(towards)
    columns = jnp.concatenate([r[..., None], -slope], axis=-1) / flown.noise_growth[..., None]  # w n c j
    return jnp.einsum("wnci,wncj->wcij", columns, columns), jnp.sum(inside & flown.inside, axis=1), columns


class NormalEquations:
    """Looks at one set of segments from many points; the segments are shared out among the cores.

    XLA leaves a scan to one of them. The first look is taken part by part, lest every thread compile for itself. A part
    of which no sample counts is not flown: it says nothing.
    """

    def __init__(self, flown: SegmentTrajectories, prior: Priors):
        w = len(flown.index)
        size = -(-w // min(w, os.cpu_count() or 1))
        self.prior = prior
        self.count = flown.inside.sum(axis=1).astype(float)
        self.noise_growth = float(np.log(flown.noise_growth[flown.inside]).sum())
        self._rows = [np.minimum(np.arange(a, a + size), w - 1) for a in range(0, w, size)]  # the last may repeat
        self._parts = {
            number: jax.tree.map(jnp.asarray, flown.nameless.part(rows))
            for number, rows in enumerate(self._rows)
            if flown.inside[rows].any()
        }
        self._compiled = False

    def __call__(self, theta: Float[np.ndarray, " k"], departure: Float[np.ndarray, "w s"]) -> Point:
        """Cost and normal equations there."""
        at, w = jnp.asarray(theta), len(departure)

        def one(number):
            found = _normal(self._parts[number], at, jnp.asarray(departure[self._rows[number]]))
            return tuple(np.asarray(x) for x in found)

        if len(self._parts) > 1 and self._compiled:
            with ThreadPoolExecutor(min(len(self._parts), cores())) as pool:
                found = dict(zip(self._parts, pool.map(one, self._parts), strict=True))
        else:
            found = {number: one(number) for number in self._parts}
        self._compiled = True
        silent = tuple(np.zeros_like(x) for x in next(iter(found.values())))
        gram, within, columns = zip(*(found.get(i, silent) for i in range(len(self._rows))), strict=True)
        gram, within = np.concatenate(gram)[:w], np.concatenate(within)[:w]
        normal = Normal(gram, self.count, float(within.sum() / self.count.sum()), columns)
        return _point(theta, departure, normal, self.prior, self.noise_growth)

    def ahead(self, point: Point, step: Float[np.ndarray, " k"], own: Float[np.ndarray, "w s"]) -> Point:
        """What would be seen after a step of parameters and initial states so short that residuals are linear in it."""
        w = len(own)
        all_steps = np.concatenate([np.tile(step, (w, 1)), own], axis=1)
        turned = np.tile(np.eye(1 + all_steps.shape[1]), (w, 1, 1))
        turned[:, 1:, 0] = -all_steps
        gram = np.einsum("wia,wcij,wjb->wcab", turned, point.normal.gram, turned, optimize=True)
        columns = []
        for rows, part in zip(self._rows, point.normal.columns, strict=True):
            moved = part.copy()
            moved[..., 0] -= np.einsum("wncj,wj->wnc", part[..., 1:], all_steps[rows])
            columns.append(moved)
        normal = point.normal._replace(gram=gram, columns=tuple(columns))
        return _point(point.theta + step, point.departure + own, normal, self.prior, self.noise_growth)


class Point(NamedTuple):
    """Where a look was taken, and what was seen."""

    theta: Float[np.ndarray, " k"]
    departure: Float[np.ndarray, "w s"]
    normal: Normal
    R: Float[np.ndarray, " c"]
    cost: float


def _point(theta: np.ndarray, departure: np.ndarray, normal: Normal, prior: Priors, noise_growth: float) -> Point:
    """`noise_growth`: sum of its logarithms over all samples and outputs, which the likelihood holds."""
    gram, total = normal.gram, normal.count.sum()
    if not np.all(np.abs(gram) < HUGE):
        return Point(theta, departure, normal._replace(inside=0.0), np.ones(gram.shape[1]), math.inf)
    R = np.maximum(gram[:, :, 0, 0].sum(axis=0) / total, TINY)
    cost = 0.5 * total * float(np.sum(np.log(R))) + noise_growth
    cost += 0.5 * float(prior.precision @ (theta - prior.mean) ** 2) + 0.5 * float(np.sum(departure**2 @ prior.states))
    if normal.inside < 1.0:
        cost += OUTSIDE * (1.0 - normal.inside)
    return Point(theta, departure, normal, R, cost)


class Local(NamedTuple):
    """What was eliminated: the segments' own states, given the step of theta."""

    inverse: Float[np.ndarray, "w s s"]
    cross: Float[np.ndarray, "w s k"]
    gradient: Float[np.ndarray, "w s"]
    gain: float

    @classmethod
    def none(cls, w: int, s: int, k: int) -> Local:
        """Of initial states that are fixed."""
        return cls(np.zeros((w, s, s)), np.zeros((w, s, k)), np.zeros((w, s)), 0.0)

    def step(self, theta: Float[np.ndarray, " k"]) -> Float[np.ndarray, "w s"]:
        """Best departure of every segment after a step of theta."""
        return np.einsum("wij,wj->wi", self.inverse, self.gradient - self.cross @ theta)


def _cholesky(own: Float[np.ndarray, "w s s"]) -> Float[np.ndarray, "w s s"]:
    """Factors; where rounding has eaten the smallest directions of an unstable flight, with a trace of the diagonal."""
    own = own + np.eye(own.shape[-1]) * (own == 0.0)  # no record and no prior says anything: it stays where it is
    try:
        return np.linalg.cholesky(own)
    except np.linalg.LinAlgError:
        return np.linalg.cholesky(own + TRACE * own * np.eye(own.shape[-1]))


def reduced(point: Point, prior: Priors) -> tuple[Float[np.ndarray, "k k"], Float[np.ndarray, " k"], Local]:
    """Information and gradient of theta with every segment's state at its best, priors counted."""
    A, g, local = by_segment(point, prior)
    A = A.sum(axis=0) + np.diag(prior.precision)
    return A, g.sum(axis=0) - prior.precision * (point.theta - prior.mean), local


def by_segment(point: Point, prior: Priors) -> tuple[Float[np.ndarray, "w k k"], Float[np.ndarray, "w k"], Local]:
    """The same of each segment alone, without the priors of theta."""
    k = len(point.theta)
    N = np.einsum("wcij,c->wij", point.normal.gram, 1.0 / point.R)
    if prior.fixed:
        w, s = point.departure.shape
        return N[:, 1 : k + 1, 1 : k + 1], N[:, 1 : k + 1, 0], Local.none(w, s, k)
    own = N[:, k + 1 :, k + 1 :] + np.diag(prior.states)
    cross, gradient = N[:, k + 1 :, 1 : k + 1], N[:, k + 1 :, 0] - prior.states * point.departure
    # By Cholesky factors: where a trial is unstable, A less cross' own^-1 cross loses all its digits otherwise.
    L = _cholesky(own)
    Y, y = np.linalg.solve(L, cross), np.linalg.solve(L, gradient[:, :, None])[:, :, 0]
    A = N[:, 1 : k + 1, 1 : k + 1] - np.einsum("wia,wib->wab", Y, Y)
    g = N[:, 1 : k + 1, 0] - np.einsum("wia,wi->wa", Y, y)
    gain = 0.5 * float(np.sum(y**2))
    inverse = np.linalg.inv(L)
    inverse = np.swapaxes(inverse, 1, 2) @ inverse
    return A, g, Local(inverse, cross, gradient, gain)
